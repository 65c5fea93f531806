"""The illumination lattice against plain NumPy: the texels around a point, and light carried from
them to it.
"""

import math

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from isogi_core.kernels.shading.framebuffer import (
    CONVERGING,
    FINAL,
    PROVISIONAL,
    Framebuffer,
)
from isogi_core.kernels.shading.lattice import (
    BURIED_GRADE,
    BURIED_ROW,
    LIGHT_NUMBERS,
    PARTIAL_GRADE,
    UNBAKED_GRADE,
    UNLIT_ROW,
    VOID_GRADE,
    VOID_ROW,
    Sky,
    base_texel,
    carry_light,
    light_texels,
    trilinear,
)
from isogi_core.kernels.shading.surface_points import SurfacePoints
from isogi_core.kernels.transport.harmonics import cosine_lobe_factors
from isogi_core.model.environment import LUMINANCE_WEIGHTS
from tests.kernels.shading.lattices import (
    RNG,
    SHAPE,
    STEP,
    border_points,
    lattice,
    lower_texels,
    some_points,
    view_of,
)
from tests.kernels.transport.harmonic_bases import scipy_basis


def test_base_texel_is_the_lower_corner_and_the_fractions_in_it():
    points = some_points()
    low, fractions = lower_texels(points)
    found = np.array([base_texel(lattice(), points, m) for m in range(len(points))])
    assert np.array_equal(found[:, :3], low)
    np.testing.assert_allclose(found[:, 3:], fractions, atol=1e-6)


def test_points_beyond_the_box_read_its_outermost_texels():
    points = np.array([[-1.0, -1.0, -1.0], [1e6, 1e6, 1e6]], np.float32)
    assert base_texel(lattice(), points, 0) == (0, 0, 0, 0.0, 0.0, 0.0)
    assert base_texel(lattice(), points, 1) == (*(n - 2 for n in SHAPE), 1.0, 1.0, 1.0)


