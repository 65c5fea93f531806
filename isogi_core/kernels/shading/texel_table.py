"""The texel table: the light of texels as frames read it, decoded and summed over the parts that
bakes keep.

A part is the light of one layer (direct, reflected, a glow). ``unpack_texels`` decodes parts from
the records of chunks; ``add_part`` adds them to the rows of the table; ``judge_rows`` then
estimates the error of each row.
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
"""Bits of an infinite half float;
those of all numbers that are not finite are at least this, the sign aside.
"""


class Numbers(NamedTuple):
    """Tables (256,) from coded bytes to values: ``samples`` int32,
    ``noise`` and ``light`` float32.
    """

    samples: np.ndarray
    noise: np.ndarray
    light: np.ndarray


class Texels(NamedTuple):
    """The decoded light of m texels in one layer, as in ``bake.texel_light.Part``: ``samples``
    (m,), ``noise`` (m, noises) and ``light`` (m, channels, coefficients).
    """

    samples: np.ndarray
    noise: np.ndarray
    light: np.ndarray


def plane(kind, axes):
    """Return the type of a plane in a record, with this number of ``axes``: it may be
    read-only, and need not be contiguous.
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
    """Return the value of the 16 bits of a ``half`` float, exactly, as float32; NaN if it is not
    finite.

    Exponent and fraction are moved to where a single float has them. The result is 2^-112 times the
    value, as the exponents' biases differ by 112; this holds for subnormal halves too (IEEE 754).
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
    """Write the half floats at ``offsets`` (m,) of a ``plane``, times ``scale``,
    to ``into`` (m,).
    """
    for m, t in enumerate(offsets):
        into[m] = number_of_half(plane[np.uint32(t)]) * scale


@kernel()
def take_singles(plane, offsets, scale, into):
    """Write the single floats at ``offsets`` (m,) of a ``plane``, times ``scale``,
    to ``into`` (m,).
    """
    for m, t in enumerate(offsets):
        into[m] = plane[np.uint32(t)] * scale


@kernel()
def take_codes(plane, offsets, numbers, scale, into):
    """Decode the bytes at ``offsets`` (m,) of a ``plane`` by the table ``numbers`` (256,), and
    write them, times ``scale``, to ``into`` (m,).
    """
    for m, t in enumerate(offsets):
        into[m] = numbers[plane[np.uint32(t)]] * scale


PLANE_TUPLE = types.Tuple(
    (SCALE_PLANE, RUNG_PLANE, NOISE_PLANE, HALF_PLANE, SINGLE_PLANE, BYTE_PLANE)
)


@kernel(types.void(OFFSETS, BOUNDS, PLANE_TUPLE, TEXEL_NUMBERS, TEXELS_RECORD))
def unpack_texels(offsets, bounds, planes, numbers, texels):
    """Decode into ``texels`` those at ``offsets`` (m,) in several records; entries ``bounds[k]`` …
    ``bounds[k + 1]`` lie in record k.

    The ``planes`` of the records are ``scales`` (records,), ``rungs`` (records, texels), ``noise``
    (records, noises, texels), and three planes (records, channels, coefficients, texels) for the
    first coefficients as ``halves``, the bits of half floats, the next as ``singles``, and the last
    as ``codes``. Noise and light are multiplied by the scale of the record.
    """
    scales, rungs, noise, halves, singles, codes = planes
    # Coefficients are stored as halves, then singles, then codes.
    first = halves.shape[2]
    second = halves.shape[2] + singles.shape[2]
    for k, scale in enumerate(scales):
        # Read one plane after the other, in the order in which they lie in memory.
        a = bounds[k]
        b = bounds[k + 1]
        places = offsets[a:b]
        light = texels.light[a:b]
        take_codes(rungs[k], places, numbers.samples, 1, texels.samples[a:b])
        for j in range(noise.shape[1]):
            take_codes(noise[k, j], places, numbers.noise, scale, texels.noise[a:b, j])
        for c in range(light.shape[1]):
            for i in range(first):
                take_halves(halves[k, c, i], places, scale, light[:, c, i])
            for i in range(first, second):
                take_singles(singles[k, c, i - first], places, scale, light[:, c, i])
            for i in range(second, light.shape[2]):
                take_codes(codes[k, c, i - second], places, numbers.light, scale, light[:, c, i])


TEXEL_LIT = 1
LIGHT_LACKING = 2
FEW_SAMPLES = 4
TEXEL_VOID = 8
"""Bits that a part may set for a texel: it has light; light that is shown is missing; it has
too few samples to be known as dark; it is void.
"""

VOID_SAMPLES = -1
"""Number of samples of a texel that can hold no light (``bake.texel_light.VOID``)."""


class Rows(NamedTuple):
    """The texel table: light as frames read it, one row per texel.

    ``transfer`` (rows, channels, columns) holds coefficients; each term has a range of columns.
    ``scatter``, relative ``error`` and ``stamp``, float32 (rows,), are the ratio of
    ``bake.noise.scatter``, the standard error over the luminance, and a number that encodes the
    sample counts and the light without samples.
    """

    transfer: np.ndarray
    scatter: np.ndarray
    error: np.ndarray
    stamp: np.ndarray


class Sums(NamedTuple):
    """Sums over the parts of m texels.

    - ``variance``, ``luminance``: float64.
    - ``rungs``: the rungs of all parts, encoded in one int64.
    - ``shown``: sum of the bits of light that is shown without samples, int64.
    - ``marks``: TEXEL_LIT, …, combined, uint8.
    """

    variance: np.ndarray
    luminance: np.ndarray
    rungs: np.ndarray
    shown: np.ndarray
    marks: np.ndarray


class Role(NamedTuple):
    """How a part of a bake counts in the rows of its texels.

    - ``gains`` (noises,): factors of its squared noises in the variance of luminance.
    - ``weights`` (channels,): factors of band 0 in the luminance.
    - ``column``, ``width``: the columns of its term.
    - ``first``: True if it is the first part of its term, which overwrites the columns.
    - ``rung``: factor of its rung in ``Sums.rungs``.
    - ``straight``: True if its light is shown by itself; other light is only added to it.
    - ``telling``: True if no light ever arrives at a texel that is dark in it.
    - ``fewest``: least number of samples at which a dark texel counts as dark.
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
    """Return the rung of a number of samples on the ladder:
    k for FIRST_LEVEL · 2^(k - 1) samples, 0 for none or void.
    """
    rung = 0
    while samples >= FIRST_LEVEL:
        samples >>= 1
        rung += 1
    return rung


