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
    cosine_and_sine_of_turn,
    cosine_hemisphere_pdf,
    direction_to_latlong,
    find_interval,
    sample_disc,
    share_of_interval,
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
def pixel_towards(image, matrix, w):
    """Return the row and the column of the pixel of a lat-long ``image`` (h, w, channels), turned
    by ``matrix``, that lies in world direction ``w``.
    """
    row, column = direction_to_latlong(turn_back(matrix, w))
    y = min(int(row * image.shape[0]), image.shape[0] - 1)
    x = min(int(column * image.shape[1]), image.shape[1] - 1)
    return y, x


@kernel()
def radiance(constant, image, matrix, w):
    """Return the linear RGB radiance from world direction ``w`` of a ``constant`` plus an ``image``
    (h, w, 3), which is turned by ``matrix``.
    """
    y, x = pixel_towards(image, matrix, w)
    return (
        constant[0] + image[y, x, 0],
        constant[1] + image[y, x, 1],
        constant[2] + image[y, x, 2],
    )


class BrightTable(NamedTuple):
    """Samples directions to the bright pixels of an environment of h × w pixels; all arrays are
    empty if that does not pay.

    - ``rows`` (h + 1,), ``columns`` (h, w + 1): cumulative shares of the rows, and of the pixels
      within each row, from 0 to 1; float64.
    - ``row_guide`` (h + 1,), ``column_guide`` (h, w + 1): their guides, see ``find_interval``;
      int32.
    - ``heights`` (h + 1,): z at the borders of the rows, from 1 to -1.
    - ``pixels`` (h, w, 4) float32: radiance of all light from each pixel, linear RGB, and the
      density per steradian of the directions to it.
    """

    rows: Any
    columns: Any
    row_guide: Any
    column_guide: Any
    heights: Any
    pixels: Any


NO_TABLE = BrightTable(
    np.zeros(0),
    np.zeros((0, 0)),
    np.zeros(0, np.int32),
    np.zeros((0, 0), np.int32),
    np.zeros(0),
    np.zeros((0, 0, 4), np.float32),
)
BRIGHT_TABLE = record(
    BrightTable,
    types.float64[::1],
    types.float64[:, ::1],
    types.int32[::1],
    types.int32[:, ::1],
    types.float64[::1],
    types.float32[:, :, ::1],
)


@kernel()
def has_bright_pixels(table):
    """Return True if rays may be aimed at bright pixels: the ``table`` that samples directions to
    them is not empty.
    """
    return table.rows.shape[0] > 0


@kernel()
def draw_bright(table, matrix, u, v):
    """Sample a world direction to a bright pixel by (u, v) in [0, 1)²; return it with the row and
    the column of the pixel.

    Directions to one pixel are uniform over its solid angle, so that their density is the same all
    over it. The pixel is found by inversion; source: pbrt, section A.5.6.
    """
    # Find the pixel, and the place of (u, v) within it.
    i = find_interval(table.rows, table.row_guide, u)
    j = find_interval(table.columns[i], table.column_guide[i], v)
    a = share_of_interval(table.rows, i, u)
    b = share_of_interval(table.columns[i], j, v)
    # Equal differences in z are equal solid angles (Archimedes).
    z = table.heights[i] + a * (table.heights[i + 1] - table.heights[i])
    radius = math.sqrt(max(1.0 - z * z, 0.0))
    cosine, sine = cosine_and_sine_of_turn((j + b) / (table.columns.shape[1] - 1))
    return turn(matrix, (radius * cosine, radius * sine, z)), i, j


@kernel()
def pixel_radiance(table, y, x):
    """Return the linear RGB radiance of the pixel in row ``y`` and column ``x`` of a ``table``."""
    return table.pixels[y, x, 0], table.pixels[y, x, 1], table.pixels[y, x, 2]


@kernel()
def balanced_light(table, y, x, cosine):
    """Return the contribution to E/π of a ray at ``cosine`` to the normal towards the pixel in row
    ``y`` and column ``x`` of a ``table``, linear RGB.

    It is the radiance times p_c/(p_c + p_e), as cosine sampling, of density p_c, and
    ``draw_bright``, of density p_e, may both draw the direction. Source: Veach and Guibas 1995,
    balance heuristic.
    """
    by_cosine = cosine_hemisphere_pdf(cosine)
    weight = by_cosine / max(by_cosine + table.pixels[y, x, 3], SMALLEST_NORMAL)
    return scale(pixel_radiance(table, y, x), weight)


@kernel()
def arriving(constant, image, matrix, table, w, cosine):
    """Return the contribution to E/π of the environment in world direction ``w``, at ``cosine`` to
    the normal.

    It is the radiance, weighted as in ``balanced_light`` if ``table`` is not empty.
    """
    if has_bright_pixels(table):
        y, x = pixel_towards(table.pixels, matrix, w)
        return balanced_light(table, y, x, cosine)
    return radiance(constant, image, matrix, w)


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