def test_trilinear_weights_are_the_products_and_sum_to_one():
    fz, fy, fx = 0.2, 0.7, 0.9
    weights = [trilinear(c, fz, fy, fx) for c in range(8)]
    outer = np.einsum("k,j,i->kji", [1 - fz, fz], [1 - fy, fy], [1 - fx, fx]).ravel()
    assert weights == pytest.approx(outer.tolist())
    assert sum(weights) == pytest.approx(1.0)


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("firsts", [[0], [0, 9], [0, 1, 5]])
@pytest.mark.parametrize("order", [1, 5])
def test_a_texels_light_is_transfer_times_light(channels, order, firsts):
    firsts = np.array([i for i in firsts if i < order**2], np.int32)
    transfer = RNG.normal(size=(40, channels, order**2)).astype(np.float32)
    noise = RNG.random(40).astype(np.float32)
    light = RNG.normal(size=(3, order**2)).astype(np.float32)
    rows = RNG.permutation(40)[:30].astype(np.int32)
    rows[4:7] = UNLIT_ROW, VOID_ROW, BURIED_ROW
    lit = np.full((30, LIGHT_NUMBERS), -7.0, np.float32)
    square = RNG.normal(size=order**2).astype(np.float32)
    straight = int(firsts[-1]) or order**2
    light_texels(rows, transfer, noise, light, square, firsts, straight, lit)
    colour = np.einsum("mcn,cn->mc", np.broadcast_to(transfer[rows], (30, 3, order**2)), light)
    there = rows >= 0
    assert (colour[there] < 0).any(), "some sums must be negative to see them cut"
    np.testing.assert_allclose(lit[there, :3], np.maximum(colour, 0.0)[there], atol=1e-5)
    reflected = np.einsum(
        "mcn,cn->mc",
        np.broadcast_to(transfer[rows], (30, 3, order**2))[..., straight:],
        light[:, straight:],
    )
    np.testing.assert_allclose(
        lit[there, 4:], np.clip(reflected, 0.0, np.maximum(colour, 0.0))[there], atol=1e-5
    )
    seen = transfer[rows, channels // 2]
    variance = np.maximum(seen @ square - (colour @ LUMINANCE_WEIGHTS) ** 2, 0.0)
    # Paths vary by a fifth of their second moment at least.
    variance += 0.2 * np.maximum(seen[:, firsts] * square[firsts], 0.0).sum(axis=1)
    np.testing.assert_allclose(lit[there, 3], (noise[rows] * np.sqrt(variance))[there], atol=1e-4)
    assert (lit[~there] == -7.0).all(), "texels without a row are left alone"


def carry(points, grade, lit, normals=None, order=3, unit=1.0):
    """`carry_light`: radiance (n, 3), state (n,), error (n,), and the sky it was given."""
    sky = Sky(
        order, np.repeat(cosine_lobe_factors(order) / math.pi, 2 * np.arange(order) + 1), SKY_LIGHT
    )
    _, _, corners = view_of(points)
    size = 3 * len(points)
    planes = Framebuffer(
        np.zeros((size, 3), np.float32), np.zeros(size, np.uint8), np.zeros(size, np.float32)
    )
    pixels = np.arange(1, size, 3, dtype=np.uint32)
    if normals is None:
        normals = np.zeros_like(points)
    some = SurfacePoints(points, normals, pixels)
    carry_light(lattice(), some, corners, grade, lit, sky, np.float32(unit), planes)
    assert not planes.state[::3].any() and not planes.radiance[2::3].any(), (
        "other pixels are left alone"
    )
    return tuple(plane[pixels] for plane in planes)


SKY_LIGHT = np.abs(RNG.normal(size=(3, 9))) * 0.05 + np.array([3.0] + [0.0] * 8)


def lit_view(points, seed=1):
    """Every texel of the view lit at random: grades and light (m, 4)."""
    count = len(view_of(points)[1])
    rng = np.random.default_rng(seed)
    lit = rng.random((count, 4)).astype(np.float32) + 0.1
    return np.full(count, FINAL, np.uint8), lit


def test_carried_light_is_scipys_linear_interpolation():
    points = border_points()
    grade, lit = lit_view(points)
    whole = lattice()
    grid = np.zeros((*SHAPE, 3))
    for slot, index in enumerate(np.ndindex(whole.chunks)):
        own = np.flatnonzero(view_of(points)[1] // whole.texels == slot)
        grid[tuple(whole.positions(index, view_of(points)[1][own] % whole.texels).T)] = lit[own, :3]
    place = (points.astype(float) / STEP)[:, ::-1].T
    radiance, state, error = carry(points, grade, lit)
    expected = np.stack([map_coordinates(grid[..., c], place, order=1) for c in range(3)], axis=-1)
    np.testing.assert_allclose(radiance, expected, atol=2e-5)
    assert (state == FINAL).all()
    assert (error < 1.0).any()


@pytest.mark.parametrize("unit", [2.0**-100, 2.0**100])
def test_light_is_carried_in_units(unit):
    points = border_points()
    grade, lit = lit_view(points)
    grade[::3] = UNBAKED_GRADE
    up = np.tile(np.array([0.0, 0.0, 1.0], np.float32), (len(points), 1))
    one, other = (carry(points, grade, lit, up, unit=each) for each in (1.0, unit))
    assert np.array_equal(other[0], one[0] * np.float32(unit))
    assert all(np.array_equal(*pair) for pair in zip(one[1:], other[1:], strict=True))


def irradiance_over_pi(normals):
    """E/π (n, 3) of SKY_LIGHT about unit normals (n, 3), by SciPy's harmonics: Σ A_l/π ℓ_lm
    Y_lm(n).
    """
    lobes = np.repeat([1.0, 2.0 / 3.0, 0.25], [1, 3, 5])
    return scipy_basis(3, np.asarray(normals, float)) @ (lobes * SKY_LIGHT).T


def one_by_one(points, grade, lit, normals):
    """Light (n, 3), its standard error (n,) and the least grade (n,), by a loop over points.

    Void and buried texels are left out of the mean, and unshadowed light stands in for what is not
    baked. Where no texel counts it is dark among buried ones, as somebody looked, and else
    unshadowed.
    """
    corners = view_of(points)[2]
    (_, fractions) = lower_texels(points)
    under = irradiance_over_pi(normals)
    light = np.zeros((len(points), 3))
    noise = np.zeros(len(points))
    least = np.zeros(len(points), int)
    for m, (own, f) in enumerate(zip(corners, fractions, strict=True)):
        weights = np.prod(np.where(np.array(list(np.ndindex(2, 2, 2))), f, 1.0 - f), axis=1)
        counts = grade[own] <= FINAL
        baked = (grade[own] <= FINAL) & (grade[own] != UNBAKED_GRADE)
        buried = weights[grade[own] == BURIED_GRADE].sum() > 0.0
        total = weights[counts].sum()
        least[m] = grade[own].min()
        if total > 0.0:
            light[m] = (
                weights[baked] @ lit[own[baked], :3] + weights[counts & ~baked].sum() * under[m]
            )
            light[m] /= total
            noise[m] = np.sqrt(((weights[baked] * lit[own[baked], 3]) ** 2).sum()) / total
        elif not buried:
            light[m] = under[m]
    return light, noise, least


ALL_GRADES = (FINAL, CONVERGING, PARTIAL_GRADE, UNBAKED_GRADE, BURIED_GRADE, VOID_GRADE)


@pytest.mark.parametrize(
    "grades",
    [
        *((each,) for each in ALL_GRADES),
        ALL_GRADES,
        (FINAL, VOID_GRADE),
        (BURIED_GRADE, VOID_GRADE),
        ALL_GRADES[3:],
    ],
)
def test_light_is_carried_as_a_loop_over_texels_has_it(grades):
    points = border_points()
    grade, lit = lit_view(points)
    grade[:] = np.random.default_rng(2).choice(grades, len(grade))
    lit[(grade == UNBAKED_GRADE) | (grade > FINAL)] = np.nan
    normals = RNG.normal(size=points.shape)
    normals = (normals / np.linalg.norm(normals, axis=1, keepdims=True)).astype(np.float32)
    light, noise, least = one_by_one(points, grade, lit, normals)
    radiance, state, error = carry(points, grade, lit, normals)
    np.testing.assert_allclose(radiance, light, rtol=2e-5, atol=1e-6)
    assert np.array_equal(state, np.clip(least, PROVISIONAL, FINAL))
    expected = np.minimum(noise / np.maximum(light @ LUMINANCE_WEIGHTS, 1e-30), 1.0)
    np.testing.assert_allclose(
        error, np.where(least <= PARTIAL_GRADE, 1.0, expected), rtol=1e-4, atol=1e-6
    )
