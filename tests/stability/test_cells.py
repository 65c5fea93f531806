"""Rays in single cells: crossings close together, grazing rays, and cubics that are hardly cubic."""

import numpy as np
import pytest

from tests.stability.scenes import ARITHMETICS, Surface, surface_of

GRAZE = 1e-6
"""Heights at which a ray only grazes, which is not judged."""

SHALLOW = 1e-4
"""Heights at which rays start in the skin of a surface, where they may be taken for outside."""

both_arithmetics = pytest.mark.parametrize("by", ARITHMETICS)


@both_arithmetics
def test_the_first_of_several_crossings_in_a_cell_is_found(by: str) -> None:
    """Rays through single cells of noise against the roots of their cubics between turns, by bisection."""
    rng, count = np.random.default_rng(21), 10_000
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


def cubics_along(surface: Surface, corner: np.ndarray, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """The field less the isovalue along segments of cells, as cubics in the way t from 0 to 1.

    Coefficients (n, 4), the cube's first, through the values at four points of each.
    """
    corners = [surface.field.voxels[tuple((corner + step).T[::-1])] for step in np.ndindex(2, 2, 2)]
    fractions = np.arange(4.0) / 3.0
    points = start + fractions[:, None, None] * (end - start)
    values = 0.0
    for (x, y, z), value in zip(np.ndindex(2, 2, 2), corners, strict=True):
        weights = [points[..., a] if upper else 1.0 - points[..., a] for a, upper in enumerate((x, y, z))]
        values = values + weights[0] * weights[1] * weights[2] * (value.astype(np.float64) - surface.level)
    return np.linalg.solve(np.vander(fractions), values).T


def height_at(cubics: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Values of cubics (n, 4) at ``t`` (n, m)."""
    a, b, c, d = (cubics[:, i, None] for i in range(4))
    return ((a * t + b) * t + c) * t + d


def first_root(cubics: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
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


@both_arithmetics
@pytest.mark.parametrize("where", [0.125, 0.25, 0.5, 0.75])
def test_a_bump_is_met_or_missed_by_its_height_alone(where: float, by: str) -> None:
    """A cell whose field along its diagonal is depth - (t - where)², from 1e-3 below the surface to 1e-3 above."""
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
    """Where the cell's diagonal at z = 1/2 meets the surface when the field is raised by ``depth``; inf: nowhere."""
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
    """A linear cell with a little of a curved one: a ray from one side to the other meets the surface on its way."""
    rng = np.random.default_rng(22)
    z, y, x = np.mgrid[:2, :2, :2]
    curve = {"xy": x * y, "xyz": x * y * z, "xy + yz": x * y + y * z, "linear": 0 * x}[kind]
    cell = surface_of((x + 0.5 * y - 0.75 * z + little * curve).astype(np.float64), 0.2)
    starts, ends = rng.random((2, 40, 3))
    before, after = cell.height(starts), cell.height(ends)
    chosen = (before * after < 0.0) & (abs(before) > SHALLOW)
    assert chosen.any()
    starts, ways = starts[chosen], (ends - starts)[chosen]
    t, _ = cell.cast(starts, ways, by=by)
    assert (t <= 1.0 + GRAZE).all()
    assert abs(cell.height(starts + t[:, None] * ways)).max() < 1e-12
