"""Wide cells: those of two texels along each side, that a lattice is read by where it need not be finer.

Their corners are every second texel of the lattice, so that coarse light is some of the fine: nothing is lit for it
alone. The idea of a lattice that is as fine as light asks for is that of S1's section 6, "future work".
"""

import math

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel
from isogi_core.kernels.chunks import PLACES, SLOTS, WORDS, number_in, row_of, within
from isogi_core.kernels.lattice import CORNERS, DARKEST, LATTICE, PIXELS, POINTS, UNBAKED, WIDE, beyond, wide_texel
from isogi_core.kernels.planes import CONVERGING, FINAL, PLANES, luminance
from isogi_core.kernels.shares import BARE, agree, bare_light

TEXELS = types.int32[:, ::1]

NONE, ONE, TWO = np.float32(0.0), np.float32(1.0), np.float32(2.0)


@kernel()
def number_of(slots, bits, read, first, z, y, x):
    """The view's own number of the texel (z, y, x), which is marked in ``read``: see ``number_in``."""
    return number_in(read, first, row_of(slots, bits, z, y, x), within(x, bits))


@kernel()
def corner_of(lattice, z, y, x, c):
    """Corner ``c`` (bit 0 is x, bit 1 is y, bit 2 is z) of the wide cell whose lowest one is (z, y, x)."""
    nz, ny, nx = lattice.shape
    return (
        beyond(z, nz) if c & 4 else z,
        beyond(y, ny) if c & 2 else y,
        beyond(x, nx) if c & 1 else x,
    )


@kernel(types.void(LATTICE, POINTS, types.boolean[:, :, ::1]))
def touch_wide(lattice, points, touched):
    """Set ``touched`` (chunks z, y, x) for each chunk that the wide cell around a point has a corner in."""
    bits = lattice.bits
    for m in range(points.shape[0]):
        z, y, x, _, _, _ = wide_texel(lattice, points, m)
        for c in range(8):
            k, j, i = corner_of(lattice, z, y, x, c)
            touched[k >> bits, j >> bits, i >> bits] = True


@kernel(types.void(LATTICE, POINTS, SLOTS, WORDS))
def mark_wide(lattice, points, slots, cells):
    """Set in ``cells`` (slots · rows,), as ``mark_texels`` does in its own, the lowest texel of each wide cell.

    Of those that a point lies in. Threads each need ``cells`` of their own.
    """
    for m in range(points.shape[0]):
        z, y, x, _, _, _ = wide_texel(lattice, points, m)
        cells[row_of(slots, lattice.bits, z, y, x)] |= np.uint32(1) << np.uint32(within(x, lattice.bits))


@kernel(types.void(LATTICE, POINTS, SLOTS, WORDS, PLACES, PIXELS))
def number_wide(lattice, points, slots, cells, first, numbers):
    """Fill ``numbers`` (points,) with those of the wide cells that points lie in, as ``cells`` has them.

    ``first`` (slots · rows,) is the number of each row's first.
    """
    for m in range(points.shape[0]):
        z, y, x, _, _, _ = wide_texel(lattice, points, m)
        numbers[m] = number_of(slots, lattice.bits, cells, first, z, y, x)


@kernel(types.void(LATTICE, TEXELS, SLOTS, WORDS))
def mark_around(lattice, lowest, slots, read):
    """Set in ``read`` (slots · rows,) the corners of wide cells, of which ``lowest`` (cells, 3; z, y, x) is one."""
    bits = lattice.bits
    for n in range(lowest.shape[0]):
        z, y, x = np.uint32(lowest[n, 0]), np.uint32(lowest[n, 1]), np.uint32(lowest[n, 2])
        for c in range(8):
            k, j, i = corner_of(lattice, z, y, x, c)
            read[row_of(slots, bits, k, j, i)] |= np.uint32(1) << np.uint32(within(i, bits))


@kernel(types.void(LATTICE, TEXELS, SLOTS, WORDS, PLACES, CORNERS))
def find_around(lattice, lowest, slots, read, first, corners):
    """Fill ``corners`` (cells, 8), x fastest, with the view's own numbers of the texels of wide cells."""
    for n in range(lowest.shape[0]):
        z, y, x = np.uint32(lowest[n, 0]), np.uint32(lowest[n, 1]), np.uint32(lowest[n, 2])
        for c in range(8):
            k, j, i = corner_of(lattice, z, y, x, c)
            corners[n, c] = number_of(slots, lattice.bits, read, first, k, j, i)


@kernel()
def least_grade(corners, m, grade):
    """The least grade of the eight texels of point ``m``; FINAL at most, as what can never be lit is as good."""
    least = np.uint8(FINAL)
    for c in range(8):
        least = min(least, grade[corners[m, c]])
    return least


