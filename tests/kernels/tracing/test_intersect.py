"""Rays against isosurfaces: one at a time, against dense marching.

Closed surfaces, planes, holes and far origins are among the cases of `tests/stability`.
"""

import math

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from isogi_core.kernels.tracing import intersect
from isogi_core.kernels.tracing.intersect import OUTSIDE_SIGN, SOLID_SIGN, UNKNOWN_SIDE
from tests.kernels.fields import cast_each, field_of
from tests.scale import few


def many(count):
    """That many, or few where Numba is switched off."""
    return few(count, max(count // 1000, 100))


def trilinear(voxels, points):
    """SciPy's trilinear value, float64, at points (..., 3) x first."""
    return map_coordinates(voxels.astype(float), np.moveaxis(points, -1, 0)[::-1], order=1, mode="nearest")


def test_a_cell_whose_corners_agree_has_only_a_lost_surface():
    for level, side in ((0.0, OUTSIDE_SIGN), (2.0, SOLID_SIGN)):
        voxels = np.full((2, 2, 2), level, np.float32)
        ray = ((0.2, 0.3, 0.4), (0.1, 0.2, 0.4), (10.0, 5.0, 2.5))
        place = ((voxels, 1.0), ray, (0, 0, 0), (0.5, 1.5))
        assert intersect.cross_cell(*place, side) == (math.inf, side)
        assert intersect.cross_cell(*place, UNKNOWN_SIDE) == (math.inf, side)
        assert intersect.cross_cell(*place, -side) == (0.5, -side)


# --- the walk ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["noise", "smooth", "binary"])
def test_cast_against_dense_marching(kind):
    """Every hit lies on the isosurface, nothing that marching sees comes before it, and nothing is missed."""
    rng = np.random.default_rng(5)
    voxels = rng.random((12, 11, 14)).astype(np.float32)
    if kind == "smooth":
        z, y, x = np.mgrid[:12, :11, :14]
        voxels = (0.5 + np.sin(x * 0.9) * np.cos(y * 0.7) * np.sin(z * 0.8 + 1) / 2).astype(np.float32)
    elif kind == "binary":
        voxels = (voxels > 0.6).astype(np.float32)
    count, steps, iso = many(1000), 2000, 0.45
    size = np.array(voxels.shape[::-1]) - 1.0
    origins, ends = rng.random((2, count, 3)) * size
    along = np.linspace(0, 1, steps + 1)
    solid = trilinear(voxels, origins[:, None] + along[:, None] * (ends - origins)[:, None]) > iso
    changes = solid[:, 1:] != solid[:, :-1]
    seen = changes.any(axis=1)
    first = np.where(seen, changes.argmax(axis=1), steps)
    t, came = cast_each(field_of(voxels), iso, origins, ends - origins, UNKNOWN_SIDE)
    assert (t[seen] <= along[first[seen] + 1] + 1e-9).all(), "missed what marching sees"
    hit = np.isfinite(t)
    at = trilinear(voxels, origins[hit] + t[hit, None] * (ends - origins)[hit])
    assert np.abs(at - iso).max() < 2e-8
    early = seen & (t < along[first] - 1e-9)
    assert early.mean() < 0.02, "grazing pairs between two steps are rare"
    assert np.array_equal(came[hit] == SOLID_SIGN, solid[hit, 0])
    both = seen & ~early
    assert np.abs(t - bisect(voxels, iso, origins, ends, along[first], 1 / steps))[both].max() < 1e-8


def bisect(voxels, iso, origins, ends, low, width):
    """The change of side between the fractions low and low + width of each segment, to rounding."""
    low, high = low.copy(), low + width
    start = trilinear(voxels, origins + low[:, None] * (ends - origins)) > iso
    for _ in range(40):
        middle = (low + high) / 2
        same = (trilinear(voxels, origins + middle[:, None] * (ends - origins)) > iso) == start
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    return low


# --- a ball --------------------------------------------------------------------------------------------------

N = 41
Z, Y, X = np.mgrid[:N, :N, :N] - 20.0
BALL = 12.0 - np.sqrt(X * X + Y * Y + Z * Z)


def inner_rays(rng, count):
    """Origins well inside the ball, half on lattice points; integer, axis-aligned and any directions."""
    origins = 20.0 + rng.uniform(-1.7, 1.7, (count, 3))
    origins[::2] = np.rint(origins[::2])
    directions = rng.normal(size=(count, 3))
    third = count // 3
    directions[:third] = rng.integers(-3, 4, (third, 3))
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    directions[third : third + third // 2] = axes[rng.integers(0, 6, third // 2)]
    directions[~directions.any(axis=1)] = (0.0, -0.0, 1.0)
    order = rng.permutation(count)
    return origins, directions[order]


def test_a_block_that_a_ray_only_touches_tells_no_side():
    """From a corner of four macrocells on the surface, into the one that is solid: no hit, and then the way out."""
    voxels = np.zeros((17, 17, 17), np.float32)
    voxels[:8, :8, :8] = 1.0
    start, inwards = np.full((1, 3), 8.0), np.array([[-1.0, -2.0, -1.5]])
    into, came = cast_each(field_of(voxels), 0.0, start, inwards, OUTSIDE_SIGN)
    assert (into[0], came[0]) == (pytest.approx(0.0, abs=1e-5), OUTSIDE_SIGN)
    out, _ = cast_each(field_of(voxels), 0.0, start + into[0] * inwards, inwards, SOLID_SIGN)
    assert out[0] == math.inf


def test_nothing_but_holes_is_an_empty_picture():
    rng = np.random.default_rng(13)
    origins = rng.uniform(-5, 15, (100, 3))
    t, _ = cast_each(field_of(np.full((9, 9, 9), np.nan)), 0.0, origins, 4.0 - origins, UNKNOWN_SIDE)
    assert np.isinf(t).all()


@pytest.mark.parametrize("length", [1e-150, 1e-6, 1.0, 1e6, 1e150])
def test_a_longer_direction_is_a_shorter_way(length):
    rng = np.random.default_rng(15)
    origins, directions = inner_rays(rng, 300)
    t, _ = cast_each(field_of(BALL), 0.0, origins, directions, UNKNOWN_SIDE)
    scaled, _ = cast_each(field_of(BALL), 0.0, origins, directions * length, UNKNOWN_SIDE)
    np.testing.assert_allclose(scaled * length, t, rtol=1e-8)


def test_all_on_one_side_has_no_surface_from_anywhere():
    rng = np.random.default_rng(16)
    origins = rng.uniform(-5, 15, (300, 3))
    for level in (0.0, 1.0):
        for iso in (0.0, 0.5, 1.0):
            t, _ = cast_each(field_of(np.full((9, 9, 9), level)), iso, origins, 4.0 - origins, UNKNOWN_SIDE)
            assert np.isinf(t).all()
