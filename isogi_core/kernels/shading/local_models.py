"""Local illumination models that S1 compares with, and shadow rays."""

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
    """The constants of a local model.

    - ``key``: unit world direction towards the key light.
    - ``sun``, ``ambient``: linear RGB of the key light and of all other light, times the albedo.
    - ``shine``, ``exponent``: strength (0 for Lambert) and exponent of Phong's highlight.
    - ``shadow``: True if shadow rays are cast.
    - ``fog_near``, ``fog_far``: world depths at which fog begins and is thick; no fog if equal.
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
    """Fill ``normals`` (m, 3), outward unit world ones, of the ``points`` in index space; they
    point to the ``eye`` if the field is flat.
    """
    for m in range(points.shape[0]):
        p = point_of(points, m)
        n = normal(field, p)
        if n[0] == 0.0 and n[1] == 0.0 and n[2] == 0.0:
            n = normalize(to_world(sub(eye, p), field.spacing))
        normals[m, 0], normals[m, 1], normals[m, 2] = n


@kernel()
def find_unoccluded(surface, starts, owners, ways, reached):
    """Fill ``reached`` (n,) with True for rays that leave the volume without hitting the
    isosurface.

    Ray i starts at row ``owners[i]`` of ``starts`` (m, 3), outside in index space, in the world
    direction ``ways[:, i]``.
    """
    count = owners.shape[0]
    field = surface.field
    origins = np.empty((3, count))
    directions = np.empty((3, count))
    for i in range(count):
        put_column(origins, i, row(starts, owners[i]))
        put_column(directions, i, to_index(column(ways, i), field.spacing))
    # Cast the rays from the outer side; those without a hit get away.
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
    """Fill ``seen`` (m,) with True for ``SurfacePoints`` that the key light in direction ``key``
    reaches, by one shadow ray each.

    Points that face away from the light count as unseen.
    """
    owners = np.empty(seen.shape[0], np.int64)
    starts = np.empty((seen.shape[0], 3))
    count = 0
    for m in range(seen.shape[0]):
        # List the points that face the light, with ray origins offset from the surface.
        p, n = point_of(points.points, m), point_of(points.normals, m)
        seen[m] = dot(n, key) > 0.0
        if seen[m]:
            starts[m, 0], starts[m, 1], starts[m, 2] = launch(
                surface.field, surface.isovalue, p, n, OUTSIDE_SIGN
            )
            owners[count] = m
            count += 1
    # Cast all rays towards the light as one stream.
    ways = np.empty((3, count))
    reached = np.empty(count, np.bool_)
    for i in range(count):
        put_column(ways, i, key)
    find_unoccluded(surface, starts, owners[:count], ways, reached)
    for i in range(count):
        seen[owners[i]] = reached[i]


@kernel()
def highlight(n, key, view, exponent):
    """Return Phong's (r·v)^e: the key light mirrored at the normal ``n``, against the direction
    ``view`` to the eye.
    """
    r = madd(scale(key, -1.0), 2.0 * dot(n, key), n)
    return max(dot(r, view), 0.0) ** exponent


@kernel()
def shade_point(p, n, eye, spacing, model, seen):
    """Return linear RGB of the point ``p`` with normal ``n`` by a local ``model``; ``seen`` is
    1 if the key light reaches it, else 0.
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
    """Shade the pixels of ``SurfacePoints`` by Lambert or Phong, with or without hard shadow and
    fog (S1, table 2).

    ``seen`` (m,) comes from ``find_shadows``; it may be empty for a model without shadow. A surface
    seen from its solid side shows the light of its outer side, as the cache does.
    """
    for m in range(points.pixels.shape[0]):
        if not model.shadow or seen[m]:
            reached = 1.0
        else:
            reached = 0.0
        p, n = point_of(points.points, m), point_of(points.normals, m)
        light = shade_point(p, n, eye, spacing, model, reached)
        put_pixel(framebuffer, points.pixels[m], light, FINAL, 0.0)
