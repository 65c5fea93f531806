"""A volume: a scalar field on a regular grid, normalised once so that kernels never see its units."""

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from isogi_core.errors import VolumeError

_LARGEST = float(np.finfo(np.float32).max)


@dataclass(frozen=True, eq=False)
class Volume:
    """A scalar field: ``value = offset + scale · voxel``, solid where ``voxel > normalised isovalue``.

    ``voxels`` is (nz, ny, nx) float32, C-contiguous, NaN where the source was not finite; ``spacing`` is
    (x, y, z), world units per voxel. ``scale`` is ± a power of two and negative where ``solid`` is
    "below". ``value_range`` is the finite minimum and maximum in the volume's own units, ``holes`` the
    number of voxels that are not finite, ``digest`` a hex name of everything that light depends on.
    """

    voxels: np.ndarray
    spacing: tuple[float, float, float]
    offset: float
    scale: float
    solid: str
    name: str
    dtype: str
    digest: str
    value_range: tuple[float, float]
    holes: int

    @property
    def shape(self) -> tuple[int, int, int]:
        """Voxels along z, y, x: the order of the array."""
        nz, ny, nx = self.voxels.shape
        return nz, ny, nx

    @property
    def size(self) -> tuple[int, int, int]:
        """Voxels along x, y, z."""
        nz, ny, nx = self.voxels.shape
        return nx, ny, nz

    @property
    def extent(self) -> tuple[float, float, float]:
        """World lengths of the box between the outermost voxel centres, along x, y, z."""
        x, y, z = ((n - 1) * step for n, step in zip(self.size, self.spacing, strict=True))
        return x, y, z

    @property
    def centre(self) -> tuple[float, float, float]:
        """The middle of the box, world x, y, z."""
        x, y, z = self.extent
        return x / 2, y / 2, z / 2

    @property
    def radius(self) -> float:
        """Radius of the sphere around the box, world units."""
        return math.hypot(*self.extent) / 2

    def normalise_isovalue(self, value: float) -> float:
        """The isovalue in voxel units, rounded to float32 exactly as the voxels are."""
        level = _normalise(np.array(float(value)), self.offset, self.scale)
        return float(np.float32(np.clip(level, -_LARGEST, _LARGEST)))

    def histogram(self, bins: int = 256) -> tuple[np.ndarray, np.ndarray]:
        """Counts (bins,) int64 of the finite voxels, and the ``bins + 1`` edges, float64, in own units."""
        finite = self.voxels[np.isfinite(self.voxels)] if self.holes else self.voxels
        counts, _ = np.histogram(finite, bins, (float(finite.min()), float(finite.max())))
        low, high = self.value_range
        if low == high:
            low, high = low - 0.5, high + 0.5
        t = np.linspace(0.0, 1.0, bins + 1)
        return counts[:: 1 if self.scale > 0 else -1].copy(), low * (1 - t) + high * t


def make_volume(
    array: np.ndarray,
    spacing: Sequence[float] = (1.0, 1.0, 1.0),
    solid: str = "above",
    name: str = "",
) -> Volume:
    """Normalise an array (z, y, x) of any real type into a Volume.

    The offset is the minimum (the maximum where ``solid`` is "below"), the scale the power of two that
    brings voxels into [0, 1] ([0, 4] where the range passes 2^1023). Both are removed before the values
    become float32, from integers of 64 bits as integers: a small range on a large offset keeps its digits,
    and tiny and subnormal ranges are like any other. A constant volume has scale ± 1. Raises VolumeError
    where the array is complex, not 3-D, thinner than two voxels or without a finite value, and where a
    spacing is not positive.
    """
    source = np.asarray(array)
    values = _checked(source, solid)
    steps = _checked_spacing(spacing)
    low, high, holes = _finite_range(values)
    offset, scale = _offset_and_scale(low, high, solid)
    voxels = np.empty(values.shape, np.float32)
    for z, plane in enumerate(values):
        voxels[z] = _normalise(plane, offset, scale)
    if holes:
        voxels[~np.isfinite(voxels)] = np.nan
    digest = _digest(voxels, steps, offset, scale)
    span = (float(low), float(high))
    return Volume(voxels, steps, offset, scale, solid, name, source.dtype.name, digest, span, holes)


