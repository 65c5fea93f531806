"""The chunks that a view touches, and the numbering of the texels that it reads.

A view numbers its texels 0 … m - 1, chunk by chunk and row by row, rows along x: ``touch_chunks``
finds the chunks, ``mark_texels`` sets a bit for each texel that a point reads, and ``find_corners``
turns the bits into numbers. A place is the slot of the texel's chunk times the texels of a chunk,
plus the offset in the chunk.
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
    """Return the last ``bits`` of a ``place``: the position of a texel in its chunk, along one
    axis or as an offset.
    """
    return np.int64(place) & ((1 << bits) - 1)


@kernel()
def borders(z, y, x, bits):
    """Return the axes along which a texel is the last of its chunk:
    bit 0 is x, bit 1 y, bit 2 z.
    """
    last = (1 << bits) - 1
    return (
        int(within(x, bits) == last)
        | int(within(y, bits) == last) << 1
        | int(within(z, bits) == last) << 2
    )


@kernel()
def even_corner(z, y, x):
    """Return the corner with all indices even, of the cell whose lowest texel is (z, y, x); the
    corner with all indices odd is the opposite one.
    """
    return np.int64(x & 1 | (y & 1) << 1 | (z & 1) << 2)


@kernel(types.void(LATTICE, POINT_ROWS, types.boolean, types.boolean[:, :, ::1]))
def touch_chunks(lattice, points, coarse, touched):
    """Set ``touched`` (chunks z, y, x) for each chunk that the ``points`` (m, 3) read: all
    eight texels of a point's cell, or the two ``coarse`` ones.
    """
    bits = lattice.bits
    for m in range(points.shape[0]):
        z, y, x, _, _, _ = base_texel(lattice, points, m)
        k, j, i = np.int64(z) >> bits, np.int64(y) >> bits, np.int64(x) >> bits
        # A corner lies in the next chunk along an axis if the cell's lowest texel is its chunk's
        # last.
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
    """Return the number of a texel's row along x, among the rows of all touched chunks."""
    slot = np.int64(slots[z >> bits, y >> bits, x >> bits])
    return (slot << 2 * bits) + (within(z, bits) << bits) + within(y, bits)


@kernel()
def rows_around(slots, bits, z, y, x):
    """Return ``row_of`` the four rows of a lattice cell, y faster than z."""
    # If all four lie in one chunk, one look-up gives them all.
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
    """Return ``row_of`` corner ``c`` of a lattice cell, and the corner's place in that row."""
    x += np.uint32(c & 1)
    return row_of(slots, bits, z + np.uint32(c >> 2), y + np.uint32(c >> 1 & 1), x), within(x, bits)


