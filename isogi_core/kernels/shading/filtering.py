"""Filtering of converging light: texels of few samples are mixed with their neighbours on the
surface.

This is an à-trous filter (Dammertz et al. 2010) over the texels of a view: each pass reads the 3 ×
3 × 3 texels around one, the second pass at twice the distance. Direct light is averaged as a ratio
to unshadowed light, Σ w D / Σ w U, as between texels and pixels; reflected light is averaged as it
is.

The mix of a texel's light and the mean around it is Wiener's (Lee 1980): if the neighbours differ
by no more than their noise explains, the mean replaces the light; the more they differ beyond it,
the more of the texel's light is kept. A texel without light takes the mean, with the scatter of its
neighbours as its error. Final light is not changed.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel, record
from isogi_core.kernels.shading.chunks import SLOTS, WORD_ARRAY, ones, within
from isogi_core.kernels.shading.framebuffer import CONVERGING, FINAL, luminance
from isogi_core.kernels.shading.irradiance_ratio import (
    DIRECT_COLUMN,
    GRADE_COLUMN,
    NOISE_COLUMN,
    NORMAL_COLUMN,
    RECORD_LENGTH,
    REFLECTED_COLUMN,
    TEXEL_RECORDS,
    UNSHADOWED_COLUMN,
)
from isogi_core.kernels.shading.lattice import (
    CORNER_ROWS,
    GRADE_ARRAY,
    LIGHT_NUMBERS,
    MIN_LIGHT,
    UNBAKED_GRADE,
)
from isogi_core.kernels.transport.transfer import TEXEL_PLACES

PATHS_COLUMN = 14
VARIANCE_COLUMN = 15
"""Columns of a texel's record that the filter alone reads: the number of samples, and the
variance of the luminance of the texel's light.
"""

DISTANCE_WEIGHTS = np.exp(np.arange(4, dtype=np.float32) / np.float32(-2.0))
"""Weight of a neighbour by its squared distance, 0 … 3, in steps: a Gaussian with a standard
deviation of one step.
"""

SHARED_VARIANCE_FACTOR = np.float32(27 / 8)
"""Factor by which variance that neighbours share counts in pixels, relative to that of independent
noise.

