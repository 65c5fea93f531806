"""The texel table: the light of texels as frames read it, unpacked and summed from the parts that
texels keep.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import (
    COUNT_ARRAY,
    INTEGER_ARRAY,
    REAL_ARRAY,
    SINGLE_ARRAY,
    kernel,
    record,
)
from isogi_core.kernels.shading.lattice import BURIED_ROW, LEAST_SPREAD, UNLIT_ROW, VOID_ROW

FIRST_LEVEL = 16
"""Samples of a texel's first level; each further level doubles them."""

INFINITE_HALF = 0x7C00
"""Bits of the half float that stands for no finite number, and below all others that do not."""


class Numbers(NamedTuple):
    """What bytes stand for, (256,) each: ``samples`` int32, ``noise`` and ``light`` float32, see
    ``bake.precision``.
    """

    samples: np.ndarray
    noise: np.ndarray
    light: np.ndarray


class Texels(NamedTuple):
    """What m texels keep of a layer, as ``bake.texel_light.Part``: ``samples``, ``noise``,
    ``light`` (coefficients).
    """

    samples: np.ndarray
    noise: np.ndarray
    light: np.ndarray


def plane(kind, axes):
    """The type of a plane in a record, of these ``axes``: it may be read-only, and its numbers lie
    apart.
    """
    return types.Array(kind, axes, "A", readonly=True)


OFFSETS = types.int32[::1]
BOUNDS = types.int64[::1]
SCALE_PLANE = plane(types.float32, 1)
RUNG_PLANE = plane(types.uint8, 2)
NOISE_PLANE = plane(types.uint8, 3)
HALF_PLANE = plane(types.uint16, 4)
SINGLE_PLANE = plane(types.float32, 4)
BYTE_PLANE = plane(types.uint8, 4)
TEXEL_NUMBERS = record(Numbers, types.int32[::1], types.float32[::1], types.float32[::1])
TEXELS_RECORD = record(Texels, types.int32[::1], types.float32[:, ::1], types.float32[:, :, ::1])


@kernel()
def number_of_half(half):
    """The number that the 16 bits of a ``half`` float stand for, exactly; NaN where it is not
    finite; float32.

    Its exponent and fraction are put where a single float has them, which then is 2^-112 of it,
    also where the half is subnormal (IEEE 754).
    """
    size = np.uint32(half) & np.uint32(0x7FFF)
    if size >= INFINITE_HALF:
        return np.float32(np.nan)
    bits = np.uint32(size << np.uint32(13)) | np.uint32(
        (np.uint32(half) & np.uint32(0x8000)) << np.uint32(16)
    )
    return np.uint32(bits).view(np.float32) * np.float32(2.0**112)


@kernel()
def take_halves(plane, offsets, scale, into):
    """Write the numbers of the half floats at ``offsets`` (m,) in a ``plane``, times ``scale``,
    ``into`` (m,).
    """
    for m, t in enumerate(offsets):
        into[m] = number_of_half(plane[np.uint32(t)]) * scale


@kernel()
def take_singles(plane, offsets, scale, into):
    """Write the single floats at ``offsets`` (m,) in a ``plane``, times ``scale``, ``into``
    (m,).
    """
    for m, t in enumerate(offsets):
        into[m] = plane[np.uint32(t)] * scale


@kernel()
def take_codes(plane, offsets, numbers, scale, into):
    """Write the ``numbers`` (256,) of bytes at ``offsets`` (m,) in a ``plane``, times ``scale``,
    ``into`` (m,).
    """
    for m, t in enumerate(offsets):
        into[m] = numbers[plane[np.uint32(t)]] * scale


PLANE_TUPLE = types.Tuple(
    (SCALE_PLANE, RUNG_PLANE, NOISE_PLANE, HALF_PLANE, SINGLE_PLANE, BYTE_PLANE)
)