@kernel()
def add_texel_light(light, m, role, transfer, row):
    """Add the ``light`` of texel ``m`` to its term's columns in a ``row`` of ``transfer``, or write
    it if the part is the first; return True if any of it is not zero.

    Light of one channel counts for all channels.
    """
    lit = False
    n = min(light.shape[2], role.width)
    for c in range(transfer.shape[1]):
        channel = min(c, light.shape[1] - 1)
        for i in range(n):
            if role.first:
                former = np.float32(0.0)
            else:
                former = transfer[row, c, role.column + i]
            transfer[row, c, role.column + i] = light[m, channel, i] + former
        # The first part clears the columns beyond its order.
        for i in range(n, role.width if role.first else n):
            transfer[row, c, role.column + i] = 0.0
    for c in range(light.shape[1]):
        for i in range(light.shape[2]):
            lit |= light[m, c, i] != 0.0
    return lit


@kernel()
def variance_of(noise, m, gains):
    """Return the variance of the luminance of texel ``m`` in a part: Σ noise² · gain over its
    noises.

    Column 0 of the ``noise`` is the standard error of a coefficient of band 0, and the last column
    that of a coefficient of the bands above; ``gains`` are those of ``Role``. The variance is at
    least a quarter of the one that follows if band 0 has the noise of the bands above: two halves
    may agree in band 0 by chance. See ``bake.noise.deviation``, which this follows.
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
    """Return the marks of a texel by a part in which it has this number of ``samples`` and is
    ``lit`` or dark.
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
    """Return the sum of the coefficients of texel ``m``, taken as the integers that their
    ``bits`` (m, channels, n²) int32 are: a checksum.
    """
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
    """Add one part of m texels to their ``rows`` (m,) of the table ``into``, and to their ``sums``.

    The part has ``samples`` (m,), ``noise`` (m, noises) and ``light`` (m, channels, n²), which is
    also given as ``bits``; ``role`` tells how it counts.
    """
    for m in range(len(samples)):
        lit = add_texel_light(light, m, role, into.transfer, np.uint32(rows[m]))
        sums.variance[m] += variance_of(noise, m, role.gains)
        for c in range(light.shape[1]):
            sums.luminance[m] += light[m, c, 0] * role.weights[c]
        sums.rungs[m] += role.rung * rung_of(samples[m])
        sums.marks[m] |= mark_of(samples[m], lit, role)
        # Light without samples is that of a fallback layer: its bits enter the stamp, so that a
        # change is noticed.
        if samples[m] == 0:
            sums.shown[m] += sum_bits(bits, m)


