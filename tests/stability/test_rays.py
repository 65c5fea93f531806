"""Rays at surfaces: none leaks or hits twice, in single cells, on faces and edges, from on the
surface or from afar.
"""

import os
from collections.abc import Iterator
from dataclasses import astuple, dataclass

import numpy as np
import pytest

from isogi_core.kernels.tracing.intersect import OUTSIDE_SIGN, SOLID_SIGN, UNKNOWN_SIDE
from isogi_core.kernels.transport.integrator import bounce_rays
from tests.stability.scenes import ARITHMETICS, Surface, surface_of
from tests.stability.volumes import CLOSED, CLOSED_SIDE, RADIUS, grid

RAYS = int(os.environ.get("ISOGI_STABILITY_RAYS", "30000"))
"""Rays at all closed surfaces together, by each arithmetic; before a release 100,000,000."""

SURFACES = sum(len(isovalues) for _, isovalues in CLOSED.values())
BATCH = 1 << 18
"""Rays that are followed together."""

MOST_CROSSINGS = 500
MIDDLE = (CLOSED_SIDE - 1) / 2
TOUCH = 1e-5
"""Voxels within which crossings are one place: there may be two, of a surface that is touched, and
not three.
"""

SHALLOW = 1e-4
"""Heights at which rays start in the skin of a surface, where they may be taken for outside."""

AHEAD = 5.0
"""Voxels before the box, where rays along lattice lines start."""

AXES = np.concatenate([np.eye(3), -np.eye(3)])
ZEROS = (0.0, -0.0, 5e-324, -1e-310, 1e-200)

EXACT = ((0, 0, 1), (1, 0, 0), (1, 2, 2), (-2, 3, 6))
"""Normals of planes that float32 voxels hold exactly."""

TILTED = ((0.31, -0.77, 0.52), (0.02, 0.01, 1.0))

both_arithmetics = pytest.mark.parametrize("by", ARITHMETICS)


@dataclass
class Faults:
    """What is wrong with rays: how many leak, how many crossings are double or left on the wrong
    side, endless rays.
    """

    leaks: int = 0
    doubles: int = 0
    wrong: int = 0
    endless: int = 0

    def __add__(self, other: "Faults") -> "Faults":
        return Faults(*(a + b for a, b in zip(astuple(self), astuple(other), strict=True)))


