"""Filtering of light that converges: a texel of few paths takes over what its neighbours on the
surface agree on.

An à-trous filter (Dammertz and others 2010) over the texels of a view: each pass looks at the 3 × 3
× 3 texels about one, the second at twice the distance. As between texels and pixels, direct light
is filtered as a ratio to unshadowed light, Σ w D / Σ w U, and reflected light as it is. How far a
texel follows is Wiener's (Lee 1980): where the neighbours differ by no more than their noise it
follows them, where they differ by more it stays. A texel without light has that of its neighbours,
with as much error as they differ by. Final light is left as it is.
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
"""Where a record has how many samples a texel took, and the variance of its own light's luminance,
for filtering.
"""

DISTANCE_WEIGHTS = np.exp(np.arange(4, dtype=np.float32) / np.float32(-2.0))
"""What a neighbour counts by its squared distance, 0 … 3, in steps: a Gauss curve of a step's
width.
"""

SHARED_VARIANCE_FACTOR = np.float32(27 / 8)
"""How much more the variance that neighbours share counts in pixels than the variance of one
texel's noise.

Pixels mix eight texels with trilinear weights, whose squares sum up to (2/3)³ in the mean over a
cell: to so little of a texel's own variance. What all of them took over from the same neighbours
does not average out.
"""

LENDS = np.float32(1e-4)
"""What neighbours count together at least that lend their light: one next to it whose normal is 54°
away does.
"""

ZERO_F32 = np.float32(0.0)
ONE_F32 = np.float32(1.0)


class Numbering(NamedTuple):
    """How a view numbers its texels: ``slots`` (chunks z, y, x) of the chunks it touches, -1
    elsewhere, and of each row along x which of its texels are ``read``, a bit for each, and the
    number of the ``first``; (slots · rows,).
    """

    slots: Any
    read: Any
    first: Any


NUMBERING = record(Numbering, SLOTS, WORD_ARRAY, WORD_ARRAY)


@kernel()
def row_at(numbering, bits, z, y, x):
    """The row of the texel at (z, y, x); -1 in chunks that the view does not touch, and outside the
    lattice.
    """
    slots = numbering.slots
    k, j, i = (
        np.uint64(z >> bits),
        np.uint64(y >> bits),
        np.uint64(x >> bits),
    )  # what is negative becomes huge
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
    """The view's own number of the texel at a ``place`` in a row; -1 where it reads none there."""
    row = np.uint64(row)
    word = np.uint32(numbering.read[row])
    if not word >> np.uint32(place) & np.uint32(1):
        return -1
    before = word & ((np.uint32(1) << np.uint32(place)) - np.uint32(1))
    return np.int64(numbering.first[row]) + np.int64(ones(before))


