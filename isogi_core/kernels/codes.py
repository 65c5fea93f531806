"""Codes: what texels keep as the store has it, plane after plane in half floats, single floats and bytes."""

from typing import NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel, record

INFINITE = 0x7C00
"""Bits of the half float that stands for no finite number, and below all others that do not."""


class Numbers(NamedTuple):
    """What bytes stand for, (256,) each: ``samples`` int32, ``noise`` and ``light`` float32, see ``bake.precision``."""

    samples: np.ndarray
    noise: np.ndarray
    light: np.ndarray


class Texels(NamedTuple):
    """What m texels keep of a layer, as ``bake.light.Part``: ``samples``, ``noise`` and ``light``, its coefficients."""

    samples: np.ndarray
    noise: np.ndarray
    light: np.ndarray


def planes(kind, axes):
    """The type of planes in a record, of these ``axes``: they may be read-only, and lie apart."""
    return types.Array(kind, axes, "A", readonly=True)


OFFSETS, BOUNDS = types.int32[::1], types.int64[::1]
SCALES, RUNGS, NOISE = planes(types.float32, 1), planes(types.uint8, 2), planes(types.uint8, 3)
HALVES, SINGLES, BYTES = planes(types.uint16, 4), planes(types.float32, 4), planes(types.uint8, 4)
NUMBERS = record(Numbers, types.int32[::1], types.float32[::1], types.float32[::1])
TEXELS = record(Texels, types.int32[::1], types.float32[:, ::1], types.float32[:, :, ::1])


@kernel()
def number_of_half(half):
    """The number that the 16 bits of a ``half`` float stand for, exactly; NaN where it is not finite; float32.

    Its exponent and fraction are put where a single float has them, which then is 2^-112 of it, also where the half
    is subnormal (IEEE 754).
    """
    size = np.uint32(half) & np.uint32(0x7FFF)
    if size >= INFINITE:
        return np.float32(np.nan)
    bits = np.uint32(size << np.uint32(13)) | np.uint32((np.uint32(half) & np.uint32(0x8000)) << np.uint32(16))
    return np.uint32(bits).view(np.float32) * np.float32(2.0**112)


@kernel()
def take_halves(plane, offsets, scale, into):
    """Write the numbers of the half floats at ``offsets`` (m,) in a ``plane``, times ``scale``, ``into`` (m,)."""
    for m, t in enumerate(offsets):
        into[m] = number_of_half(plane[np.uint32(t)]) * scale


@kernel()
def take_singles(plane, offsets, scale, into):
    """As ``take_halves``, of single floats."""
    for m, t in enumerate(offsets):
        into[m] = plane[np.uint32(t)] * scale


@kernel()
def take_codes(plane, offsets, numbers, scale, into):
    """As ``take_halves``, of bytes that stand for ``numbers`` (256,)."""
    for m, t in enumerate(offsets):
        into[m] = numbers[plane[np.uint32(t)]] * scale


@kernel(types.void(OFFSETS, BOUNDS, SCALES, RUNGS, NOISE, HALVES, SINGLES, BYTES, NUMBERS, TEXELS))
def unpack_texels(offsets, bounds, scales, rungs, noise, halves, singles, codes, numbers, texels):
    """Fill ``texels`` with those at ``offsets`` (m,) in records; ``bounds[k]`` … ``bounds[k + 1]`` are of record k.

    The records' planes are ``rungs`` (records, texels), ``noise`` (records, noises, texels), and (records, channels,
    coefficients of this kind, texels) ``halves``, the bits of half floats, then ``singles``, then ``codes``. Noise and
    light are times ``scales`` (records,). Planes are read one after the other, as they lie.
    """
    first, second = halves.shape[2], halves.shape[2] + singles.shape[2]
    for k, scale in enumerate(scales):
        a, b = bounds[k], bounds[k + 1]
        own, light = offsets[a:b], texels.light[a:b]
        take_codes(rungs[k], own, numbers.samples, 1, texels.samples[a:b])
        for j in range(noise.shape[1]):
            take_codes(noise[k, j], own, numbers.noise, scale, texels.noise[a:b, j])
        for c in range(light.shape[1]):
            for i in range(first):
                take_halves(halves[k, c, i], own, scale, light[:, c, i])
            for i in range(first, second):
                take_singles(singles[k, c, i - first], own, scale, light[:, c, i])
            for i in range(second, light.shape[2]):
                take_codes(codes[k, c, i - second], own, numbers.light, scale, light[:, c, i])
