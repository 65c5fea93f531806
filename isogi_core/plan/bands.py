"""Bands of harmonics: project an environment to them, and choose the number that a light needs."""

import math
from typing import Literal

import numpy as np

from isogi_core.kernels.transport.harmonics import (
    DIAGONAL,
    MAX_ORDER,
    RECURRENCE_OFFSET,
    RECURRENCE_SLOPE,
)
from isogi_core.model.environment import LUMINANCE_WEIGHTS, Environment

# Gauss nodes and weights, moved from [-1, 1] to [0, 1]: exact to rounding up to MAX_ORDER, even if
# one row is a whole meridian.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(24)
GAUSS_NODES = 0.5 * (_NODES + 1.0)
GAUSS_WEIGHTS = 0.5 * _WEIGHTS


def project_environment(environment: Environment, order: int) -> np.ndarray:
    """Project an environment to SH coefficients, linear RGB, (3, n²) float64. The constant part
    is exact, the image is integrated by ``project_image``.
    """
    coefficients = np.zeros((3, order**2))
    if environment.image.any():
        coefficients += project_image(environment.image, order)
    coefficients[:, 0] += environment.constant * math.sqrt(4.0 * math.pi)
    return coefficients


def project_image(image: np.ndarray, order: int) -> np.ndarray:
    """Project a lat-long image (h, w, 3) to coefficients ∫ L Y_i dω, for ``order`` <= MAX_ORDER;
    (3, order²) float64.

    The result is exact for an image that is constant over each pixel: the integral over a pixel is
    a product of one in θ and one in φ, so that the solid angles of pixels are exact too. Source:
    S1, eq. 7.
    """
    height, width = image.shape[:2]
    # Integrate along the rows first, then across them.
    moments = np.tensordot(_waves(order, width), image, (2, 1))
    even, odd = np.matmul(_profiles(order, height), moments)
    # Y_l,m takes the cosine of mφ, Y_l,-m the sine.
    m, l = np.triu_indices(order)
    out = np.zeros((3, order**2))
    out[:, l * (l + 1) - m] = odd[m, l].T
    out[:, l * (l + 1) + m] = even[m, l].T
    return out


def _waves(order: int, width: int) -> np.ndarray:
    """Return ∫ cos mφ dφ and ∫ sin mφ dφ over each of the ``width`` pixels of a row, for m <
    ``order``; (2, order, width).
    """
    m = np.arange(order)[:, None]
    half = math.pi / width
    angle = m * (half * (2 * np.arange(width) + 1))
    share = 2.0 * half * np.sinc(m / width)
    return np.asarray(share * np.stack([np.cos(angle), np.sin(angle)]))


def _profiles(order: int, height: int) -> np.ndarray:
    """Return ∫ Y_lm(θ, 0) sinθ dθ over each of the ``height`` rows, for m >= 0; (order, order,
    height), indexed by m, l; 0 for l < m.
    """
    row = math.pi / height
    theta = (np.arange(height)[:, None] + GAUSS_NODES) * row
    weights = row * GAUSS_WEIGHTS * np.sin(theta)
    profiles = np.zeros((order, order, height))
    for m in range(order):
        for l, values in enumerate(_meridian(order, m, theta), start=m):
            profiles[m, l] = (weights * values).sum(axis=1)
    return profiles


def _meridian(order: int, m: int, theta: np.ndarray) -> list[np.ndarray]:
    """Return Y_lm(θ, 0) for l = m … order - 1, by the recurrence of ``harmonics.accumulate`` on
    arrays.
    """
    z = np.cos(theta)
    before = np.zeros_like(z)
    values = [DIAGONAL[m] * np.sin(theta) ** m]
    for l in range(m + 1, order):
        values.append(RECURRENCE_SLOPE[l, m] * z * values[-1] - RECURRENCE_OFFSET[l, m] * before)
        before = values[-2]
    return values


