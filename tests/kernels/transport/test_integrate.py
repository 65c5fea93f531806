"""Light transport against closed forms: furnaces, cavities, half a sky, and the cosine lobe of an
open surface.
"""

import math
from pathlib import Path

import numpy as np
import pytest

from isogi_core.kernels.shading.local_models import find_normals
from isogi_core.kernels.shading.surface_points import SurfacePoints
from isogi_core.kernels.tracing.field import to_index
from isogi_core.kernels.tracing.intersect import (
    OUTSIDE_SIGN,
    SOLID_SIGN,
    UNKNOWN_SIDE,
    launch,
    shading_normal,
)
from isogi_core.kernels.transport import transfer
from isogi_core.kernels.transport.harmonics import cosine_lobe_factors, evaluate
from isogi_core.kernels.transport.light_paths import Surroundings
from isogi_core.kernels.transport.paths import PathRules, SampleRange, TransferRules
from isogi_core.kernels.transport.sampling import about
from isogi_core.kernels.transport.transfer import bake_texels, locate_texels
from tests.kernels.fields import cast_each, cells_of, field_of, surface_of
from tests.kernels.transport.lighting import trace_points
from tests.loaded import read_nrrd
from tests.scale import COMPILED, few

ENDLESS = 1000
FACTOR = math.sqrt(4.0 * math.pi)
DARK = np.zeros((1, 1, 3), np.float32)
Z, Y, X = np.mgrid[:49, :49, :49] - 24.0
BALL = 16.0 - np.sqrt(X * X + Y * Y + Z * Z)
TORUS = 6.0 - np.hypot(np.hypot(X, Y) - 14.0, Z)
SMALL_BALL = 12.0 - np.linalg.norm(np.indices((41, 41, 41)) - 20.0, axis=0)


def slope(towards):
    """A half-space: solid behind the plane through the middle of the box with the normal
    `towards`.
    """
    return -(X * towards[0] + Y * towards[1] + Z * towards[2])


def bake(field, texels, count, shares, order=1, first=0, step=(1.0, 1.0, 1.0), **ends):
    """`bake_texels` from nothing: sums (m, 2, channels, n²), isovalues and void (m,)."""
    sums = np.zeros((len(texels), 2, len(shares), order**2))
    rules = TransferRules(shares, ends.get("survival", 1.0), ends.get("branches", 1))
    isovalues, void = bake_more(field, texels, SampleRange(first, count), rules, sums, step)
    return sums, isovalues, void


def bake_more(field, texels, samples, rules, sums, step=(1.0, 1.0, 1.0)):
    """Add samples to the sums of texels; isovalues and void (m,)."""
    m = len(texels)
    isovalues = np.full(m, np.nan)
    void = np.zeros(m, np.bool_)
    place = (np.ascontiguousarray(texels, np.int32), np.empty((3, m)), np.empty((3, m)), isovalues)
    locate_texels(field, np.array(step), *place, void)
    rows = np.flatnonzero(~void)
    if len(rows):
        cells = cells_of(field, float(isovalues[rows].min()), float(isovalues[rows].max()))
        orders = np.full(sums.shape[2], math.isqrt(sums.shape[3]))
        bake_texels(field, cells, place, rows, samples, rules, orders, sums)
    return isovalues, void


