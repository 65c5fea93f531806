"""The local models that S1 compares with, hard shadows, and the per-pixel path tracer that is the reference."""

import math
from typing import NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel, record
from isogi_core.kernels.bricks import BRICKS
from isogi_core.kernels.field import FIELD, normal, to_index
from isogi_core.kernels.integrator import launch
from isogi_core.kernels.intersect import OUTSIDE
from isogi_core.kernels.lattice import PIXELS, POINTS
from isogi_core.kernels.lights import fog
from isogi_core.kernels.lit import SURROUNDINGS, light_paths, to_world
from isogi_core.kernels.packets import cast_batch
from isogi_core.kernels.planes import FINAL, PLANES, put_pixel
from isogi_core.kernels.rng import mix
from isogi_core.kernels.vec import column, dot, length, madd, normalize, put_column, scale, sub
from isogi_core.kernels.waves import WAVE


class LocalModel(NamedTuple):
    """A local model's constants.

    ``key`` unit world direction towards the key light; ``sun`` and ``ambient`` linear RGB of it and of
    the rest, times the albedo; ``shine`` Phong's highlight (0 for Lambert) and ``exponent``;
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


VECTOR = types.UniTuple(types.float64, 3)
REAL = types.float64
LOCAL_MODEL = record(LocalModel, VECTOR, VECTOR, VECTOR, REAL, REAL, types.boolean, REAL, REAL)


@kernel()
def single(vectors, m):
    """Row ``m`` of a float32 (n, 3) array as a tuple of float64."""
    return np.float64(vectors[m, 0]), np.float64(vectors[m, 1]), np.float64(vectors[m, 2])


@kernel(types.void(FIELD, POINTS, VECTOR, POINTS))
def find_normals(field, points, eye, normals):
    """Fill ``normals`` (m, 3), world, outward, of the ``points`` (index space); towards the ``eye`` where flat."""
    for m in range(points.shape[0]):
        p = single(points, m)
        n = normal(field, p)
        if n[0] == 0.0 and n[1] == 0.0 and n[2] == 0.0:
            n = normalize(to_world(sub(eye, p), field.spacing))
        normals[m, 0], normals[m, 1], normals[m, 2] = n


@kernel()
def find_open(field, bricks, iso, points, normals, owners, ways, reached):
    """Fill ``reached`` (n,): whether rays from points ``owners`` (n,) in world directions ``ways`` (3, n) get away."""
    count = owners.shape[0]
    origins, directions = np.empty((3, count)), np.empty((3, count))
    for i in range(count):
        m = owners[i]
        put_column(origins, i, launch(field, iso, single(points, m), single(normals, m), OUTSIDE))
        put_column(directions, i, to_index(column(ways, i), field.spacing))
    t, came = np.empty(count), np.empty(count, np.int8)
    cast_batch(field, bricks, np.full(count, iso), origins, directions, np.full(count, OUTSIDE, np.int8), t, came)
    for i in range(count):
        reached[i] = not t[i] < math.inf


@kernel(types.void(FIELD, BRICKS, types.float64, POINTS, POINTS, VECTOR, types.boolean[::1]))
def find_shadows(field, bricks, iso, points, normals, key, seen):
    """Fill ``seen`` (m,): whether the key light reaches each point past the isosurface, by one hard shadow ray.

    Points that are turned away from the light count as unseen; ``iso`` is within the range of ``bricks``.
    """
    owners, count = np.empty(points.shape[0], np.int64), 0
    for m in range(points.shape[0]):
        seen[m] = dot(single(normals, m), key) > 0.0
        if seen[m]:
            owners[count] = m
            count += 1
    ways, reached = np.empty((3, count)), np.empty(count, np.bool_)
    for i in range(count):
        put_column(ways, i, key)
    find_open(field, bricks, iso, points, normals, owners[:count], ways, reached)
    for i in range(count):
        seen[owners[i]] = reached[i]


@kernel()
def highlight(n, key, view, exponent):
    """Phong's (r·v)^e: the mirror direction of the key light against the direction to the eye."""
    r = madd(scale(key, -1.0), 2.0 * dot(n, key), n)
    return max(dot(r, view), 0.0) ** exponent


