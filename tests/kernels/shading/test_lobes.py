"""Light of lobes against rays cast one by one, and against closed forms."""

import math

import numpy as np
import pytest

from isogi_core.kernels.shading.framebuffer import (
    BLUE,
    CONVERGING,
    FINAL,
    GREEN,
    PROVISIONAL,
    RED,
    Framebuffer,
    PixelPoints,
)
from isogi_core.kernels.shading.lobes import EVEN, RAYS, RIM, SHARP, STREAM, add_lobes, light_lobes, rim_way
from isogi_core.kernels.tracing.field import OFFSET, to_index
from isogi_core.kernels.tracing.intersect import OUTSIDE, cast
from isogi_core.kernels.transport.integrator import launch
from isogi_core.kernels.transport.lights import DIRECTIONAL, LampArrays, draw_from_disc
from isogi_core.kernels.transport.rng import mix, point_2d
from tests.kernels.fields import field_of, surface_of
from tests.scale import few

COUNT = few(1500, 40)
Z, Y, X = np.mgrid[:41, :41, :41].astype(float)
FLOOR, EDGE = 8.0, 18.0
ROOM = np.maximum(FLOOR - Z, np.minimum(np.minimum(EDGE - X, Z - 24.0), 27.0 - Z))
"""A floor, and above it a shelf one side of which ends at x = EDGE."""
LIGHT = np.array([RED, GREEN, BLUE], float)


def lamps_of(*lobes):
    """Directional lamps (towards, degrees across, colour)."""
    towards = np.array([np.array(t) / np.linalg.norm(t) for t, _, _ in lobes]).reshape(-1, 3)
    edges = np.empty((len(lobes), 2, 3))
    for k, (axis, (_, degrees, _)) in enumerate(zip(towards, lobes, strict=True)):
        east = np.cross(axis, [0.0, 1.0, 0.0])
        east /= np.linalg.norm(east)
        edges[k] = math.sin(math.radians(degrees / 2.0)) * np.array([east, np.cross(axis, east)])
    colours = np.array([c for *_, c in lobes], float).reshape(-1, 3)
    return LampArrays(np.full(len(lobes), DIRECTIONAL, np.int8), towards, edges, colours)


def floor_points(count=COUNT, spacing=(1.0, 1.0, 1.0)):
    """Points (n, 3) float32 of the floor, index space, and its normals."""
    xy = np.random.default_rng(3).uniform(8.0, 32.0, (count, 2))
    points = np.column_stack([xy, np.full(count, FLOOR)]).astype(np.float32)
    return points, np.tile(np.array([0.0, 0.0, 1.0], np.float32), (count, 1))


def light(lamps, points, normals, spacing=(1.0, 1.0, 1.0)):
    """`light_lobes` of the room: (n, 4)."""
    lit, field = np.full((len(points), 4), 7.0, np.float32), field_of(ROOM, spacing)
    light_lobes(surface_of(field, 0.0), PixelPoints(points, normals, pixels_of(points)), lamps, lit)
    return lit


def pixels_of(points):
    return (5 + 3 * np.arange(len(points))).astype(np.uint32)


def gets_away(field, p, n, w):
    """Whether a ray from a surface point meets nothing."""
    o = launch(field, 0.0, tuple(p), tuple(n), OUTSIDE)
    return not cast(field, 0.0, o, to_index(tuple(w), field.spacing), OUTSIDE)[0] < math.inf


def twin(lamps, points, normals, spacing=(1.0, 1.0, 1.0)):
    """The same, ray by ray."""
    field, lit = field_of(ROOM, spacing), np.zeros((len(points), 4))
    for m, (p, n, pixel) in enumerate(zip(points.astype(float), normals.astype(float), pixels_of(points), strict=True)):
        for k in range(len(lamps.kinds)):
            share, variance = seen_of(field, lamps, k, p, n, np.uint64(mix(int(pixel), STREAM)))
            lit[m, :3] += share * lamps.colours[k]
            lit[m, 3] += variance * (lamps.colours[k] @ LIGHT) ** 2
    return lit


def seen_of(field, lamps, k, p, n, seed):
    """What a point gets of a lobe's light, and the variance of that."""
    rim = [lamps.places[k]]
    if np.linalg.norm(lamps.edges[k, 0]) > SHARP:
        first = 0.5 * math.pi * point_2d(seed, 0, k)[0]
        rim = [np.array(rim_way(lamps, k, first + 2.0 * math.pi * i / RIM)) for i in range(RIM)]
    seen = [n @ w > 0.0 and gets_away(field, p, n, w) for w in rim]
    if all(seen) or not any(seen):
        return all(seen) * max(n @ lamps.places[k], 0.0), 0.0
    brought = []
    for i in range(RAYS):
        w, cosine = draw_from_disc(tuple(lamps.places[k]), lamps.edges[k], *point_2d(seed, i, k))
        brought.append(max(n @ np.array(w), 0.0) / cosine * gets_away(field, p, n, w))
    return np.mean(brought), EVEN * np.var(brought) / (RAYS - 1)


