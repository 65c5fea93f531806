"""The cubic along a ray: against SciPy's trilinear value and NumPy's roots, and where it only touches."""

import math

import numpy as np
import pytest
from numba import njit
from scipy.ndimage import map_coordinates

from isogi_core.kernels.simd.voxels import cube
from isogi_core.kernels.tracing.cubic import cubic_along, ends_solid, first_crossing, horner, turning_points
from isogi_core.kernels.tracing.intersect import OUTSIDE_SIGN, SOLID_SIGN, less
from tests.scale import few


def many(count):
    """That many, or few where Numba is switched off."""
    return few(count, max(count // 1000, 100))


@njit(cache=True)
def crossing(q, side, blur):
    """`first_crossing` as t or inf, and the side at the cubic's end."""
    t, crosses = first_crossing(q, side == SOLID_SIGN, blur, True)
    return t if crosses else math.inf, SOLID_SIGN if ends_solid(q) else OUTSIDE_SIGN


@njit(cache=True)
def first_crossings(cubics, side):
    """`crossing` of cubics (n, 4): t (n,) and the last side (n,)."""
    t, last = np.empty(len(cubics)), np.empty(len(cubics), np.int64)
    for m in range(len(cubics)):
        q = (float(cubics[m, 0]), float(cubics[m, 1]), float(cubics[m, 2]), float(cubics[m, 3]))
        t[m], last[m] = crossing(q, side, 0.0)
    return t, last


def roots(cubics):
    """`numpy.roots` of many cubics at once: the eigenvalues of their companion matrices, (n, 3) complex."""
    companion = np.zeros((len(cubics), 3, 3))
    companion[:, 1, 0] = companion[:, 2, 1] = 1.0
    companion[:, 0] = -cubics[:, 1:] / cubics[:, :1]
    return np.linalg.eigvals(companion)


def trilinear(voxels, points):
    """SciPy's trilinear value, float64, at points (..., 3) x first."""
    return map_coordinates(voxels.astype(float), np.moveaxis(points, -1, 0)[::-1], order=1, mode="nearest")


def test_cubic_along_a_ray_is_the_trilinear_value():
    rng = np.random.default_rng(1)
    for _ in range(200):
        voxels = rng.normal(size=(2, 2, 2)).astype(np.float32)
        a, b = rng.random((2, 3))
        q = cubic_along(less(cube(voxels, 0, 0, 0), 0.25), tuple(a), tuple(b - a))
        t = np.linspace(0, 1, 7)
        expected = trilinear(voxels, a + t[:, None] * (b - a)) - 0.25
        np.testing.assert_allclose([horner(q, s) for s in t], expected, atol=1e-14)


def test_turning_points_are_the_roots_of_the_slope():
    rng = np.random.default_rng(2)
    for q in rng.normal(size=(many(2000), 4)):
        slope = np.roots([3 * q[0], 2 * q[1], q[2]])
        expected = sorted(np.clip(slope.real, 0, 1)) if np.isreal(slope).all() else (1.0, 1.0)
        np.testing.assert_allclose(turning_points(tuple(q)), expected, atol=1e-10)


@pytest.mark.parametrize("side", [OUTSIDE_SIGN, SOLID_SIGN])
def test_first_crossing_against_numpys_roots(side):
    """1e5 cubics that begin on `side`, less those whose roots nearly meet or lie on an end: both answers are right."""
    rng = np.random.default_rng(3)
    cubics = rng.normal(size=(many(100_000), 4)) * 10.0 ** rng.uniform(-3, 3, (many(100_000), 4))
    cubics[:, 3] = -side * np.abs(cubics[:, 3])
    found, last = first_crossings(cubics, side)
    all_roots = roots(cubics)
    real = np.abs(all_roots.imag) < 1e-9
    expected = np.where(real & (all_roots.real >= 0) & (all_roots.real <= 1), all_roots.real, math.inf).min(axis=1)
    delicate = (np.abs(all_roots.imag) < 1e-4) & ~real
    pairs = np.abs(all_roots - np.roll(all_roots, 1, axis=1)).min(axis=1) < 1e-4
    ends = np.minimum(np.abs(all_roots), np.abs(all_roots - 1)).min(axis=1) < 1e-9
    clear = ~(delicate.any(axis=1) | pairs | ends)
    assert clear.mean() > 0.99
    assert np.array_equal(found[clear] < math.inf, expected[clear] < math.inf)
    hit = clear & (expected < math.inf)
    assert hit.mean() > 0.2
    assert np.abs(found[hit] - expected[hit]).max() < 2e-8
    assert np.array_equal(last == SOLID_SIGN, cubics.sum(axis=1) > 0)


@pytest.mark.parametrize("where", [0.1, 0.5, 0.875])
@pytest.mark.parametrize("lean", [0.0, 0.7])
def test_double_roots_end_and_never_come_and_go(where, lean):
    """f = depth - (t - where)²(1 + lean t): a bump that reaches `depth` above the surface."""
    depths = np.concatenate([-(10.0 ** np.arange(-3, -19, -0.25)), [0.0], 10.0 ** np.arange(-18, -3, 0.25)])
    square = np.array([0.0, 1.0, -2 * where, where**2])
    cubic = -(square + lean * np.append(square[1:], 0.0))
    found, last = first_crossings(cubic + np.outer(depths, [0, 0, 0, 1]), OUTSIDE_SIGN)
    hit = found < math.inf
    assert np.array_equal(hit, np.sort(hit)), "a deeper bump is hit where a shallower one is"
    assert not hit[depths < -1e-14].any() and hit[depths > 1e-14].all()
    assert (np.abs(found[hit] - where) <= 2 * np.sqrt(np.abs(depths[hit])) + 1e-7).all()
    assert (last == OUTSIDE_SIGN).all()


def test_a_turn_within_the_blur_only_touches():
    """f = (t - 1/2)² less and more than nothing, seen from either side."""
    for side in (SOLID_SIGN, OUTSIDE_SIGN):
        bump = [side * c for c in (0.0, -1.0, 1.0, -0.25)]
        for depth, met in ((1e-13, True), (1e-15, False), (-1e-15, False), (-1e-13, False)):
            t, last = crossing((*bump[:3], bump[3] + side * depth), side, 1e-14)
            assert (t < math.inf) == met and last == side


@pytest.mark.parametrize("scale", [1.0, 1e-8, 1e-16, 1e-30, 1e-100, 1e-300])
@pytest.mark.parametrize(
    ("rest", "root"),
    [((2.0, 0.0, -0.5), 0.5), ((0.0, 1.0, -0.25), 0.25), ((-1.0, 2.0, -0.75), 0.5), ((0.0, 0.0, -1.0), math.inf)],
)
def test_cubics_that_are_hardly_cubic(scale, rest, root):
    for a in (0.0, scale * 1e-9, -scale * 1e-9):
        t, _ = crossing((a, *rest), OUTSIDE_SIGN, 0.0)
        assert t == pytest.approx(root, abs=3e-8)


def test_a_cubic_of_nothing_is_outside_and_has_no_crossing():
    assert crossing((0.0, 0.0, 0.0, 0.0), OUTSIDE_SIGN, 0.0) == (math.inf, OUTSIDE_SIGN)


def test_a_root_lost_to_rounding_is_at_the_entry():
    t, last = crossing((0.0, 0.0, 1.0, 1e-17), OUTSIDE_SIGN, 0.0)
    assert (t, last) == (pytest.approx(0.0, abs=1e-8), SOLID_SIGN)
