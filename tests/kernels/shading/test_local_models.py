"""Local models and the path tracer against NumPy and closed forms."""

import math

import numpy as np
import pytest
from numba import njit

from isogi_core.kernels.shading.framebuffer import FINAL, Framebuffer
from isogi_core.kernels.shading.local_models import (
    LocalModel,
    find_normals,
    find_shadows,
    shade_local,
)
from isogi_core.kernels.shading.surface_points import SurfacePoints, point_of
from isogi_core.kernels.tracing.field import to_index
from isogi_core.kernels.tracing.intersect import OUTSIDE_SIGN, cast, launch
from isogi_core.kernels.transport.light_paths import Surroundings
from isogi_core.kernels.transport.paths import PathRules, SampleRange
from tests.kernels.fields import field_of, surface_of
from tests.kernels.transport.lighting import trace_points
from tests.scale import few

COUNT = few(2000, 60)
Z, Y, X = np.mgrid[:41, :41, :41] - 20.0
BALL = 12.0 - np.sqrt(X * X + Y * Y + Z * Z)
EYE = (90.0, 35.0, 60.0)
KEY = (0.36, 0.48, 0.8)
SUN = (0.9, 0.5, 0.2)
AMBIENT = (0.1, 0.2, 0.3)
LAMBERT = LocalModel(KEY, SUN, AMBIENT, 0.0, 32.0, False, 0.0, 0.0)


def ball_points(count=COUNT, spacing=(1.0, 1.0, 1.0)):
    """Points (n, 3) float32 of the sphere, index space, and their exact unit normals in world
    space.
    """
    u = np.random.default_rng(31).normal(size=(count, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    n = u / spacing
    return (20.0 + 12.0 * u).astype(np.float32), n / np.linalg.norm(n, axis=1, keepdims=True)


def shade(model, points, normals, voxels=BALL, iso=0.0, spacing=(1.0, 1.0, 1.0)):
    """`shade_local` after `find_shadows`: linear RGB (n, 3)."""
    field = field_of(voxels, spacing)
    normals = normals.astype(np.float32)
    seen = np.zeros(len(points), np.bool_)
    size = 2 * len(points)
    some = SurfacePoints(points, normals, np.arange(1, size, 2, dtype=np.uint32))
    if model.shadow:
        find_shadows(surface_of(field, iso), some, model.key, seen)
    planes = Framebuffer(
        np.zeros((size, 3), np.float32), np.zeros(size, np.uint8), np.full(size, 7.0, np.float32)
    )
    pixels = some.pixels
    shade_local(some, seen, EYE, spacing, model, planes)
    assert (
        not planes.radiance[::2].any()
        and (planes.state[pixels] == FINAL).all()
        and not planes.error[pixels].any()
    )
    return planes.radiance[pixels]


def twin(model, points, normals, seen=1.0, spacing=(1.0, 1.0, 1.0)):
    """Lambert or Phong with fog, in NumPy."""
    cosine = np.maximum(normals @ model.key, 0.0)
    view = (np.array(EYE) - points) * spacing
    depth = np.linalg.norm(view, axis=1)
    mirror = 2.0 * (normals @ model.key)[:, None] * normals - model.key
    shine = np.maximum((mirror * view).sum(axis=1) / depth, 0.0) ** model.exponent
    lit = seen * (cosine + np.where(cosine > 0, model.shine * shine, 0.0))
    clear = 1.0
    if model.fog_far > model.fog_near:
        far = np.maximum(depth - model.fog_near, 0.0) / (model.fog_far - model.fog_near)
        clear = np.exp(-4.0 * far**2)[:, None]
    return clear * (np.array(model.ambient) + lit[:, None] * model.sun)


@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (0.5, 2.0, 1.0)])
def test_normals_of_a_ball(spacing):
    points, expected = ball_points(spacing=spacing)
    normals = np.empty_like(points)
    find_normals(field_of(BALL, spacing), points, EYE, normals)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-6)
    assert (normals * expected).sum(axis=1).min() > math.cos(math.radians(1.0))


def test_a_flat_place_faces_the_eye():
    points = np.array([[20, 20, 20]], np.float32)
    normals = np.empty_like(points)
    find_normals(field_of(np.ones((41, 41, 41)), (1.0, 2.0, 1.0)), points, EYE, normals)
    towards = (np.array(EYE) - 20.0) * (1.0, 2.0, 1.0)
    np.testing.assert_allclose(normals[0], towards / np.linalg.norm(towards), rtol=1e-6)


@pytest.mark.parametrize(
    "model",
    [
        LAMBERT,
        LAMBERT._replace(shine=0.4),
        LAMBERT._replace(shine=0.4, exponent=5.0),
        LAMBERT._replace(fog_near=60.0, fog_far=110.0),
        LAMBERT._replace(shine=0.3, fog_near=70.0, fog_far=71.0),
    ],
    ids=["lambert", "phong", "broad", "fog", "phong in fog"],
)
@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (0.5, 2.0, 1.0)])
def test_local_models_are_those_of_numpy(model, spacing):
    points, normals = ball_points(spacing=spacing)
    normals = normals.astype(np.float32).astype(float)
    expected = twin(model, points.astype(float), normals, spacing=spacing)
    np.testing.assert_allclose(shade(model, points, normals, spacing=spacing), expected, atol=2e-6)


