"""Chunks: the cubes that the lattice's texels are kept in, and how a view numbers the texels that
it reads.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import COUNT_ARRAY, SINGLE_ARRAY, kernel, record
from isogi_core.kernels.shading.framebuffer import FINAL, FRAMEBUFFER, luminance
from isogi_core.kernels.shading.lattice import (
    CORNER_ROWS,
    LATTICE,
    UNLIT_ROW,
    base_texel,
    trilinear,
)
from isogi_core.kernels.shading.surface_points import PIXEL_ARRAY, POINT_ROWS

PLACE_ARRAY = types.uint32[::1]
SLOTS = types.int32[:, :, ::1]
WORD_ARRAY = types.uint32[::1]


@kernel()
def within(place, bits):
    """The last ``bits`` of a ``place``: where in its chunk a texel is, along one axis or counted
    through.
    """
    return np.int64(place) & ((1 << bits) - 1)


@kernel()
def borders(z, y, x, bits):
    """Along which axes (bit 0 is x, bit 1 is y, bit 2 is z) a texel is the last of its chunk."""
    last = (1 << bits) - 1
    return (
        int(within(x, bits) == last)
        | int(within(y, bits) == last) << 1
        | int(within(z, bits) == last) << 2
    )


@kernel()
def even_corner(z, y, x):
    """The corner whose indices are all even of the cell whose lowest texel is this; that of odd
    ones is opposite.
    """
    return np.int64(x & 1 | (y & 1) << 1 | (z & 1) << 2)


@kernel(types.void(LATTICE, POINT_ROWS, types.boolean, types.boolean[:, :, ::1]))
def touch_chunks(lattice, points, coarse, touched):
    """Set ``touched`` (chunks z, y, x) for each chunk that a point reads: all of its cell, or
    ``coarse`` texels.
    """
    bits = lattice.bits
    for m in range(points.shape[0]):
        z, y, x, _, _, _ = base_texel(lattice, points, m)
        k, j, i = np.int64(z) >> bits, np.int64(y) >> bits, np.int64(x) >> bits
        crossed = borders(z, y, x, bits)
        if coarse:
            even = even_corner(z, y, x)
            for c in (even & crossed, (7 - even) & crossed):
                touched[k + (c >> 2), j + ((c >> 1) & 1), i + (c & 1)] = True
            continue
        touched[k, j, i] = True
        if crossed:
            for c in range(1, 8):
                if c & crossed == c:
                    touched[k + (c >> 2), j + ((c >> 1) & 1), i + (c & 1)] = True


@kernel()
def row_of(slots, bits, z, y, x):
    """Place of a texel's row along x, among the rows of all touched chunks."""
    slot = np.int64(slots[z >> bits, y >> bits, x >> bits])
    return (slot << 2 * bits) + (within(z, bits) << bits) + within(y, bits)


@kernel()
def rows_around(slots, bits, z, y, x):
    """``row_of`` the four rows of a lattice cell, y faster than z: from its own chunk where all are
    in that.
    """
    r = row_of(slots, bits, z, y, x)
    last = (1 << bits) - 1
    if within(z, bits) < last and within(y, bits) < last:
        return r, r + 1, r + last + 1, r + last + 2
    return (
        r,
        row_of(slots, bits, z, y + 1, x),
        row_of(slots, bits, z + 1, y, x),
        row_of(slots, bits, z + 1, y + 1, x),
    )


@kernel()
def row_of_corner(slots, bits, z, y, x, c):
    """``row_of`` corner ``c`` of a lattice cell, and the corner's place in that row."""
    x += np.uint32(c & 1)
    return row_of(slots, bits, z + np.uint32(c >> 2), y + np.uint32(c >> 1 & 1), x), within(x, bits)


