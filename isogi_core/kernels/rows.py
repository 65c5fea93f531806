"""Rows: the light of texels as frames read it, summed up from the parts that texels keep."""

import math
from typing import NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel, record
from isogi_core.kernels.lattice import BURIED_ROW, LEAST_SPREAD, UNLIT, VOID_ROW

LIT, LACKING, FEW, NEVER = 1, 2, 4, 8
"""What a part may say of a texel: it has light; shown light lacks; it has too few samples to be dark; it is void."""

VOID = -1
"""Number of samples of a texel that can hold no light (see bake.precision.VOID)."""


class Rows(NamedTuple):
    """Light as frames read it: ``transfer`` (rows, channels, columns), and of each row float32 ``scatter`` (see
    ``bake.moments``), relative ``error`` and ``stamp``, which tells how far it is baked.

    Columns are the coefficients of terms that meet lights of their own, side by side.
    """

    transfer: np.ndarray
    scatter: np.ndarray
    error: np.ndarray
    stamp: np.ndarray


class Sums(NamedTuple):
    """What is summed over the parts of m texels: ``variance`` and ``luminance``, float64; ``rungs``, those of the
    parts side by side, and the bits of what is ``shown`` without samples, int64; ``marks``, LIT, …, uint8.
    """

    variance: np.ndarray
    luminance: np.ndarray
    rungs: np.ndarray
    shown: np.ndarray
    marks: np.ndarray


class Role(NamedTuple):
    """What a part is to a look: ``gains`` (noises,) of its squared noises, luminance ``weights`` (channels,) of band 0.

    It is of the term with ``width`` columns from ``column`` on, and the ``first`` of its parts or not. ``rung`` is
    what its rung counts in ``Sums.rungs``. Of a ``straight`` part light is shown, of others only added to it; one that
    is ``telling`` is dark where no light ever comes. With fewer samples than ``fewest`` a part is not known to be dark.
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


COLUMN, WHOLE = types.float32[::1], types.int64[::1]
REAL = types.float64[::1]
ROWS = record(Rows, types.float32[:, :, ::1], COLUMN, COLUMN, COLUMN)
SUMS = record(Sums, REAL, REAL, WHOLE, WHOLE, types.uint8[::1])
TERM = (types.int64, types.int64, types.boolean)
ROLE = record(Role, REAL, REAL, *TERM, types.int64, types.boolean, types.boolean, types.int64)
SAMPLES, NUMBERS = types.int32[::1], types.int32[::1]
NOISE, LIGHT = types.float32[:, ::1], types.float32[:, :, ::1]


@kernel()
def rung_of(samples):
    """The rung of a number of samples on the ladder: 0 for none or void, k for 16 · 2^(k - 1)."""
    rung = 0
    while samples >= 16:
        samples >>= 1
        rung += 1
    return rung


@kernel()
def add_light(light, m, role, transfer, row):
    """Add the ``light`` of a texel to its term's columns of a ``row``, or put it there; whether there is any.

    A light of one channel is that of all.
    """
    lit = False
    n = min(light.shape[2], role.width)
    for c in range(transfer.shape[1]):
        own = min(c, light.shape[1] - 1)
        for i in range(n):
            former = np.float32(0.0) if role.first else transfer[row, c, role.column + i]
            transfer[row, c, role.column + i] = light[m, own, i] + former
        for i in range(n, role.width if role.first else n):
            transfer[row, c, role.column + i] = 0.0
    for c in range(light.shape[1]):
        for i in range(light.shape[2]):
            lit |= light[m, c, i] != 0.0
    return lit


@kernel()
def variance_of(noise, m, gains):
    """Variance of the luminance in a part, at least a quarter of what even noise would be: see ``noise.deviation``."""
    total, even, last = 0.0, 0.0, np.float64(noise[m, noise.shape[1] - 1]) ** 2
    for j in range(noise.shape[1]):
        total += np.float64(noise[m, j]) ** 2 * gains[j]
        even += last * gains[j] / 4.0
    return max(total, even)


@kernel()
def mark_of(samples, lit, role):
    """What a part with so many ``samples`` says of a texel, ``lit`` or dark in it."""
    lacks = role.straight and samples == 0 and not lit
    marks = LIT if lit or not role.telling else 0
    return marks | (LACKING if lacks else 0) | (FEW if samples < role.fewest else 0) | (NEVER if samples == VOID else 0)


@kernel()
def sum_bits(bits, m):
    """The sum of a texel's numbers, taken by their ``bits`` (m, channels, n²) int32."""
    total = np.int64(0)
    for c in range(bits.shape[1]):
        for i in range(bits.shape[2]):
            total += bits[m, c, i]
    return total


