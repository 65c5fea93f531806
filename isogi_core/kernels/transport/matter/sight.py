"""The view through refracting matter: rays from the eye split in two at each interface, as long
as both parts count.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import SINGLE_ARRAY, SINGLE_ROWS, kernel, record
from isogi_core.kernels.tracing.cast import SURFACE, cast_batch
from isogi_core.kernels.tracing.field import to_index
from isogi_core.kernels.tracing.intersect import UNKNOWN_SIDE
from isogi_core.kernels.tracing.ray_stream import Rays
from isogi_core.kernels.tracing.slabs import longest
from isogi_core.kernels.tracing.vec import column, dot, madd, normalize, put_column, scale, sub
from isogi_core.kernels.tracing.walls import NO_WALL, nearest_wall
from isogi_core.kernels.transport.integrator import whole
from isogi_core.kernels.transport.light_paths import SURROUNDINGS_RECORD, to_world
from isogi_core.kernels.transport.lights import radiance, row
from isogi_core.kernels.transport.matter.passage import (
    PASSABLE,
    brightest,
    dimmed,
    meet_interface,
    transmitted,
    way_inside,
)
from isogi_core.kernels.transport.rng import point_2d
from isogi_core.kernels.transport.room_paths import lit_from

PARTED_PLACES = 16
"""A ray splits if each part counts at least 1 / (PARTED_PLACES · places); places are the ends
that its point may see.
"""

START_BACK_VOXELS = 1e-2
"""Voxels before the surface at which the eye's rays start, so that they hit it despite rounding."""


class Leaves(NamedTuple):
    """The ends of the rays of n points: the environment, and the walls that they see.

    - ``sky`` (n, 3) float32: light of the environment.
    - ``weights``, ``points`` (rows, 3) float32: weight and index-space point of a wall; row b · m +
      j is place j of point m, of at most b places.
    - ``met`` (rows,) int8: number of the wall, or -1; ``sides`` (rows,) int8: 1 for its front, -1
      for its back.
    - ``cut`` (n,) float32: share of light that was not split but followed one way at random.
    """

    sky: Any
    weights: Any
    points: Any
    met: Any
    sides: Any
    cut: Any


SMALL_INTEGERS = types.int8[::1]
LEAVES_OF = record(
    Leaves, SINGLE_ROWS, SINGLE_ROWS, SINGLE_ROWS, SMALL_INTEGERS, SMALL_INTEGERS, SINGLE_ARRAY
)


class Chances(NamedTuple):
    """Random choices of rays that do not split: by ``seeds`` (n,) uint64 and ``samples`` (n,) int64
    of each point.

    With NO_SAMPLE the greater part is followed. Light passes at most ``deep`` interfaces, and then
    goes on as if there were no matter.
    """

    seeds: Any
    samples: Any
    deep: int


CHANCES_RECORD = record(Chances, types.uint64[::1], types.int64[::1], types.int64)

NO_SAMPLE = -1
"""Sample number of points that follow the greater part instead of a random one."""


class Progress(NamedTuple):
    """Counts for each of n points, (n,) each: places ``used`` by its rays, walls ``shown``, and
    random choices ``made``.
    """

    used: Any
    shown: Any
    made: Any


class Sight(NamedTuple):
    """At most r rays to be followed: ``origins``, unit world ``ways`` and ``weights`` (3, r),
    ``sides`` of their starts and ``owners`` among the points (r,).
    """

    origins: Any
    ways: Any
    weights: Any
    sides: Any
    owners: Any


@kernel()
def make_sight(r):
    """Allocate ``r`` rays."""
    return Sight(
        np.empty((3, r)),
        np.empty((3, r)),
        np.empty((3, r)),
        np.empty(r, np.int8),
        np.empty(r, np.int64),
    )


@kernel()
def push(sight, j, o, w, weight, side, owner):
    """Write a ray to place ``j``; return the next place."""
    put_column(sight.origins, j, o)
    put_column(sight.ways, j, w)
    put_column(sight.weights, j, weight)
    sight.sides[j] = side
    sight.owners[j] = owner
    return j + 1


@kernel()
def put_leaf(leaves, place, p, weight, wall, side):
    """Write a wall that is seen at ``p``, with its ``weight`` and its ``side``, to a ``place``
    of the ``leaves``.
    """
    for c in range(3):
        leaves.weights[place, c] = np.float32(weight[c])
        leaves.points[place, c] = np.float32(p[c])
    leaves.met[place] = np.int8(wall)
    leaves.sides[place] = np.int8(side)


@kernel()
def choice(chances, progress, m):
    """Return the next random number in [0, 1) of point ``m``.

    With NO_SAMPLE it is one half: an event of probability p, taken if the number is less than p,
    then happens if p is more than one half, so that rays follow the greater part. Choices are
    counted from 1, and each has a dimension of its number.
    """
    progress.made[m] += 1
    sample = chances.samples[m]
    if sample == NO_SAMPLE:
        return 0.5
    return point_2d(chances.seeds[m], np.uint64(sample), np.uint64(progress.made[m]))[0]


@kernel()
def part(surface, matter, sight, j, ray, shown):
    """Write the rays that leave the interface which ``ray`` = (p, w, weight, side it came from,
    owner) hits, from place ``j`` on.

    Returns the next place. The ray splits if its owner may see more places and neither part is too
    small. Otherwise all of its light follows one part, with a probability equal to its share, which
    is right on average. ``shown`` is (leaves, chances, progress).
    """
    (p, w, weight, came, owner) = ray
    (leaves, chances, progress) = shown
    share, mirrored, passed = meet_interface(surface.field, matter, p, w, came)
    places = leaves.met.shape[0] // leaves.sky.shape[0]
    less = brightest(weight) * min(share, 1.0 - share)
    # Follow one part if the ray may not split.
    if progress.used[owner] >= places or less * (PARTED_PLACES * places) < 1.0:
        leaves.cut[owner] += np.float32(less)
        if share >= 1.0 or (share > 0.0 and choice(chances, progress, owner) < share):
            return push(sight, j, p, mirrored, weight, came, owner)
        return push(sight, j, p, passed, weight, -came, owner)
    # Split into a refracted and a reflected ray.
    progress.used[owner] += 1
    j = push(sight, j, p, passed, scale(weight, 1.0 - share), -came, owner)
    return push(sight, j, p, mirrored, scale(weight, share), came, owner)


