"""Lamps: lights that stay where they are, each of which a point sees along one ray.

What a lamp gives is told as irradiance over π, so that a surface of albedo R under it has R times that radiance.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel, record
from isogi_core.kernels.harmonics import accumulate
from isogi_core.kernels.sampling import sample_disc
from isogi_core.kernels.vec import cross, dot, length, madd, scale, sub

DIRECTIONAL, POINT, AREA = 0, 1, 2

NOTHING = (0.0, 0.0, 0.0)


class LampArrays(NamedTuple):
    """k >= 0 lamps, all in the world.

    ``kinds`` int8 (k,); ``places`` float64 (k, 3): the unit direction towards a directional lamp, the
    position of a point, the corner of an area; ``edges`` (k, 2, 3): two radii of a directional lamp's disc, as
    long as the sine of its half angle, zeros, the edges of an area; ``colours`` (k, 3) linear RGB over π:
    irradiance, intensity, radiance.
    """

    kinds: Any
    places: Any
    edges: Any
    colours: Any


NO_LAMPS = LampArrays(np.zeros(0, np.int8), np.zeros((0, 3)), np.zeros((0, 2, 3)), np.zeros((0, 3)))
LAMPS = record(LampArrays, types.int8[::1], types.float64[:, ::1], types.float64[:, :, ::1], types.float64[:, ::1])


@kernel()
def row(vectors, m):
    """Row ``m`` of a (k, 3) array as a tuple."""
    return vectors[m, 0], vectors[m, 1], vectors[m, 2]


@kernel()
def draw_from_disc(towards, edges, u, v):
    """A direction to the disc of a directional lamp, and its cosine to the disc's axis ``towards``.

    Its density per steradian is that cosine over the disc's projected area: even radiance E/area then gives
    a surface that faces the lamp E, without noise.
    """
    x, y = sample_disc(u, v)
    across = madd(scale(row(edges, 0), x), y, row(edges, 1))
    cosine = math.sqrt(max(1.0 - dot(across, across), 0.0))
    return madd(across, cosine, towards), cosine


@kernel()
def illuminate(lamps, k, p, n, u, v):
    """What lamp ``k`` sends to the world point ``p`` with normal ``n``, were nothing between.

    Returns the unit direction towards it, its distance and an estimate of E/π, linear RGB, from (u, v) in
    [0, 1)²: E cosθ/π, I cosθ/(π r²), or L A cosθ cosθ'/(π r²) (Veach 1997, section 8.2).
    """
    place, edges, colour = row(lamps.places, k), lamps.edges[k], row(lamps.colours, k)
    if lamps.kinds[k] == DIRECTIONAL:
        w, cosine = draw_from_disc(place, edges, u, v)
        return w, math.inf, scale(colour, max(dot(n, w), 0.0) / cosine)
    away = sub(madd(madd(place, u, row(edges, 0)), v, row(edges, 1)), p)
    distance = length(away)
    square = distance * distance
    if not square > 0.0:
        return n, 0.0, NOTHING
    w = scale(away, 1.0 / distance)
    share = max(dot(n, w), 0.0) / square
    if lamps.kinds[k] == AREA:
        share *= max(-dot(w, cross(row(edges, 0), row(edges, 1))), 0.0)
    return w, distance, scale(colour, share)


VECTORS = types.float64[:, ::1]


@kernel(types.void(types.int64, VECTORS, VECTORS, VECTORS))
def project_lamps(order, directions, irradiances, coefficients):
    """Add Σ E Y_i(d) of lights without size in unit ``directions`` (k, 3) to ``coefficients`` (3, n²).

    ``irradiances`` (k, 3) are those of a surface that faces each of them.
    """
    for k in range(directions.shape[0]):
        x, y, z = row(directions, k)
        for c in range(3):
            accumulate(order, x, y, z, irradiances[k, c], coefficients[c])