Pixels mix eight texels with trilinear weights, the mean of whose sum of squares over a cell is
(2/3)³ = 8/27: independent noise falls by this factor. Light that all eight took from the same
neighbours does not average out, and therefore counts 27/8 times as much.
"""

MIN_LENDING_WEIGHT = np.float32(1e-4)
"""Least total weight of the neighbours of a texel without light, for it to take their mean. One
neighbour at distance 1 whose normal is 54° away reaches it.
"""

ZERO_F32 = np.float32(0.0)
ONE_F32 = np.float32(1.0)


class Numbering(NamedTuple):
    """Numbers of the texels that a view reads: they are counted row by row, rows run along x.

    ``slots`` (chunks z, y, x) numbers the chunks that the view touches, -1 elsewhere. ``read`` and
    ``first`` (slots · rows,) hold, for each row of these chunks, a bit for each texel that the view
    reads, and the number of the first of them.
    """

    slots: Any
    read: Any
    first: Any


NUMBERING = record(Numbering, SLOTS, WORD_ARRAY, WORD_ARRAY)


@kernel()
def row_at(numbering, bits, z, y, x):
    """Return the row of the texel at (z, y, x); -1 in chunks that the view does not touch, and
    outside the lattice.
    """
    slots = numbering.slots
    # Negative indices wrap around to huge unsigned ones, so that one comparison tests both bounds.
    k, j, i = (
        np.uint64(z >> bits),
        np.uint64(y >> bits),
        np.uint64(x >> bits),
    )
    if (
        k >= np.uint64(slots.shape[0])
        or j >= np.uint64(slots.shape[1])
        or i >= np.uint64(slots.shape[2])
    ):
        return -1
    slot = np.int64(slots[k, j, i])
    if slot >= 0:
        return (slot << 2 * bits) + (within(z, bits) << bits) + within(y, bits)
    return -1


@kernel(inline=True)
def number_of(numbering, row, place):
    """Return the view's number of the texel at ``place`` in a ``row``;
    -1 if the view does not read it.
    """
    row = np.uint64(row)
    word = np.uint32(numbering.read[row])
    if not word >> np.uint32(place) & np.uint32(1):
        return -1
    # Its number is that of the row's first texel plus the number of set bits below its place.
    before = word & ((np.uint32(1) << np.uint32(place)) - np.uint32(1))
    return np.int64(numbering.first[row]) + np.int64(ones(before))


@kernel(inline=True)
def likeness(texels, t, s):
    """Return the weight of texel ``s`` for texel ``t`` by the cosine c between their normals:
    c¹⁶, which is a half at 17°.
    """
    cosine = texels[t, NORMAL_COLUMN] * texels[s, NORMAL_COLUMN]
    cosine += (
        texels[t, NORMAL_COLUMN + 1] * texels[s, NORMAL_COLUMN + 1]
        + texels[t, NORMAL_COLUMN + 2] * texels[s, NORMAL_COLUMN + 2]
    )
    square = max(cosine, ZERO_F32) ** 2
    return square**2 * square**2 * (square**2 * square**2)


@kernel()
def neighbours_of(numbering, bits, texels, at, step, found, weights):
    """List in ``found`` (27,) the lit texels among the 3 × 3 × 3 around the one at ``at`` = (t, z,
    y, x), a ``step`` apart, and their weights in ``weights``.

    Weights are DISTANCE_WEIGHTS times ``likeness``. Returns the number of texels found, texel t
    included if it is lit.
    """
    t, z, y, x = at
    count = 0
    # If all three texels along x lie in one chunk, their row is looked up once.
    inside = step <= within(x, bits) < (1 << bits) - step
    for k in range(-1, 2):
        for j in range(-1, 2):
            row = row_at(numbering, bits, z + k * step, y + j * step, x)
            if inside and row < 0:
                continue
            for i in range(-1, 2):
                if inside:
                    texel_row = row
                else:
                    texel_row = row_at(numbering, bits, z + k * step, y + j * step, x + i * step)
                if texel_row >= 0:
                    number = number_of(numbering, texel_row, within(x + i * step, bits))
                else:
                    number = -1
                # Count texels with light whose weight is not zero.
                s = np.uint64(max(number, 0))
                if number >= 0 and CONVERGING <= texels[s, GRADE_COLUMN] <= FINAL:
                    weight = DISTANCE_WEIGHTS[k * k + j * j + i * i] * likeness(texels, t, s)
                    if weight > ZERO_F32:
                        found[count] = s
                        weights[count] = weight
                        count += 1
    return count


@kernel()
def mean_of(texels, found, weights, count):
    """Return the mean light of ``count`` neighbours: the ratio of direct to unshadowed light,
    reflected light, and the variance of the luminance of both.

    Neighbours count by ``weights`` times their numbers of samples.
    """
    direct = unshadowed = reflected = (ZERO_F32, ZERO_F32, ZERO_F32)
    total = MIN_LIGHT
    variance = ZERO_F32
    for n in range(np.uint64(count)):
        s = np.uint64(found[n])
        # Sum direct, unshadowed and reflected light apart; weights enter the variance as squares.
        w = weights[n] * texels[s, PATHS_COLUMN]
        direct = (
            direct[0] + w * texels[s, 0],
            direct[1] + w * texels[s, 1],
            direct[2] + w * texels[s, 2],
        )
        unshadowed = (
            unshadowed[0] + w * texels[s, UNSHADOWED_COLUMN],
            unshadowed[1] + w * texels[s, UNSHADOWED_COLUMN + 1],
            unshadowed[2] + w * texels[s, UNSHADOWED_COLUMN + 2],
        )
        r = texels[s, REFLECTED_COLUMN]
        g = texels[s, REFLECTED_COLUMN + 1]
        b = texels[s, REFLECTED_COLUMN + 2]
        reflected = reflected[0] + w * r, reflected[1] + w * g, reflected[2] + w * b
        total = total + w
        variance = variance + w * w * texels[s, VARIANCE_COLUMN]
    # Divide sums, and not texel by texel: texels with little unshadowed light count less.
    ratio = (
        direct[0] / max(unshadowed[0], MIN_LIGHT),
        direct[1] / max(unshadowed[1], MIN_LIGHT),
        direct[2] / max(unshadowed[2], MIN_LIGHT),
    )
    return (
        ratio,
        (reflected[0] / total, reflected[1] / total, reflected[2] / total),
        variance / (total * total),
    )


@kernel(inline=True)
def expected(texels, s, ratio, reflected):
    """Return direct and reflected light, linear RGB, of texel ``s`` if it had the mean
    ``ratio`` and ``reflected`` light of its neighbours.
    """
    direct = (
        ratio[0] * texels[s, UNSHADOWED_COLUMN],
        ratio[1] * texels[s, UNSHADOWED_COLUMN + 1],
        ratio[2] * texels[s, UNSHADOWED_COLUMN + 2],
    )
    return direct, reflected


@kernel()
def differences(texels, found, weights, count, ratio, reflected):
    """Return three sums over a texel's ``count`` neighbours: of squared differences beyond noise,
    at least 0; of noise; and of the ``weights``, by which both are weighted.

    A difference is that of a neighbour's luminance from its ``expected`` light. The noise is the
    variance of its luminance. Noise is summed over all neighbours before it is subtracted, as the
    few paths of one neighbour may agree by chance and show none.
    """
    scatter = ZERO_F32
    noise = ZERO_F32
    total = MIN_LIGHT
    for n in range(np.uint64(count)):
        s = np.uint64(found[n])
        w = weights[n]
        direct, around = expected(texels, s, ratio, reflected)
        # Compare the luminance of the neighbour with that expected from the mean.
        r = texels[s, 0] + texels[s, REFLECTED_COLUMN] - direct[0] - around[0]
        g = texels[s, 1] + texels[s, REFLECTED_COLUMN + 1] - direct[1] - around[1]
        b = texels[s, 2] + texels[s, REFLECTED_COLUMN + 2] - direct[2] - around[2]
        difference = luminance(r, g, b)
        scatter = scatter + w * difference * difference
        noise = noise + w * texels[s, VARIANCE_COLUMN]
        total = total + w
    return max(scatter - noise, ZERO_F32), noise, total


@kernel()
def mean_paths(texels, found, weights, count):
    """Return the weighted mean of the numbers of samples of a texel's neighbours."""
    paths = ZERO_F32
    total = MIN_LIGHT
    for n in range(np.uint64(count)):
        s = np.uint64(found[n])
        w = weights[n]
        paths = paths + w * texels[s, PATHS_COLUMN]
        total = total + w
    return paths / total