@kernel(types.void(LATTICE, POINT_ROWS, types.boolean, SLOTS, WORD_ARRAY))
def mark_texels(lattice, points, coarse, slots, read):
    """Set in ``read`` (slots · rows,), a bit for each texel of a row, those that a point reads.

    They are all eight of its cell, or the two ``coarse`` ones: see ``find_coarse_corners``.
    ``slots`` (z, y, x) numbers the touched chunks. Threads each need a ``read`` of their own.
    """
    bits = lattice.bits
    last = (1 << bits) - 1
    for m in range(points.shape[0]):
        z, y, x, _, _, _ = base_texel(lattice, points, m)
        if coarse:
            even = even_corner(z, y, x)
            for c in (even, 7 - even):
                r, i = row_of_corner(slots, bits, z, y, x, c)
                read[r] |= np.uint32(1) << np.uint32(i)
            continue
        i = within(x, bits)
        for r in rows_around(slots, bits, z, y, x):
            read[r] |= np.uint32((3 if i < last else 1) << i)
        if i == last:
            for r in rows_around(slots, bits, z, y, x + 1):
                read[r] |= np.uint32(1)


@kernel()
def ones(word):
    """Bits that are set in a ``word`` of 32; sums of pairs of bits, then of fours, of bytes, and of
    all.
    """
    pairs = word - (word >> np.uint32(1) & np.uint32(0x55555555))
    fours = (pairs & np.uint32(0x33333333)) + (pairs >> np.uint32(2) & np.uint32(0x33333333))
    return (
        (fours + (fours >> np.uint32(4)) & np.uint32(0x0F0F0F0F)) * np.uint32(0x01010101)
        & np.uint32(0xFFFFFFFF)
    ) >> np.uint32(24)


@kernel()
def number_in_row(read, first, r, i):
    """The view's own number of the texel at place ``i`` of row ``r``, or of the next one there that
    it reads.
    """
    return first[r] + np.uint32(ones(read[r] & ((np.uint32(1) << np.uint32(i)) - np.uint32(1))))


@kernel(types.void(LATTICE, POINT_ROWS, SLOTS, WORD_ARRAY, PLACE_ARRAY, CORNER_ROWS))
def find_corners(lattice, points, slots, read, first, corners):
    """Fill ``corners`` (points, 8), x fastest, with the view's own numbers of the texels.

    Texels are numbered row by row as ``mark_texels`` left them in ``read``; ``first`` (slots ·
    rows,) is the number of each row's first.
    """
    bits = lattice.bits
    for m in range(points.shape[0]):
        z, y, x, _, _, _ = base_texel(lattice, points, m)
        i = within(x, bits)
        for c, r in enumerate(rows_around(slots, bits, z, y, x)):
            number = number_in_row(read, first, r, i)
            corners[m, 2 * c] = number
            corners[m, 2 * c + 1] = number + 1
        if i == (1 << bits) - 1:
            for c, r in enumerate(rows_around(slots, bits, z, y, x + 1)):
                corners[m, 2 * c + 1] = first[r]


@kernel()
def is_nearer(c, corner):
    """Whether corner ``c`` of a cell is nearer to this ``corner`` than to that opposite to it."""
    apart = c ^ corner
    return (apart & 1) + (apart >> 1 & 1) + (apart >> 2) < 2


@kernel(types.void(LATTICE, POINT_ROWS, SLOTS, WORD_ARRAY, PLACE_ARRAY, CORNER_ROWS))
def find_coarse_corners(lattice, points, slots, read, first, corners):
    """Find corners of a view that reads the lattice coarsely: two texels of each cell stand for
    all.

    They are the corners whose indices are all even or all odd (``view_texels.first_texels``), each
    for the four corners that are nearer to it.
    """
    bits = lattice.bits
    numbers = np.empty(2, np.uint32)
    for m in range(points.shape[0]):
        z, y, x, _, _, _ = base_texel(lattice, points, m)
        even = even_corner(z, y, x)
        for n, c in enumerate((even, 7 - even)):
            r, i = row_of_corner(slots, bits, z, y, x, c)
            numbers[n] = number_in_row(read, first, r, i)
        for c in range(8):
            if is_nearer(c, even):
                corners[m, c] = numbers[0]
            else:
                corners[m, c] = numbers[1]


@kernel(types.void(LATTICE, types.int64, types.int64, WORD_ARRAY, PLACE_ARRAY, PLACE_ARRAY))
def find_places(lattice, begin, end, read, first, places):
    """Write to ``places`` (texels,) where the texels of the rows ``begin`` … ``end`` are.

    A place is that of its chunk among the slots times the texels of a chunk, and the offset in it.
    """
    for r in range(begin, end):
        word = int(read[r])
        place = r << lattice.bits
        number = first[r]
        while word:
            if word & 1:
                places[number] = place
                number += 1
            word >>= 1
            place += 1


