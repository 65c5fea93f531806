"""Lights, starts of paths and one path at a time, for the tests of what paths gather."""

import math

import numpy as np
from numba import njit

from isogi_core.kernels._jit import kernel
from isogi_core.kernels.tracing.field import to_index
from isogi_core.kernels.tracing.intersect import OUTSIDE, cast, launch, shading_normal
from isogi_core.kernels.tracing.vec import column, dot, madd, put_column
from isogi_core.kernels.transport import streams
from isogi_core.kernels.transport.light_paths import Surroundings, sample_source, to_world
from isogi_core.kernels.transport.lights import AREA, DIRECTIONAL, NO_LAMPS, POINT, LampArrays, arriving
from isogi_core.kernels.transport.paths import PathRules, PathStarts, SampleRange
from isogi_core.kernels.transport.rng import point_2d
from isogi_core.kernels.transport.sampling import about, sample_cosine_hemisphere
from isogi_core.kernels.transport.transfer import bake_irradiance, locate_texels, texel_seed
from isogi_core.model.environment import cumulative
from isogi_core.model.latlong import pixel_directions, solid_angles
from tests.kernels.fields import cells_of

Z, Y, X = np.mgrid[:41, :41, :41] - 20.0
DISTANCE = np.sqrt(X * X + Y * Y + Z * Z)
BALL = 12.0 - DISTANCE
NOISY = BALL + np.random.default_rng(7).normal(size=BALL.shape) * 2.0
PLANE = -Z
SHELL = 3.0 - np.abs(DISTANCE - 16.0)
TORUS = 5.0 - np.hypot(np.hypot(X, Y) - 12.0, Z)
DARK = np.zeros((1, 1, 3), np.float32)
UP = np.array([[0.0], [0.0], [1.0]])
MIDDLE = np.full((3, 1), 20.0)


@kernel()
def trace_path(field, iso, start, seed, index, tree, way):
    """One diffuse path from a ``start`` (point, normal, side): (bounces before it left, world direction in which).

    Cosine-weighted directions, so that every path carries the same weight R^k; bounce b draws the
    pair b of sample ``index`` of the sequence ``seed``. From the first hit of the ``PathTree`` it goes on in this
    ``way``, one of its branches, and draws from sample ``branches`` · ``index`` + ``way``. Returns -1 bounces when
    after all of its bounces the path is still inside, or has ended by chance: from the second on it goes on from a
    hit with the chance ``survival``. Source: S1, section 4.1; DESIGN section 3.
    """
    p, n, side = start
    for bounce in range(tree.bounces + 1):
        u, v = point_2d(seed, index, bounce)
        w = about(n, sample_cosine_hemisphere(u, v))
        d = to_index(w, field.spacing)
        o = launch(field, iso, p, n, side)
        t, side = cast(field, iso, o, d, side)
        if not t < math.inf:
            return bounce, w
        if bounce == 0:
            index = index * tree.branches + way
        elif not point_2d(seed, index, streams.ROULETTE + bounce)[0] < tree.survival:
            return -1, (0.0, 0.0, 0.0)
        p = madd(o, t, d)
        n = shading_normal(field, p, side, w)
    return -1, (0.0, 0.0, 0.0)


@njit
def light_path(field, iso, p, n, seed, index, weights, light):
    """One path, each of its rays cast by itself: what it gathers, linear RGB."""
    r, g, b, side = 0.0, 0.0, 0.0, OUTSIDE
    first = 0 if light.table[0].shape[0] > 0 else 1
    for bounce in range(weights.shape[0]):
        o = launch(field, iso, p, n, side)
        x, y, z = weights[bounce]
        for source in range(first, 1 + light.lamps.kinds.shape[0]):
            u, v = point_2d(seed, index, streams.SOURCES + source * streams.PAIRS + bounce)
            w, reach, shine = sample_source(light, source, to_world(o, field.spacing), n, u, v)
            if max(shine[0], shine[1], shine[2]) > 0.0:
                t, _ = cast(field, iso, o, to_index(w, field.spacing), side)
                if not t < reach:
                    r, g, b = r + x * shine[0], g + y * shine[1], b + z * shine[2]
        u, v = point_2d(seed, index, bounce)
        w = about(n, sample_cosine_hemisphere(u, v))
        d = to_index(w, field.spacing)
        t, side = cast(field, iso, o, d, side)
        if not t < math.inf:
            end = arriving(light.constant, light.image, light.matrix, light.table, w, dot(n, w))
            return r + x * end[0], g + y * end[1], b + z * end[2]
        p = madd(o, t, d)
        n = shading_normal(field, p, side, w)
    return r, g, b


@njit
def one_by_one(field, starts, samples, weights, light, gathered):
    g = len(starts.isovalues)
    for m in range(g * samples.count):
        i, sample = m % g, samples.first + m // g
        p, n = column(starts.points, i), column(starts.normals, i)
        path = light_path(field, starts.isovalues[i], p, n, starts.seeds[i], sample, weights, light)
        put_column(gathered, m, path)


def lamps(*rows):
    """Lamps of (kind, place, edges, colour)."""
    kinds, places, edges, colours = zip(*rows, strict=True)
    edges = [np.zeros((2, 3)) if each is None else each for each in edges]
    return LampArrays(np.array(kinds, np.int8), *(np.array(each, float) for each in (places, edges, colours)))


def surroundings(image=DARK, constant=0.0, table=False, lamps=NO_LAMPS, matrix=None):
    """Light of an image, with a table where it is to be drawn from."""
    image = np.asarray(image, np.float32)
    light = Surroundings(np.full(3, constant), image, np.eye(3) if matrix is None else matrix, lamps=lamps)
    if not table:
        return light
    bright = np.maximum(image.sum(axis=2) - image.sum(axis=2).mean(), 0.0)
    return light._replace(table=cumulative(bright * solid_angles(*image.shape[:2])))


def gather(field, place, light, weights, samples, sums=None):
    """E/π at the two halves of each texel, the mean of some samples, (m, 2, 3); those before are in ``sums``.

    ``samples`` are a number, or first and count. A path of ``bake_irradiance`` is one of ``light_paths``.
    """
    some = SampleRange(0, samples) if isinstance(samples, int) else SampleRange(*samples)
    sums, cells = np.zeros((len(place[0]), 2, 3)) if sums is None else sums.copy(), cells_of(field, place[3][0])
    bake_irradiance(field, cells, place, np.arange(len(sums)), some, PathRules(weights, 1.0), light, sums)
    return sums / (some.first + some.count)


def place_at(points, normals):
    """The place of texels (texels, points, normals, isovalues) of points with normals (3, m), on one isosurface."""
    texels = np.zeros((points.shape[1], 3), np.int32)
    texels[:, 0] = np.arange(len(texels))
    return texels, points, normals, np.zeros(len(texels))


def halves_of(place):
    """The ``PathStarts`` of the two halves of each texel."""
    texels, *others = place
    seeds = [texel_seed(*texel, half) for texel in texels.tolist() for half in range(2)]
    return PathStarts(*(np.repeat(each, 2, axis=-1) for each in others), np.array(seeds, np.uint64))


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
    place = (np.ascontiguousarray(texels, np.int32), np.empty((3, m)), np.empty((3, m)), np.empty(m))
    void = np.empty(m, np.bool_)
    locate_texels(field, np.ones(3), *place, void)
    assert not void.any()
    return place, cells_of(field, place[3].min(), place[3].max())
