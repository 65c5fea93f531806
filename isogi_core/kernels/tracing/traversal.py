"""Conservative traversal in float32: SIMD lanes follow rays to the first cell that may hold the
surface.

The active-cell map skips empty space. A lane stops at a cell if float32 cannot prove that the field
keeps its sign there; the float64 intersection decides then (``cast_batch``).
"""

from typing import Any, NamedTuple

from isogi_core.kernels._jit import kernel
from isogi_core.kernels.simd.maths import bits, f32, fma, i32, mask_of, popcount, rank, where
from isogi_core.kernels.simd.memory import gather, gather_pair, take
from isogi_core.kernels.simd.types import RAY_WIDTH
from isogi_core.kernels.tracing.active_cells import BRICK_CELLS, POSITION_ERROR
from isogi_core.kernels.tracing.ray_stream import STRAY_BIT

MIN_BUSY_LANES = RAY_WIDTH // 2
"""Lanes at work below which idle lanes take the next rays."""

MAX_WAITING_LANES = max(RAY_WIDTH // 3, 1)
"""Lanes that wait at a cell that may hold the surface, from which on these cells are tested."""

MISS = -1
UNSURE = -2
"""Results of the traversal that name no cell: no hit, or a case that only ``cast`` can decide.

Of 2³¹ voxels neither of the last two is the lowest corner of a cell, so that no cell has these
codes.
"""

HUGE_INVERSE = 1e30
"""Stands for 1/0, so that its product with 0 is 0."""


class Ray(NamedTuple):
    """Constants of the rays that lanes follow, f32×N and i32×N, in mirrored coordinates (all
    directions ≥ 0).

    - ``owner``: column of the ray in the stream.
    - ``o``, ``d``, ``inv``: origin, direction and its reciprocals.
    - ``end``, ``iso``: distance to the exit, and isovalue.
    - ``mirror``: axes that are mirrored, as bits.
    - ``octant``: shift of the skip distances of the direction's octant in a word of the map.
    - ``flip``: mask that turns a mirrored cell's place in its brick back.
    - ``stride``, ``base``: flat addresses of bricks (see ``linear``).
    - ``limit``: first cell behind the volume along each axis.
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
    """Return the points p + t·d of all lanes."""
    return fma(t, d[0], p[0]), fma(t, d[1], p[1]), fma(t, d[2], p[2])


@kernel()
def choose_points(mask, a, b):
    """Return the points ``a`` in lanes of the mask, else ``b``."""
    return where(mask, a[0], b[0]), where(mask, a[1], b[1]), where(mask, a[2], b[2])


@kernel()
def linear(c, stride, base):
    """Return the flat address of cell or brick ``c``."""
    return c[0] * stride[0] + c[1] * stride[1] + c[2] * stride[2] + base


@kernel()
def strides_of(mirror, y, z, last):
    """Return strides (x, y, z) and base of a flat array with rows of ``y`` and planes of ``z``, for
    mirrored lanes.

    ``last`` is the index of the last element along x, y, z.
    """
    mx, my, mz = (mirror & 1) != 0, (mirror & 2) != 0, (mirror & 4) != 0
    stride = where(mx, -1, 1), where(my, -y, y), where(mz, -z, z)
    return stride, where(mx, last[0], 0) + where(my, last[1] * y, 0) + where(mz, last[2] * z, 0)


@kernel()
def filled(n):
    """Return the cells along an axis of ``n`` voxels, rounded up to whole bricks."""
    return (n - 1 + BRICK_CELLS - 1) // BRICK_CELLS * BRICK_CELLS


@kernel()
def last_cell(descends, n):
    """Return the cell behind the last one along an axis of ``n`` voxels; ``descends`` is not 0
    if it is mirrored.
    """
    return where(descends != 0, filled(n), n - 1)


@kernel()
def first_cell(x, descends, limit, n):
    """Return the cell of the mirrored coordinate ``x`` along an axis of ``n`` voxels
    that ends before ``limit``.
    """
    lowest = where(descends != 0, filled(n) - (n - 1), 0)
    return min(max(i32(x), lowest), limit - 1)


@kernel()
def unmirror(c, descends, n):
    """Return the index in the volume of a mirrored cell along an axis of ``n`` voxels."""
    return min(where(descends != 0, filled(n) - 1 - c, c), n - 2)


@kernel()
def least_node(c, mirror, shape):
    """Return the flat index of the lowest corner of the lanes' cells, which names the cell.

    Cells beyond the last one, which only fill up a brick, get the last one's name.
    """
    nz, ny, nx = shape
    x = unmirror(c[0], mirror & 1, nx)
    y = unmirror(c[1], mirror & 2, ny)
    z = unmirror(c[2], mirror & 4, nz)
    return (z * ny + y) * nx + x


@kernel()
def look_up(cells, c, ray):
    """Look cells ``c`` up in the active-cell map: (active, mask of c's corner, side of the
    empty cube there).
    """
    # Read the word of the brick: skip distances of eight octants, or a pointer to its cells.
    top = gather(cells.tops, linear((c[0] >> 2, c[1] >> 2, c[2] >> 2), ray.stride, ray.base))
    near = (top >> 28) == 0
    # Read the word of the cell's layer: 16 bits of active cells, and 16 of cells without near ones.
    layer = (top << 2) + ((c[2] ^ (ray.flip >> 4)) & 3)
    word = gather(cells.cells, where(near, layer, 0))
    word = word >> (((c[0] & 3) | ((c[1] & 3) << 2)) ^ (ray.flip & 15))
    close = near & ((word & 0x10000) != 0)
    # Skip one or two cells within a brick, or up to 15 bricks.
    size = where(near, where(close, 1, 2), ((top >> ray.octant) & 15) << 2)
    keep = where(near, where(close, -1, -2), -4)
    return near & ((word & 1) != 0), keep, size


@kernel()
def leave(ray, c, low, size):
    """Return the points at which lanes leave a cube of cells with corner ``low``: (t, next
    cell, mask of the lanes that leave the volume).
    """
    n = low[0] + size, low[1] + size, low[2] + size
    tx = (f32(n[0]) - ray.o[0]) * ray.inv[0]
    ty = (f32(n[1]) - ray.o[1]) * ray.inv[1]
    tz = (f32(n[2]) - ray.o[2]) * ray.inv[2]
    # The nearest of the three far planes is the exit; cells never go backwards, whatever rounding
    # says.
    t = min(min(tx, ty), tz)
    p = points_along(ray.o, t, ray.d)
    x = where(tx <= t, n[0], max(c[0], i32(p[0])))
    y = where(ty <= t, n[1], max(c[1], i32(p[1])))
    z = where(tz <= t, n[2], max(c[2], i32(p[2])))
    return t, (x, y, z), (x >= ray.limit[0]) | (y >= ray.limit[1]) | (z >= ray.limit[2])


@kernel()
def lerp(a, b, t):
    """Return a + t (b - a)."""
    return fma(t, b - a, a)


@kernel()
def bernstein(v, a, b):
    """Return the Bernstein coefficients of the trilinear field from ``a`` to ``b`` in the unit cell
    with corners ``v``.

    They are values of the field's blossom: at the corners of the box between a and b, averaged. If
    all have one sign, the field keeps that sign along the segment.
    """
    # Interpolate the corners along x at both ends of the segment, then along y.
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
    # The inner coefficients average the three blossom values with one, or two, coordinates of b.
    third = 1.0 / 3.0
    one = (lerp(aa0, aa1, b[2]) + lerp(ab0, ab1, a[2]) + lerp(ba0, ba1, a[2])) * third
    two = (lerp(bb0, bb1, a[2]) + lerp(ba0, ba1, b[2]) + lerp(ab0, ab1, b[2])) * third
    return lerp(aa0, aa1, a[2]), one, two, lerp(bb0, bb1, b[2])


@kernel()
def corner_values(flat, place, turned, sy, sz, iso):
    """Return the eight corner values less the isovalue of cells with the first corner at ``place``.

    ``turned`` lanes are mirrored in x; ``sy`` and ``sz`` lead to the second corner along y and z.
    """
    # Load pairs of neighbours along x; a mirrored lane swaps them.
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
    """Return the mask of those ``lanes`` in which the field certainly keeps ``sign`` in cell
    ``c`` on the ``span`` (in, out).

    The field less the isovalue is a cubic along the ray. If its Bernstein coefficients all have the
    sign, by more than float32 can be wrong, so has the cubic.
    """
    # Gather the corners of the cell. Corners are addressed among voxels; mirroring runs from the
    # far end of the last whole brick, as the ray's mirrored coordinates do.
    flat, (_, ny, nx) = volume
    bz, by, bx = cells.shape
    stride, base = strides_of(
        ray.mirror, nx, nx * ny, (BRICK_CELLS * bx, BRICK_CELLS * by, BRICK_CELLS * bz)
    )
    turned = stride[0] < 0
    # A mirrored lane reads its pairs along x from the lower neighbour on. Lanes that are not asked
    # for read from the start of the array.
    place = linear(c, stride, base) + where(turned, -1, 0)
    sy, sz = where(lanes, stride[1], 0), where(lanes, stride[2], 0)
    v = corner_values(flat, where(lanes, place, 0), turned, sy, sz, ray.iso)
    # Compare the Bernstein coefficients with the margin of float32 errors in this brick. The cells
    # of all lanes are in the volume, also of those that are not asked for, so that each has a
    # margin.
    corner = f32(c[0]), f32(c[1]), f32(c[2])
    p = ray.o[0] - corner[0], ray.o[1] - corner[1], ray.o[2] - corner[2]
    b = bernstein(v, points_along(p, span[0], ray.d), points_along(p, span[1], ray.d))
    margin = gather(cells.margins, linear((c[0] >> 2, c[1] >> 2, c[2] >> 2), ray.stride, ray.base))
    inner = (b[0] * sign > margin) & (b[1] * sign > margin)
    return lanes & inner & (b[2] * sign > margin) & (b[3] * sign > margin)


@kernel()
def cell_of(word):
    """Return the cell of a word of ``put_cells``: its upper 31 bits."""
    return (word >> 1) & 0x7FFFFFFF


@kernel()
def put_cells(found, entries, owner, cell, sign, t, lanes):
    """Write 2 · cell + (1 if solid) of the chosen lanes to ``found`` at their rays,
    and ``t`` to ``entries``.
    """
    word = cell * 2 + where(sign > 0.0, 1, 0)
    chosen = bits(lanes)
    lane = 0
    # Lanes end at different rays, so that they are stored one by one.
    while chosen != 0:
        if chosen & 1:
            m = owner[lane]
            found[m] = word[lane]
            entries[m] = t[lane]
        chosen >>= 1
        lane += 1


@kernel()
def put_word(found, owner, word, lanes):
    """Write ``word`` to ``found`` at the rays of the chosen lanes."""
    chosen = bits(lanes)
    lane = 0
    while chosen != 0:
        if chosen & 1:
            found[owner[lane]] = word
        chosen >>= 1
        lane += 1


@kernel()
def no_ray():
    """Return a ``Ray`` of zeros in all lanes, with which ``take_rays`` blends the first rays."""
    zero = f32(0.0)
    nought = i32(0)
    point = (zero, zero, zero)
    cell = (nought, nought, nought)
    return Ray(nought, point, point, point, zero, zero, nought, nought, nought, cell, nought, cell)


@kernel()
def take_rays(records, following, turn, fresh, ray, shape, cells):
    """Return ``ray`` with rays of the stream from ``following`` on in the ``fresh`` lanes;
    ``turn`` numbers them.
    """
    nz, ny, nx = shape
    bz, by, bx = cells.shape
    # Read origin, direction, exit and isovalue of the next rays.
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
    # Derive the addresses that mirrored axes need.
    flip = ((mirror & 1) * 3) | ((mirror & 2) * 6) | ((mirror & 4) * 12)
    stride, base = strides_of(mirror, bx, bx * by, (bx - 1, by - 1, bz - 1))
    limit = last_cell(mirror & 1, nx), last_cell(mirror & 2, ny), last_cell(mirror & 4, nz)
    owner = where(fresh, turn, ray.owner)
    return Ray(owner, o, d, inv, end, iso, mirror, (mirror & 7) << 2, flip, stride, base, limit)


@kernel()
def enter(volume, cells, ray, given):
    """Return the first cells of rays: (cell, sign of the field there, mask of doubtful starts);
    ``given`` is the sign, or 0 if it is unknown.

    A start is in doubt if the field must be evaluated in an active cell, or contradicts the given
    sign.
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
    """Find the first cell that each of ``count`` rays may hit; write it to ``found`` as 2 · cell +
    (1 from a solid side), or UNSURE.

    ``volume`` is (flat voxels, shape), ``cells`` its active-cell map, ``records`` (FIELDS, n) the
    stream of rays (see ``ray_stream``). Entries of rays that hit nothing are not changed.
    ``entries`` gets the distance to that cell, in steps of the direction's largest component.
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
        # Give idle lanes the next rays of the stream, once enough of them are idle.
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
        # End if all rays are done.
        if popcount(walking | waiting) == 0:
            if following >= count:
                return
            continue
        # Let walking lanes skip empty space until enough of them wait at an active cell.
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
        # Test the cells of waiting lanes: those that certainly hold no surface walk on, others are
        # written.
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