@kernel(
    types.void(
        NUMBERING, types.int64, TEXEL_PLACES, types.int64, types.int64, TEXEL_RECORDS, TEXEL_RECORDS
    )
)
def filter_texels(numbering, bits, positions, first, step, texels, filtered):
    """Filter the records ``texels`` from number ``first`` on, one for each position, into
    ``filtered`` (texels, RECORD_LENGTH).

    ``positions`` (m, 3; z, y, x) are the lattice indices of those texels; ``step`` is the distance
    between neighbours, in texels. In the output, VARIANCE_COLUMN is the variance after filtering,
    and NOISE_COLUMN the standard error that pixels report, in which shared variance counts more
    (see SHARED_VARIANCE_FACTOR). Texels without light become CONVERGING if at least two neighbours,
    of total weight MIN_LENDING_WEIGHT or more, have light.
    """
    found = np.empty(27, np.uint32)
    weights = np.empty(27, np.float32)
    for m in range(positions.shape[0]):
        t = np.uint64(first + m)
        for c in range(RECORD_LENGTH):
            filtered[t, c] = texels[t, c]
        # Leave final, void and buried texels as they are.
        unlit = texels[t, GRADE_COLUMN] == UNBAKED_GRADE
        if texels[t, GRADE_COLUMN] != CONVERGING and not unlit:
            continue
        # Find the neighbours, their mean light, and how much they differ beyond their noise.
        at = t, np.int64(positions[m, 0]), np.int64(positions[m, 1]), np.int64(positions[m, 2])
        count = neighbours_of(numbering, bits, texels, at, step, found, weights)
        if count < 2:
            continue
        ratio, reflected, variance = mean_of(texels, found, weights, count)
        signal, noise, total = differences(texels, found, weights, count, ratio, reflected)
        if unlit and total < MIN_LENDING_WEIGHT:
            continue
        # Wiener's weight of the texel's light: signal / (signal + noise).
        if unlit:
            kept_share = ZERO_F32
        else:
            kept_share = signal / max(signal + noise, MIN_LIGHT)
        # Mix the texel's light with the light expected from its neighbours.
        direct, around = expected(texels, t, ratio, reflected)
        for c in range(3):
            filtered[t, DIRECT_COLUMN + c] = (
                kept_share * texels[t, DIRECT_COLUMN + c] + (ONE_F32 - kept_share) * direct[c]
            )
            filtered[t, REFLECTED_COLUMN + c] = (
                kept_share * texels[t, REFLECTED_COLUMN + c] + (ONE_F32 - kept_share) * around[c]
            )
        # Add the variance that is left of the texel's light to that of the neighbours' mean. By
        # Wiener's mix a lit texel keeps the kept share of its noise; light that was only taken is
        # as uncertain as neighbours differ.
        if unlit:
            variance_left = signal / total
        else:
            variance_left = kept_share * (noise / total)
        variance_taken = (ONE_F32 - kept_share) ** 2 * variance
        if unlit:
            filtered[t, GRADE_COLUMN] = CONVERGING
            filtered[t, PATHS_COLUMN] = mean_paths(texels, found, weights, count)
        filtered[t, VARIANCE_COLUMN] = variance_left + variance_taken
        filtered[t, NOISE_COLUMN] = math.sqrt(
            variance_left + SHARED_VARIANCE_FACTOR * variance_taken
        )


