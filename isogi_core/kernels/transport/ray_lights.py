"""Lights that single rays are aimed at: panels, discs and a sharp environment, and the light
that rays bring from them.
"""

import math
from typing import Any, NamedTuple

from numba import types

from isogi_core.kernels._jit import REAL_ARRAY, REAL_ROWS, kernel, record
from isogi_core.kernels.tracing.vec import (
    SMALLEST_NORMAL,
    cross,
    dot,
    length,
    madd,
    normalize,
    scale,
    sub,
)
from isogi_core.kernels.transport.light_paths import SURROUNDINGS_RECORD
from isogi_core.kernels.transport.lights import (
    NO_LIGHT,
    draw_bright,
    draw_from_disc,
    has_bright_pixels,
    pixel_radiance,
    pixel_towards,
    radiance,
    row,
)


class Panels(NamedTuple):
    """k ≥ 0 flat lamps and luminaires: ``corners`` (k, 3), ``edges`` (k, 2, 3), ``radiances`` (k,
    3).

    Both sides emit if ``twofold`` (k,) is 1. Lamps do not end rays as walls do: ``clear`` (k,) is 1
    for these.
    """

    corners: Any
    edges: Any
    radiances: Any
    twofold: Any
    clear: Any


class Discs(NamedTuple):
    """k ≥ 0 discs at infinity, see ``LampArrays``, with their ``radiances`` (k, 3)."""

    towards: Any
    edges: Any
    radiances: Any


class ShineLights(NamedTuple):
    """All light that rays of shine may bring.

    ``around`` has only lamps without an extent; the others are panels and discs. A ray that ends on
    a surface is expected to bring the radiance ``ambient``. Each ray is the best of ``ways``
    candidates.
    """

    around: Any
    panels: Any
    discs: Any
    ambient: float
    ways: int


PAIRS_OF_ROWS = types.float64[:, :, ::1]
PANELS = record(Panels, REAL_ROWS, PAIRS_OF_ROWS, REAL_ROWS, REAL_ARRAY, REAL_ARRAY)
DISCS = record(Discs, REAL_ROWS, PAIRS_OF_ROWS, REAL_ROWS)
SHINE_LIGHTS = record(ShineLights, SURROUNDINGS_RECORD, PANELS, DISCS, types.float64, types.int64)


@kernel()
def panel_met(panels, k, p, w):
    """Return the distance of panel ``k`` along ``w`` from the world point ``p``, infinite if it
    is dark or missed, and its density per steradian under area sampling.
    """
    u, v = row(panels.edges[k], 0), row(panels.edges[k], 1)
    across = cross(u, v)
    away = sub(row(panels.corners, k), p)
    area = length(across)
    # Only the front emits, unless the panel is twofold.
    slope = dot(across, w) / area
    if slope == 0.0 or not (slope < 0.0 or panels.twofold[k] > 0.0):
        return math.inf, 0.0
    # Intersect its plane, and find the coordinates of the point along both edges.
    t = dot(across, away) / area / slope
    q = sub(scale(w, t), away)
    a = dot(cross(q, v), across) / (area * area)
    b = dot(cross(u, q), across) / (area * area)
    if not (t > 0.0 and 0.0 <= a <= 1.0 and 0.0 <= b <= 1.0):
        return math.inf, 0.0
    return t, t * t / max(area * abs(slope), SMALLEST_NORMAL)


@kernel()
def disc_met(discs, k, w):
    """Return the density of direction ``w`` when sampled from disc ``k``;
    0 outside of it. See ``draw_from_disc``.
    """
    towards = row(discs.towards, k)
    cosine = dot(towards, w)
    across = madd(w, -cosine, towards)
    radius = row(discs.edges[k], 0)
    square = dot(radius, radius)
    if cosine > 0.0 and dot(across, across) <= square:
        return cosine / (math.pi * square)
    return 0.0


@kernel()
def count_lights(lights):
    """Return the number of lights that rays may be aimed at."""
    if has_bright_pixels(lights.around.table):
        bright = 1
    else:
        bright = 0
    return bright + lights.panels.corners.shape[0] + lights.discs.towards.shape[0]


@kernel()
def draw_light(lights, which, p, a, b):
    """Sample a world direction from ``p`` towards light number ``which`` by (a, b) in [0, 1)²."""
    around = lights.around
    panels = lights.panels
    # Lights are numbered: the bright environment if there is one, then panels, then discs.
    bright = 1 if has_bright_pixels(around.table) else 0
    if which < bright:
        return draw_bright(around.table, around.matrix, a, b)[0]
    k = which - bright
    if k < panels.corners.shape[0]:
        edges = panels.edges[k]
        return normalize(
            sub(madd(madd(row(panels.corners, k), a, row(edges, 0)), b, row(edges, 1)), p)
        )
    k -= panels.corners.shape[0]
    return draw_from_disc(row(lights.discs.towards, k), lights.discs.edges[k], a, b)[0]


@kernel(inline=True)
def expect_along(lights, p, w):
    """Return the linear RGB radiance along ``w`` from ``p`` without occlusion, and the density
    of ``draw_light`` over all lights, chosen uniformly.
    """
    around = lights.around
    panels = lights.panels
    discs = lights.discs
    # Add the environment, with its density if it is sampled.
    total = 0.0
    if has_bright_pixels(around.table):
        y, x = pixel_towards(around.table.pixels, around.matrix, w)
        (r, g, b) = pixel_radiance(around.table, y, x)
        total += around.table.pixels[y, x, 3]
    else:
        (r, g, b) = radiance(around.constant, around.image, around.matrix, w)
    # Add the panels and discs that the ray would meet.
    for k in range(panels.corners.shape[0]):
        t, density = panel_met(panels, k, p, w)
        if t < math.inf:
            light = row(panels.radiances, k)
            r = r + light[0]
            g = g + light[1]
            b = b + light[2]
            total = total + density
    for k in range(discs.towards.shape[0]):
        density = disc_met(discs, k, w)
        if density > 0.0:
            light = row(discs.radiances, k)
            r = r + light[0]
            g = g + light[1]
            b = b + light[2]
            total = total + density
    return (r, g, b), total / max(count_lights(lights), 1)


@kernel()
def lamps_before(lights, p, w, t):
    """Return the light of lamps before ``t`` along the ray from ``p`` in direction ``w``."""
    panels = lights.panels
    (r, g, b) = NO_LIGHT
    for k in range(panels.corners.shape[0]):
        if panels.clear[k] > 0.0 and panel_met(panels, k, p, w)[0] < t:
            light = row(panels.radiances, k)
            r, g, b = r + light[0], g + light[1], b + light[2]
    return r, g, b