def _checked(array: np.ndarray, solid: str) -> np.ndarray:
    """The array as integers or floats of at most 64 bits; VolumeError where it is no real 3-D field."""
    if solid not in ("above", "below"):
        raise VolumeError(f"solid is '{solid}': say which side of the isovalue is solid, 'above' or 'below'.")
    if array.dtype.kind not in "biuf":
        raise VolumeError(f"The volume holds {array.dtype} values: give one real number per voxel.")
    if array.ndim != 3:
        raise VolumeError(f"The volume has {array.ndim} dimensions, not 3: choose one scalar field of it.")
    if min(array.shape) < 2:
        sides = " × ".join(str(n) for n in array.shape[::-1])
        raise VolumeError(f"A volume of {sides} voxels has no cells: every side needs at least 2 voxels.")
    if array.dtype.kind == "b":
        return array.view(np.uint8)
    with np.errstate(over="ignore"):
        return array if array.dtype.itemsize <= 8 else array.astype(np.float64)


def _checked_spacing(spacing: Sequence[float]) -> tuple[float, float, float]:
    """Spacing as three floats; VolumeError where one is missing, zero, negative or not finite."""
    steps = [float(step) for step in spacing]
    if len(steps) != 3 or not all(math.isfinite(step) and step > 0.0 for step in steps):
        given = ", ".join(f"{step:g}" for step in steps)
        raise VolumeError(f"The spacing ({given}) must be three positive numbers: set spacing in the scene.")
    return steps[0], steps[1], steps[2]


def _finite_range(array: np.ndarray) -> tuple[float, float, int]:
    """Finite minimum and maximum (exact Python numbers), and how many values are not finite."""
    lows, highs, count = [], [], 0
    for plane in array:
        finite = plane[np.isfinite(plane)]
        count += finite.size
        if finite.size:
            lows.append(finite.min().item())
            highs.append(finite.max().item())
    if not lows:
        raise VolumeError("The volume has no finite value: every voxel is NaN or infinite.")
    return min(lows), max(highs), array.size - count


def _offset_and_scale(low: float, high: float, solid: str) -> tuple[float, float]:
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


def _normalise(values: np.ndarray, offset: float, scale: float) -> np.ndarray:
    """``(values - offset) / scale`` in float64 without overflow on the way, never -0."""
    sign, exponent = math.copysign(1.0, scale), math.frexp(scale)[1] - 1
    if values.dtype.kind in "iu" and values.dtype.itemsize == 8 and exponent < 63:
        return np.asarray(np.ldexp(_integer_distance(values, int(offset), int(sign)), -exponent))
    shift = 2 if exponent > 1000 else 0
    with np.errstate(over="ignore"):
        distance = np.ldexp(values.astype(np.float64), -shift) - math.ldexp(offset, -shift)
        return np.asarray(np.ldexp(sign * distance, shift - exponent) + 0.0)


def _integer_distance(values: np.ndarray, offset: int, sign: int) -> np.ndarray:
    """``sign · (values - offset)``, known to lie in [0, 2^63), exact modulo 2^64, then as float64."""
    whole = values.astype(values.dtype.newbyteorder("=")).view(np.uint64)
    start = np.uint64(offset % 2**64)
    distance = whole - start if sign > 0 else start - whole
    return distance.astype(np.float64)


def _digest(voxels: np.ndarray, spacing: Sequence[float], offset: float, scale: float) -> str:
    """Hex digest over the field's bits, its shape, spacing and units."""
    digest = hashlib.blake2b(digest_size=16)
    digest.update(f"{voxels.shape} {[step.hex() for step in spacing]} {offset.hex()} {scale.hex()}".encode())
    digest.update(voxels.data)
    return digest.hexdigest()