@both_arithmetics
@pytest.mark.parametrize("name", CLOSED)
def test_rays_go_in_and_out_of_closed_surfaces_by_turns(name: str, by: str) -> None:
    make, isovalues = CLOSED[name]
    rng = np.random.default_rng(7)
    for isovalue in isovalues:
        surface = surface_of(make(), isovalue)
        faults = Faults()
        for batch in batches(-(-RAYS // SURFACES)):
            faults = faults + follow(surface, *rays(rng, batch), by)
        assert faults == Faults(), f"at isovalue {isovalue}"


@both_arithmetics
@pytest.mark.parametrize(
    ("name", "isovalue", "origin", "direction"),
    [
        pytest.param(
            "noise",
            0.0,
            (1.0 + 2.0**-16.5, 7.3, 26.8),
            (-1.0, 1e-200, -1e-310),
            id="begins in the skin",
        ),
        pytest.param(
            "noise of bytes",
            3.5,
            (35.0, 7.5, 34.0),
            (-5.0, 4.5, -6.0),
            id="leaves along a double root",
        ),
    ],
)
def test_rays_that_once_leaked_go_in_and_out_by_turns(
    name: str, isovalue: float, origin: tuple[float, ...], direction: tuple[float, ...], by: str
) -> None:
    """Found among 100,000,000."""
    surface = surface_of(CLOSED[name][0](), isovalue)
    assert follow(surface, np.array([origin]), np.array([direction]), by) == Faults()


def batches(count: int) -> Iterator[int]:
    """Sizes of batches that make ``count``."""
    for first in range(0, count, BATCH):
        yield min(BATCH, count - first)


def rays(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Rays from anywhere in the box, many from lattice points and middles, some from as far behind
    these.

    Directions are any, of integers, to lattice points, along axes, and all but along axes.
    """
    origins = rng.uniform(0.0, CLOSED_SIDE - 1.0, (count, 3))
    directions = rng.normal(size=(count, 3))
    origins[::2], origins[::8] = np.rint(origins[::2]), np.rint(2.0 * origins[::8]) / 2.0
    kind = rng.integers(0, 5, count)
    whole, towards, along, nearly = (kind == n for n in range(1, 5))
    directions[whole] = rng.integers(-3, 4, (whole.sum(), 3))
    directions[towards] = rng.integers(0, CLOSED_SIDE, (towards.sum(), 3)) - origins[towards]
    directions[along | nearly] = AXES[rng.integers(0, 6, (along | nearly).sum())]
    directions[nearly] += rng.choice(ZEROS, (nearly.sum(), 3))
    directions[~directions.any(axis=1)] = (0.0, -0.0, 1.0)
    origins[1::8] -= (
        4.0 * CLOSED_SIDE * directions[1::8] / abs(directions[1::8]).max(axis=1, keepdims=True)
    )
    return origins, directions


def follow(surface: Surface, origins: np.ndarray, directions: np.ndarray, by: str) -> Faults:
    """Cast rays, and from each crossing on again with the side known, until none is left.

    Those that start in the skin are not judged by where they end.
    """
    heights = surface.height(origins)
    starts = np.where(heights > 0.0, SOLID_SIGN, OUTSIDE_SIGN)
    judged = (heights == 0.0) | (abs(heights) > SHALLOW)
    ends = starts.copy()
    faults = Faults()
    alive = np.arange(len(origins))
    sides = np.int8(UNKNOWN_SIDE)
    short = np.zeros(len(origins), bool)
    for _ in range(MOST_CROSSINGS):
        t, came = surface.cast(origins, directions, sides, by)
        hit = np.isfinite(t)
        ways = t * abs(directions).max(axis=1)
        sure = hit & (ways > np.where(sides == UNKNOWN_SIDE, 2.0 * TOUCH, TOUCH))
        between = surface.height(origins[sure] + 0.5 * t[sure, None] * directions[sure])
        faults.wrong += int((between * came[sure] > 1e-9).sum())
        hop = hit & (ways < TOUCH) & (sides != UNKNOWN_SIDE)
        faults.doubles += int((hop & short).sum())
        if not hit.any():
            break
        alive = alive[hit]
        short = hop[hit]
        sides = -came[hit]
        ends[alive] = sides
        origins = origins[hit] + t[hit, None] * directions[hit]
        directions = directions[hit]
    else:
        faults.endless = len(alive)
    faults.leaks = int((judged & (ends != OUTSIDE_SIGN)).sum())
    return faults


@both_arithmetics
def test_rays_from_a_face_meet_what_rays_from_outside_meet(by: str) -> None:
    faces, directions = rays_from_faces()
    noise = surface_of(CLOSED["noise"][0](), 0.3)
    here, _ = noise.cast(faces, directions, by=by)
    outside, _ = noise.cast(faces - directions, directions, by=by)
    met = np.isfinite(here)
    assert met.any()
    assert np.array_equal(met, np.isfinite(outside))
    assert abs(here - outside + 1.0)[met].max() < 1e-9


@both_arithmetics
def test_rays_meet_nothing_that_lies_behind_them(by: str) -> None:
    faces, directions = rays_from_faces()
    noise = surface_of(CLOSED["noise"][0](), 0.3)
    for origins in (faces, faces - directions):
        assert np.isinf(noise.cast(origins, -directions, by=by)[0]).all()


def rays_from_faces(count: int = 2_000) -> tuple[np.ndarray, np.ndarray]:
    """Rays that begin on a face of the box, inwards."""
    rng = np.random.default_rng(15)
    faces = rng.uniform(0.0, CLOSED_SIDE - 1.0, (count, 3))
    axes = rng.integers(0, 3, count)
    faces[np.arange(count), axes] = rng.choice([0.0, CLOSED_SIDE - 1.0], count)
    return faces, MIDDLE + rng.normal(size=faces.shape) * 4.0 - faces


@both_arithmetics
def test_a_surface_on_the_faces_of_the_box_is_met_there(by: str) -> None:
    """The faces hold the isovalue, and all is solid within."""
    rng = np.random.default_rng(18)
    solid = surface_of(np.pad(1.0 + rng.random((CLOSED_SIDE - 2,) * 3), 1), 0.0)
    away = rng.normal(size=(3_000, 3)) * 10.0 ** rng.uniform(0.0, 6.0, (3_000, 1))
    origins = MIDDLE + away + CLOSED_SIDE * np.sign(away)
    directions = rng.uniform(0.0, CLOSED_SIDE - 1.0, origins.shape) - origins
    t, _ = solid.cast(origins, directions, by=by)
    assert np.isfinite(t).all()
    met = origins + t[:, None] * directions
    assert abs(abs(met - MIDDLE).max(axis=1) - MIDDLE).max() < 1e-4


@both_arithmetics
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("axis", range(3), ids="xyz")
def test_rays_along_lattice_lines_meet_linear_crossings(axis: int, sign: int, by: str) -> None:
    """Through voxels and half-way between, the other components 0, -0, subnormal or tiny."""
    rng = np.random.default_rng(20)
    count = 500
    noise = surface_of(rng.random((CLOSED_SIDE,) * 3), 0.5)
    origins = rng.integers(1, 2 * CLOSED_SIDE - 3, (count, 3)) / 2.0
    directions = rng.choice(ZEROS, (count, 3))
    along = np.repeat(origins, CLOSED_SIDE, axis=0).reshape(count, CLOSED_SIDE, 3)
    along[..., axis] = np.arange(CLOSED_SIDE)[::sign]
    expected = first_change(noise.height(along.reshape(-1, 3)).reshape(count, CLOSED_SIDE))
    origins[:, axis] = MIDDLE - sign * (MIDDLE + AHEAD)
    directions[:, axis] = sign
    found = noise.cast(origins, directions, by=by)[0] - AHEAD
    met = np.isfinite(expected)
    assert met.any()
    assert np.array_equal(np.isfinite(found), met)
    assert abs(found - expected)[met].max() < 1e-6


def first_change(heights: np.ndarray) -> np.ndarray:
    """Where the heights (n, m) of points a step apart, joined by lines, first pass 0: in steps, inf
    where nowhere.
    """
    solid = heights > 0.0
    changes = solid[:, 1:] != solid[:, :-1]
    rows = np.arange(len(heights))
    first = changes.argmax(axis=1)
    low = heights[rows, first]
    high = heights[rows, first + 1]
    return np.where(
        changes.any(axis=1), first + low / np.where(low == high, 1.0, low - high), np.inf
    )


@both_arithmetics
@pytest.mark.parametrize(
    ("hole", "place"),
    [(np.nan, (32, 20, 20)), (np.inf, (26, 26, 28)), (-np.inf, (20, 31, 21))],
    ids=str,
)
def test_a_hole_takes_the_surface_of_its_eight_cells_only(
    hole: float, place: tuple[int, int, int], by: str
) -> None:
    rng = np.random.default_rng(12)
    ball = CLOSED["ball"][0]()
    pierced = ball.copy()
    pierced[place[::-1]] = hole
    out = (np.array(place) - MIDDLE) / RADIUS + 0.5 * rng.normal(size=(2_000, 3))
    origins = MIDDLE + 19.0 * out / np.linalg.norm(out, axis=1, keepdims=True)
    directions = np.array(place) + 0.7 * rng.normal(size=origins.shape) - origins
    before, after = (
        surface_of(array, 0.0).cast(origins, directions, by=by)[0] for array in (ball, pierced)
    )

    def beside(t: np.ndarray, reach: float) -> np.ndarray:
        """Which rays meet the surface within ``reach`` voxels of the hole along each axis."""
        met = origins + np.where(np.isfinite(t), t, 0.0)[:, None] * directions
        return np.isfinite(t) & (abs(met - place) < reach).all(axis=1)

    assert beside(before, 1.0 - TOUCH).any()
    assert not beside(after, 1.0 - TOUCH).any()
    late = before < np.where(np.isfinite(after), after, np.inf) - 1e-9
    assert not (late & ~beside(before, 1.0 + TOUCH)).any()


@pytest.mark.parametrize("offset", [0.0, 1000.0])
@pytest.mark.parametrize(
    ("lift", "normal"),
    [
        *((0.0, normal) for normal in EXACT),
        *((0.3, normal) for normal in EXACT + TILTED),
    ],
    ids=lambda value: (
        "normal " + " ".join(map(str, value)) if isinstance(value, tuple) else f"lift {value}"
    ),
)
def test_rays_that_leave_a_plane_never_meet_it_again(
    lift: float, normal: tuple[float, ...], offset: float
) -> None:
    """Cosine rays, many of which graze; without a lift only from planes that voxels hold
    exactly.
    """
    rng = np.random.default_rng(9)
    up = np.array(normal) / np.linalg.norm(normal)
    count = 2_500
    x, y, z = grid(*(CLOSED_SIDE,) * 3)
    surface = surface_of(
        offset - (normal[0] * x + normal[1] * y + normal[2] * z), offset, offset=lift
    )
    origins = MIDDLE + rng.uniform(-5.0, 5.0, (count, 3)) + 9.0 * up
    directions = np.broadcast_to(-up, origins.shape)
    t, came = surface.cast(origins, directions)
    assert np.isfinite(t).all()
    columns = [np.ascontiguousarray(v.T) for v in (origins, directions)]
    numbers = rng.random((2, count))
    numbers[0, ::3] = 10.0 ** rng.uniform(-12.0, -2.0, numbers[0, ::3].shape)
    bounce_rays(surface.field, np.full(count, surface.level), *columns, t, came, numbers)
    starts, ways = (v.T for v in columns)
    for by in ARITHMETICS:
        assert np.isinf(surface.cast(starts, ways, came, by)[0]).all()


@both_arithmetics
def test_skipping_empty_space_changes_no_hit(by: str) -> None:
    """By macrocells and by maps, against a walk through every cell.

    A ray through the corner of a macrocell enters the cell of its hit by another way than one that
    walks there: the last bit of t may differ, of 2 rays in 1,008,000, and the picture does not.
    """
    rng = np.random.default_rng(10)
    differ = 0
    for make, isovalues in CLOSED.values():
        for isovalue in isovalues:
            surface = surface_of(make(), isovalue)
            some = rays(rng, 1_000)
            t, came = surface.cast(*some, by=by)
            walked, from_side = unskipped(surface).cast(*some, by="float64")
            np.testing.assert_allclose(t, walked, rtol=np.finfo(np.float64).eps, atol=0.0)
            np.testing.assert_array_equal(came, from_side)
            differ += int((t != walked).sum())
    assert differ <= 2


def unskipped(surface: Surface) -> Surface:
    """The surface with macrocells of infinite ranges, so that rays walk through all cells."""
    low = np.full_like(surface.field.low, -np.inf)
    high = np.full_like(surface.field.high, np.inf)
    return Surface(surface.field._replace(low=low, high=high), surface.bricks, surface.level)


@both_arithmetics
@pytest.mark.parametrize("boxes", [1e2, 1e4, 1e6])
def test_rays_from_afar_meet_the_points_met_from_near(boxes: float, by: str) -> None:
    rng = np.random.default_rng(14)
    ball = surface_of(CLOSED["ball"][0](), 0.0)
    directions = rng.normal(size=(1_000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    through = MIDDLE + rng.uniform(-3.0, 3.0, directions.shape)
    near, _ = ball.cast(through - 1.5 * CLOSED_SIDE * directions, directions, by=by)
    away, _ = ball.cast(through - boxes * CLOSED_SIDE * directions, directions, by=by)
    assert abs((away - boxes * CLOSED_SIDE) - (near - 1.5 * CLOSED_SIDE)).max() < 1e-4


GRAZE = 1e-6
"""Heights at which a ray only grazes, which is not judged."""


@both_arithmetics
def test_the_first_of_several_crossings_in_a_cell_is_found(by: str) -> None:
    """Rays through single cells of noise against the roots of their cubics between turns, by
    bisection.
    """
    rng = np.random.default_rng(21)
    count = 10_000
    noise = surface_of(rng.random((33, 33, 33)), 0.5)
    corner = rng.integers(0, 32, (count, 3))
    origins, ends = corner + rng.random((2, count, 3))
    cubics = cubics_along(noise, corner, origins - corner, ends - corner)
    t, turns, judged = first_root(cubics)
    beyond = judged & (np.sign(height_at(cubics, turns)) != np.sign(cubics[:, 3:])).any(axis=1)
    assert beyond.sum() > 1_000
    found, _ = noise.cast(origins, ends - origins, by=by)
    near = abs(np.where(t <= 1.0, t, 2.0) - np.where(found <= 1.0, found, 2.0)) < GRAZE
    assert near[judged].all()


def cubics_along(
    surface: Surface, corner: np.ndarray, start: np.ndarray, end: np.ndarray
) -> np.ndarray:
    """The field less the isovalue along segments of cells, as cubics in the way t from 0 to 1.

    Coefficients (n, 4), the cube's first, through the values at four points of each.
    """
    corners = [surface.field.voxels[tuple((corner + step).T[::-1])] for step in np.ndindex(2, 2, 2)]
    fractions = np.arange(4.0) / 3.0
    points = start + fractions[:, None, None] * (end - start)
    values = 0.0
    for (x, y, z), value in zip(np.ndindex(2, 2, 2), corners, strict=True):
        weights = [
            points[..., a] if upper else 1.0 - points[..., a] for a, upper in enumerate((x, y, z))
        ]
        values = values + weights[0] * weights[1] * weights[2] * (
            value.astype(np.float64) - surface.level
        )
    return np.linalg.solve(np.vander(fractions), values).T


def height_at(cubics: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Values of cubics (n, 4) at ``t`` (n, m)."""
    a, b, c, d = (cubics[:, i, None] for i in range(4))
    return ((a * t + b) * t + c) * t + d


def first_root(cubics: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The first crossings (n,), inf where there is none, the turns (n, 2) within the cell, and
    which can be judged.
    """
    a, b, c, _ = cubics.T
    wave = np.sqrt(np.maximum(b * b - 3.0 * a * c, 0.0))
    turns = np.sort(
        np.clip(np.stack([(-b - wave) / (3.0 * a), (-b + wave) / (3.0 * a)], axis=1), 0.0, 1.0),
        axis=1,
    )
    knots = np.column_stack([np.zeros(len(a)), turns, np.ones(len(a))])
    heights = height_at(cubics, knots)
    judged = (abs(heights) > GRAZE).all(axis=1) & (abs(heights[:, 0]) > SHALLOW)
    solid = heights > 0.0
    changes = solid[:, 1:] != solid[:, :-1]
    first = changes.argmax(axis=1)
    rows = np.arange(len(a))
    low = knots[rows, first]
    high = knots[rows, first + 1]
    for _ in range(50):
        middle = 0.5 * (low + high)
        same = (height_at(cubics, middle[:, None])[:, 0] > 0.0) == solid[:, 0]
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    return np.where(changes.any(axis=1), low, np.inf), turns, judged


@both_arithmetics
@pytest.mark.parametrize("where", [0.125, 0.25, 0.5, 0.75])
def test_a_bump_is_met_or_missed_by_its_height_alone(where: float, by: str) -> None:
    """A cell whose field along its diagonal is depth - (t - where)², from 1e-3 below the surface to
    1e-3 above.
    """
    steps = 10.0 ** np.linspace(-18.0, -3.0, 31)
    depths = np.concatenate([-steps[::-1], [0.0], steps])
    y, x = np.mgrid[:2, :2]
    cell = np.broadcast_to(-(x - where) * (y - where), (2, 2, 2))
    found = np.array([bump(cell, depth, by) for depth in depths])
    hit = np.isfinite(found)
    assert not hit[depths < -1e-14].any()
    assert hit[depths > 1e-14].all()
    assert (np.diff(hit.astype(int)) >= 0).all()
    assert (abs(found[hit] - where) <= 2.0 * np.sqrt(abs(depths[hit])) + 1e-7).all()


def bump(cell: np.ndarray, depth: float, by: str) -> float:
    """Where the cell's diagonal at z = 1/2 meets the surface when the field is raised by ``depth``;
    inf: nowhere.
    """
    raised = surface_of(cell, 0.0)
    scale = float(cell.max() - cell.min())
    level = raised.level - depth / 2.0 ** np.ceil(np.log2(scale))
    surface = Surface(raised.field, raised.bricks, level)
    t, _ = surface.cast(np.array([[0.0, 0.0, 0.5]]), np.array([[1.0, 1.0, 0.0]]), by=by)
    assert not np.isnan(t[0])
    return float(t[0])


@both_arithmetics
@pytest.mark.parametrize("little", [0.0, *10.0 ** np.arange(0.0, -31.0, -3.0)], ids="{:g}".format)
@pytest.mark.parametrize("kind", ["xy", "xyz", "xy + yz", "linear"])
def test_rays_cross_cells_whose_field_is_hardly_cubic(kind: str, little: float, by: str) -> None:
    """A linear cell with a little of a curved one: a ray from one side to the other meets the
    surface on its way.
    """
    rng = np.random.default_rng(22)
    z, y, x = np.mgrid[:2, :2, :2]
    curve = {"xy": x * y, "xyz": x * y * z, "xy + yz": x * y + y * z, "linear": 0 * x}[kind]
    cell = surface_of((x + 0.5 * y - 0.75 * z + little * curve).astype(np.float64), 0.2)
    starts, ends = rng.random((2, 40, 3))
    before, after = cell.height(starts), cell.height(ends)
    chosen = (before * after < 0.0) & (abs(before) > SHALLOW)
    assert chosen.any()
    ways = (ends - starts)[chosen]
    starts = starts[chosen]
    t, _ = cell.cast(starts, ways, by=by)
    assert (t <= 1.0 + GRAZE).all()
    assert abs(cell.height(starts + t[:, None] * ways)).max() < 1e-12
