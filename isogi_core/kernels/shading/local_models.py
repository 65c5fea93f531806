"""The local models that S1 compares with, hard shadows, and the per-pixel path tracer that is the
reference.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import REAL_TRIPLE, kernel, record
from isogi_core.kernels.shading.framebuffer import FINAL, FRAMEBUFFER, put_pixel
from isogi_core.kernels.shading.surface_points import POINT_ROWS, SURFACE_POINTS, point_of
from isogi_core.kernels.tracing.cast import SURFACE, cast_batch
from isogi_core.kernels.tracing.field import FIELD_RECORD, normal, to_index
from isogi_core.kernels.tracing.intersect import OUTSIDE_SIGN, launch
from isogi_core.kernels.tracing.ray_stream import Rays
from isogi_core.kernels.tracing.vec import (
    column,
    dot,
    length,
    madd,
    normalize,
    put_column,
    scale,
    sub,
)
from isogi_core.kernels.transport.light_paths import to_world
from isogi_core.kernels.transport.lights import fog, row


class LocalModel(NamedTuple):
    """A local model's constants.

    ``key`` unit world direction towards the key light; ``sun`` and ``ambient`` linear RGB of it and
    of the rest, times the albedo; ``shine`` Phong's highlight (0 for Lambert) and ``exponent``;
    ``shadow`` whether a shadow ray is cast; ``fog_near``, ``fog_far`` world depths (equal: no fog).
    """

    key: tuple[float, float, float]
    sun: tuple[float, float, float]
    ambient: tuple[float, float, float]
    shine: float
    exponent: float
    shadow: bool
    fog_near: float
    fog_far: float


REAL_NUMBER = types.float64
LOCAL_MODEL = record(
    LocalModel,
    REAL_TRIPLE,
    REAL_TRIPLE,
    REAL_TRIPLE,
    REAL_NUMBER,
    REAL_NUMBER,
    types.boolean,
    REAL_NUMBER,
    REAL_NUMBER,
)


@kernel(types.void(FIELD_RECORD, POINT_ROWS, REAL_TRIPLE, POINT_ROWS))
def find_normals(field, points, eye, normals):
    """Fill ``normals`` (m, 3), world, outward, of the ``points`` (index space); towards the ``eye``
    where flat.
    """
    for m in range(points.shape[0]):
        p = point_of(points, m)
        n = normal(field, p)
        if n[0] == 0.0 and n[1] == 0.0 and n[2] == 0.0:
            n = normalize(to_world(sub(eye, p), field.spacing))
        normals[m, 0], normals[m, 1], normals[m, 2] = n


@kernel()
def find_unoccluded(surface, starts, owners, ways, reached):
    """Fill ``reached`` (n,): whether rays get away that start outside, in the rows ``owners`` (n,)
    of ``starts``.

    These are in index space, (m, 3), and the ``ways`` (3, n) in the world.
    """
    count = owners.shape[0]
    field = surface.field
    origins = np.empty((3, count))
    directions = np.empty((3, count))
    for i in range(count):
        put_column(origins, i, row(starts, owners[i]))
        put_column(directions, i, to_index(column(ways, i), field.spacing))
    t = np.empty(count)
    came = np.empty(count, np.int8)
    rays = Rays(
        np.full(count, surface.isovalue), origins, directions, np.full(count, OUTSIDE_SIGN, np.int8)
    )
    cast_batch(field, surface.cells, rays, t, came)
    for i in range(count):
        reached[i] = not t[i] < math.inf


@kernel(types.void(SURFACE, SURFACE_POINTS, REAL_TRIPLE, types.boolean[::1]))
def find_shadows(surface, points, key, seen):
    """Fill ``seen`` (m,): whether the key light reaches each of ``SurfacePoints`` past the
    isosurface, by a shadow ray.

    Points that are turned away from the light count as unseen.
    """
    owners = np.empty(seen.shape[0], np.int64)
    starts = np.empty((seen.shape[0], 3))
    count = 0
    for m in range(seen.shape[0]):
        p, n = point_of(points.points, m), point_of(points.normals, m)
        seen[m] = dot(n, key) > 0.0
        if seen[m]:
            starts[m, 0], starts[m, 1], starts[m, 2] = launch(
                surface.field, surface.isovalue, p, n, OUTSIDE_SIGN
            )
            owners[count] = m
            count += 1
    ways = np.empty((3, count))
    reached = np.empty(count, np.bool_)
    for i in range(count):
        put_column(ways, i, key)
    find_unoccluded(surface, starts, owners[:count], ways, reached)
    for i in range(count):
        seen[owners[i]] = reached[i]


@kernel()
def highlight(n, key, view, exponent):
    """Phong's (r·v)^e: the mirror direction of the key light against the direction to the eye."""
    r = madd(scale(key, -1.0), 2.0 * dot(n, key), n)
    return max(dot(r, view), 0.0) ** exponent


@kernel()
def shade_point(p, n, eye, spacing, model, seen):
    """Linear RGB of one point by a local ``model``; ``seen`` is 1 where the key light reaches it,
    else 0.
    """
    cosine = max(dot(n, model.key), 0.0)
    v = to_world(sub(eye, p), spacing)
    shine = 0.0
    if model.shine > 0.0 and cosine > 0.0:
        shine = seen * model.shine * highlight(n, model.key, normalize(v), model.exponent)
    clear = 1.0
    if model.fog_far > model.fog_near:
        clear = fog(length(v), model.fog_near, model.fog_far)
    return scale(madd(model.ambient, seen * cosine + shine, model.sun), clear)


@kernel(
    types.void(
        SURFACE_POINTS, types.boolean[::1], REAL_TRIPLE, REAL_TRIPLE, LOCAL_MODEL, FRAMEBUFFER
    )
)
def shade_local(points, seen, eye, spacing, model, framebuffer):
    """Lambert or Phong, with or without hard shadow and fog, at the pixels of ``SurfacePoints``
    (S1, table 2).

    ``seen`` (m,) is what ``find_shadows`` says; it may hold no rows for a model without shadow. A
    surface seen from its solid side shows its outer side's light, as the cache does.
    """
    for m in range(points.pixels.shape[0]):
        if not model.shadow or seen[m]:
            reached = 1.0
        else:
            reached = 0.0
        p, n = point_of(points.points, m), point_of(points.normals, m)
        light = shade_point(p, n, eye, spacing, model, reached)
        put_pixel(framebuffer, points.pixels[m], light, FINAL, 0.0)
