"""Scouts: rays in lanes, followed in float32 to the first cell that may hold the surface.

Lanes are persistent: one whose ray has ended takes the next ray. Rays are mirrored so that no component
of their direction is negative, and cells that may hold the surface wait until there are several.

How wrong is a float32 ray? With N the longest side, u = 2⁻²⁴: its origin in the box by N·u, a face's
parameter by 3·u·N along the axis of that face, a point by 2·u·N more: 6·u·N voxels and less than
POSITION_ERROR · N. In a brick with all cells around it the field changes by at most 3 × its range per
voxel's length along the ray; margins hold that much.
"""

import math

from isogi_core.kernels._jit import kernel
from isogi_core.kernels.bricks import BRICK
from isogi_core.kernels.crossings import clip_box_lanes, longest_of
from isogi_core.kernels.intersect import UNKNOWN
from isogi_core.kernels.lane_memory import gather, gather_pair, load, store, take
from isogi_core.kernels.lanes import (
    COUNT,
    bits,
    floats,
    fma,
    ints,
    lane_numbers,
    least,
    magnitude,
    mask_of,
    most,
    pick,
    popcount,
    rank,
    select,
)

BUSY = COUNT // 2
"""Fewer lanes than these at work, and the others take the next rays."""

WAITING = max(COUNT // 3, 1)
"""Lanes at a cell that may hold the surface before these cells are looked at."""

CLEAR, ASK = -1, -2
"""What a scout found where it is not a cell: nothing, or that ``cast`` must be asked."""

FIELDS = 10
"""Numbers of a prepared ray: origin, direction (x, y, z, mirrored), way to the exit, isovalue, sign, mirror."""

EVERY = (1 << COUNT) - 1
"""The bits of all lanes."""

HUGE = 1e30
"""Stands for 1/0: times nothing it is nothing."""

STRAY = 8
"""The bit of a mirror that says: no ray to follow, ask ``cast``."""


@kernel()
def mirrored(d, here, size):
    """A direction's component and a place along an axis of ``size``, mirrored where descending: (d, place, mask)."""
    descends = d < 0.0
    return floats(magnitude(d)), floats(select(descends, size - here, here)), descends


@kernel()
def prepare_lanes(shape, bricks_shape, isovalues, origins, directions, sides, m, rays, spans, r):
    """Write the records of COUNT rays from ray ``m`` on to column ``r`` of ``rays`` and ``spans``.

    Returns, as bits, which of them meet the box.
    """
    o = load(origins[0], m), load(origins[1], m), load(origins[2], m)
    d = load(directions[0], m), load(directions[1], m), load(directions[2], m)
    near, far = clip_box_lanes(shape, o, d)
    longest = longest_of(d)
    shrink = 1.0 / longest
    sound = (shrink < math.inf) & (far < math.inf)
    mirror = select(sound, ints(0), STRAY)
    for a in range(3):
        step, here = select(sound, d[a] * shrink, 1.0), select(sound, o[a] + near * d[a], 0.0)
        step, here, descends = mirrored(step, here, float(BRICK * bricks_shape[2 - a]))
        mirror = mirror + select(descends, ints(1 << a), 0)
        store(rays[a], r, here)
        store(rays[3 + a], r, step)
    side = floats(load(sides, m))
    store(rays[6], r, floats((far - near) * longest))
    store(rays[7], r, floats(load(isovalues, m)))
    store(rays[8], r, select(near == 0.0, -side, float(UNKNOWN)))
    store(rays[9], r, floats(mirror))
    store(spans[0], r, near)
    store(spans[1], r, far)
    return bits(near < far)


@kernel()
def close_ranks(rays, spans, owners, r, met):
    """Move those of the COUNT columns from ``r`` on whose bit is set in ``met`` together; returns their end."""
    for column in range(r, r + COUNT):
        if met & 1:
            for field in range(FIELDS):
                rays[field, r] = rays[field, column]
            spans[0, r], spans[1, r], owners[r] = spans[0, column], spans[1, column], owners[column]
            r += 1
        met >>= 1
    return r


@kernel()
def prepare(shape, bricks_shape, isovalues, origins, directions, sides, first, last, rays, spans, owners):
    """Write the records of those rays first … last that meet the box to ``rays`` (FIELDS, n); returns how many.

    ``owners`` (n,) gets their numbers, ``spans`` (2, n) what ``clip_box`` gives for them. There are COUNT rays
    or more from 0 on, and room for COUNT records more.
    """
    count = 0
    for i in range(first, last, COUNT):
        m = max(min(i, last - COUNT), 0)
        met = prepare_lanes(shape, bricks_shape, isovalues, origins, directions, sides, m, rays, spans, count)
        store(owners, count, lane_numbers() + m)
        met &= EVERY << (i - m)
        count = count + COUNT if met == EVERY else close_ranks(rays, spans, owners, count, met)
    return count


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
def look(bricks, c, octant, flip, stride, base):
    """What the map says of cells ``c``: (marked, cells' corner & this, side of the empty cube from that corner)."""
    top = gather(bricks.tops, linear((c[0] >> 2, c[1] >> 2, c[2] >> 2), stride, base))
    near = (top >> 28) == 0
    layer = (top << 2) + ((c[2] ^ (flip >> 4)) & 3)
    word = gather(bricks.cells, select(near, layer, 0))
    word = word >> (((c[0] & 3) | ((c[1] & 3) << 2)) ^ (flip & 15))
    close = near & ((word & 0x10000) != 0)
    size = select(near, select(close, ints(1), ints(2)), ((top >> octant) & 15) << 2)
    keep = select(near, select(close, ints(-1), ints(-2)), ints(-4))
    return near & ((word & 1) != 0), keep, size


@kernel()
def leave(o, d, inv, c, low, size):
    """Where lanes leave a cube of cells with corner ``low``: (t, cell they enter then)."""
    n = low[0] + size, low[1] + size, low[2] + size
    tx = (floats(n[0]) - o[0]) * inv[0]
    ty = (floats(n[1]) - o[1]) * inv[1]
    tz = (floats(n[2]) - o[2]) * inv[2]
    t = least(least(tx, ty), tz)
    p = along(o, t, d)
    x = select(tx <= t, n[0], most(c[0], ints(p[0])))
    y = select(ty <= t, n[1], most(c[1], ints(p[1])))
    z = select(tz <= t, n[2], most(c[2], ints(p[2])))
    return t, (x, y, z)


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
def certain(flat, bricks, place, stride, brick, c, o, d, t, out, iso, sign):
    """Whether the field has ``sign`` for certain in cell ``c`` from ``t`` to ``out``."""
    turned = stride[0] < 0
    v = corner_values(flat, place + select(turned, ints(-1), 0), turned, stride[1], stride[2], iso)
    corner = floats(c[0]), floats(c[1]), floats(c[2])
    p = o[0] - corner[0], o[1] - corner[1], o[2] - corner[2]
    b = bernstein(v, along(p, t, d), along(p, out, d))
    margin = gather(bricks.margins, brick)
    inner = (b[0] * sign > margin) & (b[1] * sign > margin)
    return inner & (b[2] * sign > margin) & (b[3] * sign > margin)


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
def scout(flat, shape, bricks, rays, count, found, entries):
    """Write to ``found`` what each of ``count`` prepared rays meets: ASK, or 2 · cell + (1 from a solid side).

    Rays that meet nothing keep what was there. ``entries`` is the way to that cell, in steps of the
    direction's largest component.
    """
    nz, ny, nx = shape
    bz, by, bx = bricks.shape
    o0, o1, o2 = rays[0], rays[1], rays[2]
    d0, d1, d2 = rays[3], rays[4], rays[5]
    way, levels, signs, mirrors = rays[6], rays[7], rays[8], rays[9]
    zero, nought = floats(0.0), ints(0)
    o, d, inv = (zero, zero, zero), (zero, zero, zero), (zero, zero, zero)
    c, stride, limit = (nought, nought, nought), (nought, nought, nought), (nought, nought, nought)
    base, owner, mirror, flip, octant = nought, nought, nought, nought, nought
    t, end, iso, sign = zero, zero, zero, zero
    none = mask_of(False)
    walking, waiting = none, none
    following = 0
    while True:
        idle = ~(walking | waiting)
        if following < count and popcount(idle) > COUNT - BUSY:
            turn = rank(idle) + following
            fresh = idle & (turn < count)
            owner = select(fresh, turn, owner)
            o = choose(fresh, (take(o0, following, fresh), take(o1, following, fresh), take(o2, following, fresh)), o)
            d = choose(fresh, (take(d0, following, fresh), take(d1, following, fresh), take(d2, following, fresh)), d)
            one, huge = floats(1.0), floats(HUGE)
            inv = least(one / d[0], huge), least(one / d[1], huge), least(one / d[2], huge)
            end, iso = (
                select(fresh, take(way, following, fresh), end),
                select(fresh, take(levels, following, fresh), iso),
            )
            told = take(signs, following, fresh)
            mirror = select(fresh, ints(take(mirrors, following, fresh)), mirror)
            following = min(count, following + popcount(idle))
            octant = (mirror & 7) << 2
            flip = ((mirror & 1) * 3) | ((mirror & 2) * 6) | ((mirror & 4) * 12)
            stride, base = strides_of(mirror, bx, bx * by, (bx - 1, by - 1, bz - 1))
            x, x_end = enter_box(o[0], (mirror & 1) != 0, nx)
            y, y_end = enter_box(o[1], (mirror & 2) != 0, ny)
            z, z_end = enter_box(o[2], (mirror & 4) != 0, nz)
            start, limit = (x, y, z), (x_end, y_end, z_end)
            c = choose(fresh, start, c)
            t = select(fresh, 0.0, t)
            corner = least_node(c, mirror, shape)
            value = gather(flat, corner)
            here = select(value > iso, floats(1.0), -1.0)
            doubtful, _, _ = look(bricks, c, octant, flip, stride, base)
            lost = fresh & ((mirror >= STRAY) | (doubtful & (told == 0.0)) | (~doubtful & (told + here == 0.0)))
            mark(found, owner, ASK, lost)
            sign = select(fresh, select(told == 0.0, here, told), sign)
            walking = walking | (fresh & ~lost)
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
            stops, keep, size = look(bricks, c, octant, flip, stride, base)
            stops = stops & walking
            waiting = waiting | stops
            walking = walking & ~stops
            out, after = leave(o, d, inv, c, (c[0] & keep, c[1] & keep, c[2] & keep), size)
            gone = walking & ((after[0] >= limit[0]) | (after[1] >= limit[1]) | (after[2] >= limit[2]))
            mark(found, owner, ASK, gone & (out < end - 1e-4))
            walking = walking & ~gone
            t = select(walking, out, t)
            c = choose(walking, after, c)
        if popcount(waiting) >= WAITING or popcount(walking) == 0:
            vs, vb = strides_of(mirror, nx, nx * ny, (BRICK * bx, BRICK * by, BRICK * bz))
            brick = linear((c[0] >> 2, c[1] >> 2, c[2] >> 2), stride, base)
            place = select(waiting, linear(c, vs, vb), nought)
            safe = choose(waiting, vs, (nought, nought, nought))
            out, after = leave(o, d, inv, c, c, ints(1))
            passed = certain(flat, bricks, place, safe, brick, c, o, d, t, out, iso, sign) & waiting
            report(found, entries, owner, least_node(c, mirror, shape), sign, t, waiting & ~passed)
            gone = passed & ((after[0] >= limit[0]) | (after[1] >= limit[1]) | (after[2] >= limit[2]))
            mark(found, owner, ASK, gone & (out < end - 1e-4))
            passed = passed & ~gone
            t = select(passed, out, t)
            c = choose(passed, after, c)
            walking = walking | passed
            waiting = none


@kernel()
def least_node(c, mirror, shape):
    """Flat index of the corner of the lanes' cells that is lowest in the volume, which names the cell.

    Cells that stand beyond the last one, to fill up a brick, get the last one's name.
    """
    nz, ny, nx = shape
    x = unmirror(c[0], (mirror & 1) != 0, nx)
    y = unmirror(c[1], (mirror & 2) != 0, ny)
    z = unmirror(c[2], (mirror & 4) != 0, nz)
    return (z * ny + y) * nx + x


@kernel()
def enter_box(x, mirrored, n):
    """The cell of mirrored coordinate ``x`` along an axis of ``n`` voxels, and the cell behind the last one."""
    padded = (n - 1 + BRICK - 1) // BRICK * BRICK
    lowest = select(mirrored, ints(padded - (n - 1)), ints(0))
    end = select(mirrored, ints(padded), ints(n - 1))
    i = most(ints(x), lowest)
    return select(i < end, i, end - 1), end


@kernel()
def unmirror(c, mirrored, n):
    """Cell index in the volume along an axis of ``n`` voxels."""
    cells = (n - 1 + BRICK - 1) // BRICK * BRICK
    c = select(mirrored, ints(cells - 1) - c, c)
    return select(c > n - 2, ints(n - 2), c)