@kernel(
    types.void(
        TEXEL_RECORDS, types.boolean[::1], GRADE_ARRAY, TEXEL_RECORDS, GRADE_ARRAY, TEXEL_RECORDS
    )
)
def take_filtered(records, noisy, grade, lit, graded, filtered):
    """Fill ``filtered`` (texels, LIGHT_NUMBERS) with the light of the filtered ``records`` for
    texels that are ``noisy`` (texels,) or newly lit, and with ``lit`` for the others.

    ``graded`` (texels,) becomes ``grade``, but CONVERGING for texels that had no light and got some
    from the filter.
    """
    for t in range(lit.shape[0]):
        new = grade[t] == UNBAKED_GRADE and records[t, GRADE_COLUMN] == CONVERGING
        graded[t] = CONVERGING if new else grade[t]
        for c in range(LIGHT_NUMBERS):
            filtered[t, c] = lit[t, c]
        if noisy[t] or new:
            filtered[t, 3] = records[t, NOISE_COLUMN]
            for c in range(3):
                filtered[t, c] = records[t, DIRECT_COLUMN + c] + records[t, REFLECTED_COLUMN + c]
                filtered[t, 4 + c] = records[t, REFLECTED_COLUMN + c]


@kernel(types.void(CORNER_ROWS, GRADE_ARRAY, TEXEL_RECORDS, GRADE_ARRAY, TEXEL_RECORDS))
def lend_texels(corners, grade, lit, graded, lent):
    """Give each texel without light the mean light of the lit texels in a cell around it.

    ``corners`` (cells, 8) number the texels of each cell, one cell for each point of the view; if
    several cells of a texel have lit corners, the last one counts. ``grade`` (texels,) and ``lit``
    (texels, values) are read. ``graded`` and ``lent`` start as copies of these; texels that get
    light become CONVERGING there.
    """
    mean = np.empty(lit.shape[1], np.float32)
    for cell in corners:
        # Average the lit corners of the cell.
        lenders = ZERO_F32
        unlit = False
        mean[:] = ZERO_F32
        for t in cell:
            unlit = unlit or grade[t] == UNBAKED_GRADE
            if CONVERGING <= grade[t] <= FINAL:
                lenders += ONE_F32
                for c in range(mean.shape[0]):
                    mean[c] += lit[t, c]
        # Write the mean to the corners without light.
        if unlit and lenders > ZERO_F32:
            for t in cell:
                if grade[t] == UNBAKED_GRADE:
                    graded[t] = CONVERGING
                    for c in range(mean.shape[0]):
                        lent[t, c] = mean[c] / lenders
