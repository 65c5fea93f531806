"""What the eye sees through matter that refracts: each ray parts in two at every interface, as far as that counts."""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel, record
from isogi_core.kernels.tracing.cast import SURFACE
from isogi_core.kernels.tracing.field import to_index
from isogi_core.kernels.tracing.intersect import UNKNOWN, cast
from isogi_core.kernels.tracing.slabs import longest
from isogi_core.kernels.tracing.vec import column, dot, madd, normalize, put_column, scale, sub
from isogi_core.kernels.tracing.walls import NOWHERE, nearest_wall
from isogi_core.kernels.transport.light_paths import SURROUNDINGS, to_world
from isogi_core.kernels.transport.lights import radiance, row
from isogi_core.kernels.transport.matter.inside import (
    PASSABLE,
    brightest,
    dimmed,
    meet_interface,
    transmitted,
    way_inside,
)
from isogi_core.kernels.transport.room_paths import lit_from

LEAVES = 8
"""Places that a pixel sees through matter, at most."""

DEEP = 16
"""Interfaces that its light passes at most: then it goes on as it would without the matter."""

LEAST = 1.0 / 128.0
"""Share of a pixel's light below which a ray does not part: the larger part goes on with all of it."""

BACK = 1e-2
"""Voxels before the surface at which the eye's rays start, so that they meet it whatever the rounding of the point."""


class Leaves(NamedTuple):
    """What n points show: ``sky`` (n, 3) float32 of what lies outside, and the walls that their rays end on.

    Row LEAVES · m + j is place j of point m: ``weights`` (rows, 3) and ``points`` (rows, 3; index space) float32, and
    the number of the wall, or -1, in ``met`` (rows,) int8; ``sides`` (rows,) int8 is 1 for its front, -1 for its back.
    """

    sky: Any
    weights: Any
    points: Any
    met: Any
    sides: Any


POINTS, SHORT = types.float32[:, ::1], types.int8[::1]
LEAVES_OF = record(Leaves, POINTS, POINTS, POINTS, SHORT, SHORT)


class Rays(NamedTuple):
    """Rays that are still to be followed: (3, LEAVES) ``origins``, ``ways``, ``weights``, and (LEAVES,) ``sides`` and
    ``depths``.
    """

    origins: Any
    ways: Any
    weights: Any
    sides: Any
    depths: Any


@kernel()
def push(rays, j, o, w, weight, side, depth):
    """Write a ray to place ``j``; returns the place after it."""
    put_column(rays.origins, j, o)
    put_column(rays.ways, j, w)
    put_column(rays.weights, j, weight)
    rays.sides[j], rays.depths[j] = side, depth
    return j + 1


@kernel()
def put_leaf(leaves, place, p, weight, wall, side):
    """Write a wall that is seen."""
    for c in range(3):
        leaves.weights[place, c], leaves.points[place, c] = np.float32(weight[c]), np.float32(p[c])
    leaves.met[place], leaves.sides[place] = np.int8(wall), np.int8(side)


@kernel()
def part(surface, matter, rays, j, ray, room_left):
    """Put what becomes of a ``ray`` = (p, w, weight, side it came from, depth) at the surface, at ``j`` and behind it.

    Returns the next place. It parts where there is ``room_left`` for both parts and neither is below LEAST.
    """
    p, w, weight, came, depth = ray
    share, mirrored, passed = meet_interface(surface.field, matter, p, w, came)
    light, less = brightest(weight), min(share, 1.0 - share)
    if not room_left or light * less < LEAST:
        if share > 0.5:
            return push(rays, j, p, mirrored, weight, came, depth)
        return push(rays, j, p, passed, weight, -came, depth)
    j = push(rays, j, p, passed, scale(weight, 1.0 - share), -came, depth)
    return push(rays, j, p, mirrored, scale(weight, share), came, depth)


@kernel()
def see_at(surface, met, light, rays, m, leaves):
    """Follow the ``rays`` of point ``m``, of which the first is there, to their ends."""
    room, matter = met
    spacing, count, done = surface.field.spacing, 1, 0
    while count > 0:
        j = count - 1
        o, w, weight = column(rays.origins, j), column(rays.ways, j), column(rays.weights, j)
        side, depth = int(rays.sides[j]), int(rays.depths[j])
        d = to_index(w, spacing)
        t, came = (math.inf, UNKNOWN) if depth > DEEP else cast(surface.field, surface.isovalue, o, d, side)
        reach, wall = nearest_wall(room.walls, o, d, NOWHERE, t)
        near, far = way_inside(surface.field.voxels.shape, o, d, side, came, reach)
        weight = dimmed(weight, transmitted(matter, far - near))
        count = j
        if wall != NOWHERE:
            slope = dot(row(room.normals, int(wall)), w)
            if lit_from(room, int(wall), slope):
                p = madd(o, reach, d)
                put_leaf(leaves, LEAVES * m + done, p, weight, wall, 1 if slope < 0.0 else -1)
                done += 1
        elif t < math.inf:
            ray = madd(o, t, d), w, weight, came, depth + 1
            count = part(surface, matter, rays, j, ray, count + done + 2 <= LEAVES)
        else:
            sky = dimmed(weight, radiance(light.constant, light.image, light.matrix, w))
            for c in range(3):
                leaves.sky[m, c] += np.float32(sky[c])


@kernel(types.void(SURFACE, PASSABLE, SURROUNDINGS, types.UniTuple(types.float64, 3), POINTS, LEAVES_OF))
def see_through(surface, met, light, eye, points, leaves):
    """Fill the ``leaves`` of n ``points`` (n, 3), where rays from the ``eye`` meet the ``surface``; in index space.

    Without absorption the weights of all that a point shows sum to 1.
    """
    leaves.met[:] = np.int8(NOWHERE)
    leaves.sky[:] = np.float32(0.0)
    rays = Rays(np.empty((3, LEAVES)), np.empty((3, LEAVES)), np.empty((3, LEAVES)), np.empty(LEAVES), np.empty(LEAVES))
    spacing = surface.field.spacing
    for m in range(points.shape[0]):
        p = float(points[m, 0]), float(points[m, 1]), float(points[m, 2])
        w = normalize(to_world(sub(p, eye), spacing))
        d = to_index(w, spacing)
        push(rays, 0, madd(p, -BACK / longest(d), d), w, (1.0, 1.0, 1.0), UNKNOWN, 0)
        see_at(surface, met, light, rays, m, leaves)