@kernel(types.void(OFFSETS, BOUNDS, PLANE_TUPLE, TEXEL_NUMBERS, TEXELS_RECORD))
def unpack_texels(offsets, bounds, planes, numbers, texels):
    """Fill ``texels`` with those at ``offsets`` (m,) in records; ``bounds[k]`` … ``bounds[k + 1]``
    are of record k.

    The records' ``planes`` are ``scales`` (records,), ``rungs`` (records, texels), ``noise``
    (records, noises, texels), and (records, channels, coefficients of this kind, texels)
    ``halves``, the bits of half floats, then ``singles``, then ``codes``. Noise and light are times
    the scales. Planes are read one after the other, as they lie.
    """
    scales, rungs, noise, halves, singles, codes = planes
    first = halves.shape[2]
    second = halves.shape[2] + singles.shape[2]
    for k, scale in enumerate(scales):
        a = bounds[k]
        b = bounds[k + 1]
        own = offsets[a:b]
        light = texels.light[a:b]
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


TEXEL_LIT = 1
LIGHT_LACKING = 2
FEW_SAMPLES = 4
TEXEL_VOID = 8
"""What a part may say of a texel: it has light; shown light lacks; it has too few samples to be
dark; it is void.
"""

VOID_SAMPLES = -1
"""Number of samples of a texel that can hold no light (see bake.precision.VOID)."""


class Rows(NamedTuple):
    """Light as frames read it: ``transfer`` (rows, channels, columns), and of each row float32
    ``scatter`` (see ``bake.noise``), relative ``error`` and ``stamp``, which says how far it is
    baked.

    Columns are the coefficients of terms that meet lights of their own, side by side.
    """

    transfer: np.ndarray
    scatter: np.ndarray
    error: np.ndarray
    stamp: np.ndarray


class Sums(NamedTuple):
    """What is summed over the parts of m texels: ``variance`` and ``luminance``, float64;
    ``rungs``, those of the parts side by side, and the bits of what is ``shown`` without samples,
    int64; ``marks``, TEXEL_LIT, …, uint8.
    """

    variance: np.ndarray
    luminance: np.ndarray
    rungs: np.ndarray
    shown: np.ndarray
    marks: np.ndarray


class Role(NamedTuple):
    """What a part is to a bake: ``gains`` (noises,) of its squared noises, luminance ``weights``
    (channels,) of band 0.

    It is of the term with ``width`` columns from ``column`` on, and the ``first`` of its parts or
    not. ``rung`` is what its rung counts in ``Sums.rungs``. Of a ``straight`` part light is shown,
    of others only added to it; one that is ``telling`` is dark where no light ever comes. With
    fewer samples than ``fewest`` a part is not known to be dark.
    """

    gains: np.ndarray
    weights: np.ndarray
    column: int
    width: int
    first: bool
    rung: int
    straight: bool
    telling: bool
    fewest: int


ROWS_RECORD = record(Rows, types.float32[:, :, ::1], SINGLE_ARRAY, SINGLE_ARRAY, SINGLE_ARRAY)
SUMS_RECORD = record(Sums, REAL_ARRAY, REAL_ARRAY, INTEGER_ARRAY, INTEGER_ARRAY, types.uint8[::1])
TERM_TYPES = (types.int64, types.int64, types.boolean)
ROLE = record(
    Role,
    REAL_ARRAY,
    REAL_ARRAY,
    *TERM_TYPES,
    types.int64,
    types.boolean,
    types.boolean,
    types.int64,
)
SAMPLE_COUNTS = types.int32[::1]
NOISE_ROWS = types.float32[:, ::1]
LIGHT_ROWS = types.float32[:, :, ::1]


@kernel()
def rung_of(samples):
    """Return the rung of a number of samples on the ladder: 0 for none or void, k for FIRST_LEVEL ·
    2^(k - 1).
    """
    rung = 0
    while samples >= FIRST_LEVEL:
        samples >>= 1
        rung += 1
    return rung