@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (0.5, 2.0, 1.0)])
@pytest.mark.parametrize("degrees", [0.0, 0.4, 3.0, 15.0])
def test_light_of_lobes_is_that_of_rays_cast_one_by_one(degrees, spacing):
    lamps = lamps_of(((0.6, 0.2, 0.8), degrees, (3.0, 2.0, 1.0)), ((-0.5, 0.1, 0.7), degrees, (0.1, 0.2, 0.4)))
    points, normals = floor_points(few(300, 20))
    lit, expected = light(lamps, points, normals, spacing), twin(lamps, points, normals, spacing)
    np.testing.assert_allclose(lit, expected, rtol=1e-5, atol=1e-6)
    assert (expected[:, 3] > 0.0).any() == (degrees > 1.0), "half-shadows are of wide lobes"


def test_without_lobes_it_is_dark():
    points, normals = floor_points(few(50, 5))
    assert not light(lamps_of(), points, normals).any()


def test_what_sees_a_lobe_has_the_cosine_of_its_light():
    """Away from the shelf nothing is in the way."""
    axis = np.array([0.6, 0.0, 0.8])
    points, normals = floor_points()
    free = points[:, 0] > EDGE + 2.0
    lit = light(lamps_of((axis, 5.0, (3.0, 2.0, 1.0))), points, normals)[free]
    np.testing.assert_allclose(
        lit[:, :3], np.broadcast_to(0.8 * np.array([3.0, 2.0, 1.0]), lit[:, :3].shape), rtol=1e-6
    )
    assert not lit[:, 3].any()


def test_of_a_lobe_on_the_horizon_its_upper_half_arrives():
    points, normals = floor_points()
    free = points[:, 0] > EDGE + 2.0
    below, level = (lamps_of(((1.0, 0.0, z), 8.0, (1.0,) * 3)) for z in (-0.5, 0.0))
    assert not light(below, points, normals).any()
    a = math.sin(math.radians(4.0))
    expected = 4.0 * a / (3.0 * math.pi) / 2.0  # mean height of half a disc, of which there is half
    assert light(level, points, normals)[free, 0].mean() == pytest.approx(expected, rel=0.05)


def test_a_half_shadow_is_the_share_of_the_disc_left_free():
    """Straight above, the shelf hides what is on its side: its lower edge before it, its upper edge from aside."""
    points, normals = floor_points(few(4000, 60))
    degrees = 30.0
    lit = light(lamps_of(((0.0, 1e-9, 1.0), degrees, (1.0,) * 3)), points, normals)
    radius, near = math.sin(math.radians(degrees / 2.0)), np.abs(points[:, 0] - EDGE) < 3.0
    away = EDGE - points[near, 0]
    slope = away / (np.where(away > 0.0, 24.0, 27.0) - FLOOR - OFFSET)
    d = np.clip(slope / np.sqrt(1.0 + slope**2) / radius, -1.0, 1.0)  # a plane cuts the disc about there
    free = (np.arccos(d) - d * np.sqrt(1.0 - d**2)) / math.pi
    wrong = lit[near, 0] - free
    assert abs(wrong.mean()) < 0.01 and np.sqrt((wrong**2).mean()) < 0.1
    told = math.sqrt(lit[near, 3].mean())
    assert 0.5 < told / wrong.std() < 2.0, "and its error is told"


def test_the_same_pixels_have_the_same_light_in_any_company():
    points, normals = floor_points()
    lamps = lamps_of(((0.4, 0.3, 0.8), 12.0, (1.0, 2.0, 3.0)))
    field = field_of(ROOM)
    whole, parts = light(lamps, points, normals), np.empty((len(points), 4), np.float32)
    for a in range(0, len(points), 17):
        piece = slice(a, a + 17)
        at = pixels_of(points)[piece]
        some = PixelPoints(points[piece], normals[piece], at)
        light_lobes(surface_of(field, 0.0), some, lamps, parts[piece])
    assert np.array_equal(whole, parts)


@pytest.mark.parametrize("unit", [1.0, 2.0**-40, 2.0**60])
def test_light_of_lobes_joins_a_picture_with_its_error(unit):
    rng = np.random.default_rng(8)
    before = unit * rng.random((6, 3)).astype(np.float32)
    error = np.array([0.1, 0.02, 0.5, 1.0, 0.3, 1.0], np.float32)
    state = np.array([FINAL, CONVERGING, FINAL, PROVISIONAL, 0, FINAL], np.uint8)
    planes, pixels = Framebuffer(before.copy(), state.copy(), error.copy()), np.array([0, 1, 2, 3, 5], np.uint32)
    lit = rng.random((5, 4)).astype(np.float32)
    lit[0] = 0.0
    add_lobes(pixels, lit, unit, planes)
    after = before.astype(float)
    after[pixels] += unit * lit[:, :3]
    np.testing.assert_allclose(planes.radiance, after, rtol=1e-6)
    noise = np.hypot(error * (before @ LIGHT) / unit, np.sqrt(np.insert(lit[:, 3], 4, 0.0)))
    expected = np.minimum(noise / (after @ LIGHT) * unit, 1.0)
    expected[3], expected[4] = 1.0, error[4]
    np.testing.assert_allclose(planes.error, expected, rtol=1e-5)
    assert np.array_equal(planes.state, state)
