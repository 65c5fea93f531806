"""Cases of single cells: crossings close together, grazing rays, and cubics that are hardly cubic."""

import numpy as np

from benchmarks.stability.case import Outcome, Size, case
from benchmarks.stability.leaks import GROUP, SHALLOW, batches
from benchmarks.stability.surface import ARITHMETICS, Surface, surface_of

Cubics = np.ndarray
"""Coefficients (n, 4), the cube's first, of polynomials in the way t through a cell, from 0 to 1."""

GRAZE = 1e-6
"""Heights at which a ray only grazes, which is not judged."""


@case(
    GROUP,
    "crossings in one cell",
    "the first of two or three is found, unless the field only grazes the isovalue, by 1e-6",
    0,
    "rays",
)
def crossings_in_a_cell(size: Size) -> Outcome:
    """Rays through single cells of noise against the roots of their cubics between turns, by bisection."""
    rng, count, wrong, twice = np.random.default_rng(21), size.pick(10_000, 1_000_000), 0, 0
    noise = surface_of(rng.random((33, 33, 33)), 0.5)
    for batch in batches(count):
        corner = rng.integers(0, 32, (batch, 3))
        origins, ends = corner + rng.random((2, batch, 3))
        cubics = cubics_along(noise, corner, origins - corner, ends - corner)
        t, turns, judged = first_root(cubics)
        twice += int((judged & (np.sign(height_at(cubics, turns)) != np.sign(cubics[:, 3:])).any(axis=1)).sum())
        for by in ARITHMETICS:
            found, _ = noise.cast(origins, ends - origins, by=by)
            near = abs(np.where(t <= 1.0, t, 2.0) - np.where(found <= 1.0, found, 2.0)) < GRAZE
            wrong += int((judged & ~near).sum())
    return Outcome(wrong, f"of {count:,} rays, {twice:,} of which turn beyond the surface")


def cubics_along(surface: Surface, corner: np.ndarray, start: np.ndarray, end: np.ndarray) -> Cubics:
    """The field less the isovalue along segments of cells, through its values at four points of each."""
    corners = [surface.field.voxels[tuple((corner + step).T[::-1])] for step in np.ndindex(2, 2, 2)]
    fractions = np.arange(4.0) / 3.0
    points = start + fractions[:, None, None] * (end - start)
    values = 0.0
    for (x, y, z), value in zip(np.ndindex(2, 2, 2), corners, strict=True):
        weights = [points[..., a] if upper else 1.0 - points[..., a] for a, upper in enumerate((x, y, z))]
        values = values + weights[0] * weights[1] * weights[2] * (value.astype(np.float64) - surface.level)
    return np.linalg.solve(np.vander(fractions), values).T


def height_at(cubics: Cubics, t: np.ndarray) -> np.ndarray:
    """Values of cubics at ``t`` (n, m)."""
    a, b, c, d = (cubics[:, i, None] for i in range(4))
    return ((a * t + b) * t + c) * t + d


def first_root(cubics: Cubics) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The first crossings (n,), inf where there is none, the turns (n, 2) within the cell, and which can be judged."""
    a, b, c, _ = cubics.T
    wave = np.sqrt(np.maximum(b * b - 3.0 * a * c, 0.0))
    turns = np.sort(np.clip(np.stack([(-b - wave) / (3.0 * a), (-b + wave) / (3.0 * a)], axis=1), 0.0, 1.0), axis=1)
    knots = np.column_stack([np.zeros(len(a)), turns, np.ones(len(a))])
    heights = height_at(cubics, knots)
    judged = (abs(heights) > GRAZE).all(axis=1) & (abs(heights[:, 0]) > SHALLOW)
    solid = heights > 0.0
    changes = solid[:, 1:] != solid[:, :-1]
    first, rows = changes.argmax(axis=1), np.arange(len(a))
    low, high = knots[rows, first], knots[rows, first + 1]
    for _ in range(50):
        middle = 0.5 * (low + high)
        same = (height_at(cubics, middle[:, None])[:, 0] > 0.0) == solid[:, 0]
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    return np.where(changes.any(axis=1), low, np.inf), turns, judged


@case(
    GROUP,
    "double roots",
    "a bump that hardly reaches the isovalue is met or missed by its height alone, and met where it is",
    0,
    "rays",
)
def double_roots(size: Size) -> Outcome:
    """A cell whose field along its diagonal is depth - (t - where)², from 1e-3 below the surface to 1e-3 above."""
    steps = 10.0 ** np.linspace(-18.0, -3.0, size.pick(31, 301))
    depths, wrong, count = np.concatenate([-steps[::-1], [0.0], steps]), 0, 0
    y, x = np.mgrid[:2, :2]
    for where in (0.125, 0.25, 0.5, 0.75):
        cell = np.broadcast_to(-(x - where) * (y - where), (2, 2, 2))
        for by in ARITHMETICS:
            found = np.array([bump(cell, depth, by) for depth in depths])
            hit = found < np.inf
            away = abs(np.where(hit, found, where) - where) > 2.0 * np.sqrt(abs(depths)) + 1e-7
            sure = (hit & (depths < -1e-14)) | (~hit & (depths > 1e-14))
            wrong += int((np.isnan(found) | away | sure).sum() + (np.diff(hit.astype(int)) < 0).sum())
            count += len(depths)
    return Outcome(wrong, f"of {count:,} rays")


def bump(cell: np.ndarray, depth: float, by: str) -> float:
    """Where the cell's diagonal at z = 1/2 meets the surface when the field is raised by ``depth``."""
    raised = surface_of(cell, 0.0)
    scale = float(cell.max() - cell.min())
    level = raised.level - depth / 2.0 ** np.ceil(np.log2(scale))
    surface = Surface(raised.field, raised.bricks, level)
    t, _ = surface.cast(np.array([[0.0, 0.0, 0.5]]), np.array([[1.0, 1.0, 0.0]]), by=by)
    return float(t[0])


@case(
    GROUP,
    "hardly cubic",
    "a ray from one side to the other meets the surface, however straight the field is along it",
    1e-12,
    "of the range",
)
def hardly_cubic(size: Size) -> Outcome:
    """Cells that are linear, bilinear or constant, and such as these with a little of the next kind."""
    rng, worst, count, cells = np.random.default_rng(22), 0.0, size.pick(20, 2_000), 0
    z, y, x = np.mgrid[:2, :2, :2]
    for little in (0.0, *10.0 ** np.arange(0.0, -31.0, -3.0)):
        for curve in (x * y, x * y * z, x * y + y * z + 0.0 * x, np.zeros_like(x)):
            cell = surface_of((x + 0.5 * y - 0.75 * z + little * curve).astype(np.float64), 0.2)
            worst = max(worst, missed(cell, rng.random((count, 3)), rng.random((count, 3))))
            cells += 1
    return Outcome(worst, f"of {count * cells:,} rays in {cells} cells")


def missed(cell: Surface, starts: np.ndarray, ends: np.ndarray) -> float:
    """The largest height at which rays between points on two sides are said to cross; inf where one does not."""
    before, after = cell.height(starts), cell.height(ends)
    chosen = (before * after < 0.0) & (abs(before) > SHALLOW)
    starts, ends, worst = starts[chosen], ends[chosen], 0.0
    for by in ARITHMETICS:
        t, _ = cell.cast(starts, ends - starts, by=by)
        if not (t <= 1.0 + GRAZE).all():
            return np.inf
        worst = max(worst, float(abs(cell.height(starts + t[:, None] * (ends - starts))).max(initial=0.0)))
    return worst