@kernel(types.void(SAMPLES, NOISE, LIGHT, types.int32[:, :, ::1], ROLE, NUMBERS, ROWS, SUMS))
def add_part(samples, noise, light, bits, role, rows, into, sums):
    """Add one part of m texels to their ``rows`` (m,) in ``into``, and to their ``sums``.

    Of the part, ``samples`` (m,), ``noise`` (m, noises) and ``light`` (m, channels, n²), also as its ``bits``.
    """
    for m in range(len(samples)):
        lit = add_light(light, m, role, into.transfer, np.uint32(rows[m]))
        sums.variance[m] += variance_of(noise, m, role.gains)
        for c in range(light.shape[1]):
            sums.luminance[m] += light[m, c, 0] * role.weights[c]
        sums.rungs[m] += role.rung * rung_of(samples[m])
        sums.marks[m] |= mark_of(samples[m], lit, role)
        if samples[m] == 0:
            sums.shown[m] += sum_bits(bits, m)


@kernel()
def place_of(marks, row):
    """Where a texel with these ``marks`` is looked up: its ``row``, or why it has none."""
    if marks & NEVER:
        return VOID_ROW
    if marks & LACKING:
        return UNLIT
    return row if marks & (LIT | FEW) else BURIED_ROW


class Judge(NamedTuple):
    """What a look's lights are to its texels' errors, see ``bake.noise`` and ``bake.moments``.

    Of each term the first of its columns, ``firsts`` (terms,), how many they are, ``widths`` (terms,), and the
    ``squares`` (terms,) of band 0 of its light; of each two of them the ``powers`` (terms, terms, channels, channels,
    most n²), all in ``unit``. The least luminance that an error is held against is ``level``, the least deviation
    ``darkest``. Stamps are the rungs, and ``beyond`` times what bits are shown, by their remainder of ``checksums``.
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
JUDGE = record(Judge, WHOLE, WHOLE, REAL, POWERS, *[types.float64] * 3, types.int64, types.int64)


@kernel()
def second_moment(transfer, row, judge):
    """The mean square of one path's luminance over turns of the light: band 0 of Σ τ·q, see ``bake.moments``."""
    total, green = 0.0, transfer.shape[1] // 2
    for a in range(judge.firsts.shape[0]):
        total += judge.squares[a] * np.float64(transfer[row, green, judge.firsts[a]])
    return total


@kernel(any_order=True)
def product_of(transfer, row, judge, a, b):
    """E[(τ_a·Dℓ_a)(τ_b·Dℓ_b)] of two terms over turns D of the light, by their ``powers``: see ``bake.moments``."""
    total, first, other = 0.0, judge.firsts[a], judge.firsts[b]
    for c in range(transfer.shape[1]):
        for d in range(transfer.shape[1]):
            for i in range(min(judge.widths[a], judge.widths[b])):
                pair = np.float64(transfer[row, c, first + i]) * np.float64(transfer[row, d, other + i])
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


@kernel(types.void(NUMBERS, ROWS, SUMS, JUDGE, NUMBERS))
def judge_rows(rows, into, sums, judge, places):
    """Fill scatter, error and stamp of the ``rows`` (m,) in ``into``, whose parts were all added, from their ``sums``.

    ``places`` (m,) are set to the rows, or to UNLIT, VOID_ROW or BURIED_ROW of texels that have nothing to show.
    """
    for m in range(len(rows)):
        row = np.uint32(rows[m])
        wrong = math.sqrt(sums.variance[m])
        second = second_moment(into.transfer, row, judge)
        spread = max(second - mean_square(into.transfer, row, judge), 0.0) + LEAST_SPREAD * max(second, 0.0)
        into.scatter[row] = wrong / max(judge.unit * math.sqrt(spread), judge.darkest)
        into.error[row] = wrong / max(sums.luminance[m], judge.level)
        into.stamp[row] = sums.rungs[m] + judge.beyond * (sums.shown[m] % judge.checksums)
        places[m] = place_of(sums.marks[m], rows[m])