@kernel()
def visible_error(framebuffer, pixel):
    """(luminance · error)² of a pixel, which is how wrong it looks; 0 where it is final."""
    if framebuffer.state[pixel] == FINAL:
        return 0.0
    light = (
        framebuffer.radiance[pixel, 0],
        framebuffer.radiance[pixel, 1],
        framebuffer.radiance[pixel, 2],
    )
    return np.float64(luminance(*light) * framebuffer.error[pixel]) ** 2


@kernel()
def is_new(places, corners, m, c, bits):
    """Whether the chunk of corner ``c`` of point ``m`` is not that of one before."""
    for d in range(c):
        if places[corners[m, d]] >> bits == places[corners[m, c]] >> bits:
            return False
    return True


@kernel(
    types.void(
        LATTICE,
        CORNER_ROWS,
        PLACE_ARRAY,
        PIXEL_ARRAY,
        types.int64,
        types.int64,
        FRAMEBUFFER,
        types.float64[::1],
    )
)
def weigh_chunks(lattice, corners, places, pixels, width, height, framebuffer, weight):
    """Add to ``weight`` (chunks,) the ``visible_error`` of the points that read each chunk.

    It counts twice in the middle of the picture, and once in its corners.
    """
    bits = 3 * lattice.bits
    for m in range(corners.shape[0]):
        wrong = visible_error(framebuffer, pixels[m])
        if wrong == 0.0:
            continue
        y, x = divmod(np.int64(pixels[m]), width)
        wrong *= 2.0 - 0.5 * (((2 * x + 1) / width - 1.0) ** 2 + ((2 * y + 1) / height - 1.0) ** 2)
        first = places[corners[m, 0]] >> bits
        weight[first] += wrong
        if places[corners[m, 7]] >> bits != first:  # opposite corners
            for c in range(1, 8):
                if is_new(places, corners, m, c, bits):
                    weight[places[corners[m, c]] >> bits] += wrong


class Pages(NamedTuple):
    """Where a pool keeps light: the ``table`` (slots, texels of a chunk) of rows, int32, and of
    each row its relative ``error`` and its ``stamp``, float32, which says how far it is baked.
    """

    table: Any
    error: Any
    stamp: Any


PAGES = record(Pages, types.int32[:, ::1], SINGLE_ARRAY, SINGLE_ARRAY)


@kernel(
    types.void(LATTICE, PLACE_ARRAY, COUNT_ARRAY, PAGES, COUNT_ARRAY, SINGLE_ARRAY, SINGLE_ARRAY)
)
def find_rows(lattice, places, slots, pages, rows, error, stamp):
    """Where the light of the texels at ``places`` is kept, and how far it is baked; all outputs
    (texels,).

    ``slots`` (chunks of the view,) leads to the pages' table, -1 where a chunk is absent; texels
    without light get UNLIT_ROW, VOID_ROW or BURIED_ROW for their ``rows`` and their ``stamp``.
    """
    bits = 3 * lattice.bits
    for t in range(places.shape[0]):
        slot = slots[places[t] >> bits]
        if slot >= 0:
            row = pages.table[slot, within(places[t], bits)]
        else:
            row = UNLIT_ROW
        rows[t] = row
        error[t] = pages.error[row] if row >= 0 else 0.0
        stamp[t] = pages.stamp[row] if row >= 0 else row


@kernel(types.void(LATTICE, POINT_ROWS, CORNER_ROWS, types.float64[::1]))
def add_footprints(lattice, points, corners, seen):
    """Add to ``seen`` (texels,) the squares of a texel's shares in the points; ``corners`` (points,
    8), x fastest.

    Shares are those of ``carry_light`` where all texels hold light: their noises are independent,
    and so a point's variance is the sum of w² times theirs. Where ``carry_ratios`` weighs them by
    normals too they are near enough, as footprints say what to bake first and no more.
    """
    for m in range(points.shape[0]):
        _, _, _, fz, fy, fx = base_texel(lattice, points, m)
        for c in range(8):
            seen[corners[m, c]] += trilinear(c, fz, fy, fx) ** 2
