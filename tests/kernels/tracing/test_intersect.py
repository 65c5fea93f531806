"""Rays against boxes, cells and isosurfaces, one at a time: NumPy's slabs and roots, SciPy's
values, dense marching.

Closed surfaces, planes, holes and far origins are among the cases of `tests/stability`.
"""

import math

import numpy as np
import pytest
from numba import njit

from isogi_core.kernels.simd.voxels import cube
from isogi_core.kernels.tracing import intersect
from isogi_core.kernels.tracing.cubic import (
    cubic_along,
    ends_solid,
    first_crossing,
    horner,
    turning_points,
)
from isogi_core.kernels.tracing.intersect import OUTSIDE_SIGN, SOLID_SIGN, UNKNOWN_SIDE, less
from isogi_core.kernels.tracing.slabs import clip_box, cut_cell, longest, reciprocals
from tests.kernels.fields import cast_each, field_of
from tests.kernels.interpolation import trilinear
from tests.scale import many


def test_clip_box_against_numpys_slabs():
    rng = np.random.default_rng(4)
    shape = (4, 5, 6)
    size = np.array(shape[::-1]) - 1.0
    for o, d in zip(
        rng.uniform(-4, 9, (many(2000), 3)), rng.normal(size=(many(2000), 3)), strict=True
    ):
        a = -o / d
        b = (size - o) / d
        near = max(np.minimum(a, b).max(), 0.0)
        far = np.maximum(a, b).min()
        found = clip_box(shape, tuple(o), tuple(d))
        assert found[0] <= found[1] if near <= far else found[0] > found[1]
        if near <= far:
            assert found == pytest.approx((near, far))


@pytest.mark.parametrize("zero", [0.0, -0.0])
def test_a_ray_beside_the_box_or_along_its_face(zero):
    shape = (4, 4, 4)
    assert clip_box(shape, (1.0, 3.5, 1.0), (1.0, zero, zero)) == (math.inf, -math.inf)
    assert clip_box(shape, (1.0, 3.0, 0.0), (1.0, zero, zero)) == (0.0, 2.0)


def test_a_cell_is_cut_as_a_box_of_its_own():
    """Along still axes all of the ray is within; a component too small for a reciprocal counts as
    still.
    """
    rng = np.random.default_rng(5)
    for o, d in zip(
        rng.uniform(-2, 4, (many(2000), 3)), rng.normal(size=(many(2000), 3)), strict=True
    ):
        near, far = cut_cell(tuple(o), reciprocals(tuple(d)), (1, 0, 2), -9.0, 9.0)
        a = (np.array([1, 0, 2]) - o) / d
        b = (np.array([2, 1, 3]) - o) / d
        expected = max(np.minimum(a, b).max(), -9.0), min(np.maximum(a, b).min(), 9.0)
        assert (near, far) == pytest.approx(expected, rel=1e-12)
    assert reciprocals((0.0, 5e-324, -4.0)) == (0.0, 0.0, -0.25)
    assert cut_cell((0.5, 9.0, 9.0), (2.0, 0.0, 0.0), (0, 0, 0), -1.0, 1.0) == (-1.0, 1.0)
    assert longest((-3.0, 2.0, 1.0)) == 3.0


@njit(cache=True)
def crossing(q, side, blur):
    """`first_crossing` as t or inf, and the side at the cubic's end."""
    t, crosses = first_crossing(q, side == SOLID_SIGN, blur, True)
    return t if crosses else math.inf, SOLID_SIGN if ends_solid(q) else OUTSIDE_SIGN


@njit(cache=True)
def first_crossings(cubics, side):
    """`crossing` of cubics (n, 4): t (n,) and the last side (n,)."""
    t = np.empty(len(cubics))
    last = np.empty(len(cubics), np.int64)
    for m in range(len(cubics)):
        q = (float(cubics[m, 0]), float(cubics[m, 1]), float(cubics[m, 2]), float(cubics[m, 3]))
        t[m], last[m] = crossing(q, side, 0.0)
    return t, last


def roots(cubics):
    """`numpy.roots` of many cubics at once: the eigenvalues of their companion matrices, (n, 3)
    complex.
    """
    companion = np.zeros((len(cubics), 3, 3))
    companion[:, 1, 0] = companion[:, 2, 1] = 1.0
    companion[:, 0] = -cubics[:, 1:] / cubics[:, :1]
    return np.linalg.eigvals(companion)


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
        if np.isreal(slope).all():
            expected = sorted(np.clip(slope.real, 0, 1))
        else:
            expected = (1.0, 1.0)
        np.testing.assert_allclose(turning_points(tuple(q)), expected, atol=1e-10)


@pytest.mark.parametrize("side", [OUTSIDE_SIGN, SOLID_SIGN])
def test_first_crossing_against_numpys_roots(side):
    """1e5 cubics that begin on `side`, less those whose roots nearly meet or lie on an end: both
    answers are right.
    """
    rng = np.random.default_rng(3)
    cubics = rng.normal(size=(many(100_000), 4)) * 10.0 ** rng.uniform(-3, 3, (many(100_000), 4))
    cubics[:, 3] = -side * np.abs(cubics[:, 3])
    found, last = first_crossings(cubics, side)
    all_roots = roots(cubics)
    real = np.abs(all_roots.imag) < 1e-9
    expected = np.where(
        real & (all_roots.real >= 0) & (all_roots.real <= 1), all_roots.real, math.inf
    ).min(axis=1)
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


