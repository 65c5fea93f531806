"""Cases of the box: rays that start on its faces, surfaces that lie in them, lattice lines, and holes in the volume."""

import numpy as np

from benchmarks.stability.case import Outcome, Size, case
from benchmarks.stability.closed import CLOSED, MIDDLE, RADIUS, SIDE
from benchmarks.stability.leaks import GROUP, TOUCH, ZEROS
from benchmarks.stability.surface import ARITHMETICS, surface_of

AHEAD = 5.0
"""Voxels before the box, where rays along lattice lines start."""


@case(
    GROUP,
    "behind and on the box",
    "what lies behind a ray is not met; from a face of the box it meets what it meets from outside",
    1e-9,
    "voxels",
)
def on_faces(size: Size) -> Outcome:
    """Rays that begin on a face of the box, inwards and outwards, against those that come from outside."""
    rng, count = np.random.default_rng(15), size.pick(2_000, 100_000)
    faces, axes = rng.uniform(0.0, SIDE - 1.0, (count, 3)), rng.integers(0, 3, count)
    at, lanes = rng.choice([0.0, SIDE - 1.0], count), np.arange(count)
    faces[lanes, axes] = at
    directions = MIDDLE + rng.normal(size=faces.shape) * 4.0 - faces
    noise = surface_of(CLOSED["noise"][0](), 0.3)
    worst, behind = 0.0, 0
    for by in ARITHMETICS:
        here, _ = noise.cast(faces, directions, by=by)
        outside, _ = noise.cast(faces - directions, directions, by=by)
        both = np.isfinite(here) & np.isfinite(outside)
        same = np.array_equal(np.isfinite(here), both)
        worst = max(worst, float(abs(here - outside + 1.0)[both].max()) if same else np.inf)
        behind += sum(int(np.isfinite(noise.cast(p, -directions, by=by)[0]).sum()) for p in (faces, faces - directions))
    return Outcome(worst if not behind else np.inf, f"of {count:,} rays; {behind} met what lies behind")


@case(GROUP, "a surface on the box's faces", "it is met all over by rays from outside, at the face", 1e-4, "voxels")
def surface_on_faces(size: Size) -> Outcome:
    """The faces hold the isovalue, and all is solid within."""
    rng, count = np.random.default_rng(18), size.pick(3_000, 300_000)
    solid = surface_of(np.pad(1.0 + rng.random((SIDE - 2,) * 3), 1), 0.0)
    away = rng.normal(size=(count, 3)) * 10.0 ** rng.uniform(0.0, 6.0, (count, 1))
    origins = MIDDLE + away + SIDE * np.sign(away)
    directions = rng.uniform(0.0, SIDE - 1.0, origins.shape) - origins
    worst = 0.0
    for by in ARITHMETICS:
        t, _ = solid.cast(origins, directions, by=by)
        met = origins + np.where(np.isfinite(t), t, 0.0)[:, None] * directions
        worst = max(worst, float(abs(abs(met - MIDDLE).max(axis=1) - MIDDLE).max()))
    return Outcome(worst, f"of {count:,} rays")


@case(
    GROUP, "lattice lines", "along edges and faces of cells a ray meets what linear interpolation says", 1e-6, "voxels"
)
def lattice_lines(size: Size) -> Outcome:
    """Rays along every axis, through voxels and half-way between, the other components 0, -0, subnormal or tiny."""
    rng, count, worst = np.random.default_rng(20), size.pick(500, 30_000), 0.0
    noise = surface_of(rng.random((SIDE, SIDE, SIDE)), 0.5)
    for axis, sign in ((axis, sign) for axis in range(3) for sign in (1, -1)):
        origins, directions = rng.integers(1, 2 * SIDE - 3, (count, 3)) / 2.0, rng.choice(ZEROS, (count, 3))
        along = np.repeat(origins, SIDE, axis=0).reshape(count, SIDE, 3)
        along[..., axis] = np.arange(SIDE)[::sign]
        expected = first_change(noise.height(along.reshape(-1, 3)).reshape(count, SIDE))
        origins[:, axis], directions[:, axis] = MIDDLE - sign * (MIDDLE + AHEAD), sign
        for by in ARITHMETICS:
            found = noise.cast(origins, directions, by=by)[0] - AHEAD
            same = np.isfinite(found) == np.isfinite(expected)
            met = np.isfinite(found) & same
            worst = max(worst, float(abs(found - expected)[met].max()), 0.0 if same.all() else np.inf)
    return Outcome(worst, f"of {6 * count:,} rays")


def first_change(heights: np.ndarray) -> np.ndarray:
    """Where the heights (n, m) of points a step apart, joined by lines, first pass 0: in steps, inf where nowhere."""
    solid = heights > 0.0
    changes = solid[:, 1:] != solid[:, :-1]
    rows, first = np.arange(len(heights)), changes.argmax(axis=1)
    low, high = heights[rows, first], heights[rows, first + 1]
    return np.where(changes.any(axis=1), first + low / np.where(low == high, 1.0, low - high), np.inf)


@case(GROUP, "a hole", "a voxel that is no number takes the surface of its eight cells and of no other", 0, "rays")
def hole(size: Size) -> Outcome:
    """Rays at a ball about a voxel of its skin, with the voxel there and without: NaN, and ± infinity."""
    rng, count, wrong, gone = np.random.default_rng(12), size.pick(2_000, 100_000), 0, 0
    ball, level = CLOSED["ball"][0](), 0.0
    whole = surface_of(ball, level)
    for nothing, place in zip((np.nan, np.inf, -np.inf), ((32, 20, 20), (26, 26, 28), (20, 31, 21)), strict=True):
        pierced = ball.copy()
        pierced[place[::-1]] = nothing
        out = (np.array(place) - MIDDLE) / RADIUS + 0.5 * rng.normal(size=(count, 3))
        origins = MIDDLE + 19.0 * out / np.linalg.norm(out, axis=1, keepdims=True)
        directions = np.array(place) + 0.7 * rng.normal(size=origins.shape) - origins
        for by in ARITHMETICS:
            before, after = (s.cast(origins, directions, by=by)[0] for s in (whole, surface_of(pierced, level)))
            lost = beside(before, origins, directions, place, 1.0 - TOUCH)
            late = before < np.where(np.isfinite(after), after, np.inf) - 1e-9
            elsewhere = late & ~beside(before, origins, directions, place, 1.0 + TOUCH)
            wrong += int((beside(after, origins, directions, place, 1.0 - TOUCH) | elsewhere).sum())
            gone += int(lost.sum())
    return Outcome(wrong if gone else np.inf, f"of {6 * count:,}, {gone:,} of which met the eight cells before")


def beside(
    t: np.ndarray, origins: np.ndarray, directions: np.ndarray, place: tuple[int, int, int], reach: float
) -> np.ndarray:
    """Which rays meet the surface within ``reach`` voxels of ``place`` along each axis."""
    met = origins + np.where(np.isfinite(t), t, 0.0)[:, None] * directions
    return np.isfinite(t) & (abs(met - place) < reach).all(axis=1)