def test_one_ball_casts_the_shadow_of_a_sphere_on_another():
    """Two balls in line with the light: in shadow is what the cylinder behind the upper one
    holds.
    """
    key = (0.0, 0.0, 1.0)
    low = 9.0 - np.sqrt(X**2 + Y**2 + (Z + 10) ** 2)
    high = 5.0 - np.sqrt((X - 3) ** 2 + Y**2 + (Z - 10) ** 2)
    u = np.random.default_rng(32).normal(size=(COUNT, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    u[:, 2] = np.abs(u[:, 2])
    points = (np.array([20.0, 20.0, 10.0]) + 9.0 * u).astype(np.float32)
    aside = np.hypot(points[:, 0] - 23.0, points[:, 1] - 20.0)
    clear = (np.abs(aside - 5.0) > 0.3) & (u[:, 2] > 0.1)
    model = LAMBERT._replace(key=key, shadow=True)
    expected = twin(model, points.astype(float), u, seen=(aside > 5.0) * 1.0)
    assert 0.1 < (aside < 5.0).mean() < 0.9
    np.testing.assert_allclose(
        shade(model, points, u, np.maximum(low, high))[clear], expected[clear], atol=2e-6
    )


NOISY = BALL + np.random.default_rng(7).normal(size=BALL.shape) * 2.0


@njit(cache=True)
def shadows_one_by_one(field, iso, points, normals, key, seen):
    for m in range(len(points)):
        p, n = point_of(points, m), point_of(normals, m)
        o = launch(field, iso, p, n, OUTSIDE_SIGN)
        t, _ = cast(field, iso, o, to_index(key, field.spacing), OUTSIDE_SIGN)
        seen[m] = n[0] * key[0] + n[1] * key[1] + n[2] * key[2] > 0.0 and not t < np.inf


@pytest.mark.slow
@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (0.5, 2.0, 1.0)])
def test_shadows_of_many_rays_are_those_of_single_ones(spacing):
    points, normals = ball_points(spacing=spacing)
    field = field_of(NOISY, spacing)
    normals = normals.astype(np.float32)
    seen = np.zeros((2, len(points)), np.bool_)
    pixels = np.arange(len(points), dtype=np.uint32)
    find_shadows(surface_of(field, 0.0), SurfacePoints(points, normals, pixels), KEY, seen[0])
    shadows_one_by_one(field, 0.0, points, normals, KEY, seen[1])
    assert np.array_equal(*seen)
    assert 0.05 < seen[0].mean() < 0.45


def trace(place, light, weights, samples, replicas=2, stream=0):
    """Sums (n, replicas, 3) of `trace_points` over the ball; ``place`` is points, normals and
    perhaps pixels.
    """
    points, normals, *pixels = place
    sums = np.zeros((len(points), replicas, 3))
    own = (pixels[0] if pixels else np.arange(len(points))).astype(np.uint32)
    some = SurfacePoints(points, normals.astype(np.float32), own)
    rules = PathRules(weights, 1.0)
    trace_points(
        surface_of(field_of(BALL), 0.0), some, light, rules, stream, SampleRange(*samples), sums
    )
    return sums


def half_sky(matrix):
    """Radiance 1 from the upper half in red, the lower in green, a constant 0.25 in all, turned by
    `matrix`.
    """
    image = np.zeros((2, 4, 3), np.float32)
    image[0, :, 0] = image[1, :, 1] = 1.0
    return Surroundings(np.full(3, 0.25), image, np.ascontiguousarray(matrix, float))


@pytest.mark.parametrize("axis", range(3))
def test_path_tracer_sees_the_turned_environment(axis):
    """A ball's point of normal n under a half sky whose pole is p: E/π = (1 + n·p)/2."""
    matrix = np.roll(np.eye(3), axis, axis=1)
    pole = matrix @ np.array([0.0, 0.0, 1.0])
    points, normals = ball_points(20)
    count = few(2048, 64)
    light = trace((points, normals), half_sky(matrix), np.full((1, 3), 0.5), (0, count)).sum(
        axis=1
    ) / (2 * count)
    up = (1.0 + normals @ pole) / 2.0
    expected = 0.5 * (0.25 + np.stack([up, 1.0 - up, np.zeros_like(up)], axis=1))
    np.testing.assert_allclose(light, expected, atol=few(0.01, 0.03))


def test_paths_belong_to_the_pixel():
    points, normals = ball_points(6)
    light = half_sky(np.eye(3))
    weights = np.full((3, 3), 0.5)
    place = points, normals
    whole = trace(place, light, weights, (0, 12))
    turned = trace(
        (points[::-1].copy(), normals[::-1], np.arange(6)[::-1].copy()), light, weights, (0, 12)
    )
    assert np.array_equal(turned[::-1], whole)
    others = trace((*place, np.arange(6) + 100), light, weights, (0, 12))
    assert not np.array_equal(others, whole)
    assert not np.array_equal(whole[:, 0], whole[:, 1]), "the halves are two randomisations"


def test_replicas_are_numbered_from_the_stream_on():
    place = ball_points(6)
    light = half_sky(np.eye(3))
    weights = np.full((3, 3), 0.5)
    four = trace(place, light, weights, (0, 5), replicas=4)
    assert np.array_equal(trace(place, light, weights, (0, 5)), four[:, :2])
    assert np.array_equal(trace(place, light, weights, (0, 5), stream=1, replicas=3), four[:, 1:])


def test_sums_of_any_number_of_goes_have_the_same_bits():
    points, normals = ball_points(6)
    surface = surface_of(field_of(BALL), 0.0)
    light = half_sky(np.eye(3))
    rules = PathRules(np.full((3, 3), 0.5), 1.0)
    place = SurfacePoints(points, normals.astype(np.float32), np.arange(6, dtype=np.uint32))
    sums = np.zeros((2, 6, 2, 3))
    for goes, into in zip(((12,), (5, 7)), sums, strict=True):
        first = 0
        for count in goes:
            trace_points(surface, place, light, rules, 0, SampleRange(first, count), into)
            first += count
    assert sums[0].any() and np.array_equal(*sums)
