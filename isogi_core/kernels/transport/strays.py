"""Strays: starts of paths of which one meets a surface outside of a box.

What lies outside may be taken away, and the paths of all others stay as they are, to the bit: no ray of theirs met
anything there, and where there is less matter nothing new is in their way.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel, record
from isogi_core.kernels.tracing.active_cells import ACTIVE_CELLS
from isogi_core.kernels.tracing.field import FIELD
from isogi_core.kernels.tracing.vec import column, madd
from isogi_core.kernels.transport.paths import SAMPLE_RANGE
from isogi_core.kernels.transport.transfer import COLUMNS, PLACE, ROWS, start_halves
from isogi_core.kernels.transport.wavefront import (
    WAVE,
    Vertices,
    columns,
    first_of_wave,
    generate,
    go_on,
    intersect,
    launch_all,
    make_vertices,
    make_wave,
    partition,
    russian_roulette,
    sample_direction,
    whole,
)


class Confines(NamedTuple):
    """Where paths may meet surfaces: a ``box`` (2, 3) of index space, its least and its greatest corner.

    Paths go on as a ``PathTree`` says: by its ``bounces``, ``survival`` and ``branches``.
    """

    bounces: int
    survival: float
    branches: int
    box: Any


CONFINES = record(Confines, types.int64, types.float64, types.int64, COLUMNS)


@kernel()
def is_within(p, box):
    """Whether the point ``p`` lies in a ``box``."""
    return box[0, 0] <= p[0] <= box[1, 0] and box[0, 1] <= p[1] <= box[1, 1] and box[0, 2] <= p[2] <= box[1, 2]


@kernel()
def mark_strays(wave, points, count, hits, box, strays):
    """Mark the starts whose rays, of ``count`` from ``points``, hit something outside of the ``box``.

    The ``hits`` of all others are left; returns how many.
    """
    origins, directions, staying = columns(points, count), columns(wave.directions, count), 0
    for h in range(hits):
        i = wave.hits[h]
        start = wave.owners[i] % strays.shape[0]
        if not is_within(madd(column(origins, i), wave.t[i], column(directions, i)), box):
            strays[start] = True
        wave.hits[staying] = i
        staying += not strays[start]
    return staying


@kernel()
def walk_within(field, cells, wave, vertices, spare, confines, stride, strays):
    """Walk the paths of a wave as ``walk_wave`` does, but none of a stray any farther."""
    for bounce in range(confines.bounces + 1):
        count = vertices.count
        sample_direction(wave, vertices, bounce, field.spacing)
        intersect(field, cells, wave, vertices.points, count)
        hits = mark_strays(wave, vertices.points, count, partition(wave, count), confines.box, strays)
        hits = russian_roulette(wave, hits, bounce, confines.survival)
        if hits == 0 or bounce == confines.bounces:
            return
        branches = confines.branches if bounce == 0 else 1
        vertices, spare = go_on(field, wave, vertices, spare, hits, branches, stride)


@kernel()
def walk_strays(field, cells, starts, samples, confines, strays):
    """Mark which of g ``PathStarts`` are ``strays`` (g,), by a ``SampleRange`` of the paths of ``walk_paths``."""
    total = starts.isovalues.shape[0] * samples.count
    origins, first = launch_all(field, starts), first_of_wave(confines.branches)
    n = whole(min(first, total)) * confines.branches
    wave, room, spare = make_wave(n), make_vertices(n), make_vertices(n)
    for begin in range(0, total, first):
        vertices = Vertices(room.points, room.normals, min(first, total - begin))
        generate(wave, vertices, starts, origins, samples.first, begin)
        walk_within(field, cells, wave, vertices, spare, confines, total, strays)


@kernel(types.void(FIELD, ACTIVE_CELLS, PLACE, ROWS, SAMPLE_RANGE, CONFINES, types.boolean[::1]))
def find_strays(field, cells, place, rows, samples, confines, strays):
    """Mark which of the ``rows`` are ``strays`` (m,), by a ``SampleRange`` of each of their two halves.

    ``place`` is what ``locate_texels`` took and wrote, and the paths are those of ``bake_texels``.
    """
    together = max(WAVE // (2 * samples.count), 1)
    for i in range(0, rows.shape[0], together):
        some = rows[i : i + together]
        marks = np.zeros(2 * some.shape[0], np.bool_)
        walk_strays(field, cells, start_halves(place, some), samples, confines, marks)
        for k in range(some.shape[0]):
            strays[some[k]] |= marks[2 * k] | marks[2 * k + 1]
