"""Real spherical harmonics: basis and rotation.

Y_lm are orthonormal over the sphere, without the Condon-Shortley phase, so that band 1 is √(3/4π)
(y, z, x). Coefficient (l, m) has index i = l(l + 1) + m; order n means the bands 0 … n-1, n²
numbers. With C_m + i S_m = (x + iy)^m, Y_lm = q_lm(z) C_m for m >= 0 and q_l|m|(z) S_|m| for m < 0:
polynomials alone, no angle and no pole (Sloan, "Efficient Spherical Harmonic Evaluation", JCGT
2(2), 2013).
"""

import math

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel
from isogi_core.kernels.simd.memory import add_to

MAX_ORDER = 10
"""Largest order of the tables."""
MATRIX = types.Array(types.float64, 2, "C", readonly=True)


def _diagonal() -> np.ndarray:
    """Return q_mm = √(2 - δ_m0) √((2m+1)!!/(2m)!!) / √4π for m < MAX_ORDER, at which the
    recurrence in l starts.
    """
    m = np.arange(1, MAX_ORDER)
    growth = np.sqrt(np.cumprod((2 * m + 1) / (2 * m)))
    return np.concatenate(([1.0], math.sqrt(2.0) * growth)) / math.sqrt(4.0 * math.pi)


def _recurrence() -> tuple[np.ndarray, np.ndarray]:
    """Return the factors (a, b), each (MAX_ORDER+1, MAX_ORDER), of q_lm = a_lm z q_(l-1)m - b_lm
    q_(l-2)m, for l > m.

    a² = (4l²-1)/(l²-m²); b = a_lm / a_(l-1)m, and 0 for l = m+1.
    """
    l, m = np.mgrid[0 : MAX_ORDER + 1, 0:MAX_ORDER]
    inside = l > m
    a = np.sqrt(np.where(inside, 4.0 * l**2 - 1.0, 0.0) / np.where(inside, l**2 - m**2, 1))
    b = np.zeros_like(a)
    b[1:] = np.divide(a[1:], a[:-1], out=np.zeros_like(a[1:]), where=a[:-1] > 0.0)
    return a, b


DIAGONAL = _diagonal()
RECURRENCE_SLOPE, RECURRENCE_OFFSET = _recurrence()


@kernel(exact=True)
def accumulate(order, x, y, z, weight, out):
    """Add weight · Y_i(x, y, z) to out[i] for all i < order²; (x, y, z) is a unit vector, out
    float64.

    ``order`` ≤ MAX_ORDER; the recurrence runs in l for each m, the powers (x + iy)^m along with it.
    With vectors of directions and weights each lane has separate sums, out[width · i + lane].
    """
    nothing = 0.0 * weight
    cosine, sine = weight, nothing
    for m in range(order):
        # Run up the bands from q_mm; cosine and sine hold weight · (x + iy)^m.
        before = nothing
        q = nothing + DIAGONAL[m]
        for l in range(m, order):
            middle = l * (l + 1)
            if m > 0:
                add_to(out, middle - m, sine * q)
            add_to(out, middle + m, cosine * q)
            before, q = q, RECURRENCE_SLOPE[l + 1, m] * z * q - RECURRENCE_OFFSET[l + 1, m] * before
        # Go on to the next power of x + iy.
        cosine, sine = x * cosine - y * sine, x * sine + y * cosine


@kernel()
def evaluate(order, x, y, z, out):
    """Write Y_i(x, y, z) to out[i] for all i < order²;
    (x, y, z) is a unit vector, out is float64.
    """
    for i in range(order * order):
        out[i] = 0.0
    accumulate(order, x, y, z, 1.0, out)