@kernel(inline=True)
def likeness(texels, t, s):
    """What texel ``s`` counts for ``t`` by the cosine between their normals: its 16th power, half
    at 17°.
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
    """Fill ``found`` (27,) with the lit texels about the one ``at`` (t, z, y, x), and what they
    count in ``weights``.

    They are those of 3 × 3 × 3, a ``step`` apart. Returns how many there are, itself among them.
    """
    t, z, y, x = at
    count = 0
    inside = step <= within(x, bits) < (1 << bits) - step
    for k in range(-1, 2):
        for j in range(-1, 2):
            row = row_at(numbering, bits, z + k * step, y + j * step, x)
            if inside and row < 0:
                continue
            for i in range(-1, 2):
                if inside:
                    own = row
                else:
                    own = row_at(numbering, bits, z + k * step, y + j * step, x + i * step)
                if own >= 0:
                    number = number_of(numbering, own, within(x + i * step, bits))
                else:
                    number = -1
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
    """Neighbours' direct light over unshadowed light, their reflected light, and the variance of
    both's luminance.

    They count by their samples too.
    """
    direct = bare = reflected = (ZERO_F32, ZERO_F32, ZERO_F32)
    total = MIN_LIGHT
    variance = ZERO_F32
    for n in range(np.uint64(count)):
        s = np.uint64(found[n])
        w = weights[n] * texels[s, PATHS_COLUMN]
        direct = (
            direct[0] + w * texels[s, 0],
            direct[1] + w * texels[s, 1],
            direct[2] + w * texels[s, 2],
        )
        bare = (
            bare[0] + w * texels[s, UNSHADOWED_COLUMN],
            bare[1] + w * texels[s, UNSHADOWED_COLUMN + 1],
            bare[2] + w * texels[s, UNSHADOWED_COLUMN + 2],
        )
        r = texels[s, REFLECTED_COLUMN]
        g = texels[s, REFLECTED_COLUMN + 1]
        b = texels[s, REFLECTED_COLUMN + 2]
        reflected = reflected[0] + w * r, reflected[1] + w * g, reflected[2] + w * b
        total = total + w
        variance = variance + w * w * texels[s, VARIANCE_COLUMN]
    ratio = (
        direct[0] / max(bare[0], MIN_LIGHT),
        direct[1] / max(bare[1], MIN_LIGHT),
        direct[2] / max(bare[2], MIN_LIGHT),
    )
    return (
        ratio,
        (reflected[0] / total, reflected[1] / total, reflected[2] / total),
        variance / (total * total),
    )


@kernel(inline=True)
def expected(texels, s, ratio, reflected):
    """The light of texel ``s`` by the ``ratio`` and the ``reflected`` light of its neighbours;
    linear RGB, twice.
    """
    direct = (
        ratio[0] * texels[s, UNSHADOWED_COLUMN],
        ratio[1] * texels[s, UNSHADOWED_COLUMN + 1],
        ratio[2] * texels[s, UNSHADOWED_COLUMN + 2],
    )
    return direct, reflected


@kernel()
def differences(texels, found, weights, count, ratio, reflected):
    """Sums over a texel's neighbours: of noise-free variance, of noise, and of what they count.

    Variance is that of the luminance about what is ``expected``; what noise explains of it is taken
    off. The noise is that of all of them, as a few paths may agree by chance and show none.
    """
    apart = ZERO_F32
    noise = ZERO_F32
    total = MIN_LIGHT
    for n in range(np.uint64(count)):
        s = np.uint64(found[n])
        w = weights[n]
        direct, around = expected(texels, s, ratio, reflected)
        r = texels[s, 0] + texels[s, REFLECTED_COLUMN] - direct[0] - around[0]
        g = texels[s, 1] + texels[s, REFLECTED_COLUMN + 1] - direct[1] - around[1]
        b = texels[s, 2] + texels[s, REFLECTED_COLUMN + 2] - direct[2] - around[2]
        difference = luminance(r, g, b)
        apart = apart + w * difference * difference
        noise = noise + w * texels[s, VARIANCE_COLUMN]
        total = total + w
    return max(apart - noise, ZERO_F32), noise, total


@kernel()
def mean_paths(texels, found, weights, count):
    """How many samples a texel's neighbours took, in the mean."""
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
    """Write to ``filtered`` (texels, RECORD_LENGTH) the records ``texels``, from the ``first`` on
    one for each position.

    ``positions`` (m, 3; z, y, x) are those texels' own, ``step`` is the distance between
    neighbours. Their VARIANCE_COLUMN is what is left of it, and NOISE_COLUMN the part of it that
    pixels report. Those without light are CONVERGING once they have that of two neighbours, which
    count LENDS at least.
    """
    found = np.empty(27, np.uint32)
    weights = np.empty(27, np.float32)
    for m in range(positions.shape[0]):
        t = np.uint64(first + m)
        for c in range(RECORD_LENGTH):
            filtered[t, c] = texels[t, c]
        unlit = texels[t, GRADE_COLUMN] == UNBAKED_GRADE
        if texels[t, GRADE_COLUMN] != CONVERGING and not unlit:
            continue
        at = t, np.int64(positions[m, 0]), np.int64(positions[m, 1]), np.int64(positions[m, 2])
        count = neighbours_of(numbering, bits, texels, at, step, found, weights)
        if count < 2:
            continue
        ratio, reflected, variance = mean_of(texels, found, weights, count)
        signal, noise, total = differences(texels, found, weights, count, ratio, reflected)
        if unlit and total < LENDS:
            continue
        if unlit:
            own = ZERO_F32
        else:
            own = signal / max(signal + noise, MIN_LIGHT)
        direct, around = expected(texels, t, ratio, reflected)
        for c in range(3):
            filtered[t, DIRECT_COLUMN + c] = (
                own * texels[t, DIRECT_COLUMN + c] + (ONE_F32 - own) * direct[c]
            )
            filtered[t, REFLECTED_COLUMN + c] = (
                own * texels[t, REFLECTED_COLUMN + c] + (ONE_F32 - own) * around[c]
            )
        if unlit:
            kept = signal / total
        else:
            kept = own * (noise / total)
        taken = (ONE_F32 - own) ** 2 * variance
        if unlit:
            filtered[t, GRADE_COLUMN] = CONVERGING
            filtered[t, PATHS_COLUMN] = mean_paths(texels, found, weights, count)
        filtered[t, VARIANCE_COLUMN] = kept + taken
        filtered[t, NOISE_COLUMN] = math.sqrt(kept + SHARED_VARIANCE_FACTOR * taken)


@kernel(
    types.void(
        TEXEL_RECORDS, types.boolean[::1], GRADE_ARRAY, TEXEL_RECORDS, GRADE_ARRAY, TEXEL_RECORDS
    )
)
def take_filtered(records, noisy, grade, lit, graded, filtered):
    """Fill ``filtered`` (texels, LIGHT_NUMBERS) with the light of the ``records`` where it is
    ``noisy`` (texels,), or where there was none and now is; with ``lit`` elsewhere. ``graded``
    (texels,) is ``grade``, in which the latter are CONVERGING.
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
    """Write to ``lent`` the light of texels without any: the mean of the others in a cell of
    theirs, the last such.

    ``corners`` (cells, 8) number the texels of each cell, which have ``grade`` (texels,) and
    ``lit`` (texels, values). ``graded`` and ``lent`` are copies of these; texels that are lent
    light are CONVERGING there.
    """
    mean = np.empty(lit.shape[1], np.float32)
    for cell in corners:
        lenders = ZERO_F32
        unlit = False
        mean[:] = ZERO_F32
        for t in cell:
            unlit = unlit or grade[t] == UNBAKED_GRADE
            if CONVERGING <= grade[t] <= FINAL:
                lenders += ONE_F32
                for c in range(mean.shape[0]):
                    mean[c] += lit[t, c]
        if unlit and lenders > ZERO_F32:
            for t in cell:
                if grade[t] == UNBAKED_GRADE:
                    graded[t] = CONVERGING
                    for c in range(mean.shape[0]):
                        lent[t, c] = mean[c] / lenders
