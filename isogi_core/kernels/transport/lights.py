"""Light sources: an environment (constant plus lat-long image) at infinity,
and lamps in the scene.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import REAL_ROWS, kernel, record
from isogi_core.kernels.tracing.vec import SMALLEST_NORMAL, cross, dot, length, madd, scale, sub
from isogi_core.kernels.transport.harmonics import accumulate, evaluate
from isogi_core.kernels.transport.sampling import (
    cosine_hemisphere_pdf,
    direction_to_latlong,
    latlong_jacobian,
    latlong_to_direction,
    piecewise_2d_pdf,
    sample_disc,
    sample_piecewise_2d,
)


@kernel()
def turn_back(matrix, w):
    """Return the world direction ``w`` in the frame of a light turned
    by ``matrix`` (3, 3): matrixᵀ w.
    """
    return (
        matrix[0, 0] * w[0] + matrix[1, 0] * w[1] + matrix[2, 0] * w[2],
        matrix[0, 1] * w[0] + matrix[1, 1] * w[1] + matrix[2, 1] * w[2],
        matrix[0, 2] * w[0] + matrix[1, 2] * w[1] + matrix[2, 2] * w[2],
    )


@kernel()
def turn(matrix, d):
    """Return the direction ``d`` of a light's frame, turned by ``matrix`` (3, 3),
    in the world: matrix d.
    """
    return (
        matrix[0, 0] * d[0] + matrix[0, 1] * d[1] + matrix[0, 2] * d[2],
        matrix[1, 0] * d[0] + matrix[1, 1] * d[1] + matrix[1, 2] * d[2],
        matrix[2, 0] * d[0] + matrix[2, 1] * d[1] + matrix[2, 2] * d[2],
    )


@kernel()
def glow(constant, image, row, column):
    """Return the linear RGB radiance of a constant plus image (h, w, 3) at ``row`` and
    ``column`` in [0, 1).
    """
    y = min(int(row * image.shape[0]), image.shape[0] - 1)
    x = min(int(column * image.shape[1]), image.shape[1] - 1)
    return (
        constant[0] + image[y, x, 0],
        constant[1] + image[y, x, 1],
        constant[2] + image[y, x, 2],
    )


@kernel()
def radiance(constant, image, matrix, w):
    """Return the linear RGB radiance from world direction ``w``;
    ``image`` (h, w, 3) is turned by ``matrix``.
    """
    row, column = direction_to_latlong(turn_back(matrix, w))
    return glow(constant, image, row, column)


@kernel()
def draw_bright(table, matrix, u, v):
    """Sample a world direction in proportion to a turned environment's image by (u, v) in [0, 1)².

    ``table`` holds the two cumulative arrays of ``sample_piecewise_2d``.
    """
    row, column = sample_piecewise_2d(table[0], table[1], u, v)
    return turn(matrix, latlong_to_direction(row, column))


@kernel()
def balance_image(table, row, column, cosine):
    """Return the weight p_c/(p_c + p_e) of a direction that cosine sampling and ``draw_bright`` may
    draw.

    ``row`` and ``column`` are its place in the image. p_c is the density of cosine sampling, p_e
    that of ``draw_bright``. A ray of either technique adds this part of the radiance to E/π.
    Source: Veach and Guibas 1995, balance heuristic.
    """
    drawn = piecewise_2d_pdf(table[0], table[1], row, column) / max(
        latlong_jacobian(row), SMALLEST_NORMAL
    )
    by_cosine = cosine_hemisphere_pdf(cosine)
    return by_cosine / max(by_cosine + drawn, SMALLEST_NORMAL)


@kernel()
def arriving(constant, image, matrix, table, w, cosine):
    """Return the contribution to E/π of the environment in world direction ``w``, at ``cosine`` to
    the normal.

    It is the radiance, times its weight by ``balance_image`` if ``table`` is not empty.
    """
    row, column = direction_to_latlong(turn_back(matrix, w))
    light = glow(constant, image, row, column)
    if table[0].shape[0] > 0:
        return scale(light, balance_image(table, row, column, cosine))
    return light


@kernel()
def unshadowed_irradiance(order, lobe, light, n, basis, c):
    """Return unoccluded irradiance over π of channel ``c``: Σ A_l/π ℓ_lm Y_lm(n).

    Harmonics have this ``order``; with K = order² coefficients, ``lobe`` (K,) holds A_l/π, those of
    the cosine lobe, ``light`` (3, K) the turned environment, and ``basis`` (K,) the harmonics of
    the unit normal ``n`` (see ``evaluate``). A sum that is cut off after some bands may fall below
    0 behind a bright light; irradiance cannot, so that 0 is returned. Source: Ramamoorthi and
    Hanrahan 2001.
    """
    total = 0.0
    for i in range(order * order):
        total += lobe[i] * light[c, i] * basis[i]
    return max(total, 0.0)


@kernel()
def unshadowed(order, lobe, light, n, basis):
    """Return unoccluded irradiance over π, linear RGB,
    at the normal ``n``. Overwrites ``basis``.
    """
    evaluate(order, n[0], n[1], n[2], basis)
    return (
        unshadowed_irradiance(order, lobe, light, n, basis, 0),
        unshadowed_irradiance(order, lobe, light, n, basis, 1),
        unshadowed_irradiance(order, lobe, light, n, basis, 2),
    )


@kernel()
def fog(depth, near, far):
    """Return the transmittance of fog that begins at ``near``: exp(-(2u)²), u = (depth -
    near)/(far - near).
    """
    u = max(depth - near, 0.0) / max(far - near, 1e-30)
    return math.exp(-4.0 * u * u)


DIRECTIONAL = 0
POINT = 1
AREA = 2

NO_LIGHT = (0.0, 0.0, 0.0)


class LampArrays(NamedTuple):
    """k ≥ 0 lamps in world space.

    - ``kinds`` int8 (k,): DIRECTIONAL, POINT or AREA.
    - ``places`` float64 (k, 3): unit direction towards a directional lamp, position of a point,
      corner of an area.
    - ``edges`` (k, 2, 3): two radii of a directional lamp's disc, as long as the sine of its half
      angle; zeros for a point; the edges of an area.
    - ``colours`` (k, 3): irradiance, intensity or radiance over π, linear RGB.
    """

    kinds: Any
    places: Any
    edges: Any
    colours: Any


NO_LAMPS = LampArrays(np.zeros(0, np.int8), np.zeros((0, 3)), np.zeros((0, 2, 3)), np.zeros((0, 3)))
LAMPS = record(
    LampArrays,
    types.int8[::1],
    types.float64[:, ::1],
    types.float64[:, :, ::1],
    types.float64[:, ::1],
)


@kernel()
def row(vectors, m):
    """Return row ``m`` of a (k, 3) array as a tuple."""
    return vectors[m, 0], vectors[m, 1], vectors[m, 2]


@kernel()
def draw_from_disc(towards, edges, u, v):
    """Sample a direction to the disc of a directional lamp, and return it with its cosine to the
    axis ``towards``.

    The lamp is a cap of the unit sphere with uniform radiance. Its projection along the axis is a
    disc with the radii ``edges``; points are uniform there, so that the density per steradian is
    cosine/area. A lamp of irradiance E has the radiance E/area. Divided by the density that is
    E/cosine, whatever the size of the disc, and a surface that faces the lamp gets exactly E.
    """
    # Draw a point of the projected disc, and lift it to the sphere.
    x, y = sample_disc(u, v)
    across = madd(scale(row(edges, 0), x), y, row(edges, 1))
    cosine = math.sqrt(max(1.0 - dot(across, across), 0.0))
    return madd(across, cosine, towards), cosine


@kernel()
def illuminate(lamps, k, p, n, u, v):
    """Sample the light of lamp ``k`` at the world point ``p`` with normal ``n``, without shadows.

    Returns the unit direction towards the lamp, its distance, and an estimate of E/π, linear RGB,
    by (u, v) in [0, 1)²: E cosθ/π, I cosθ/(π r²), or L A cosθ cosθ'/(π r²) (Veach 1997, section
    8.2).
    """
    place = row(lamps.places, k)
    edges = lamps.edges[k]
    colour = row(lamps.colours, k)
    # A directional lamp is at infinity.
    if lamps.kinds[k] == DIRECTIONAL:
        w, cosine = draw_from_disc(place, edges, u, v)
        # The cosine to the axis comes from the density of ``draw_from_disc``.
        return w, math.inf, scale(colour, max(dot(n, w), 0.0) / cosine)
    # Sample a point of an area; the edges of a point lamp are zero.
    away = sub(madd(madd(place, u, row(edges, 0)), v, row(edges, 1)), p)
    distance = length(away)
    square = distance * distance
    if not square > 0.0:
        return n, 0.0, NO_LIGHT
    w = scale(away, 1.0 / distance)
    share = max(dot(n, w), 0.0) / square
    # The cross product of the edges is area times normal; the back of an area emits nothing.
    if lamps.kinds[k] == AREA:
        share *= max(-dot(w, cross(row(edges, 0), row(edges, 1))), 0.0)
    return w, distance, scale(colour, share)


@kernel(types.void(types.int64, REAL_ROWS, REAL_ROWS, REAL_ROWS))
def project_lamps(order, directions, irradiances, coefficients):
    """Add Σ E Y_i(d) of lights without size in unit ``directions`` (k, 3) to ``coefficients`` (3,
    n²).

    ``irradiances`` (k, 3) are those of a surface that faces each of them.
    """
    for k in range(directions.shape[0]):
        x, y, z = row(directions, k)
        for c in range(3):
            accumulate(order, x, y, z, irradiances[k, c], coefficients[c])
