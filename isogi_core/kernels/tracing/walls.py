"""Walls: flat rectangles around the isosurface. Rays meet them one at a time or in SIMD
vectors, with the same bits.
"""

from typing import Any, NamedTuple

from numba import types

from isogi_core.kernels._jit import REAL_ARRAY, REAL_ROWS, kernel, record
from isogi_core.kernels.simd.maths import divide, where
from isogi_core.kernels.simd.memory import load, store
from isogi_core.kernels.simd.types import PATH_WIDTH
from isogi_core.kernels.tracing.vec import load_columns

NO_WALL = -1.0
"""Stands for no wall instead of a number."""

WALL_RIM = 1e-9
"""Share of its edges by which a wall extends beyond them,
so that no ray slips between two that touch.
"""


class Walls(NamedTuple):
    """k ≥ 0 rectangles, as rays in index space meet them; all float64.

    ``corners`` (k, 3) are in index space. ``planes`` (k, 3) times an index-space direction give its
    world component along the wall's normal; ``across`` (k, 2, 3) times the vector from the corner
    give its coordinates along the two edges. Rays whose component is below ``backs`` (k,) are
    stopped: all if that is infinite, those that hit the front if it is 0.
    """

    corners: Any
    planes: Any
    across: Any
    backs: Any


WALLS_RECORD = record(Walls, REAL_ROWS, REAL_ROWS, types.float64[:, :, ::1], REAL_ARRAY)


@kernel(exact=True)
def inner(rows, k, v):
    """Return row ``k`` of a (k, 3) array times the vector ``v``."""
    return rows[k, 0] * v[0] + rows[k, 1] * v[1] + rows[k, 2] * v[2]


@kernel(exact=True)
def nearest_wall(walls, o, d, start, reach):
    """Return the first wall that the ray o + t·d meets for 0 < t < ``reach``: (t, number), or
    (reach, NO_WALL).

    A ray never meets the wall ``start`` that it starts on, a number or NO_WALL. Takes vectors of
    rays as well.
    """
    # Begin with no wall, as a number or a vector as ``start`` is.
    found = start * 0.0 + NO_WALL
    for k in range(walls.corners.shape[0]):
        # Find the ray's hit on the wall's plane, and its coordinates along the two edges.
        x = o[0] - walls.corners[k, 0]
        y = o[1] - walls.corners[k, 1]
        z = o[2] - walls.corners[k, 2]
        # A ray parallel to the plane has an infinite t or NaN, and fails the comparisons below.
        slope = inner(walls.planes, k, d)
        t = divide(-inner(walls.planes, k, (x, y, z)), slope)
        p = x + t * d[0], y + t * d[1], z + t * d[2]
        a, b = inner(walls.across[k], 0, p), inner(walls.across[k], 1, p)
        within = (a >= -WALL_RIM) & (a <= 1.0 + WALL_RIM) & (b >= -WALL_RIM) & (b <= 1.0 + WALL_RIM)
        # Keep it if it is on the rectangle, before the nearest so far, on a side that stops rays.
        met = within & (t > 0.0) & (t < reach) & (start != float(k)) & (slope < walls.backs[k])
        reach = where(met, t, reach)
        found = where(met, float(k), found)
    return reach, found


@kernel()
def meet_walls(walls, origins, directions, start, t, met):
    """Shorten the distances ``t`` (n,) of rays ``origins`` + t · ``directions`` (3, n) to their
    first walls.

    ``start`` (n,) are the walls that they start on; ``met`` (n,) are the walls that they hit, or
    NO_WALL. n is a multiple of the vector width.
    """
    for i in range(0, t.shape[0], PATH_WIDTH):
        o, d = load_columns(origins, i), load_columns(directions, i)
        reach, found = nearest_wall(walls, o, d, load(start, i, PATH_WIDTH), load(t, i, PATH_WIDTH))
        store(t, i, reach)
        store(met, i, found)