@kernel()
def add_texel_light(light, m, role, transfer, row):
    """Add the ``light`` of a texel to its term's columns of a ``row``, or put it there; whether
    there is any.

    A light of one channel is that of all.
    """
    lit = False
    n = min(light.shape[2], role.width)
    for c in range(transfer.shape[1]):
        own = min(c, light.shape[1] - 1)
        for i in range(n):
            if role.first:
                former = np.float32(0.0)
            else:
                former = transfer[row, c, role.column + i]
            transfer[row, c, role.column + i] = light[m, own, i] + former
        for i in range(n, role.width if role.first else n):
            transfer[row, c, role.column + i] = 0.0
    for c in range(light.shape[1]):
        for i in range(light.shape[2]):
            lit |= light[m, c, i] != 0.0
    return lit


@kernel()
def variance_of(noise, m, gains):
    """Variance of the luminance in a part, at least a quarter of what even noise would be: see
    ``noise.deviation``.
    """
    total = 0.0
    even = 0.0
    last = np.float64(noise[m, noise.shape[1] - 1]) ** 2
    for j in range(noise.shape[1]):
        total += np.float64(noise[m, j]) ** 2 * gains[j]
        even += last * gains[j] / 4.0
    return max(total, even)


@kernel()
def mark_of(samples, lit, role):
    """The marks that a part with this number of ``samples`` gives a texel, ``lit`` or dark in
    it.
    """
    lacks = role.straight and samples == 0 and not lit
    if lit or not role.telling:
        marks = TEXEL_LIT
    else:
        marks = 0
    marks |= (LIGHT_LACKING if lacks else 0) | (FEW_SAMPLES if samples < role.fewest else 0)
    return marks | (TEXEL_VOID if samples == VOID_SAMPLES else 0)


@kernel()
def sum_bits(bits, m):
    """The sum of a texel's numbers, taken by their ``bits`` (m, channels, n²) int32."""
    total = np.int64(0)
    for c in range(bits.shape[1]):
        for i in range(bits.shape[2]):
            total += bits[m, c, i]
    return total


@kernel(
    types.void(
        SAMPLE_COUNTS,
        NOISE_ROWS,
        LIGHT_ROWS,
        types.int32[:, :, ::1],
        ROLE,
        COUNT_ARRAY,
        ROWS_RECORD,
        SUMS_RECORD,
    )
)
def add_part(samples, noise, light, bits, role, rows, into, sums):
    """Add one part of m texels to their ``rows`` (m,) in ``into``, and to their ``sums``.

    Of the part, ``samples`` (m,), ``noise`` (m, noises) and ``light`` (m, channels, n²), also as
    its ``bits``.
    """
    for m in range(len(samples)):
        lit = add_texel_light(light, m, role, into.transfer, np.uint32(rows[m]))
        sums.variance[m] += variance_of(noise, m, role.gains)
        for c in range(light.shape[1]):
            sums.luminance[m] += light[m, c, 0] * role.weights[c]
        sums.rungs[m] += role.rung * rung_of(samples[m])
        sums.marks[m] |= mark_of(samples[m], lit, role)
        if samples[m] == 0:
            sums.shown[m] += sum_bits(bits, m)


@kernel()
def lookup_of(marks, row):
    """Where a texel with these ``marks`` is looked up: its ``row``, or why it has none."""
    if marks & TEXEL_VOID:
        return VOID_ROW
    if marks & LIGHT_LACKING:
        return UNLIT_ROW
    if marks & (TEXEL_LIT | FEW_SAMPLES):
        return row
    return BURIED_ROW