@kernel()
def shade_point(p, n, eye, spacing, model, seen):
    """Linear RGB of one point by a local ``model``; ``seen`` is 1 where the key light reaches it, else 0."""
    cosine = max(dot(n, model.key), 0.0)
    v = to_world(sub(eye, p), spacing)
    shine = 0.0
    if model.shine > 0.0 and cosine > 0.0:
        shine = seen * model.shine * highlight(n, model.key, normalize(v), model.exponent)
    clear = 1.0
    if model.fog_far > model.fog_near:
        clear = fog(length(v), model.fog_near, model.fog_far)
    return scale(madd(model.ambient, seen * cosine + shine, model.sun), clear)


@kernel(types.void(POINTS, POINTS, types.boolean[::1], VECTOR, VECTOR, LOCAL_MODEL, PIXELS, PLANES))
def shade_local(points, normals, seen, eye, spacing, model, pixels, planes):
    """Lambert or Phong, with or without hard shadow and fog, at the points' ``pixels`` (m,) (S1, table 2).

    ``seen`` (m,) is what ``find_shadows`` says; it may hold no rows for a model without shadow. A
    surface seen from its solid side shows its outer side's light, as the cache does.
    """
    for m in range(points.shape[0]):
        reached = 1.0 if not model.shadow or seen[m] else 0.0
        light = shade_point(single(points, m), single(normals, m), eye, spacing, model, reached)
        put_pixel(planes, pixels[m], light, FINAL, 0.0)


@kernel()
def trace_together(field, bricks, iso, points, normals, pixels, light, weights, survival, stream, first, count, sums):
    """``trace_points`` for a few points whose paths go together."""
    replicas = sums.shape[1]
    starts = replicas * pixels.shape[0]
    here, facing, seeds = np.empty((3, starts)), np.empty((3, starts)), np.empty(starts, np.uint64)
    for i in range(starts):
        put_column(here, i, single(points, i // replicas))
        put_column(facing, i, single(normals, i // replicas))
        seeds[i] = mix(np.int64(pixels[i // replicas]), stream + i % replicas)
    levels, gathered = np.full(starts, iso), np.empty((3, starts * count))
    light_paths(field, bricks, levels, here, facing, seeds, first, count, weights, survival, light, gathered)
    for m in range(starts * count):
        for c in range(3):
            sums[m % starts // replicas, m % replicas, c] += gathered[c, m]


@kernel(
    types.void(
        FIELD,
        BRICKS,
        types.float64,
        POINTS,
        POINTS,
        PIXELS,
        SURROUNDINGS,
        types.float64[:, ::1],
        types.float64,
        types.int64,
        types.int64,
        types.int64,
        types.float64[:, :, ::1],
    )
)
def trace_points(field, bricks, iso, points, normals, pixels, light, weights, survival, stream, first, count, sums):
    """Path-trace the points: add samples first … first + count of each replica to ``sums`` (m, replicas, 3).

    Replicas are independent randomisations, from number ``stream`` on; they and ``pixels`` (m,), picture indices,
    own the random numbers. ``light`` are the Surroundings; ``weights`` (bounces + 1, 3) R^(k+1) per channel, over
    the chance to get there, ``survival`` (see ``spin``); ``iso`` is within the range of ``bricks``. Sums grow
    sample by sample, so that their bits do not tell in how many goes. Source: S1, figure 2; the reference
    of figures 7 and 11.
    """
    replicas = sums.shape[1]
    together, samples = max(WAVE // (replicas * count), 1), max(min(count, WAVE // replicas), 1)
    for a in range(0, pixels.shape[0], together):
        b = min(a + together, pixels.shape[0])
        for begin in range(first, first + count, samples):
            some = min(samples, first + count - begin)
            part = points[a:b], normals[a:b], pixels[a:b]
            trace_together(field, bricks, iso, *part, light, weights, survival, stream, begin, some, sums[a:b])