@kernel(types.void(LATTICE, POINT_ROWS, types.boolean, SLOTS, WORD_ARRAY))
def mark_texels(lattice, points, coarse, slots, read):
    """Set in ``read`` (slots · rows,) the bit of each texel that the ``points`` read, one word per
    row.

    These are all eight texels of a point's cell, or the two ``coarse`` ones: see
    ``find_coarse_corners``. A row is that of one chunk, so that it has 32 texels at most. ``slots``
    (z, y, x) numbers the touched chunks. Each thread needs its separate ``read``.
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
        # Set the bits of two neighbours along x in each of the four rows; the second may be in the
        # next chunk.
        i = within(x, bits)
        for r in rows_around(slots, bits, z, y, x):
            read[r] |= np.uint32((3 if i < last else 1) << i)
        if i == last:
            for r in rows_around(slots, bits, z, y, x + 1):
                read[r] |= np.uint32(1)


@kernel()
def ones(word):
    """Return the number of bits that are set in a 32-bit ``word``: sums of pairs of bits, of
    fours, of bytes, and of all (Warren, "Hacker's Delight", section 5-1).
    """
    pairs = word - (word >> np.uint32(1) & np.uint32(0x55555555))
    fours = (pairs & np.uint32(0x33333333)) + (pairs >> np.uint32(2) & np.uint32(0x33333333))
    return (
        (fours + (fours >> np.uint32(4)) & np.uint32(0x0F0F0F0F)) * np.uint32(0x01010101)
        & np.uint32(0xFFFFFFFF)
    ) >> np.uint32(24)


@kernel()
def number_in_row(read, first, r, i):
    """Return the view's number of the texel at place ``i`` of row ``r``, or of the next one
    that it reads there.
    """
    return first[r] + np.uint32(ones(read[r] & ((np.uint32(1) << np.uint32(i)) - np.uint32(1))))


@kernel(types.void(LATTICE, POINT_ROWS, SLOTS, WORD_ARRAY, PLACE_ARRAY, CORNER_ROWS))
def find_corners(lattice, points, slots, read, first, corners):
    """Fill ``corners`` (points, 8), x fastest, with the view's numbers of the texels around each
    point.

    ``read`` is as ``mark_texels`` left it; ``first`` (slots · rows,) is the number of each row's
    first texel.
    """
    bits = lattice.bits
    for m in range(points.shape[0]):
        z, y, x, _, _, _ = base_texel(lattice, points, m)
        i = within(x, bits)
        # Two neighbours along x in one row have consecutive numbers.
        for c, r in enumerate(rows_around(slots, bits, z, y, x)):
            number = number_in_row(read, first, r, i)
            corners[m, 2 * c] = number
            corners[m, 2 * c + 1] = number + 1
        # Replace the second if it is the first texel of a row in the next chunk.
        if i == (1 << bits) - 1:
            for c, r in enumerate(rows_around(slots, bits, z, y, x + 1)):
                corners[m, 2 * c + 1] = first[r]


@kernel()
def is_nearer(c, corner):
    """Return True if corner ``c`` of a cell is nearer to this ``corner`` than
    to the opposite one.
    """
    differing = c ^ corner
    return (differing & 1) + (differing >> 1 & 1) + (differing >> 2) < 2


@kernel(types.void(LATTICE, POINT_ROWS, SLOTS, WORD_ARRAY, PLACE_ARRAY, CORNER_ROWS))
def find_coarse_corners(lattice, points, slots, read, first, corners):
    """Fill ``corners`` for a view that reads the lattice coarsely: two texels of each cell stand
    for all eight.

    They are the corners whose indices are all even or all odd (``view_texels.first_texels``); each
    stands for the four corners that are nearer to it. Arguments are as in ``find_corners``.
    """
    bits = lattice.bits
    numbers = np.empty(2, np.uint32)
    for m in range(points.shape[0]):
        z, y, x, _, _, _ = base_texel(lattice, points, m)
        even = even_corner(z, y, x)
        # Number the two texels of the cell that are read.
        for n, c in enumerate((even, 7 - even)):
            r, i = row_of_corner(slots, bits, z, y, x, c)
            numbers[n] = number_in_row(read, first, r, i)
        # Let each of them stand for the corners near it.
        for c in range(8):
            if is_nearer(c, even):
                corners[m, c] = numbers[0]
            else:
                corners[m, c] = numbers[1]


@kernel(types.void(LATTICE, types.int64, types.int64, WORD_ARRAY, PLACE_ARRAY, PLACE_ARRAY))
def find_places(lattice, begin, end, read, first, places):
    """Write the places of the texels in rows ``begin`` to ``end`` to ``places`` (texels,),
    by their numbers.
    """
    for r in range(begin, end):
        # Visit the set bits of the row's word from its lowest on.
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
    """Return (luminance · error)² of a ``pixel``, the squared error as it is seen;
    0 if the pixel is final.
    """
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
    """Return True if no corner before ``c`` of point ``m`` lies in the chunk of corner ``c``."""
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

    The error counts twice in the middle of the picture and once in its corners, so that the middle
    is baked first.
    """
    bits = 3 * lattice.bits
    for m in range(corners.shape[0]):
        error = visible_error(framebuffer, pixels[m])
        if error == 0.0:
            continue
        y, x = divmod(np.int64(pixels[m]), width)
        # The weight of a pixel is 2 in the middle, and falls by half the squared distance on each
        # axis.
        error *= 2.0 - 0.5 * (((2 * x + 1) / width - 1.0) ** 2 + ((2 * y + 1) / height - 1.0) ** 2)
        # Add it once for each different chunk of the eight corners; if the opposite corners 0 and 7
        # lie in one chunk, all do.
        first = places[corners[m, 0]] >> bits
        weight[first] += error
        if places[corners[m, 7]] >> bits != first:
            for c in range(1, 8):
                if is_new(places, corners, m, c, bits):
                    weight[places[corners[m, c]] >> bits] += error


class Pages(NamedTuple):
    """The memory in which a pool keeps light: the ``table`` (slots, texels of a chunk) int32 of
    rows, and for each row its relative ``error`` and its ``stamp`` of how far it is baked,
    float32.
    """

    table: Any
    error: Any
    stamp: Any


PAGES = record(Pages, types.int32[:, ::1], SINGLE_ARRAY, SINGLE_ARRAY)


@kernel(
    types.void(LATTICE, PLACE_ARRAY, COUNT_ARRAY, PAGES, COUNT_ARRAY, SINGLE_ARRAY, SINGLE_ARRAY)
)
def find_rows(lattice, places, slots, pages, rows, error, stamp):
    """Fill ``rows``, ``error`` and ``stamp`` (texels,) of the texels at ``places`` from the
    ``pages`` of a pool.

    ``slots`` (chunks of the view,) are the slots of chunks in the pages' table, -1 if a chunk is
    absent. Texels without light get UNLIT_ROW, VOID_ROW or BURIED_ROW as their row and their stamp,
    and no error.
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
    """Add to ``seen`` (texels,) the squared weights of each texel in the ``points``; ``corners``
    (points, 8), x fastest.

    Weights are trilinear, as in ``carry_light`` if all texels hold light. Noises of texels are
    independent, so that the variance of a point is the sum of w² times theirs. For
    ``carry_ratios``, which weighs by normals too, this is an approximation, but footprints only
    decide the order of bakes.
    """
    for m in range(points.shape[0]):
        _, _, _, fz, fy, fx = base_texel(lattice, points, m)
        for c in range(8):
            seen[corners[m, c]] += trilinear(c, fz, fy, fx) ** 2
