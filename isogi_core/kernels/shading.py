"""The local models that S1 compares with, hard shadows, and the per-pixel path tracer that is the reference."""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel, record
from isogi_core.kernels.field import FIELD, normal
from isogi_core.kernels.integrator import launch, to_index, trace_path
from isogi_core.kernels.intersect import OUTSIDE, cast
from isogi_core.kernels.lattice import POINTS
from isogi_core.kernels.lights import fog, radiance
from isogi_core.kernels.rng import mix
from isogi_core.kernels.vec import dot, length, madd, normalize, scale, sub


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
def to_world(v, spacing):
    """An index-space vector in world space."""
    return (v[0] * spacing[0], v[1] * spacing[1], v[2] * spacing[2])


@kernel(types.void(FIELD, POINTS, VECTOR, POINTS))
def find_normals(field, points, eye, normals):
    """Fill ``normals`` (m, 3), world, outward, of the ``points`` (index space); towards the ``eye`` where flat."""
    for m in range(points.shape[0]):
        p = (np.float64(points[m, 0]), np.float64(points[m, 1]), np.float64(points[m, 2]))
        n = normal(field, p)
        if n[0] == 0.0 and n[1] == 0.0 and n[2] == 0.0:
            n = normalize(to_world(sub(eye, p), field.spacing))
        normals[m, 0], normals[m, 1], normals[m, 2] = n


@kernel()
def lit_by(field, iso, p, n, key):
    """1 where the key light reaches ``p``, 0 where the isosurface is in its way (one hard shadow ray)."""
    o = launch(field, iso, p, n, OUTSIDE)
    t, _ = cast(field, iso, o, to_index(key, field.spacing), OUTSIDE)
    return 0.0 if t < math.inf else 1.0


@kernel()
def highlight(n, key, view, exponent):
    """Phong's (r·v)^e: the mirror direction of the key light against the direction to the eye."""
    r = madd(scale(key, -1.0), 2.0 * dot(n, key), n)
    return max(dot(r, view), 0.0) ** exponent


@kernel(types.void(FIELD, types.float64, POINTS, POINTS, VECTOR, LOCAL_MODEL, POINTS))
def shade_local(field, iso, points, normals, eye, model, out):
    """Fill ``out`` (m, 3) linear RGB with Lambert or Phong, with or without hard shadow and fog (S1, table 2).

    A surface seen from its solid side shows its outer side's light, as the cache does.
    """
    for m in range(points.shape[0]):
        p = (np.float64(points[m, 0]), np.float64(points[m, 1]), np.float64(points[m, 2]))
        n = (np.float64(normals[m, 0]), np.float64(normals[m, 1]), np.float64(normals[m, 2]))
        cosine = max(dot(n, model.key), 0.0)
        seen = lit_by(field, iso, p, n, model.key) if model.shadow and cosine > 0.0 else 1.0
        v = to_world(sub(eye, p), field.spacing)
        shine = 0.0
        if model.shine > 0.0 and cosine > 0.0:
            shine = seen * model.shine * highlight(n, model.key, normalize(v), model.exponent)
        clear = 1.0
        if model.fog_far > model.fog_near:
            clear = fog(length(v), model.fog_near, model.fog_far)
        for c in range(3):
            out[m, c] = clear * (model.ambient[c] + (seen * cosine + shine) * model.sun[c])


class Surroundings(NamedTuple):
    """The environment for lookups: ``constant`` (3,), ``image`` (h, w, 3), turned by ``matrix`` (3, 3)."""

    constant: Any
    image: Any
    matrix: Any


SURROUNDINGS = record(Surroundings, types.float64[::1], types.float32[:, :, ::1], types.float64[:, ::1])


@kernel(
    types.void(
        FIELD,
        types.float64,
        POINTS,
        POINTS,
        types.int64[::1],
        SURROUNDINGS,
        types.float64[:, ::1],
        types.int64,
        types.int64,
        types.float64[:, :, ::1],
    )
)
def trace_points(field, iso, points, normals, pixels, light, weights, first, count, sums):
    """Path-trace the points: add samples first … first + count of both halves to ``sums`` (m, 2, 3).

    ``pixels`` (m,) are picture indices, which own the random numbers; ``weights`` (bounces + 1, 3)
    is R^(k+1) per channel. Source: S1, figure 2; the reference of figures 7 and 11.
    """
    bounces = weights.shape[0] - 1
    for m in range(points.shape[0]):
        p = (np.float64(points[m, 0]), np.float64(points[m, 1]), np.float64(points[m, 2]))
        n = (np.float64(normals[m, 0]), np.float64(normals[m, 1]), np.float64(normals[m, 2]))
        for half in range(2):
            seed = mix(pixels[m], half)
            for index in range(first, first + count):
                k, w = trace_path(field, iso, p, n, OUTSIDE, seed, index, bounces)
                if k >= 0:
                    arriving = radiance(light.constant, light.image, light.matrix, w)
                    for c in range(3):
                        sums[m, half, c] += weights[k, c] * arriving[c]
