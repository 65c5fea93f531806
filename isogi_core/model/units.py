"""Units: between a volume's own values and its voxels, which are ``(value - offset) / scale``."""

import math
from fractions import Fraction
from typing import Any

import numpy as np

FURTHEST = 2.0**120
"""Largest normalised voxel or isovalue, to which outliers are moved: float32 sums of a few such are finite."""


def offset_and_scale(low: float, high: float, solid: str) -> tuple[float, float]:
    """The empty end of the range as a double, and ± the least power of two that spans it: both exact.

    Integers beyond 2^53 may have no double: the offset is then the next one outside the range.
    """
    sign, end = (1, low) if solid == "above" else (-1, high)
    offset = float(end) + 0.0  # one zero
    if sign * (Fraction(offset) - Fraction(end)) > 0:
        offset = math.nextafter(offset, -sign * math.inf)
    span = sign * (Fraction(high if sign > 0 else low) - Fraction(offset))
    if span == 0:
        return offset, float(sign)
    exponent = (span.numerator - 1).bit_length() - (span.denominator.bit_length() - 1)
    return offset, math.ldexp(sign, min(exponent, 1023))


def normalise(values: np.ndarray, offset: float, scale: float) -> np.ndarray:
    """``(values - offset) / scale`` in float64 without overflow on the way, never -0, and at most FURTHEST in size."""
    sign, exponent = math.copysign(1.0, scale), math.frexp(scale)[1] - 1
    shift = 2 if exponent > 1000 else 0
    with np.errstate(over="ignore"):
        distance = np.ldexp(values.astype(np.float64), -shift) - math.ldexp(offset, -shift)
        if values.dtype.kind in "iu" and values.dtype.itemsize == 8 and exponent < 63:
            distance = np.where(np.abs(distance) < 2.0**63, _integer_distance(values, int(offset)), distance)
        return np.clip(np.ldexp(sign * distance, shift - exponent) + 0.0, -FURTHEST, FURTHEST)


def _integer_distance(values: np.ndarray, offset: int) -> np.ndarray:
    """``values - offset``, where that is known to be less than 2^63 in size: exact modulo 2^64, then as float64."""
    whole = values.astype(values.dtype.newbyteorder("=")).view(np.uint64)
    return (whole - np.uint64(offset % 2**64)).view(np.int64).astype(np.float64)


def count_steps(low: float, high: float, dtype: np.dtype[Any]) -> float:
    """How many steps a type has from one value to another: whole numbers, or units in the last place of the larger."""
    if dtype.kind != "f":
        return float(high - low)
    unit = float(np.spacing(np.array(max(abs(low), abs(high)), dtype)))
    return high / unit - low / unit