def trace(field, iso, points, light, weights, count, image=DARK):
    """Mean over the samples of `trace_points` from surface points; (m, 3)."""
    points = np.ascontiguousarray(points, np.float32)
    normals = np.empty_like(points)
    sums = np.zeros((len(points), 2, 3))
    find_normals(field, points, (0.0, 0.0, 0.0), normals)
    surroundings = Surroundings(np.full(3, float(light)), np.asarray(image, np.float32), np.eye(3))
    pixels = SurfacePoints(points, normals, np.arange(len(points), dtype=np.uint32))
    samples = SampleRange(0, count // 2)
    rules = PathRules(weights, 1.0)
    trace_points(surface_of(field, iso), pixels, surroundings, rules, 0, samples, sums)
    return sums.sum(axis=1) / (count // 2 * 2)


def albedo_powers(albedos, bounces, extra=0):
    """R^(k + extra) for k = 0 … bounces, one column for each albedo."""
    return np.array(albedos, float)[None] ** (np.arange(bounces + 1)[:, None] + extra)


def shares_of(albedos, bounces, least=0):
    """What a path counts, one row for each albedo: R^k after k = `least` … `bounces` bounces, or
    else nothing.
    """
    shares = np.zeros((len(albedos), bounces + 2))
    shares[:, 1 + least :] = np.array(albedos, float)[:, None] ** np.arange(least, bounces + 1)
    return shares


def surface_points(field, iso, count, seed=1):
    """Points where random rays from far away meet the surface from outside, (m, 3) float32."""
    rng = np.random.default_rng(seed)
    size = np.array(field.voxels.shape[::-1]) - 1.0
    away = rng.normal(size=(count, 3))
    away *= np.linalg.norm(size) / np.linalg.norm(away, axis=1, keepdims=True)
    origins = rng.random((count, 3)) * size + away
    t, came = cast_each(field, iso, origins, -away, UNKNOWN_SIDE)
    hit = np.isfinite(t) & (came == OUTSIDE_SIGN)
    return (origins - t[:, None] * away)[hit].astype(np.float32)


# --- furnaces
# ------------------------------------------------------------------------------------------------


@COMPILED
@pytest.mark.parametrize("body", [BALL, TORUS], ids=["ball", "torus"])
def test_white_furnace_texels(body):
    """Albedo 1 and no end of bounces: every path gets out, so a texel's whole transfer is that of
    open sky.
    """
    texels = np.argwhere(np.abs(body) < 1.0)[::17]
    sums, _, void = bake(field_of(body), texels, 64, shares_of([1.0], ENDLESS))
    reflected, _, _ = bake(field_of(body), texels, 64, shares_of([1.0], ENDLESS, 1))
    whole = FACTOR * sums[:, :, 0, 0] / 64
    assert not void.any() and len(texels) > 200
    assert reflected.any() == (body is TORUS), "a torus sees itself"
    assert abs(whole.mean() - 1.0) < 0.005
    assert np.abs(whole - 1.0).max() < 0.05


@COMPILED
@pytest.mark.data
def test_white_furnace_engine(shared_data: Path):
    """The engine at 70, seen from outside: bores and passages give their light back after many
    bounces.
    """
    voxels, _ = read_nrrd(shared_data / "engine_256x256x128_uint8.nhdr")
    field = field_of(voxels.astype(np.float32))
    points = surface_points(field, 70.0, 3000)
    pixels = trace(field, 70.0, points, 1.0, np.ones((ENDLESS + 1, 3)), 16)
    assert abs(pixels.mean() - 1.0) < 0.005
    texels = np.unique(np.rint(points).astype(int)[:, ::-1], axis=0)
    sums, _, void = bake(field, texels, 8, shares_of([1.0], ENDLESS))
    whole = FACTOR * sums[~void][:, :, 0, 0] / 8
    assert len(whole) > 300 and void.mean() < 0.01
    assert abs(whole.mean() - 1.0) < 0.005


# --- open surfaces
# -------------------------------------------------------------------------------------------


def cosine_lobe(order, normal):
    """A_l/π Y_lm(n): what an unoccluded surface passes on, closed form; (n²,)."""
    basis = np.empty(order**2)
    evaluate(order, *normal, basis)
    return np.repeat(cosine_lobe_factors(order) / math.pi, 2 * np.arange(order) + 1) * basis


@pytest.mark.parametrize("towards", [(0, 0, 1), (0, 0, -1), (1, 0, 0), (1, 2, 2), (-2, 3, 6)])
def test_transfer_of_a_plane_is_the_cosine_lobe(towards):
    order = 6
    count = few(4096, 128)
    normal = np.array(towards) / np.linalg.norm(towards)
    plane = field_of(slope(towards)), [[24, 24, 24]], count
    sums, isovalues, void = bake(*plane, shares_of([0.9], 3), order)
    assert isovalues == [0.0] and not void.any()
    for half in sums[0, :, 0] / count:
        np.testing.assert_allclose(half, cosine_lobe(order, normal), atol=6.0 / count)
    assert (sums[0, 0] != sums[0, 1]).any(), "the two halves are independent"
    assert not bake(*plane, shares_of([0.9], 3, 1), order)[0].any()


@COMPILED
def test_transfer_of_a_ball_is_the_cosine_lobe():
    """Each texel is lit on the isosurface through itself, and its rays start above the facets of a
    trilinear ball.
    """
    texels = np.argwhere(np.abs(BALL) < 1.0)[::97]
    sums, _, _ = bake(field_of(BALL), texels, 2048, shares_of([0.0], 1), 5)
    away = texels[:, ::-1] - 24.0
    lobes = [cosine_lobe(5, n) for n in away / np.linalg.norm(away, axis=1, keepdims=True)]
    assert np.abs(sums[:, :, 0].mean(axis=1) / 2048 - lobes).max() < 0.002


# --- cavities
# ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("bounces", [0, 1, 30])
def test_nothing_leaves_a_closed_cavity(bounces):
    """A hollow ball: not one of the paths from its inner wall gets out, however far they go."""
    shell = field_of(3.0 - np.abs(np.sqrt(X * X + Y * Y + Z * Z) - 16.0))
    inward = np.random.default_rng(3).normal(size=(few(200, 3), 3))
    middle = np.full_like(inward, 24.0)
    t, came = cast_each(shell, 0.0, middle, inward, UNKNOWN_SIDE)
    assert (came == OUTSIDE_SIGN).all()
    count = few(64, 2)
    light = trace(shell, 0.0, middle + t[:, None] * inward, 1.0, np.ones((bounces + 1, 3)), count)
    assert np.array_equal(light, np.zeros_like(light))


@COMPILED
@pytest.mark.parametrize("a", [30.0, 60.0])
@pytest.mark.parametrize("cosine", [-1 / 3, 0.0, 1 / 3])
def test_cavity_with_an_opening_is_an_integrating_sphere(a, cosine):
    """The closed form of a spherical cavity whose cap above z = h is cut off by a plane.

    From a point of a sphere's inner wall, cosine-distributed directions hit the sphere uniformly.
    So a path leaves with the probability f = (1 - h/a)/2, the cap's share of the sphere, at its
    first step and, being uniform over the rest of the wall again, at every later one: after k
    bounces with f (1 - f)^k. The plane cuts the wall off too, so the opening has no depth and
    nothing is above it. Under constant light 1 the direct transfer is f and the whole one, with
    albedo R, f / (1 - R (1 - f)). On a lattice the brim is blunt by about a voxel and the opening
    as much too wide, which halves as the radius a doubles.
    """
    n = int(2 * a + 11)
    middle = (n - 1) / 2
    z, y, x = (axis - middle for axis in np.ogrid[:n, :n, :n])
    wall = 1.5 - np.abs(np.sqrt(x * x + y * y + z * z) - a - 1.5)
    cavity = field_of(np.minimum(wall, cosine * a - z))
    outward = np.random.default_rng(4).normal(size=(3000, 3))
    origins = np.full_like(outward, middle)
    t, came = cast_each(cavity, 0.0, origins, outward, UNKNOWN_SIDE)
    closed = np.isfinite(t)
    assert (came[closed] == OUTSIDE_SIGN).all()
    points = (origins + t[:, None] * outward)[closed]
    albedos = np.array([0.0, 0.5, 0.9])
    light = trace(cavity, 0.0, points, 1.0, albedo_powers(albedos, 300), 64).mean(axis=0)
    share = (1.0 - cosine) / 2.0
    np.testing.assert_allclose(light, share / (1.0 - albedos * (1.0 - share)), rtol=1.7 / a)
    opening = light[0]
    np.testing.assert_allclose(light, opening / (1.0 - albedos * (1.0 - opening)), rtol=0.004)


# --- the parts
# -----------------------------------------------------------------------------------------------


def test_about_turns_the_pole_to_the_normal_and_keeps_lengths():
    rng = np.random.default_rng(5)
    for n in [*np.eye(3), *-np.eye(3), *(v / np.linalg.norm(v) for v in rng.normal(size=(50, 3)))]:
        assert about(tuple(n), (0.0, 0.0, 1.0)) == pytest.approx(tuple(n))
        d = rng.normal(size=3)
        turned = np.array(about(tuple(n), tuple(d)))
        assert np.linalg.norm(turned) == pytest.approx(np.linalg.norm(d))
        assert turned @ n == pytest.approx(d[2])


def test_shading_normal_looks_to_the_side_that_the_ray_came_from():
    ball = field_of(BALL)
    p = (40.0, 24.0, 24.0)
    d = (-2.0, 0.0, 0.0)
    assert shading_normal(ball, p, OUTSIDE_SIGN, d) == pytest.approx((1.0, 0.0, 0.0), abs=1e-6)
    assert shading_normal(ball, p, SOLID_SIGN, d) == pytest.approx((-1.0, 0.0, 0.0), abs=1e-6)
    flat = field_of(np.ones((5, 5, 5)))
    assert shading_normal(flat, (2.0, 2.0, 2.0), OUTSIDE_SIGN, d) == (1.0, 0.0, 0.0)


def test_to_index_divides_by_the_spacing():
    assert to_index((1.0, 1.0, 1.0), (0.5, 2.0, 4.0)) == (2.0, 0.5, 0.25)


def test_every_texel_and_half_has_a_sequence_of_its_own():
    seeds = {int(transfer.texel_seed(*map(np.uint64, place))) for place in np.ndindex(9, 9, 9, 2)}
    assert len(seeds) == 2 * 9**3


@pytest.mark.parametrize("offset", [0.3, 0.0, 1.5])
def test_launch_is_as_many_voxels_whatever_the_spacing(offset):
    field = field_of(slope((0, 0, 1)), (0.1, 1.0, 25.0))._replace(offset=offset)
    for n in ((0.0, 0.0, 1.0), (0.6, 0.0, 0.8)):
        start = np.array(launch(field, 0.0, (24.0, 24.0, 24.0), n, OUTSIDE_SIGN))
        assert np.linalg.norm(start - 24.0) == pytest.approx(offset)


def test_rays_without_an_offset_do_not_meet_what_they_start_on():
    """From float32 points on either side of an oblique plane by rounding, all leave to where it is
    not.
    """
    towards = (0.48, 0.6, 0.64)
    field = field_of(slope(towards))._replace(offset=0.0)
    across = np.random.default_rng(9).uniform(-8.0, 8.0, (200, 3))
    points = 24.0 + across - (across @ towards)[:, None] * np.array(towards)
    light = trace(field, 0.0, points, 1.0, albedo_powers(np.zeros(3), 3), 16)
    np.testing.assert_allclose(light, 1.0, atol=1e-12)


@COMPILED
def test_roulette_ends_paths_and_keeps_their_light():
    """Each path that goes on stands for those that do not: the same means from fewer paths that
    leave.
    """
    texels = np.argwhere(np.abs(TORUS) < 0.3)[::40].astype(np.int32)
    k = np.arange(9)
    albedo = 0.9
    survival = 0.6
    count = 2048
    carried = albedo**k / survival ** np.maximum(k - 1, 0)
    shares = np.hstack([[0.0], albedo**k])[None]
    ends = np.hstack([[0.0, 0.0], np.ones(8)])[None]
    field = field_of(TORUS)
    whole = bake(field, texels, count, shares)[0].mean(axis=1).ravel() * FACTOR / count
    spun = (
        bake(field, texels, count, np.hstack([[0.0], carried])[None], survival=survival)[0]
        * FACTOR
        / count
    )
    assert abs((spun.mean(axis=1).ravel() - whole).mean()) < 1e-3 * whole.mean()
    assert np.abs(spun.mean(axis=1).ravel() / whole - 1.0).max() < 0.05
    reflected = [
        bake(field, texels, count, ends, survival=chance)[0].sum() for chance in (1.0, survival)
    ]
    assert reflected[1] < 0.95 * reflected[0]


@COMPILED
def test_branches_keep_the_light_and_take_its_noise():
    """Four ways on from the first hit: the same means, with less than half of the variance above
    band 0.
    """
    texels = np.argwhere(np.abs(TORUS) < 0.3)[::10].astype(np.int32)
    shares = shares_of([0.9], 8, 1)
    field = field_of(TORUS)
    count = 256
    single, four = (
        bake(field, texels, count, shares, 3, branches=branches)[0] / count for branches in (1, 4)
    )
    spreads = [np.mean((halves[:, 0] - halves[:, 1]) ** 2, axis=0)[0] for halves in (single, four)]
    assert spreads[1][1:].sum() < 0.5 * spreads[0][1:].sum()
    apart = (four - single).mean(axis=(0, 1))[0]
    allowed = np.sqrt((spreads[0] + spreads[1]) / 2.0 / len(texels))
    assert (np.abs(apart) < 4.0 * allowed).all()


def test_texels_without_a_surface_are_void_and_untouched():
    voxels = np.zeros((16, 16, 16), np.float32)
    voxels[:8] = 1.0
    voxels[12, 3, 3] = np.nan
    texels = [[8, 8, 8], [3, 8, 8], [14, 14, 14], [12, 3, 3], [11, 3, 3]]
    sums, isovalues, void = bake(field_of(voxels), texels, 8, shares_of([0.5], 1))
    assert void.tolist() == [False, True, True, True, True]
    assert sums[0].all() and not sums[1:].any()
    assert isovalues[:3].tolist() == [0.5, 1.0, 0.0] and np.isnan(isovalues[3:]).all()


@pytest.mark.parametrize("level", [0.1, 0.3, 0.7, 1.0])
def test_texels_on_a_plateaus_edge_agree_between_voxels(level):
    """Rounding of a texel's value must not tell them from those on voxels: all are lit half-way
    down, in the open.
    """
    voxels = np.zeros((16, 16, 16), np.float32)
    voxels[:8] = level
    texels = [[9, y, x] for y in range(4, 18) for x in range(4, 18)]
    sums, isovalues, void = bake(
        field_of(voxels), texels, 8, shares_of([0.5], 1), step=(5 / 7,) * 3
    )
    assert np.array_equal(isovalues, np.full(len(texels), np.float32(level) / 2)) and not void.any()
    assert sums.min() * FACTOR == pytest.approx(8.0)


@pytest.mark.parametrize("side", [OUTSIDE_SIGN, SOLID_SIGN])
def test_launch_lifts_off_and_stays_where_there_is_no_room(side):
    ball = field_of(SMALL_BALL)
    inwards = -1.0 if side == SOLID_SIGN else 1.0
    start = launch(ball, 0.0, (32.0, 20.0, 20.0), (inwards, 0.0, 0.0), side)
    assert start == pytest.approx((32.0 + 0.3 * inwards, 20.0, 20.0))
    assert launch(ball, 0.0, (32.0, 20.0, 20.0), (-inwards, 0.0, 0.0), side) == (32.0, 20.0, 20.0)
