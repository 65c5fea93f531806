"""Lights and starts of paths, for the tests of what paths gather."""

import math

import numpy as np

from isogi_core.frame.rays.point_paths import path_starts
from isogi_core.kernels.tracing.walls import NO_WALL
from isogi_core.kernels.transport.light_paths import Open, Surroundings, light_in_the_open
from isogi_core.kernels.transport.lights import AREA, DIRECTIONAL, NO_LAMPS, POINT, LampArrays
from isogi_core.kernels.transport.paths import PathRules, PathStarts, SampleRange
from isogi_core.kernels.transport.transfer import bake_irradiance, locate_texels, texel_seed
from isogi_core.model.environment import bright_table, pixel_directions
from tests.kernels.fields import cells_of

Z, Y, X = np.mgrid[:41, :41, :41] - 20.0
DISTANCE = np.sqrt(X * X + Y * Y + Z * Z)
BALL = 12.0 - DISTANCE
NOISY = BALL + np.random.default_rng(7).normal(size=BALL.shape) * 2.0
PLANE = -Z
TORUS = 5.0 - np.hypot(np.hypot(X, Y) - 12.0, Z)
DARK = np.zeros((1, 1, 3), np.float32)
UP = np.array([[0.0], [0.0], [1.0]])
MIDDLE = np.full((3, 1), 20.0)


def lamps(*rows):
    """Lamps of (kind, place, edges, colour)."""
    kinds, places, edges, colours = zip(*rows, strict=True)
    edges = [np.zeros((2, 3)) if each is None else each for each in edges]
    return LampArrays(
        np.array(kinds, np.int8), *(np.array(each, float) for each in (places, edges, colours))
    )


def surroundings(image=DARK, constant=0.0, table=False, lamps=NO_LAMPS, matrix=None):
    """Light of an image, with a table where it is to be drawn from."""
    image = np.asarray(image, np.float32)
    light = Surroundings(
        np.full(3, constant), image, np.eye(3) if matrix is None else matrix, lamps=lamps
    )
    if not table:
        return light
    bright = np.maximum(image.sum(axis=2) - image.sum(axis=2).mean(), 0.0)
    return light._replace(table=bright_table(image + light.constant, bright))


def gather(field, place, light, weights, samples, sums=None):
    """E/π at the two halves of each texel, the mean of some samples, (m, 2, 3); those before are in
    ``sums``.

    ``samples`` are a number, or first and count.
    """
    if isinstance(samples, int):
        some = SampleRange(0, samples)
    else:
        some = SampleRange(*samples)
    if sums is None:
        sums = np.zeros((len(place[0]), 2, 3))
    else:
        sums = sums.copy()
    cells = cells_of(field, place[3][0])
    bake_irradiance(
        field, cells, place, np.arange(len(sums)), some, PathRules(weights, 1.0), light, sums
    )
    return sums / (some.first + some.count)


def place_at(points, normals):
    """The place of texels (texels, points, normals, isovalues) of points with normals (3, m), on
    one isosurface.
    """
    texels = np.zeros((points.shape[1], 3), np.int32)
    texels[:, 0] = np.arange(len(texels))
    return texels, points, normals, np.zeros(len(texels))


def halves_of(place):
    """The starts of the two halves of each texel."""
    texels, *others = place
    seeds = [texel_seed(*texel, half) for texel in texels.tolist() for half in range(2)]
    both = (np.repeat(each, 2, axis=-1) for each in others)
    return PathStarts(*both, np.array(seeds, np.uint64), np.full(len(seeds), NO_WALL))


def trace_points(surface, points, light, rules, stream, samples, sums):
    """Add what paths in the open bring to ``SurfacePoints`` to ``sums`` (m, replicas, 3), from a
    ``stream`` on.
    """
    starts = path_starts(surface, points, range(stream, stream + sums.shape[1]))
    light_in_the_open(
        Open(surface.field, surface.cells), starts, samples, rules, light, sums.reshape(-1, 3)
    )


def on_ball(count, seed=3):
    """Points (3, n) of the ball of radius 12, and their normals."""
    n = np.random.default_rng(seed).normal(size=(3, count))
    n /= np.linalg.norm(n, axis=0)
    return 20.0 + 12.0 * n, n


def sunny(height=32, sun=(0.36, 0.48, 0.8), radiance=400.0):
    """A dim sky of two colours with a disc of 5 degrees in it."""
    directions = pixel_directions(height, 2 * height)
    image = np.where(directions[..., 2:] > 0.0, (0.3, 0.4, 0.6), (0.1, 0.1, 0.0))
    image[directions @ sun > math.cos(math.radians(5.0))] = radiance
    return image


EVERY_LAMP = lamps(
    (DIRECTIONAL, (0.0, 0.6, 0.8), None, (0.3, 0.2, 0.1)),
    (DIRECTIONAL, (1.0, 0.0, 0.0), [(0.0, 0.1, 0.0), (0.0, 0.0, 0.1)], (0.1, 0.2, 0.3)),
    (POINT, (30.0, 35.0, 38.0), None, (90.0, 10.0, 50.0)),
    (AREA, (5.0, 5.0, 38.0), [(0.0, 20.0, 0.0), (20.0, 0.0, 0.0)], (0.5, 0.4, 0.3)),
)
TURN = np.array([[0.0, -1.0, 0.0], [0.6, 0.0, -0.8], [0.8, 0.0, 0.6]])
LIGHTS = {
    "constant": surroundings(constant=0.7),
    "image": surroundings(sunny(), 0.2, matrix=TURN),
    "table": surroundings(sunny(), 0.2, table=True, matrix=TURN),
    "lamps": surroundings(lamps=EVERY_LAMP),
    "all": surroundings(sunny(), 0.1, table=True, lamps=EVERY_LAMP, matrix=TURN),
}


def place_of(field, texels):
    """What `locate_texels` tells, and the map of their isosurfaces."""
    m = len(texels)
    place = (
        np.ascontiguousarray(texels, np.int32),
        np.empty((3, m)),
        np.empty((3, m)),
        np.empty(m),
    )
    void = np.empty(m, np.bool_)
    locate_texels(field, np.ones(3), *place, void)
    assert not void.any()
    return place, cells_of(field, place[3].min(), place[3].max())
