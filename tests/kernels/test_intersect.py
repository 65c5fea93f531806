"""Rays against isosurfaces: the cubic against NumPy's roots, rays against dense marching.

Closed surfaces, planes, holes and far origins are among the cases of `benchmarks.stability`.
"""

import math

import numpy as np
import pytest
from numba import njit
from scipy.ndimage import map_coordinates

from isogi_core.kernels import intersect
from isogi_core.kernels.integrator import launch
from isogi_core.kernels.intersect import OUTSIDE, SOLID, UNKNOWN
from tests.kernels.test_macrocells import field_of
from tests.scale import few


def many(count):
    """That many, or few where Numba is switched off."""
    return few(count, max(count // 1000, 100))


@njit(cache=True)
def cast_rays(field, iso, origins, directions, side):
    """`intersect.cast` for rays (n, 3): t (n,) and the side each came from (n,)."""
    t, came = np.empty(len(origins)), np.empty(len(origins), np.int64)
    for m in range(len(origins)):
        o = (float(origins[m, 0]), float(origins[m, 1]), float(origins[m, 2]))
        d = (float(directions[m, 0]), float(directions[m, 1]), float(directions[m, 2]))
        t[m], came[m] = intersect.cast(field, iso, o, d, side)
    return t, came


@njit(cache=True)
def first_crossings(cubics, side):
    """`intersect.first_crossing` of cubics (n, 4): t (n,) and the last side (n,)."""
    t, last = np.empty(len(cubics)), np.empty(len(cubics), np.int64)
    for m in range(len(cubics)):
        q = (float(cubics[m, 0]), float(cubics[m, 1]), float(cubics[m, 2]), float(cubics[m, 3]))
        t[m], last[m] = intersect.first_crossing(q, side, 0.0)
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


# --- the cubic ---------------------------------------------------------------------------------------------


def test_cubic_along_a_ray_is_the_trilinear_value():
    rng = np.random.default_rng(1)
    for _ in range(200):
        voxels = rng.normal(size=(2, 2, 2)).astype(np.float32)
        a, b = rng.random((2, 3))
        q = intersect.cubic_along(intersect.corners(voxels, 0, 0, 0, 0.25), tuple(a), tuple(b - a))
        t = np.linspace(0, 1, 7)
        expected = trilinear(voxels, a + t[:, None] * (b - a)) - 0.25
        np.testing.assert_allclose([intersect.horner(q, s) for s in t], expected, atol=1e-14)


def test_turning_points_are_the_roots_of_the_slope():
    rng = np.random.default_rng(2)
    for q in rng.normal(size=(many(2000), 4)):
        slope = np.roots([3 * q[0], 2 * q[1], q[2]])
        expected = sorted(np.clip(slope.real, 0, 1)) if np.isreal(slope).all() else (1.0, 1.0)
        np.testing.assert_allclose(intersect.turning_points(tuple(q)), expected, atol=1e-10)


@pytest.mark.parametrize("side", [OUTSIDE, SOLID])
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
    assert np.array_equal(last == SOLID, cubics.sum(axis=1) > 0)


@pytest.mark.parametrize("where", [0.1, 0.5, 0.875])
@pytest.mark.parametrize("lean", [0.0, 0.7])
def test_double_roots_end_and_never_come_and_go(where, lean):
    """f = depth - (t - where)²(1 + lean t): a bump that reaches `depth` above the surface."""
    depths = np.concatenate([-(10.0 ** np.arange(-3, -19, -0.25)), [0.0], 10.0 ** np.arange(-18, -3, 0.25)])
    square = np.array([0.0, 1.0, -2 * where, where**2])
    cubic = -(square + lean * np.append(square[1:], 0.0))
    found, last = first_crossings(cubic + np.outer(depths, [0, 0, 0, 1]), OUTSIDE)
    hit = found < math.inf
    assert np.array_equal(hit, np.sort(hit)), "a deeper bump is hit where a shallower one is"
    assert not hit[depths < -1e-14].any() and hit[depths > 1e-14].all()
    assert (np.abs(found[hit] - where) <= 2 * np.sqrt(np.abs(depths[hit])) + 1e-7).all()
    assert (last == OUTSIDE).all()


def test_a_turn_within_the_blur_only_touches():
    """f = (t - 1/2)² less and more than nothing, seen from either side."""
    for side in (SOLID, OUTSIDE):
        bump = [side * c for c in (0.0, -1.0, 1.0, -0.25)]
        for depth, met in ((1e-13, True), (1e-15, False), (-1e-15, False), (-1e-13, False)):
            t, last = intersect.first_crossing((*bump[:3], bump[3] + side * depth), side, 1e-14)
            assert (t < math.inf) == met and last == side


@pytest.mark.parametrize("scale", [1.0, 1e-8, 1e-16, 1e-30, 1e-100, 1e-300])
@pytest.mark.parametrize(
    ("rest", "root"),
    [((2.0, 0.0, -0.5), 0.5), ((0.0, 1.0, -0.25), 0.25), ((-1.0, 2.0, -0.75), 0.5), ((0.0, 0.0, -1.0), math.inf)],
)
def test_cubics_that_are_hardly_cubic(scale, rest, root):
    for a in (0.0, scale * 1e-9, -scale * 1e-9):
        t, _ = intersect.first_crossing((a, *rest), OUTSIDE, 0.0)
        assert t == pytest.approx(root, abs=3e-8)


def test_a_cubic_of_nothing_is_outside_and_has_no_crossing():
    assert intersect.first_crossing((0.0, 0.0, 0.0, 0.0), OUTSIDE, 0.0) == (math.inf, OUTSIDE)


def test_a_root_lost_to_rounding_is_at_the_entry():
    t, last = intersect.first_crossing((0.0, 0.0, 1.0, 1e-17), OUTSIDE, 0.0)
    assert (t, last) == (pytest.approx(0.0, abs=1e-8), SOLID)


def test_a_cell_whose_corners_agree_has_no_surface_unless_one_was_lost():
    for level, side in ((0.0, OUTSIDE), (2.0, SOLID)):
        voxels = np.full((2, 2, 2), level, np.float32)
        ray = ((0.2, 0.3, 0.4), (0.1, 0.2, 0.4), (10.0, 5.0, 2.5), (0, 0, 0), 0.5, 1.5)
        assert intersect.cross_cell(voxels, 1.0, *ray, side) == (math.inf, side)
        assert intersect.cross_cell(voxels, 1.0, *ray, UNKNOWN) == (math.inf, side)
        assert intersect.cross_cell(voxels, 1.0, *ray, -side) == (0.5, -side)


# --- the box and the walk ------------------------------------------------------------------------------------


def test_clip_box_against_the_slabs_of_numpy():
    rng = np.random.default_rng(4)
    voxels = np.zeros((4, 5, 6), np.float32)
    size = np.array(voxels.shape[::-1]) - 1.0
    for o, d in zip(rng.uniform(-4, 9, (many(2000), 3)), rng.normal(size=(many(2000), 3)), strict=True):
        a, b = -o / d, (size - o) / d
        near, far = max(np.minimum(a, b).max(), 0.0), np.maximum(a, b).min()
        found = intersect.clip_box(voxels, tuple(o), tuple(d))
        assert found[0] <= found[1] if near <= far else found[0] > found[1]
        if near <= far:
            assert found == pytest.approx((near, far))


@pytest.mark.parametrize("zero", [0.0, -0.0])
def test_a_ray_beside_the_box_or_along_its_face(zero):
    voxels = np.zeros((4, 4, 4), np.float32)
    assert intersect.clip_box(voxels, (1.0, 3.5, 1.0), (1.0, zero, zero)) == (math.inf, -math.inf)
    assert intersect.clip_box(voxels, (1.0, 3.0, 0.0), (1.0, zero, zero)) == (0.0, 2.0)


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
    t, came = cast_rays(field_of(voxels), iso, origins, ends - origins, UNKNOWN)
    assert (t[seen] <= along[first[seen] + 1] + 1e-9).all(), "missed what marching sees"
    hit = np.isfinite(t)
    at = trilinear(voxels, origins[hit] + t[hit, None] * (ends - origins)[hit])
    assert np.abs(at - iso).max() < 2e-8
    early = seen & (t < along[first] - 1e-9)
    assert early.mean() < 0.02, "grazing pairs between two steps are rare"
    assert np.array_equal(came[hit] == SOLID, solid[hit, 0])
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


@pytest.mark.parametrize("side", [OUTSIDE, SOLID])
def test_launch_lifts_off_the_surface_and_stays_where_there_is_no_room(side):
    ball = field_of(BALL)
    inwards = -1.0 if side == SOLID else 1.0
    start = launch(ball, 0.0, (32.0, 20.0, 20.0), (inwards, 0.0, 0.0), side)
    assert start == pytest.approx((32.0 + 0.3 * inwards, 20.0, 20.0))
    assert launch(ball, 0.0, (32.0, 20.0, 20.0), (-inwards, 0.0, 0.0), side) == (32.0, 20.0, 20.0)


def test_a_block_that_a_ray_only_touches_says_nothing_of_its_side():
    """From a corner of four macrocells on the surface, into the one that is solid: no hit, and then the way out."""
    voxels = np.zeros((17, 17, 17), np.float32)
    voxels[:8, :8, :8] = 1.0
    start, inwards = np.full((1, 3), 8.0), np.array([[-1.0, -2.0, -1.5]])
    into, came = cast_rays(field_of(voxels), 0.0, start, inwards, OUTSIDE)
    assert (into[0], came[0]) == (pytest.approx(0.0, abs=1e-5), OUTSIDE)
    out, _ = cast_rays(field_of(voxels), 0.0, start + into[0] * inwards, inwards, SOLID)
    assert out[0] == math.inf


def test_nothing_but_holes_is_an_empty_picture():
    rng = np.random.default_rng(13)
    origins = rng.uniform(-5, 15, (100, 3))
    t, _ = cast_rays(field_of(np.full((9, 9, 9), np.nan)), 0.0, origins, 4.0 - origins, UNKNOWN)
    assert np.isinf(t).all()


@pytest.mark.parametrize("length", [1e-150, 1e-6, 1.0, 1e6, 1e150])
def test_a_longer_direction_is_a_shorter_way(length):
    rng = np.random.default_rng(15)
    origins, directions = inner_rays(rng, 300)
    t, _ = cast_rays(field_of(BALL), 0.0, origins, directions, UNKNOWN)
    scaled, _ = cast_rays(field_of(BALL), 0.0, origins, directions * length, UNKNOWN)
    np.testing.assert_allclose(scaled * length, t, rtol=1e-8)


def test_all_on_one_side_has_no_surface_from_anywhere():
    rng = np.random.default_rng(16)
    origins = rng.uniform(-5, 15, (300, 3))
    for level in (0.0, 1.0):
        for iso in (0.0, 0.5, 1.0):
            t, _ = cast_rays(field_of(np.full((9, 9, 9), level)), iso, origins, 4.0 - origins, UNKNOWN)
            assert np.isinf(t).all()
