"""Light of walls in the framebuffer, interpolated between the texels of a lattice on each wall."""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import INTEGER_ARRAY, kernel, record
from isogi_core.kernels.shading.framebuffer import FRAMEBUFFER, luminance, put_pixel
from isogi_core.kernels.shading.surface_points import PIXEL_ARRAY, POINT_ROWS, point_of
from isogi_core.kernels.tracing.vec import sub
from isogi_core.kernels.tracing.walls import WALLS_RECORD, inner
from isogi_core.kernels.transport.lights import row

WALL_VARIANCE_COLUMN = 3
"""Column of a wall's texel that holds the variance of its luminance, after the colours."""


class WallTable(NamedTuple):
    """The texels of k walls.

    - ``light`` float32 (texels, 4): linear RGB that leaves them, and the variance of its luminance.
    - ``first`` (k,): first row of each wall.
    - ``rows``, ``columns`` (k,): texels along its second and its first edge, at least 2.
    - ``states`` uint8 (k,): state of the pixels that show it.
    """

    light: Any
    first: Any
    rows: Any
    columns: Any
    states: Any


WALL_TABLE = record(
    WallTable, types.float32[:, ::1], INTEGER_ARRAY, INTEGER_ARRAY, INTEGER_ARRAY, types.uint8[::1]
)


@kernel()
def texel_before(share, count):
    """Return the texel before a ``share`` (0 to 1) of an edge with ``count`` texels, and the
    fraction to the next; texels are at the middles of equal parts.
    """
    place = min(max(share * count - 0.5, 0.0), count - 1.0)
    low = min(int(place), count - 2)
    return low, place - low


@kernel()
def mix_texels(table, first, columns, way, c):
    """Return column ``c`` of a wall's texels, bilinear between four of them at the fractions
    ``way`` (x, y) along the first and the second edge.

    The table has a row for each texel, ``columns`` of them along the first edge: the four are rows
    ``first``, ``first`` + 1, and those ``columns`` further on.
    """
    light = table.light
    (x, y) = way
    low = (1.0 - x) * light[first, c] + x * light[first + 1, c]
    high = (1.0 - x) * light[first + columns, c] + x * light[first + columns + 1, c]
    return (1.0 - y) * low + y * high


@kernel(
    types.void(
        WALLS_RECORD,
        WALL_TABLE,
        PIXEL_ARRAY,
        POINT_ROWS,
        types.int8[::1],
        types.float32,
        FRAMEBUFFER,
    )
)
def light_walls(walls, table, pixels, points, numbers, darkest, framebuffer):
    """Write the light of walls ``numbers`` (m,) at their ``points`` (m, 3), in index space, to the
    ``framebuffer`` at ``pixels`` (m,).

    The error is relative to the luminance, or to ``darkest`` if that is larger.
    """
    for m in range(pixels.shape[0]):
        k = int(numbers[m])
        # Find the four texels around the point, by its share of both edges.
        away = sub(point_of(points, m), row(walls.corners, k))
        i, x = texel_before(inner(walls.across[k], 0, away), table.columns[k])
        j, y = texel_before(inner(walls.across[k], 1, away), table.rows[k])
        first = table.first[k] + j * table.columns[k] + i
        way = (x, y)
        r = mix_texels(table, first, table.columns[k], way, 0)
        g = mix_texels(table, first, table.columns[k], way, 1)
        b = mix_texels(table, first, table.columns[k], way, 2)
        noise = math.sqrt(mix_texels(table, first, table.columns[k], way, WALL_VARIANCE_COLUMN))
        error = min(noise / max(luminance(r, g, b), darkest), 1.0)
        put_pixel(framebuffer, pixels[m], (r, g, b), table.states[k], np.float32(error))
