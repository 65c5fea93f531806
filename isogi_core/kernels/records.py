"""Records: rays as scouts take them, mirrored, in float32, side by side in memory."""

import math

from isogi_core.kernels._jit import kernel
from isogi_core.kernels.bricks import BRICK
from isogi_core.kernels.crossings import clip_box_lanes, longest_of
from isogi_core.kernels.intersect import UNKNOWN
from isogi_core.kernels.lane_memory import load, store
from isogi_core.kernels.lanes import COUNT, bits, floats, ints, lane_numbers, magnitude, select

FIELDS = 10
"""Numbers of a record: origin, direction (x, y, z, mirrored), way to the exit, isovalue, sign, mirror."""

EVERY = (1 << COUNT) - 1
"""The bits of all lanes."""

STRAY = 8
"""The bit of a mirror that says: no ray to follow, ask ``cast``."""


@kernel()
def mirrored(d, here, size):
    """A direction's component and a place along an axis of ``size``, mirrored where descending: (d, place, mask)."""
    descends = d < 0.0
    return floats(magnitude(d)), floats(select(descends, size - here, here)), descends


@kernel()
def record_lanes(shape, bricks_shape, isovalues, origins, directions, sides, m, records, spans, r):
    """Write the records of COUNT rays from ray ``m`` on to column ``r`` of ``records`` and ``spans``.

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
        store(records[a], r, here)
        store(records[3 + a], r, step)
    side = floats(load(sides, m))
    store(records[6], r, floats((far - near) * longest))
    store(records[7], r, floats(load(isovalues, m)))
    store(records[8], r, select(near == 0.0, -side, float(UNKNOWN)))
    store(records[9], r, floats(mirror))
    store(spans[0], r, near)
    store(spans[1], r, far)
    return bits(near < far)


@kernel()
def close_ranks(records, spans, owners, r, met):
    """Move those of the COUNT columns from ``r`` on whose bit is set in ``met`` together; returns their end."""
    for column in range(r, r + COUNT):
        if met & 1:
            for field in range(FIELDS):
                records[field, r] = records[field, column]
            spans[0, r], spans[1, r], owners[r] = spans[0, column], spans[1, column], owners[column]
            r += 1
        met >>= 1
    return r


@kernel()
def prepare(shape, bricks_shape, isovalues, origins, directions, sides, first, last, records, spans, owners):
    """Write the records of those rays first … last that meet the box to ``records`` (FIELDS, n); returns how many.

    ``owners`` (n,) gets their numbers, ``spans`` (2, n) what ``clip_box`` gives for them. There are COUNT rays
    or more from 0 on, and room for COUNT records more.
    """
    count = 0
    for i in range(first, last, COUNT):
        m = max(min(i, last - COUNT), 0)
        met = record_lanes(shape, bricks_shape, isovalues, origins, directions, sides, m, records, spans, count)
        store(owners, count, lane_numbers() + m)
        met &= EVERY << (i - m)
        count = count + COUNT if met == EVERY else close_ranks(records, spans, owners, count, met)
    return count
