"""Conservative traversal in float32: rays in SIMD lanes, followed to the first cell that may hold
the surface.

Empty space is skipped by the active-cell map. What float32 cannot prove is left to the float64
intersection.
"""

from typing import Any, NamedTuple

from isogi_core.kernels._jit import kernel
from isogi_core.kernels.simd.maths import bits, f32, fma, i32, mask_of, popcount, rank, where
from isogi_core.kernels.simd.memory import gather, gather_pair, take
from isogi_core.kernels.simd.types import RAY_WIDTH
from isogi_core.kernels.tracing.active_cells import BRICK_CELLS, POSITION_ERROR
from isogi_core.kernels.tracing.ray_stream import STRAY_BIT

MIN_BUSY_LANES = RAY_WIDTH // 2
"""Fewer lanes than these at work, and the others take the next rays."""

MAX_WAITING_LANES = max(RAY_WIDTH // 3, 1)
"""Lanes at a cell that may hold the surface before these cells are looked at."""

MISS = -1
UNSURE = -2
"""Results of the traversal that are no cell: the ray meets nothing, or only ``cast`` can decide.

Of 2³¹ voxels none of the last two names a cell, so that no word of a cell is one of these.
"""

HUGE_INVERSE = 1e30
"""Stands for 1/0: times nothing it is nothing."""


class Ray(NamedTuple):
    """What stays the same while lanes follow their rays; all mirrored, f32×N and i32×N.

    ``owner`` the ray's column in the stream; ``o``, ``d`` origin and direction, ``inv`` its
    reciprocals; ``end`` the way to the exit, ``iso`` the isovalue; ``mirror`` the stream's;
    ``octant`` where the skips of the direction's octant begin in a word, ``flip`` turns a cell's
    place in its brick back; ``stride`` and ``base`` lead to cells (see ``linear``); ``limit`` the
    cells behind the last ones.
    """

    owner: Any
    o: Any
    d: Any
    inv: Any
    end: Any
    iso: Any
    mirror: Any
    octant: Any
    flip: Any
    stride: Any
    base: Any
    limit: Any


@kernel()
def points_along(p, t, d):
    """The points p + t·d of lanes."""
    return fma(t, d[0], p[0]), fma(t, d[1], p[1]), fma(t, d[2], p[2])


@kernel()
def choose_points(mask, a, b):
    """The vectors a where the mask is set, else b."""
    return where(mask, a[0], b[0]), where(mask, a[1], b[1]), where(mask, a[2], b[2])


@kernel()
def linear(c, stride, base):
    """Place of cell or brick c in a flat array."""
    return c[0] * stride[0] + c[1] * stride[1] + c[2] * stride[2] + base


@kernel()
def strides_of(mirror, y, z, last):
    """Strides (x, y, z) and base in a flat array with rows of ``y`` and planes of ``z``, for
    mirrored lanes.

    ``last`` is the index of the last element along x, y, z.
    """
    mx, my, mz = (mirror & 1) != 0, (mirror & 2) != 0, (mirror & 4) != 0
    stride = where(mx, -1, 1), where(my, -y, y), where(mz, -z, z)
    return stride, where(mx, last[0], 0) + where(my, last[1] * y, 0) + where(mz, last[2] * z, 0)


@kernel()
def filled(n):
    """Cells along an axis of ``n`` voxels when the last brick is filled up."""
    return (n - 1 + BRICK_CELLS - 1) // BRICK_CELLS * BRICK_CELLS


@kernel()
def last_cell(descends, n):
    """The cell behind the last one along a mirrored axis of ``n`` voxels; ``descends`` is not 0
    where it is turned.
    """
    return where(descends != 0, filled(n), n - 1)


@kernel()
def first_cell(x, descends, limit, n):
    """The cell of mirrored coordinate ``x`` along an axis of ``n`` voxels that ends before
    ``limit``.
    """
    lowest = where(descends != 0, filled(n) - (n - 1), 0)
    return min(max(i32(x), lowest), limit - 1)


@kernel()
def unmirror(c, descends, n):
    """Cell index in the volume along an axis of ``n`` voxels."""
    return min(where(descends != 0, filled(n) - 1 - c, c), n - 2)


@kernel()
def least_node(c, mirror, shape):
    """Flat index of the corner of the lanes' cells that is lowest in the volume, which names the
    cell.

    Cells that stand beyond the last one, to fill up a brick, get the last one's name.
    """
    nz, ny, nx = shape
    x = unmirror(c[0], mirror & 1, nx)
    y = unmirror(c[1], mirror & 2, ny)
    z = unmirror(c[2], mirror & 4, nz)
    return (z * ny + y) * nx + x


@kernel()
def look_up(cells, c, ray):
    """What the active-cell map says of cells ``c``: (active, corner's bits of c, side of the empty
    cube there).
    """
    top = gather(cells.tops, linear((c[0] >> 2, c[1] >> 2, c[2] >> 2), ray.stride, ray.base))
    near = (top >> 28) == 0
    layer = (top << 2) + ((c[2] ^ (ray.flip >> 4)) & 3)
    word = gather(cells.cells, where(near, layer, 0))
    word = word >> (((c[0] & 3) | ((c[1] & 3) << 2)) ^ (ray.flip & 15))
    close = near & ((word & 0x10000) != 0)
    size = where(near, where(close, 1, 2), ((top >> ray.octant) & 15) << 2)
    keep = where(near, where(close, -1, -2), -4)
    return near & ((word & 1) != 0), keep, size


@kernel()
def leave(ray, c, low, size):
    """Where lanes leave a cube of cells with corner ``low``: (t, cell they enter then, whether that
    is outside).
    """
    n = low[0] + size, low[1] + size, low[2] + size
    tx = (f32(n[0]) - ray.o[0]) * ray.inv[0]
    ty = (f32(n[1]) - ray.o[1]) * ray.inv[1]
    tz = (f32(n[2]) - ray.o[2]) * ray.inv[2]
    t = min(min(tx, ty), tz)
    p = points_along(ray.o, t, ray.d)
    x = where(tx <= t, n[0], max(c[0], i32(p[0])))
    y = where(ty <= t, n[1], max(c[1], i32(p[1])))
    z = where(tz <= t, n[2], max(c[2], i32(p[2])))
    return t, (x, y, z), (x >= ray.limit[0]) | (y >= ray.limit[1]) | (z >= ray.limit[2])


@kernel()
def lerp(a, b, t):
    """a + t (b - a)."""
    return fma(t, b - a, a)


@kernel()
def bernstein(v, a, b):
    """Bernstein coefficients of the trilinear field from ``a`` to ``b`` in the unit cell; ``v`` its
    corners.

    By the field's blossom: its values at the corners of the box between a and b, averaged.
    """
    x0 = lerp(v[0], v[1], a[0])
    x1 = lerp(v[2], v[3], a[0])
    x2 = lerp(v[4], v[5], a[0])
    x3 = lerp(v[6], v[7], a[0])
    y0 = lerp(v[0], v[1], b[0])
    y1 = lerp(v[2], v[3], b[0])
    y2 = lerp(v[4], v[5], b[0])
    y3 = lerp(v[6], v[7], b[0])
    aa0, aa1 = lerp(x0, x1, a[1]), lerp(x2, x3, a[1])
    ab0, ab1 = lerp(x0, x1, b[1]), lerp(x2, x3, b[1])
    ba0, ba1 = lerp(y0, y1, a[1]), lerp(y2, y3, a[1])
    bb0, bb1 = lerp(y0, y1, b[1]), lerp(y2, y3, b[1])
    third = 1.0 / 3.0
    one = (lerp(aa0, aa1, b[2]) + lerp(ab0, ab1, a[2]) + lerp(ba0, ba1, a[2])) * third
    two = (lerp(bb0, bb1, a[2]) + lerp(ba0, ba1, b[2]) + lerp(ab0, ab1, b[2])) * third
    return lerp(aa0, aa1, a[2]), one, two, lerp(bb0, bb1, b[2])


@kernel()
def corner_values(flat, place, turned, sy, sz, iso):
    """The eight corner values less the isovalue of cells whose lowest x and first y, z corner is at
    ``place``.

    ``turned`` where x is mirrored; ``sy`` and ``sz`` lead to the second corner along y and z.
    """
    a, b = gather_pair(flat, place)
    c, d = gather_pair(flat, place + sy)
    e, f = gather_pair(flat, place + sz)
    g, h = gather_pair(flat, place + (sy + sz))
    return (
        where(turned, b, a) - iso,
        where(turned, a, b) - iso,
        where(turned, d, c) - iso,
        where(turned, c, d) - iso,
        where(turned, f, e) - iso,
        where(turned, e, f) - iso,
        where(turned, h, g) - iso,
        where(turned, g, h) - iso,
    )


@kernel()
def certain(volume, cells, ray, c, span, sign, lanes):
    """Whether the field has ``sign`` for certain in cells ``c`` of the chosen ``lanes``, on the
    ``span`` (in, out).
    """
    flat, (_, ny, nx) = volume
    bz, by, bx = cells.shape
    stride, base = strides_of(
        ray.mirror, nx, nx * ny, (BRICK_CELLS * bx, BRICK_CELLS * by, BRICK_CELLS * bz)
    )
    turned = stride[0] < 0
    place = linear(c, stride, base) + where(turned, -1, 0)
    sy, sz = where(lanes, stride[1], 0), where(lanes, stride[2], 0)
    v = corner_values(flat, where(lanes, place, 0), turned, sy, sz, ray.iso)
    corner = f32(c[0]), f32(c[1]), f32(c[2])
    p = ray.o[0] - corner[0], ray.o[1] - corner[1], ray.o[2] - corner[2]
    b = bernstein(v, points_along(p, span[0], ray.d), points_along(p, span[1], ray.d))
    margin = gather(cells.margins, linear((c[0] >> 2, c[1] >> 2, c[2] >> 2), ray.stride, ray.base))
    inner = (b[0] * sign > margin) & (b[1] * sign > margin)
    return lanes & inner & (b[2] * sign > margin) & (b[3] * sign > margin)


@kernel()
def cell_of(word):
    """The cell of a word of ``put_cells``: its upper 31 bits."""
    return (word >> 1) & 0x7FFFFFFF


@kernel()
def put_cells(found, entries, owner, cell, sign, t, lanes):
    """Write cell · 2 + (1 where solid) of the chosen lanes to ``found`` at their rays, and ``t`` to
    ``entries``.
    """
    word = cell * 2 + where(sign > 0.0, 1, 0)
    chosen = bits(lanes)
    lane = 0
    while chosen != 0:
        if chosen & 1:
            m = owner[lane]
            found[m] = word[lane]
            entries[m] = t[lane]
        chosen >>= 1
        lane += 1


@kernel()
def put_word(found, owner, word, lanes):
    """Write ``word`` of the chosen lanes to ``found`` at their rays."""
    chosen = bits(lanes)
    lane = 0
    while chosen != 0:
        if chosen & 1:
            found[owner[lane]] = word
        chosen >>= 1
        lane += 1


@kernel()
def no_ray():
    """Lanes that follow nothing yet."""
    zero = f32(0.0)
    nought = i32(0)
    point = (zero, zero, zero)
    cell = (nought, nought, nought)
    return Ray(nought, point, point, point, zero, zero, nought, nought, nought, cell, nought, cell)


@kernel()
def take_rays(records, following, turn, fresh, ray, shape, cells):
    """The ``ray`` with the stream's rays from ``following`` on in the ``fresh`` lanes; ``turn``
    numbers them.
    """
    nz, ny, nx = shape
    bz, by, bx = cells.shape
    x = take(records[0], following, fresh)
    y = take(records[1], following, fresh)
    z = take(records[2], following, fresh)
    u = take(records[3], following, fresh)
    v = take(records[4], following, fresh)
    w = take(records[5], following, fresh)
    o, d = choose_points(fresh, (x, y, z), ray.o), choose_points(fresh, (u, v, w), ray.d)
    inv = (
        min(1.0 / d[0], HUGE_INVERSE),
        min(1.0 / d[1], HUGE_INVERSE),
        min(1.0 / d[2], HUGE_INVERSE),
    )
    end = where(fresh, take(records[6], following, fresh), ray.end)
    iso = where(fresh, take(records[7], following, fresh), ray.iso)
    mirror = where(fresh, i32(take(records[9], following, fresh)), ray.mirror)
    flip = ((mirror & 1) * 3) | ((mirror & 2) * 6) | ((mirror & 4) * 12)
    stride, base = strides_of(mirror, bx, bx * by, (bx - 1, by - 1, bz - 1))
    limit = last_cell(mirror & 1, nx), last_cell(mirror & 2, ny), last_cell(mirror & 4, nz)
    owner = where(fresh, turn, ray.owner)
    return Ray(owner, o, d, inv, end, iso, mirror, (mirror & 7) << 2, flip, stride, base, limit)


@kernel()
def enter(volume, cells, ray, given):
    """Where rays begin: (cell, the field's sign there, whether that is in doubt); ``given`` the
    sign, or 0.
    """
    flat, shape = volume
    nz, ny, nx = shape
    mirror = ray.mirror
    limit = ray.limit
    x = first_cell(ray.o[0], mirror & 1, limit[0], nx)
    y = first_cell(ray.o[1], mirror & 2, limit[1], ny)
    z = first_cell(ray.o[2], mirror & 4, limit[2], nz)
    here = where(gather(flat, least_node((x, y, z), mirror, shape)) > ray.iso, f32(1.0), -1.0)
    active, _, _ = look_up(cells, (x, y, z), ray)
    doubtful = (mirror >= STRAY_BIT) | (active & (given == 0.0)) | (~active & (given + here == 0.0))
    return (x, y, z), where(given == 0.0, here, given), doubtful


@kernel()
def traverse(volume, cells, records, count, found, entries):
    """Write to ``found`` what each of ``count`` rays meets: UNSURE, or 2 · cell + (1 from a solid
    side).

    ``volume`` (flat voxels, shape), ``cells`` its active-cell map, ``records`` (FIELDS, n) the
    stream's, see ``ray_stream``. Rays that meet nothing keep what was there. ``entries`` is the way
    to that cell, in steps of the direction's largest component.
    """
    shape = volume[1]
    ray = no_ray()
    c = (i32(0), i32(0), i32(0))
    t = f32(0.0)
    sign = f32(0.0)
    walking = mask_of(False)
    waiting = mask_of(False)
    following = 0
    slack = POSITION_ERROR * max(shape)
    while True:
        idle = ~(walking | waiting)
        if following < count and popcount(idle) > RAY_WIDTH - MIN_BUSY_LANES:
            turn = rank(idle) + following
            fresh = idle & (turn < count)
            ray = take_rays(records, following, turn, fresh, ray, shape, cells)
            start, first, doubtful = enter(volume, cells, ray, take(records[8], following, fresh))
            put_word(found, ray.owner, UNSURE, fresh & doubtful)
            c = choose_points(fresh, start, c)
            t = where(fresh, 0.0, t)
            sign = where(fresh, first, sign)
            walking = walking | (fresh & ~doubtful)
            following = min(count, following + popcount(idle))
        if popcount(walking | waiting) == 0:
            if following >= count:
                return
            continue
        while True:
            ahead = popcount(walking)
            if ahead == 0 or popcount(waiting) >= MAX_WAITING_LANES:
                break
            if following < count and ahead + popcount(waiting) < MIN_BUSY_LANES:
                break
            stops, keep, size = look_up(cells, c, ray)
            waiting = waiting | (stops & walking)
            walking = walking & ~stops
            out, after, outside = leave(ray, c, (c[0] & keep, c[1] & keep, c[2] & keep), size)
            put_word(found, ray.owner, UNSURE, walking & outside & (out < ray.end - slack))
            walking = walking & ~outside
            t, c = where(walking, out, t), choose_points(walking, after, c)
        if popcount(waiting) >= MAX_WAITING_LANES or popcount(walking) == 0:
            out, after, outside = leave(ray, c, c, i32(1))
            passed = certain(volume, cells, ray, c, (t, out), sign, waiting)
            put_cells(
                found,
                entries,
                ray.owner,
                least_node(c, ray.mirror, shape),
                sign,
                t,
                waiting & ~passed,
            )
            put_word(found, ray.owner, UNSURE, passed & outside & (out < ray.end - slack))
            passed = passed & ~outside
            t, c = where(passed, out, t), choose_points(passed, after, c)
            walking = walking | passed
            waiting = mask_of(False)