def test_a_turn_within_the_blur_only_touches():
    """f = (t - 1/2)² less and more than nothing, seen from either side."""
    for side in (SOLID_SIGN, OUTSIDE_SIGN):
        bump = [side * c for c in (0.0, -1.0, 1.0, -0.25)]
        for depth, met in ((1e-13, True), (1e-15, False), (-1e-15, False), (-1e-13, False)):
            t, last = crossing((*bump[:3], bump[3] + side * depth), side, 1e-14)
            assert (t < math.inf) == met and last == side


def test_a_cubic_of_nothing_is_outside_and_has_no_crossing():
    assert crossing((0.0, 0.0, 0.0, 0.0), OUTSIDE_SIGN, 0.0) == (math.inf, OUTSIDE_SIGN)


def test_a_root_lost_to_rounding_is_at_the_entry():
    t, last = crossing((0.0, 0.0, 1.0, 1e-17), OUTSIDE_SIGN, 0.0)
    assert (t, last) == (pytest.approx(0.0, abs=1e-8), SOLID_SIGN)


def test_a_cell_whose_corners_agree_has_only_a_lost_surface():
    for level, side in ((0.0, OUTSIDE_SIGN), (2.0, SOLID_SIGN)):
        voxels = np.full((2, 2, 2), level, np.float32)
        ray = ((0.2, 0.3, 0.4), (0.1, 0.2, 0.4), (10.0, 5.0, 2.5))
        place = ((voxels, 1.0), ray, (0, 0, 0), (0.5, 1.5))
        assert intersect.cross_cell(*place, side) == (math.inf, side)
        assert intersect.cross_cell(*place, UNKNOWN_SIDE) == (math.inf, side)
        assert intersect.cross_cell(*place, -side) == (0.5, -side)


@pytest.mark.parametrize("kind", ["noise", "smooth", "binary"])
def test_cast_against_dense_marching(kind):
    """Every hit lies on the isosurface, nothing that marching sees comes before it, and nothing is
    missed.
    """
    rng = np.random.default_rng(5)
    voxels = rng.random((12, 11, 14)).astype(np.float32)
    if kind == "smooth":
        z, y, x = np.mgrid[:12, :11, :14]
        voxels = (0.5 + np.sin(x * 0.9) * np.cos(y * 0.7) * np.sin(z * 0.8 + 1) / 2).astype(
            np.float32
        )
    elif kind == "binary":
        voxels = (voxels > 0.6).astype(np.float32)
    count = many(1000)
    steps = 2000
    iso = 0.45
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
    assert (
        np.abs(t - bisect(voxels, iso, origins, ends, along[first], 1 / steps))[both].max() < 1e-8
    )


def bisect(voxels, iso, origins, ends, low, width):
    """The change of side between the fractions low and low + width of each segment, to rounding."""
    high = low + width
    low = low.copy()
    start = trilinear(voxels, origins + low[:, None] * (ends - origins)) > iso
    for _ in range(40):
        middle = (low + high) / 2
        same = (trilinear(voxels, origins + middle[:, None] * (ends - origins)) > iso) == start
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    return low


BALL = 12.0 - np.linalg.norm(np.indices((41, 41, 41)) - 20.0, axis=0)


def inner_rays(rng, count):
    """Origins well inside the ball, half on lattice points; integer, axis-aligned and any
    directions.
    """
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
    """From a corner of four macrocells on the surface, into the one that is solid: no hit, and then
    the way out.
    """
    voxels = np.zeros((17, 17, 17), np.float32)
    voxels[:8, :8, :8] = 1.0
    start = np.full((1, 3), 8.0)
    inwards = np.array([[-1.0, -2.0, -1.5]])
    into, came = cast_each(field_of(voxels), 0.0, start, inwards, OUTSIDE_SIGN)
    assert (into[0], came[0]) == (pytest.approx(0.0, abs=1e-5), OUTSIDE_SIGN)
    out, _ = cast_each(field_of(voxels), 0.0, start + into[0] * inwards, inwards, SOLID_SIGN)
    assert out[0] == math.inf


@pytest.mark.parametrize("length", [1e-150, 1e-6, 1.0, 1e6, 1e150])
def test_a_longer_direction_is_a_shorter_way(length):
    rng = np.random.default_rng(15)
    origins, directions = inner_rays(rng, 300)
    t, _ = cast_each(field_of(BALL), 0.0, origins, directions, UNKNOWN_SIDE)
    scaled, _ = cast_each(field_of(BALL), 0.0, origins, directions * length, UNKNOWN_SIDE)
    np.testing.assert_allclose(scaled * length, t, rtol=1e-8)


@pytest.mark.parametrize("level", [0.0, 1.0, math.nan])
@pytest.mark.parametrize("iso", [0.0, 0.5, 1.0])
def test_one_value_or_holes_alone_have_no_surface_from_anywhere(level, iso):
    origins = np.random.default_rng(16).uniform(-5, 15, (300, 3))
    t, _ = cast_each(field_of(np.full((9, 9, 9), level)), iso, origins, 4.0 - origins, UNKNOWN_SIDE)
    assert np.isinf(t).all()
