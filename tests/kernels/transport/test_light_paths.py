"""Lit paths against closed forms, against paths one at a time, and by their statistics."""

import math

import numpy as np
import pytest

from isogi_core.kernels.shading.surface_points import SurfacePoints
from isogi_core.kernels.tracing.walls import NO_WALL
from isogi_core.kernels.transport.lights import POINT
from isogi_core.kernels.transport.paths import PathRules, PathStarts, SampleRange
from isogi_core.kernels.transport.rng import mix
from isogi_core.model.environment import bright_table, pixel_directions, solid_angles
from tests.kernels.fields import field_of, surface_of
from tests.kernels.transport.lighting import (
    BALL,
    LIGHTS,
    MIDDLE,
    NOISY,
    PLANE,
    TURN,
    UP,
    Z,
    gather,
    halves_of,
    lamps,
    on_ball,
    place_at,
    sunny,
    surroundings,
    trace_points,
)
from tests.oracles.paths import gathered, one_surface
from tests.scale import COMPILED, PYTHON, few


@pytest.mark.slow
@pytest.mark.parametrize("name", LIGHTS)
@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (0.5, 1.0, 2.0)])
def test_waves_gather_what_paths_one_by_one_do(name, spacing):
    texels, count = few((150, 20), (10, 2))
    weights = np.cumprod(np.array([[1.0, 0.9, 0.8], *[[0.9, 0.7, 0.5]] * 4]), axis=0)
    light = LIGHTS[name]
    field = field_of(NOISY, spacing)
    place = place_at(*on_ball(texels))
    world = one_surface(field, albedo=(0.9, 0.7, 0.5))
    paths = gathered(
        world, halves_of(place), SampleRange(3, count), 4, light, weight=(1.0, 0.9, 0.8)
    )[:, :, 0]
    nothing = np.zeros((texels, 2, 3))
    found = gather(field, place, light, weights, (3, count), nothing) * (3 + count)
    np.testing.assert_allclose(found.reshape(-1, 3), paths.sum(axis=1), rtol=1e-12, atol=1e-14)
    assert (paths > 0.0).mean() > 0.2


@pytest.mark.parametrize(("count", "points"), [(3, 300), (2500, 2)])
def test_points_are_traced_by_the_paths_one_by_one(count, points):
    """To the last bit of their sums, also where one point alone has more paths than a wave."""
    if PYTHON:
        count = min(count, 3)
        points = min(points, 20)
    field = field_of(NOISY)
    light = LIGHTS["image"]
    points, normals = (np.ascontiguousarray(each.T, np.float32) for each in on_ball(points))
    weights = np.cumprod(np.full((4, 3), 0.7), axis=0)
    pixels = np.arange(len(points), dtype=np.uint32) + 11
    sums = np.zeros((2, len(points), 2, 3))
    place = SurfacePoints(points, normals, pixels)
    samples = SampleRange(2, count)
    trace_points(surface_of(field, 0.0), place, light, PathRules(weights, 1.0), 0, samples, sums[0])
    seeds = np.array(
        [mix(pixel, half) for pixel in pixels.tolist() for half in range(2)], np.uint64
    )
    here, around = (np.repeat(each.T.astype(float), 2, axis=1) for each in (points, normals))
    starts = PathStarts(here, around, np.zeros(len(seeds)), seeds, np.full(len(seeds), NO_WALL))
    paths = gathered(one_surface(field, albedo=0.7), starts, samples, 3, light, weight=0.7)[:, :, 0]
    for sample in paths.reshape(len(points), 2, count, 3).transpose(2, 0, 1, 3):
        sums[1] += sample
    assert sums[0].any(axis=(1, 2)).mean() > 0.9 and np.array_equal(*sums)


# --- closed forms
# ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("table", [False, True])
def test_furnace(table):
    """A convex body under radiance 1 from everywhere receives π; the table may draw what it
    likes.
    """
    image = np.ones((8, 16, 3), np.float32)
    light = surroundings(image)
    if table:
        light = light._replace(
            table=bright_table(image, np.random.default_rng(2).random((8, 16)) ** 4)
        )
    count = few(4096, 40)
    found = gather(field_of(PLANE), place_at(MIDDLE, UP), light, np.ones((2, 3)), count // 2).mean(
        axis=1
    )
    np.testing.assert_allclose(found, 1.0, atol=6.0 / count**0.5 if table else 1e-6)


def test_a_lamp_is_hidden_by_what_is_nearer_only():
    """A floor under a slab: a lamp between the two is seen, one within or above the slab is not."""
    slab = np.maximum(PLANE - 10.0, 2.0 - np.abs(Z - 5.0))
    floor = np.array([[20.0], [20.0], [10.0]])
    for height, seen in ((16.0, True), (22.9, True), (25.0, False), (39.0, False), (60.0, False)):
        light = surroundings(lamps=lamps((POINT, (22.0, 20.0, height), None, (1.0, 1.0, 1.0))))
        found = gather(field_of(slab), place_at(floor, UP), light, np.ones((1, 3)), 1)
        assert (found > 0.0).all() == seen and found.any() == seen


# --- statistics
# --------------------------------------------------------------------------------------------------


@pytest.mark.slow
@COMPILED
@pytest.mark.parametrize("voxels", [BALL, NOISY], ids=["ball", "noisy ball"])
def test_rays_towards_bright_parts_change_noise_and_not_the_mean(voxels):
    """Against cosine rays alone, under a turned, broad sun: each start's mean within its noise, at
    far less of it.
    """
    weights = np.array([0.8, 0.6, 0.4]) ** np.arange(3.0)[:, None]
    image = sunny(radiance=60.0)
    place = place_at(*(np.tile(each, 10_000) for each in on_ball(40)))
    plain, drawn = (
        gather(
            field_of(voxels), place, surroundings(image, 0.1, table=table, matrix=TURN), weights, 1
        )
        .reshape(10_000, 40, 2, 3)
        .swapaxes(0, 1)
        .reshape(40, 20_000, 3)
        for table in (False, True)
    )
    noise = np.sqrt((plain.var(axis=1) + drawn.var(axis=1)) / 20_000)
    z = (plain.mean(axis=1) - drawn.mean(axis=1)) / noise
    assert np.abs(z).max() < 4.5 and abs(z[:, 1].mean()) < 4.0 / len(z) ** 0.5
    assert drawn.var(axis=1).mean() < 0.1 * plain.var(axis=1).mean()


@COMPILED
def test_a_small_sun_is_found_by_few_samples():
    """Irradiance of a plane under a dim sky and one pixel of 10⁻⁵ of it, against the sum over the
    pixels.
    """
    image = np.full((256, 512, 3), 0.2)
    image[60, 100] = 40_000.0
    share = solid_angles(256, 512) * np.maximum(pixel_directions(256, 512)[..., 2], 0.0) / math.pi
    expected = (share[..., None] * image).sum(axis=(0, 1))
    assert expected[0] > 1.0
    found = gather(
        field_of(PLANE), place_at(MIDDLE, UP), surroundings(image, table=True), np.ones((1, 3)), 128
    ).mean(axis=1)
    np.testing.assert_allclose(found[0], expected, rtol=0.01)