@kernel(types.void(CORNERS, PIXELS, CORNERS, types.uint8[::1], CORNERS, WIDE))
def choose_cells(narrow, numbers, around, grade, corners, wide):
    """Fill ``corners`` (points, 8) and ``wide`` (points,): which texels points read, and whether of wide cells.

    ``narrow`` (points, 8) are those of cells of one texel, which are read where they are lit and by their ``grade``
    (texels,) as good as those ``around`` (cells, 8) the wide cell that ``numbers`` (points,) tells; else these are.
    """
    for m in range(numbers.shape[0]):
        least = least_grade(narrow, m, grade)
        wide[m] = least == UNBAKED or least < least_grade(around, numbers[m], grade)
        for c in range(8):
            corners[m, c] = around[numbers[m], c] if wide[m] else narrow[m, c]


@kernel()
def differ(held, t, u):
    """The square of how much the luminances of two texels differ, less what their noise brings in the mean."""
    away = luminance(held[t, 0] - held[u, 0], held[t, 1] - held[u, 1], held[t, 2] - held[u, 2])
    return away * away - held[t, 3] * held[t, 3] - held[u, 3] * held[u, 3]


@kernel()
def alike(shares, t, u):
    """What a pair of texels counts: their normals, as ``agree`` has those of a texel and a point."""
    return agree(shares, t, shares[u, 4], shares[u, 5], shares[u, 6])


@kernel()
def spread_at(around, n, grade, held, facing):
    """How much what is ``held`` by the lit texels ``around`` wide cell ``n`` differs: see ``spread_light``.

    By pairs, which count by their normals where these are ``facing`` one way or another, and else alike.
    """
    if least_grade(around, n, grade) < FINAL:
        return NONE
    total = weight = NONE
    for c in range(8):
        for d in range(c):
            t, u = around[n, c], around[n, d]
            if grade[t] == FINAL and grade[u] == FINAL:
                own = alike(held, t, u) if facing else ONE
                total, weight = total + own * differ(held, t, u), weight + own
    return math.sqrt(max(total, NONE) / (TWO * weight)) if weight > NONE else np.float32(math.inf)


@kernel(types.void(types.uint8[::1], types.float32[:, ::1], CORNERS, types.float32[::1]))
def spread_light(grade, lit, around, spread):
    """Fill ``spread`` (cells,): how much the light of the texels ``around`` (cells, 8) each wide cell differs.

    The deviation of its luminance without noise, in what ``lit`` (texels, 4) is told in; inf where fewer than two hold
    light, and 0 where one of the eight is not final as yet.
    """
    for n in range(around.shape[0]):
        spread[n] = spread_at(around, n, grade, lit, False)


@kernel()
def shown_about(around, n, grade, shares, bare):
    """Luminance of unshadowed light about the mean normal of the lit texels of wide cell ``n``."""
    x = y = z = NONE
    for c in range(8):
        t = around[n, c]
        if grade[t] == FINAL:
            x, y, z = x + shares[t, 4], y + shares[t, 5], z + shares[t, 6]
    whole = max(np.float32(math.sqrt(x * x + y * y + z * z)), DARKEST)
    over = bare_light(bare, x / whole, y / whole, z / whole)
    return luminance(over[0], over[1], over[2])


@kernel(types.void(types.uint8[::1], types.float32[:, ::1], BARE, CORNERS, types.float32[::1]))
def spread_shares(grade, shares, bare, around, spread):
    """``spread_light`` of ``shares`` (texels, RECORD), times what the mean normal would have without shadows.

    Points hardly mix texels whose normals differ, and so pairs of these hardly count.
    """
    for n in range(around.shape[0]):
        spread[n] = spread_at(around, n, grade, shares, True) * shown_about(around, n, grade, shares, bare)


@kernel()
def mark_corners(corners, m, asked):
    """Set ``asked`` for the eight texels of point ``m``."""
    for c in range(8):
        asked[corners[m, c]] = True


@kernel(types.void(CORNERS, PIXELS, WIDE, CORNERS, WIDE, PIXELS, PLANES, WIDE))
def ask_texels(narrow, numbers, split, corners, wide, pixels, planes, asked):
    """Set ``asked`` (texels,) for the ``corners`` (points, 8) that points read, and for those that they should read.

    The latter are ``narrow`` (points, 8) ones in wide cells that are ``split`` (cells,), of which ``numbers`` (points,)
    tells that of each point. Points that were read ``wide`` (points,) there are not final.
    """
    for m in range(numbers.shape[0]):
        mark_corners(corners, m, asked)
        if wide[m] and split[numbers[m]]:
            mark_corners(narrow, m, asked)
            if planes.state[pixels[m]] == FINAL:
                planes.state[pixels[m]] = CONVERGING