def cosine_lobe_factors(order: int) -> np.ndarray:
    """Return A_l for l < order, float64: irradiance E_lm = A_l L_lm; π, 2π/3, π/4, 0, -π/24, 0, …

    Ramamoorthi and Hanrahan, "An Efficient Representation for Irradiance Environment Maps", 2001,
    eq. 8.
    """
    factors = np.zeros(order)
    for l in range(0, order, 2):
        share = math.comb(l, l // 2) / 2**l
        factors[l] = -2.0 * math.pi * (-1) ** (l // 2) / ((l + 2) * (l - 1)) * share
    factors[1:2] = 2.0 * math.pi / 3.0
    return factors


@kernel()
def _step(first, before, l, i, m, n):
    """Return P_i(l; m, n) of Ivanic and Ruedenberg, table 2: band 1 times band l-1.
    Matrices are centred.
    """
    c = MAX_ORDER
    if n == l:
        return (
            first[1 + i, 2] * before[c + m, c + l - 1] - first[1 + i, 0] * before[c + m, c - l + 1]
        )
    if n == -l:
        return (
            first[1 + i, 2] * before[c + m, c - l + 1] + first[1 + i, 0] * before[c + m, c + l - 1]
        )
    return first[1 + i, 1] * before[c + m, c + n]


@kernel()
def _inner_weights(m):
    """Return the weights of P₁ and P₋₁ within V; rows 0 and ±1 refer to the row 0, which stands
    for both signs together.
    """
    if abs(m) == 1:
        same = math.sqrt(2.0)
        other = 0.0
    else:
        same = 1.0
        other = 1.0
    if m == 0:
        return -math.sqrt(2.0), -math.sqrt(2.0)
    return (same, -other) if m > 0 else (other, same)


@kernel()
def _element(first, before, l, m, n):
    """Return element (m, n) of band l: u U + v V + w W of Ivanic and Ruedenberg,
    tables 1 and 2 as corrected.
    """
    k = abs(m)
    s = 1 if m > 0 else -1
    # Compute the factors u, v and w (table 1).
    if abs(n) == l:
        below = 2 * l * (2 * l - 1)
    else:
        below = (l + n) * (l - n)
    u = math.sqrt((l + m) * (l - m) / below)
    v = 0.5 * math.sqrt((l + k - 1) * (l + k) / below)
    if k > 0:
        w = 0.5 * math.sqrt(max(0, (l - k - 1) * (l - k)) / below)
    else:
        w = 0.0
    # Sum the terms of U, V and W (table 2): index, row and weight of each.
    plus, minus = _inner_weights(m)
    total = 0.0
    for i, row, weight in (
        (0, m, u),
        (1, m - s, v * plus),
        (-1, s - m, v * minus),
        (1, m + s, -w),
        (-1, -m - s, -s * w),
    ):
        total += weight * _step(first, before, l, i, row, n)
    return total


@kernel()
def band_rotation(l, first, before, out):
    """Fill ``out`` with the rotation matrix of band l ≥ 2 from bands 1 and l-1: element (m, n) at
    [MAX_ORDER+m, MAX_ORDER+n].

    ``first`` is (3, 3), ``before`` and ``out`` are (2 MAX_ORDER + 1, 2 MAX_ORDER + 1) with zeros
    around the band. Ivanic and Ruedenberg, J. Phys. Chem. 100, 6342 (1996), with the corrections in
    A 102, 9099 (1998).
    """
    for m in range(-l, l + 1):
        for n in range(-l, l + 1):
            out[MAX_ORDER + m, MAX_ORDER + n] = _element(first, before, l, m, n)


@kernel()
def _apply_band(l, band, coefficients, out):
    """Write out_m = Σ_n band_mn coefficients_n within band l, for every channel."""
    middle = l * (l + 1)
    for channel in range(coefficients.shape[0]):
        for m in range(-l, l + 1):
            total = 0.0
            for n in range(-l, l + 1):
                total += band[MAX_ORDER + m, MAX_ORDER + n] * coefficients[channel, middle + n]
            out[channel, middle + m] = total


@kernel((types.int64, MATRIX, MATRIX, types.float64[:, ::1]))
def rotate(order, matrix, coefficients, out):
    """Write the coefficients of the rotated function L'(ω) = L(Q⁻¹ω) to ``out``; Q is the (3, 3)
    rotation ``matrix``.

    ``coefficients`` and ``out`` are different (channels, order²) float64 arrays. Rotate the
    unrotated light every time: chained rotations drift. Source: Ivanic and Ruedenberg 1996,
    corrected 1998.
    """
    side = 2 * MAX_ORDER + 1
    before = np.zeros((side, side))
    band = np.zeros((side, side))
    # Band 1 is the rotation matrix itself, in the order y, z, x.
    first = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            first[i, j] = matrix[(i + 1) % 3, (j + 1) % 3]
            band[MAX_ORDER - 1 + i, MAX_ORDER - 1 + j] = first[i, j]
    before[MAX_ORDER, MAX_ORDER] = 1.0
    _apply_band(0, before, coefficients, out)
    # Build the rotation of each band from those of band 1 and of the band before.
    for l in range(1, order):
        if l > 1:
            before, band = band, before
            band_rotation(l, first, before, band)
        _apply_band(l, band, coefficients, out)
