"""Skip distances: how far a ray may go from an empty brick, for each octant of directions.

A skip distance is the side of the largest cube of empty bricks that begins at the brick and lies
ahead in the octant. Cubes grow by one brick at a time, for 64 bricks along x at once: one bit each.
"""

import numpy as np

from isogi_core.kernels._jit import kernel

SKIP_BITS = 4
"""Bits of a skip distance; a word holds those of the octants 0 … 7. Bit a of an octant is set if
directions descend along axis a.

No skip distance is 0, so that a word is one of skip distances if its uppermost four bits are not 0.
"""

LONGEST_SKIP = 2**SKIP_BITS - 1
"""Longest skip distance, in bricks."""

WORD_BRICKS = 64
"""Bricks along x whose bits share a word."""

NO_BITS = np.uint64(0)
ALL_BITS = np.uint64(2**WORD_BRICKS - 1)
NEXT_BIT = np.uint64(1)
LAST_BIT = np.uint64(WORD_BRICKS - 1)


@kernel()
def write_bits(empty, hollow, outside):
    """Write a bit for each brick: to ``hollow`` if it is ``empty`` (z, y, x) or beyond the volume,
    to ``outside`` if it is beyond.

    ``hollow`` and ``outside`` (z, y, words) reach beyond the volume by one word on each side.
    """
    bz, by, bx = empty.shape
    hollow[:] = ALL_BITS
    outside[:] = ALL_BITS
    for k in range(bz):
        for j in range(by):
            for first in range(0, bx, WORD_BRICKS):
                count = min(WORD_BRICKS, bx - first)
                # Pack a row of up to 64 bricks into a word; bits beyond the volume are set.
                bits = NO_BITS
                for i in range(count):
                    bits |= np.uint64(empty[k, j, first + i]) << np.uint64(i)
                if count < WORD_BRICKS:
                    beyond = ALL_BITS << np.uint64(count)
                else:
                    beyond = NO_BITS
                w = first // WORD_BRICKS + 1
                hollow[k + 1, j + 1, w] = bits | beyond
                outside[k + 1, j + 1, w] = beyond


@kernel()
def flip(bits, others):
    """Flip those ``bits`` that are set in ``others``; both are flat arrays of words."""
    for q in range(bits.size):
        bits[q] ^= others[q]


@kernel()
def find_empty_pairs(cubes, dy, dz, first, last, rows):
    """Write to ``rows`` the cubes from ``first`` to ``last`` that are empty together with their
    neighbours along y, along z, and along both.
    """
    a = cubes[first:last]
    b = cubes[first + dy : last + dy]
    c = cubes[first + dz : last + dz]
    d = cubes[first + dy + dz : last + dy + dz]
    for q in range(rows.size):
        rows[q] = a[q] & b[q] & c[q] & d[q]


@kernel()
def meet_next(rows, following, descended, outside, larger):
    """Write to ``larger`` those of ``rows`` that are empty together with their neighbour along
    x, or lie ``outside``; ``following`` are the neighbouring words.
    """
    if descended:
        for q in range(larger.size):
            larger[q] = outside[q] | rows[q] & (rows[q] << NEXT_BIT | following[q] >> LAST_BIT)
    else:
        for q in range(larger.size):
            larger[q] = outside[q] | rows[q] & (rows[q] >> NEXT_BIT | following[q] << LAST_BIT)


@kernel()
def enlarge(cubes, octant, outside, steps, rows, larger):
    """Write to ``larger`` the empty cubes that are one brick larger: those whose eight corner
    ``cubes`` are empty.

    ``steps`` lead to the next word along y and z; ``rows`` is scratch space. All arrays are flat.
    """
    along_y, along_z = steps
    dx = octant & 1
    dy = -along_y if octant & 2 else along_y
    dz = -along_z if octant & 4 else along_z
    # Leave out the border, whose neighbours would lie beyond the arrays.
    first = along_y + along_z + 1
    last = cubes.size - along_y - along_z - 1
    find_empty_pairs(cubes, dy, dz, first - 1, last + 1, rows[first - 1 : last + 1])
    # The neighbour along x may be in the next word, or in the word before if the axis descends.
    if dx:
        following = rows[first - 1 : last - 1]
    else:
        following = rows[first + 1 : last + 1]
    meet_next(rows[first:last], following, dx, outside[first:last], larger[first:last])


@kernel()
def write_octant(sides, octant, shape, tops):
    """Add the skip distances of an octant to the words ``tops`` (bricks,), in its four bits.

    Plane p of ``sides`` (SKIP_BITS, z, y, words) holds bit p of each brick's distance. Planes have
    a border of one word on each side, and bits of 64 bricks along x in a word.
    """
    bz, by, bx = shape
    one = np.uint64(1)
    shift = np.uint64(SKIP_BITS * octant)
    for k in range(bz):
        for j in range(by):
            for first in range(0, bx, WORD_BRICKS):
                z = k + 1
                y = j + 1
                w = first // WORD_BRICKS + 1
                # Collect the four bits of each brick's distance from the four planes.
                a = sides[0, z, y, w]
                b = sides[1, z, y, w]
                c = sides[2, z, y, w]
                d = sides[3, z, y, w]
                place = (k * by + j) * bx + first
                row = tops[place : place + min(WORD_BRICKS, bx - first)]
                for i in range(row.size):
                    s = np.uint64(i)
                    low = a >> s & one | (b >> s & one) << one
                    high = c >> s & one | (d >> s & one) << one
                    row[i] |= np.int32(np.uint32((low | high << np.uint64(2)) << shift))


@kernel()
def fill_skips(empty, tops):
    """Write the skip distances of the ``empty`` bricks (z, y, x) to ``tops`` (bricks,); other
    bricks keep their word.

    As each cube lies in the next, a skip distance is the number of cubes that are empty. It is
    counted in binary: bit p of the count flips with each cube whose side is a multiple of 2^p.
    """
    bz, by, bx = empty.shape
    flat = empty.reshape(empty.size)
    for b in range(tops.size):
        if flat[b]:
            tops[b] = 0
    # Pack the bricks into words, with a border of empty ones that counts as outside.
    shape = (bz + 2, by + 2, -(-bx // WORD_BRICKS) + 2)
    hollow = np.empty(shape, np.uint64)
    outside = np.empty(shape, np.uint64)
    sides = np.empty((SKIP_BITS, *shape), np.uint64)
    write_bits(empty, hollow, outside)
    count = hollow.size
    steps = (shape[2], shape[1] * shape[2])
    first_cubes = hollow.reshape(count)
    beyond = outside.reshape(count)
    bits = sides.reshape((SKIP_BITS, count))
    cubes = np.empty(count, np.uint64)
    rows = np.empty(count, np.uint64)
    larger = np.full(count, ALL_BITS)
    # Grow the cubes of each octant brick by brick, and count those that are empty.
    for octant in range(2**3):
        bits[:] = NO_BITS
        for b in range(count):
            cubes[b] = first_cubes[b]
        for side in range(1, LONGEST_SKIP + 1):
            for p in range(SKIP_BITS):
                if side % 2**p == 0:
                    flip(bits[p], cubes)
            enlarge(cubes, octant, beyond, steps, rows, larger)
            cubes, larger = larger, cubes
        write_octant(sides, octant, empty.shape, tops)