def sphere_nodes(degree: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return points θ, φ of the sphere and their quadrature weights, (points,) each: exact for
    harmonics below ``degree``.
    """
    z, weights = np.polynomial.legendre.leggauss(degree // 2 + 1)
    phi = 2.0 * math.pi / degree * np.arange(degree)
    theta, phi = (grid.ravel() for grid in np.meshgrid(np.arccos(z), phi, indexing="ij"))
    return theta, phi, np.repeat(weights * 2.0 * math.pi / degree, degree)


def evaluate_harmonics(order: int, theta: np.ndarray, phi: np.ndarray) -> np.ndarray:
    """Evaluate Y_i at the points θ, φ (points,) for i < order²; (order², points) float64."""
    basis = np.empty((order**2, len(theta)))
    for m in range(order):
        for l, values in enumerate(_meridian(order, m, theta), start=m):
            basis[l * (l + 1) - m] = np.sin(m * phi) * values
            basis[l * (l + 1) + m] = np.cos(m * phi) * values
    return basis


Kind = Literal["direct", "indirect"]
"""Light that reaches a texel straight from the environment, or after it was reflected."""

MEASURED_ALBEDO = 0.7
"""Albedo of the surfaces on which TRANSFER_DIRECT and TRANSFER_INDIRECT were measured."""

TRANSFER_DIRECT = np.array(
    [0.871, 0.417, 0.0797, 6.44e-3, 3.79e-3, 1.52e-3, 1.07e-3, 5.87e-4, 4.49e-4, 3.01e-4]
)
TRANSFER_INDIRECT = np.array(
    [0.0212, 6.18e-3, 9.83e-4, 1.34e-4, 7.48e-5, 2.59e-5, 1.60e-5, 7.71e-6, 5.10e-6, 2.98e-6]
)
"""T_l = 4π |τ_l|² / (2l + 1) for l < MAX_ORDER, over the square of the mean transfer, direct and
indirect.

Geometric means over the engine at 70, the CT head at 110, the MNI brain at 90, the bonsai at 80 and
heptane at 100: 512 texels at the surface of each, weighted by their visibility in random views,
with 8192 paths, 4 bounces and albedo 0.7. An unoccluded surface has (A_l/π)² of the cosine lobe: 1,
0.444, 0.0625, 0, 1.7e-3, 0; the edges of shadows add the slow decay.
"""

DECAY: dict[Kind, float] = {"direct": 2.8, "indirect": 3.9}
"""From MAX_ORDER on T_l falls as (l + ½)^-DECAY: fitted to bands 8 to 31 (direct) and 8 to 20
(indirect) of the same texels.
"""

STEEPEST_SLOPE = -4.0
"""Steepest slope that is assumed for a light's power per coefficient: probes level off beyond
band 9.
"""

_TRANSFER: dict[Kind, np.ndarray] = {"direct": TRANSFER_DIRECT, "indirect": TRANSFER_INDIRECT}


FAR_BANDS = 8
"""Most bands that a plan takes if the light needs them; a scene may ask for more.

Under uffizi the error of orders 6 and 8 is 3.2 and 1.7 %, with 48 and 79 bytes of direct light.
"""

FAR_BANDS_ERROR = 0.02
"""Error within which FAR_BANDS are taken at any smaller target, so that a smaller target never
takes fewer bands than a larger one.
"""


def band_energy(light: np.ndarray) -> np.ndarray:
    """Return the mean square luminance of each band of a ``light`` (3, n²), linear RGB; (n,)
    float64.

    B_l = Σ_m c_lm² / 4π, a mean over the sphere, and equally over all rotations of the light seen
    in one direction.
    """
    order = math.isqrt(light.shape[1])
    squares = (LUMINANCE_WEIGHTS @ light) ** 2 / (4.0 * math.pi)
    return np.add.reduceat(squares, np.arange(order) ** 2)


def truncation_error(
    energy: np.ndarray, order: int, kind: Kind, albedo: float = MEASURED_ALBEDO
) -> float:
    """Return the relative error of a lit surface whose ``kind`` of light keeps the bands below
    ``order`` <= MAX_ORDER.

    It is the root mean square over the surface that views see and over all rotations of the light,
    over the mean of direct and indirect luminance. ``energy`` (MAX_ORDER,) is the result of
    ``band_energy``; the bands beyond are extrapolated, see ``_beyond``. The error of indirect light
    is about in proportion to the ``albedo``; that of direct light changes with it by 15 % at most,
    which is neglected.

    Measured on the five surfaces of TRANSFER_DIRECT and five others (carp, teapot, tooth, neghip,
    T1 brain) under eight probes and two skies, up to order 5: right within a factor of 1.6 on eight
    of them, and up to 2.3 times too large on the smooth tooth and teapot.
    """
    if not energy[0] > 0.0:
        return 0.0
    # Sum the energy that the cut bands would have transferred.
    lost = float(_TRANSFER[kind][order:] @ energy[order:]) + _beyond(energy, kind)
    if kind == "indirect":
        reflected = albedo / MEASURED_ALBEDO
    else:
        reflected = 1.0
    return reflected * math.sqrt(lost / float(energy[0]))


def choose_order(
    energy: np.ndarray, target: float, kind: Kind, most: int = 5, albedo: float = MEASURED_ALBEDO
) -> tuple[int, float]:
    """Return the least order whose ``truncation_error`` is within ``target``, or ``most`` if none
    is, and that order's error.

    Bytes grow as n², while the error falls about as 1/n² under a soft light, as 1/n under lamps,
    and only as 1/√n under a sun. A constant light has order 1 and no error.
    """
    for order in range(1, most):
        error = truncation_error(energy, order, kind, albedo)
        if error <= target:
            return order, error
    return most, truncation_error(energy, most, kind, albedo)


def _beyond(energy: np.ndarray, kind: Kind) -> float:
    """Return Σ T_l B_l over the bands l >= MAX_ORDER, approximated by the integral over x = l + ½.

    T falls as x^-DECAY. The light's power per coefficient, B_l / 2x, is extrapolated as x^slope,
    with the slope between bands 4 … 6 and bands 7 … 9, which is at most 0.
    """
    per_coefficient = energy / (2.0 * np.arange(MAX_ORDER) + 1.0)
    near, far = float(per_coefficient[4:7].mean()), float(per_coefficient[7:10].mean())
    # A light without energy in the last bands has none beyond.
    if far == 0.0:
        return 0.0
    # Power falls between the centres of both groups of bands, x = 5.5 and x = 8.5.
    if far < near:
        slope = max(math.log(far / near) / math.log(8.5 / 5.5), STEEPEST_SLOPE)
    else:
        slope = 0.0
    # Extrapolate light and transfer to x = MAX_ORDER, and integrate their product, a power of x, to
    # infinity.
    light = 2.0 * MAX_ORDER * far * (MAX_ORDER / 8.5) ** slope
    transfer = _TRANSFER[kind][-1] * (MAX_ORDER / (MAX_ORDER - 0.5)) ** -DECAY[kind]
    return float(light * transfer * MAX_ORDER / (DECAY[kind] - slope - 2.0))
