"""Scouts: rays in lanes, followed in float32 to the first cell that may hold the surface.

Lanes are persistent: one whose ray has ended takes the next ray. Rays are mirrored so that no component
of their direction is negative, and cells that may hold the surface wait until there are several.

How wrong is a float32 ray? With N the longest side, u = 2⁻²⁴: its origin in the box by N·u, a face's
parameter by 3·u·N along the axis of that face, a point by 2·u·N more: 6·u·N voxels and less than
POSITION_ERROR · N. In a brick with all cells around it the field changes by at most 3 × its range per
voxel's length along the ray; margins hold that much. A ray that leaves the cells that far before its exit,
or less, has been proven to its end.
"""

from typing import Any, NamedTuple

from isogi_core.kernels._jit import kernel
from isogi_core.kernels.bricks import BRICK, POSITION_ERROR
from isogi_core.kernels.lane_memory import gather, gather_pair, take
from isogi_core.kernels.lanes import (
    COUNT,
    bits,
    floats,
    fma,
    ints,
    least,
    mask_of,
    most,
    pick,
    popcount,
    rank,
    select,
)
from isogi_core.kernels.records import STRAY

BUSY = COUNT // 2
"""Fewer lanes than these at work, and the others take the next rays."""

WAITING = max(COUNT // 3, 1)
"""Lanes at a cell that may hold the surface before these cells are looked at."""

CLEAR, ASK = -1, -2
"""What a scout found where it is not a cell: nothing, or that ``cast`` must be asked.

Of 2³¹ voxels none of the last two names a cell, so that no word of a cell is one of these.
"""

HUGE = 1e30
"""Stands for 1/0: times nothing it is nothing."""


class Ray(NamedTuple):
    """What stays the same while lanes follow their rays; all mirrored.

    ``owner`` the record; ``o``, ``d`` origin and direction, ``inv`` its reciprocals; ``end`` the way to the
    exit, ``iso`` the isovalue; ``mirror`` the record's; ``octant`` where the leaps of the direction's octant
    begin in a word, ``flip`` turns a cell's place in its brick back; ``stride`` and ``base`` lead to bricks
    (see ``linear``); ``limit`` the cells behind the last ones.
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
def along(p, t, d):
    """The points p + t·d of lanes."""
    return fma(t, d[0], p[0]), fma(t, d[1], p[1]), fma(t, d[2], p[2])


@kernel()
def choose(mask, a, b):
    """The vectors a where the mask is set, else b."""
    return select(mask, a[0], b[0]), select(mask, a[1], b[1]), select(mask, a[2], b[2])


@kernel()
def linear(c, stride, base):
    """Place of cell or brick c in a flat array."""
    return c[0] * stride[0] + c[1] * stride[1] + c[2] * stride[2] + base


@kernel()
def strides_of(mirror, y, z, last):
    """Strides (x, y, z) and base in a flat array with rows of ``y`` and planes of ``z``, for mirrored lanes.

    ``last`` is the index of the last element along x, y, z.
    """
    mx, my, mz = (mirror & 1) != 0, (mirror & 2) != 0, (mirror & 4) != 0
    stride = select(mx, ints(-1), ints(1)), select(my, ints(-y), ints(y)), select(mz, ints(-z), ints(z))
    base = select(mx, ints(last[0]), ints(0)) + select(my, ints(last[1] * y), ints(0))
    return stride, base + select(mz, ints(last[2] * z), ints(0))


@kernel()
def filled(n):
    """Cells along an axis of ``n`` voxels when the last brick is filled up."""
    return (n - 1 + BRICK - 1) // BRICK * BRICK


@kernel()
def last_cell(descends, n):
    """The cell behind the last one along a mirrored axis of ``n`` voxels; ``descends`` is not 0 where it is turned."""
    return select(descends != 0, ints(filled(n)), n - 1)


@kernel()
def first_cell(x, descends, limit, n):
    """The cell of mirrored coordinate ``x`` along an axis of ``n`` voxels that ends before ``limit``."""
    lowest = select(descends != 0, ints(filled(n) - (n - 1)), 0)
    return least(most(ints(x), lowest), limit - 1)


@kernel()
def unmirror(c, descends, n):
    """Cell index in the volume along an axis of ``n`` voxels."""
    return least(select(descends != 0, filled(n) - 1 - c, c), n - 2)


@kernel()
def least_node(c, mirror, shape):
    """Flat index of the corner of the lanes' cells that is lowest in the volume, which names the cell.

    Cells that stand beyond the last one, to fill up a brick, get the last one's name.
    """
    nz, ny, nx = shape
    x, y, z = unmirror(c[0], mirror & 1, nx), unmirror(c[1], mirror & 2, ny), unmirror(c[2], mirror & 4, nz)
    return (z * ny + y) * nx + x


@kernel()
def look(bricks, c, ray):
    """What the map says of cells ``c``: (marked, corner's bits of c, side of the empty cube from that corner)."""
    top = gather(bricks.tops, linear((c[0] >> 2, c[1] >> 2, c[2] >> 2), ray.stride, ray.base))
    near = (top >> 28) == 0
    layer = (top << 2) + ((c[2] ^ (ray.flip >> 4)) & 3)
    word = gather(bricks.cells, select(near, layer, 0))
    word = word >> (((c[0] & 3) | ((c[1] & 3) << 2)) ^ (ray.flip & 15))
    close = near & ((word & 0x10000) != 0)
    size = select(near, select(close, ints(1), ints(2)), ((top >> ray.octant) & 15) << 2)
    keep = select(near, select(close, ints(-1), ints(-2)), ints(-4))
    return near & ((word & 1) != 0), keep, size


@kernel()
def leave(ray, c, low, size):
    """Where lanes leave a cube of cells with corner ``low``: (t, cell they enter then, whether that is outside)."""
    n = low[0] + size, low[1] + size, low[2] + size
    tx = (floats(n[0]) - ray.o[0]) * ray.inv[0]
    ty = (floats(n[1]) - ray.o[1]) * ray.inv[1]
    tz = (floats(n[2]) - ray.o[2]) * ray.inv[2]
    t = least(least(tx, ty), tz)
    p = along(ray.o, t, ray.d)
    x = select(tx <= t, n[0], most(c[0], ints(p[0])))
    y = select(ty <= t, n[1], most(c[1], ints(p[1])))
    z = select(tz <= t, n[2], most(c[2], ints(p[2])))
    return t, (x, y, z), (x >= ray.limit[0]) | (y >= ray.limit[1]) | (z >= ray.limit[2])


@kernel()
def lerp(a, b, t):
    """a + t (b - a)."""
    return fma(t, b - a, a)


@kernel()
def bernstein(v, a, b):
    """Bernstein coefficients of the trilinear field from ``a`` to ``b`` in the unit cell; ``v`` its corners.

    By the field's blossom: its values at the corners of the box between a and b, averaged.
    """
    x0, x1, x2, x3 = lerp(v[0], v[1], a[0]), lerp(v[2], v[3], a[0]), lerp(v[4], v[5], a[0]), lerp(v[6], v[7], a[0])
    y0, y1, y2, y3 = lerp(v[0], v[1], b[0]), lerp(v[2], v[3], b[0]), lerp(v[4], v[5], b[0]), lerp(v[6], v[7], b[0])
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
    """The eight corner values less the isovalue of cells whose lowest x and first y, z corner is at ``place``.

    ``turned`` where x is mirrored; ``sy`` and ``sz`` lead to the second corner along y and z.
    """
    a, b = gather_pair(flat, place)
    c, d = gather_pair(flat, place + sy)
    e, f = gather_pair(flat, place + sz)
    g, h = gather_pair(flat, place + (sy + sz))
    return (
        select(turned, b, a) - iso,
        select(turned, a, b) - iso,
        select(turned, d, c) - iso,
        select(turned, c, d) - iso,
        select(turned, f, e) - iso,
        select(turned, e, f) - iso,
        select(turned, h, g) - iso,
        select(turned, g, h) - iso,
    )


@kernel()
def certain(flat, shape, bricks, ray, c, t, out, sign, lanes):
    """Whether the field has ``sign`` for certain in cells ``c`` of the chosen ``lanes``, from ``t`` to ``out``."""
    nz, ny, nx = shape
    bz, by, bx = bricks.shape
    stride, base = strides_of(ray.mirror, nx, nx * ny, (BRICK * bx, BRICK * by, BRICK * bz))
    turned = stride[0] < 0
    place = linear(c, stride, base) + select(turned, ints(-1), 0)
    sy, sz = select(lanes, stride[1], 0), select(lanes, stride[2], 0)
    v = corner_values(flat, select(lanes, place, 0), turned, sy, sz, ray.iso)
    corner = floats(c[0]), floats(c[1]), floats(c[2])
    p = ray.o[0] - corner[0], ray.o[1] - corner[1], ray.o[2] - corner[2]
    b = bernstein(v, along(p, t, ray.d), along(p, out, ray.d))
    margin = gather(bricks.margins, linear((c[0] >> 2, c[1] >> 2, c[2] >> 2), ray.stride, ray.base))
    inner = (b[0] * sign > margin) & (b[1] * sign > margin)
    return lanes & inner & (b[2] * sign > margin) & (b[3] * sign > margin)


@kernel()
def cell_of(word):
    """The cell of a ``report``: the word's upper 31 bits."""
    return (word >> 1) & 0x7FFFFFFF


@kernel()
def report(found, entries, owner, cell, sign, t, lanes):
    """Write cell · 2 + (1 where solid) of the chosen lanes to ``found`` at their rays, and ``t`` to ``entries``."""
    word = cell * 2 + select(sign > 0.0, ints(1), ints(0))
    chosen = bits(lanes)
    lane = 0
    while chosen != 0:
        if chosen & 1:
            m = pick(owner, lane)
            found[m], entries[m] = pick(word, lane), pick(t, lane)
        chosen >>= 1
        lane += 1


@kernel()
def mark(found, owner, word, lanes):
    """Write ``word`` of the chosen lanes to ``found`` at their rays."""
    chosen = bits(lanes)
    lane = 0
    while chosen != 0:
        if chosen & 1:
            found[pick(owner, lane)] = word
        chosen >>= 1
        lane += 1


@kernel()
def no_ray():
    """Lanes that follow nothing yet."""
    zero, nought = floats(0.0), ints(0)
    point, cell = (zero, zero, zero), (nought, nought, nought)
    return Ray(nought, point, point, point, zero, zero, nought, nought, nought, cell, nought, cell)


@kernel()
def enlist(records, following, turn, fresh, ray, shape, bricks):
    """The ``ray`` with the records from ``following`` on in the ``fresh`` lanes; ``turn`` numbers them."""
    nz, ny, nx = shape
    bz, by, bx = bricks.shape
    x, y, z = take(records[0], following, fresh), take(records[1], following, fresh), take(records[2], following, fresh)
    u, v, w = take(records[3], following, fresh), take(records[4], following, fresh), take(records[5], following, fresh)
    o, d = choose(fresh, (x, y, z), ray.o), choose(fresh, (u, v, w), ray.d)
    inv = least(1.0 / d[0], HUGE), least(1.0 / d[1], HUGE), least(1.0 / d[2], HUGE)
    end = select(fresh, take(records[6], following, fresh), ray.end)
    iso = select(fresh, take(records[7], following, fresh), ray.iso)
    mirror = select(fresh, ints(take(records[9], following, fresh)), ray.mirror)
    flip = ((mirror & 1) * 3) | ((mirror & 2) * 6) | ((mirror & 4) * 12)
    stride, base = strides_of(mirror, bx, bx * by, (bx - 1, by - 1, bz - 1))
    limit = last_cell(mirror & 1, nx), last_cell(mirror & 2, ny), last_cell(mirror & 4, nz)
    owner = select(fresh, turn, ray.owner)
    return Ray(owner, o, d, inv, end, iso, mirror, (mirror & 7) << 2, flip, stride, base, limit)


@kernel()
def enter(flat, shape, bricks, ray, told):
    """Where rays begin: (cell, the field's sign there, whether that is in doubt); ``told`` the sign, or 0."""
    nz, ny, nx = shape
    mirror, limit = ray.mirror, ray.limit
    x = first_cell(ray.o[0], mirror & 1, limit[0], nx)
    y = first_cell(ray.o[1], mirror & 2, limit[1], ny)
    z = first_cell(ray.o[2], mirror & 4, limit[2], nz)
    here = select(gather(flat, least_node((x, y, z), mirror, shape)) > ray.iso, floats(1.0), -1.0)
    marked, _, _ = look(bricks, (x, y, z), ray)
    doubtful = (mirror >= STRAY) | (marked & (told == 0.0)) | (~marked & (told + here == 0.0))
    return (x, y, z), select(told == 0.0, here, told), doubtful


@kernel()
def scout(flat, shape, bricks, records, count, found, entries):
    """Write to ``found`` what each of ``count`` rays meets: ASK, or 2 · cell + (1 from a solid side).

    ``records`` (FIELDS, n) are those of ``prepare``. Rays that meet nothing keep what was there. ``entries``
    is the way to that cell, in steps of the direction's largest component.
    """
    ray, c, t, sign = no_ray(), (ints(0), ints(0), ints(0)), floats(0.0), floats(0.0)
    walking, waiting = mask_of(False), mask_of(False)
    following, slack = 0, POSITION_ERROR * max(shape)
    while True:
        idle = ~(walking | waiting)
        if following < count and popcount(idle) > COUNT - BUSY:
            turn = rank(idle) + following
            fresh = idle & (turn < count)
            ray = enlist(records, following, turn, fresh, ray, shape, bricks)
            start, first, doubtful = enter(flat, shape, bricks, ray, take(records[8], following, fresh))
            mark(found, ray.owner, ASK, fresh & doubtful)
            c, t, sign = choose(fresh, start, c), select(fresh, 0.0, t), select(fresh, first, sign)
            walking = walking | (fresh & ~doubtful)
            following = min(count, following + popcount(idle))
        if popcount(walking | waiting) == 0:
            if following >= count:
                return
            continue
        while True:
            ahead = popcount(walking)
            if ahead == 0 or popcount(waiting) >= WAITING:
                break
            if following < count and ahead + popcount(waiting) < BUSY:
                break
            stops, keep, size = look(bricks, c, ray)
            waiting = waiting | (stops & walking)
            walking = walking & ~stops
            out, after, outside = leave(ray, c, (c[0] & keep, c[1] & keep, c[2] & keep), size)
            mark(found, ray.owner, ASK, walking & outside & (out < ray.end - slack))
            walking = walking & ~outside
            t, c = select(walking, out, t), choose(walking, after, c)
        if popcount(waiting) >= WAITING or popcount(walking) == 0:
            out, after, outside = leave(ray, c, c, ints(1))
            passed = certain(flat, shape, bricks, ray, c, t, out, sign, waiting)
            report(found, entries, ray.owner, least_node(c, ray.mirror, shape), sign, t, waiting & ~passed)
            mark(found, ray.owner, ASK, passed & outside & (out < ray.end - slack))
            passed = passed & ~outside
            t, c = select(passed, out, t), choose(passed, after, c)
            walking, waiting = walking | passed, mask_of(False)
