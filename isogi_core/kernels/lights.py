"""Light that arrives from infinitely far: a constant and a latitude-longitude image, or harmonics of both."""

import math

from isogi_core.kernels._jit import kernel
from isogi_core.kernels.harmonics import evaluate
from isogi_core.kernels.sampling import direction_to_latlong


@kernel()
def turn_back(matrix, w):
    """The world direction ``w`` as seen by a light turned by ``matrix`` (3, 3): its transpose times w."""
    return (
        matrix[0, 0] * w[0] + matrix[1, 0] * w[1] + matrix[2, 0] * w[2],
        matrix[0, 1] * w[0] + matrix[1, 1] * w[1] + matrix[2, 1] * w[2],
        matrix[0, 2] * w[0] + matrix[1, 2] * w[1] + matrix[2, 2] * w[2],
    )


@kernel()
def radiance(constant, image, matrix, w):
    """Linear RGB radiance that arrives from world direction ``w``; ``image`` (h, w, 3) is turned by ``matrix``."""
    row, column = direction_to_latlong(turn_back(matrix, w))
    y = min(int(row * image.shape[0]), image.shape[0] - 1)
    x = min(int(column * image.shape[1]), image.shape[1] - 1)
    return (constant[0] + image[y, x, 0], constant[1] + image[y, x, 1], constant[2] + image[y, x, 2])


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
