"""Light that arrives from infinitely far: a constant and a latitude-longitude image, or harmonics of both."""

import math

from isogi_core.kernels._jit import kernel
from isogi_core.kernels.harmonics import evaluate
from isogi_core.kernels.sampling import (
    cosine_hemisphere_pdf,
    direction_to_latlong,
    latlong_jacobian,
    latlong_to_direction,
    piecewise_2d_pdf,
    sample_piecewise_2d,
)
from isogi_core.kernels.vec import SMALLEST, scale


@kernel()
def turn_back(matrix, w):
    """The world direction ``w`` as seen by a light turned by ``matrix`` (3, 3): its transpose times w."""
    return (
        matrix[0, 0] * w[0] + matrix[1, 0] * w[1] + matrix[2, 0] * w[2],
        matrix[0, 1] * w[0] + matrix[1, 1] * w[1] + matrix[2, 1] * w[2],
        matrix[0, 2] * w[0] + matrix[1, 2] * w[1] + matrix[2, 2] * w[2],
    )


@kernel()
def turn(matrix, d):
    """The world direction of what a light turned by ``matrix`` (3, 3) sees in direction ``d``: the matrix times d."""
    return (
        matrix[0, 0] * d[0] + matrix[0, 1] * d[1] + matrix[0, 2] * d[2],
        matrix[1, 0] * d[0] + matrix[1, 1] * d[1] + matrix[1, 2] * d[2],
        matrix[2, 0] * d[0] + matrix[2, 1] * d[1] + matrix[2, 2] * d[2],
    )


@kernel()
def glow(constant, image, row, column):
    """Linear RGB radiance of a constant and an image (h, w, 3) at a place in fractions of its height and width."""
    y = min(int(row * image.shape[0]), image.shape[0] - 1)
    x = min(int(column * image.shape[1]), image.shape[1] - 1)
    return (constant[0] + image[y, x, 0], constant[1] + image[y, x, 1], constant[2] + image[y, x, 2])


@kernel()
def radiance(constant, image, matrix, w):
    """Linear RGB radiance that arrives from world direction ``w``; ``image`` (h, w, 3) is turned by ``matrix``."""
    row, column = direction_to_latlong(turn_back(matrix, w))
    return glow(constant, image, row, column)


@kernel()
def draw_bright(table, matrix, u, v):
    """A world direction towards the bright parts of a turned environment, from (u, v) in [0, 1)².

    ``table`` is the two cumulative arrays of ``sample_piecewise_2d`` over its image.
    """
    row, column = sample_piecewise_2d(table[0], table[1], u, v)
    return turn(matrix, latlong_to_direction(row, column))


@kernel()
def balance(table, row, column, cosine):
    """Share p_c/(p_c + p_e) of a direction, at a place of the image, between the two ways in which it is drawn.

    p_c is the density of cosine sampling, p_e that of ``draw_bright``. The same share of the radiance is
    what a ray of either sort adds to E/π. Source: Veach and Guibas 1995, the balance heuristic.
    """
    drawn = piecewise_2d_pdf(table[0], table[1], row, column) / max(latlong_jacobian(row), SMALLEST)
    by_cosine = cosine_hemisphere_pdf(cosine)
    return by_cosine / max(by_cosine + drawn, SMALLEST)


@kernel()
def arriving(constant, image, matrix, table, w, cosine):
    """What a ray in world direction ``w``, at ``cosine`` to the normal, adds to E/π by the environment it reaches.

    The radiance, and with a ``table`` that is not empty its share by ``balance``.
    """
    row, column = direction_to_latlong(turn_back(matrix, w))
    light = glow(constant, image, row, column)
    return scale(light, balance(table, row, column, cosine)) if table[0].shape[0] > 0 else light


@kernel()
def irradiance(order, lobe, light, n, basis, c):
    """Unoccluded irradiance over π at unit normal ``n``: Σ A_l/π ℓ_lm Y_lm(n), clamped to 0, for channel ``c``.

    ``lobe`` (n²) holds A_l/π per coefficient, ``light`` (3, n²) the turned environment, ``basis``
    (n²) the harmonics of ``n`` (see ``evaluate``). Source: Ramamoorthi and Hanrahan 2001.
    """
    total = 0.0
    for i in range(order * order):
        total += lobe[i] * light[c, i] * basis[i]
    return max(total, 0.0)


@kernel()
def unshadowed(order, lobe, light, n, basis):
    """Irradiance over π, linear RGB, of a point with normal ``n`` that nothing shadows. Overwrites ``basis``."""
    evaluate(order, n[0], n[1], n[2], basis)
    return (
        irradiance(order, lobe, light, n, basis, 0),
        irradiance(order, lobe, light, n, basis, 1),
        irradiance(order, lobe, light, n, basis, 2),
    )


@kernel()
def fog(depth, near, far):
    """Share of the surface seen through fog that begins at ``near``: exp(-(2u)²), u = (depth - near)/(far - near)."""
    u = max(depth - near, 0.0) / max(far - near, 1e-30)
    return math.exp(-4.0 * u * u)