@kernel()
def meet_surface(surface, sight, count):
    """Return the hits of the first ``count`` rays on the surface: (index-space directions,
    distances, sides that they came from).

    Distances are in world units, as directions are unit vectors of the world in index space, and
    infinite if a ray misses. Arrays are filled up to whole SIMD vectors.
    """
    n = whole(count)
    directions = np.ones((3, n))
    t = np.empty(n)
    came = np.empty(n, np.int8)
    # Lanes that fill up the last vector start at infinity.
    origins = np.full((3, n), math.inf)
    sides = np.zeros(n, np.int8)
    for j in range(count):
        put_column(origins, j, column(sight.origins, j))
        put_column(directions, j, to_index(column(sight.ways, j), surface.field.spacing))
        sides[j] = sight.sides[j]
    rays = Rays(np.full(n, surface.isovalue), origins, directions, sides)
    cast_batch(surface.field, surface.cells, rays, t, came)
    return directions, t, came


@kernel()
def show_end(room, light, shown, ends, m, weight):
    """Add the light or the wall at the end of a ray of point ``m``: ``ends`` = (point, direction,
    wall or NO_WALL).

    Without a wall the ray brings the environment's light; walls are listed if they emit on that
    side.
    """
    leaves, _, progress = shown
    p, w, wall = ends
    if wall == NO_WALL:
        sky = dimmed(weight, radiance(light.constant, light.image, light.matrix, w))
        for c in range(3):
            leaves.sky[m, c] += np.float32(sky[c])
        return
    slope = dot(row(room.normals, int(wall)), w)
    if lit_from(room, int(wall), slope):
        place = m * (leaves.met.shape[0] // leaves.sky.shape[0]) + progress.shown[m]
        put_leaf(leaves, place, p, weight, wall, 1 if slope < 0.0 else -1)
        progress.shown[m] += 1


@kernel()
def follow_trees(surface, met, light, sight, count, following, depth, shown):
    """Follow the first ``count`` rays to their next hits; write rays that go on to ``following``,
    and return their number.

    ``shown`` is (leaves, chances, progress).
    """
    leaves, chances, _ = shown
    directions, t, came = meet_surface(surface, sight, count)
    going = 0
    for j in range(count):
        o = column(sight.origins, j)
        w = column(sight.ways, j)
        d = column(directions, j)
        met_at = t[j] if depth < chances.deep else math.inf
        # Absorb light along the part of the way that is inside of the matter.
        reach, wall = nearest_wall(met.room.walls, o, d, NO_WALL, met_at)
        near, far = way_inside(
            surface.field.voxels.shape, o, d, int(sight.sides[j]), int(came[j]), reach
        )
        weight = dimmed(column(sight.weights, j), transmitted(met.matter, far - near))
        owner = sight.owners[j]
        # Split at the surface, or show the wall or the environment that the ray ends on.
        if wall == NO_WALL and reach < math.inf:
            ray = madd(o, reach, d), w, weight, int(came[j]), owner
            going = part(surface, met.matter, following, going, ray, shown)
        else:
            if depth == chances.deep and t[j] < math.inf:
                leaves.cut[owner] += np.float32(brightest(weight))
            if reach < math.inf:
                p = madd(o, reach, d)
            else:
                p = o
            show_end(met.room, light, shown, (p, w, wall), owner, weight)
    return going


@kernel(
    types.void(
        SURFACE,
        PASSABLE,
        SURROUNDINGS_RECORD,
        types.UniTuple(types.float64, 3),
        SINGLE_ROWS,
        CHANCES_RECORD,
        LEAVES_OF,
    )
)
def see_through(surface, met, light, eye, points, chances, leaves):
    """Fill the ``leaves`` of n ``points`` (n, 3) at which rays from the ``eye`` meet the
    ``surface``; all in index space.

    Without absorption the weights of all that a point shows sum to 1. The mean over all ``chances``
    is exact. Source: Whitted 1980; Arvo and Kirk 1990 on rays that split as long as that counts.
    """
    leaves.met[:] = np.int8(NO_WALL)
    leaves.sky[:] = np.float32(0.0)
    leaves.cut[:] = np.float32(0.0)
    spacing = surface.field.spacing
    n = points.shape[0]
    places = leaves.met.shape[0]
    sight = make_sight(places)
    following = make_sight(places)
    shown = (
        leaves,
        chances,
        Progress(np.ones(n, np.int64), np.zeros(n, np.int64), np.zeros(n, np.int64)),
    )
    # Start one ray at each point, a little before the surface.
    for m in range(n):
        p = float(points[m, 0]), float(points[m, 1]), float(points[m, 2])
        w = normalize(to_world(sub(p, eye), spacing))
        d = to_index(w, spacing)
        push(
            sight,
            m,
            madd(p, -START_BACK_VOXELS / longest(d), d),
            w,
            (1.0, 1.0, 1.0),
            UNKNOWN_SIDE,
            m,
        )
    count = n
    # Follow all rays interface by interface.
    for depth in range(chances.deep + 1):
        count = follow_trees(surface, met, light, sight, count, following, depth, shown)
        if count == 0:
            return
        sight, following = following, sight