@kernel()
def lookup_of(marks, row):
    """Return the ``row`` of a texel with these ``marks``, or VOID_ROW, UNLIT_ROW or BURIED_ROW
    if it has nothing to show.
    """
    if marks & TEXEL_VOID:
        return VOID_ROW
    if marks & LIGHT_LACKING:
        return UNLIT_ROW
    if marks & (TEXEL_LIT | FEW_SAMPLES):
        return row
    return BURIED_ROW


class Judge(NamedTuple):
    """The lights of a bake, by which the errors of texels are judged: see ``bake.noise``.

    - ``firsts``, ``widths`` (terms,): the first column of each term, and the number of its columns.
    - ``squares`` (terms,): band 0 of the square of each term's light.
    - ``powers`` (terms, terms, channels, channels, most n²): see ``bake.noise.powers``.
    - ``unit``: the radiance that the light is counted in.
    - ``level``: least luminance that errors are relative to.
    - ``darkest``: least standard deviation of a path.
    - ``beyond``, ``checksums``: a stamp is the rungs plus ``beyond`` times the checksum of light
      without samples, modulo ``checksums``.
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
    """Return the mean square of one path's luminance over all turns of the light, in the unit of
    the bake.

    A path brings light from the one direction that it leaves in, so that its expected square is
    the transfer τ times the squared light q. The mean over all turns keeps band 0 alone: Σ τ_0 q_0
    over the terms. ``squares`` are of the luminance of all channels together; the transfer of the
    middle channel stands for all: green, which has the largest part of luminance. See
    ``bake.noise.path_deviation``.
    """
    total = 0.0
    green = transfer.shape[1] // 2
    for a in range(judge.firsts.shape[0]):
        total += judge.squares[a] * np.float64(transfer[row, green, judge.firsts[a]])
    return total


@kernel(any_order=True)
def product_of(transfer, row, judge, a, b):
    """Return E[(τ_a·Dℓ_a)(τ_b·Dℓ_b)] of two terms over all turns D of the light, by their
    ``powers``: see ``bake.noise.powers``.
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
    """Return E[(Σ τ·Dℓ)²], the mean square of a texel's luminance over all turns D of the light."""
    total = 0.0
    for a in range(judge.firsts.shape[0]):
        for b in range(judge.firsts.shape[0]):
            total += product_of(transfer, row, judge, a, b)
    return total


@kernel(types.void(COUNT_ARRAY, ROWS_RECORD, SUMS_RECORD, JUDGE, COUNT_ARRAY))
def judge_rows(rows, into, sums, judge, places):
    """Fill scatter, error and stamp of the ``rows`` (m,) of ``into``, to which all parts were
    added, by their ``sums``.

    ``places`` (m,) become the rows, or UNLIT_ROW, VOID_ROW or BURIED_ROW for texels that have
    nothing to show.
    """
    for m in range(len(rows)):
        row = np.uint32(rows[m])
        # The variance of one path is its second moment less the square of its mean; LEAST_SPREAD
        # of the second moment is added for noise that does not follow the light's direction.
        deviation = math.sqrt(sums.variance[m])
        second = second_moment(into.transfer, row, judge)
        spread = max(second - mean_square(into.transfer, row, judge), 0.0) + LEAST_SPREAD * max(
            second, 0.0
        )
        # Scatter stays as the light turns; error is that of the mean over all turns.
        into.scatter[row] = deviation / max(judge.unit * math.sqrt(spread), judge.darkest)
        into.error[row] = deviation / max(sums.luminance[m], judge.level)
        into.stamp[row] = sums.rungs[m] + judge.beyond * (sums.shown[m] % judge.checksums)
        places[m] = lookup_of(sums.marks[m], rows[m])


@kernel(
    types.void(types.float32[::1], types.int64, types.int64, types.int32[::1], types.int32[::1])
)
def find_fewest(stamps, parts, levels, numbers, fewest):
    """Fill ``fewest`` (m,) with the smallest number of samples in any of the ``parts`` of texels
    with these ``stamps`` (m,).

    A stamp encodes one rung per part to the base ``levels``; ``numbers`` (256,) are the sample
    numbers of rungs. Negative stamps, of texels without light, count as rung 0.
    """
    for m in range(stamps.shape[0]):
        rungs = max(int(stamps[m]), 0)
        least = levels
        for _ in range(parts):
            least = min(least, rungs % levels)
            rungs //= levels
        fewest[m] = numbers[least]