class Judge(NamedTuple):
    """What a bake's lights are to its texels' errors, see ``bake.noise``.

    Of each term the first of its columns, ``firsts`` (terms,), how many they are, ``widths``
    (terms,), and the ``squares`` (terms,) of band 0 of its light; of each two of them the
    ``powers`` (terms, terms, channels, channels, most n²), all in ``unit``. The least luminance
    that an error is held against is ``level``, the least deviation ``darkest``. Stamps are the
    rungs, and ``beyond`` times what bits are shown, by their remainder of ``checksums``.
    """

    firsts: np.ndarray
    widths: np.ndarray
    squares: np.ndarray
    powers: np.ndarray
    unit: float
    level: float
    darkest: float
    beyond: int
    checksums: int


POWERS = types.float64[:, :, :, :, ::1]
JUDGE = record(
    Judge,
    INTEGER_ARRAY,
    INTEGER_ARRAY,
    REAL_ARRAY,
    POWERS,
    *[types.float64] * 3,
    types.int64,
    types.int64,
)


@kernel()
def second_moment(transfer, row, judge):
    """The mean square of one path's luminance over turns of the light: band 0 of Σ τ·q, see
    ``bake.noise``.
    """
    total = 0.0
    green = transfer.shape[1] // 2
    for a in range(judge.firsts.shape[0]):
        total += judge.squares[a] * np.float64(transfer[row, green, judge.firsts[a]])
    return total


@kernel(any_order=True)
def product_of(transfer, row, judge, a, b):
    """E[(τ_a·Dℓ_a)(τ_b·Dℓ_b)] of two terms over turns D of the light, by their ``powers``: see
    ``bake.noise``.
    """
    total = 0.0
    first = judge.firsts[a]
    other = judge.firsts[b]
    for c in range(transfer.shape[1]):
        for d in range(transfer.shape[1]):
            for i in range(min(judge.widths[a], judge.widths[b])):
                pair = np.float64(transfer[row, c, first + i]) * np.float64(
                    transfer[row, d, other + i]
                )
                total += pair * judge.powers[a, b, c, d, i]
    return total


@kernel()
def mean_square(transfer, row, judge):
    """E[(Σ τ·Dℓ)²] of all terms over turns D of the light."""
    total = 0.0
    for a in range(judge.firsts.shape[0]):
        for b in range(judge.firsts.shape[0]):
            total += product_of(transfer, row, judge, a, b)
    return total


@kernel(types.void(COUNT_ARRAY, ROWS_RECORD, SUMS_RECORD, JUDGE, COUNT_ARRAY))
def judge_rows(rows, into, sums, judge, places):
    """Fill scatter, error and stamp of the ``rows`` (m,) in ``into``, whose parts were all added,
    from their ``sums``.

    ``places`` (m,) are set to the rows, or to UNLIT_ROW, VOID_ROW or BURIED_ROW of texels that have
    nothing to show.
    """
    for m in range(len(rows)):
        row = np.uint32(rows[m])
        wrong = math.sqrt(sums.variance[m])
        second = second_moment(into.transfer, row, judge)
        spread = max(second - mean_square(into.transfer, row, judge), 0.0) + LEAST_SPREAD * max(
            second, 0.0
        )
        into.scatter[row] = wrong / max(judge.unit * math.sqrt(spread), judge.darkest)
        into.error[row] = wrong / max(sums.luminance[m], judge.level)
        into.stamp[row] = sums.rungs[m] + judge.beyond * (sums.shown[m] % judge.checksums)
        places[m] = lookup_of(sums.marks[m], rows[m])


@kernel(
    types.void(types.float32[::1], types.int64, types.int64, types.int32[::1], types.int32[::1])
)
def find_fewest(stamps, parts, levels, numbers, fewest):
    """Fill ``fewest`` (m,): the fewest samples of any of the ``parts`` of texels with these
    ``stamps`` (m,).

    A stamp has as many ``levels`` for each part, which stand for ``numbers`` (256,) of samples;
    negative ones for none.
    """
    for m in range(stamps.shape[0]):
        rungs = max(int(stamps[m]), 0)
        least = levels
        for _ in range(parts):
            least = min(least, rungs % levels)
            rungs //= levels
        fewest[m] = numbers[least]
