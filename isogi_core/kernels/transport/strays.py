"""Strays: starts of paths of which one meets a surface outside of a box.

What lies outside may be taken away, and the paths of all others stay as they are, to the bit: no ray of theirs met
anything there, and where there is less matter nothing new is in their way.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel, record
from isogi_core.kernels.tracing.active_cells import ACTIVE_CELLS
from isogi_core.kernels.tracing.field import FIELD_RECORD
from isogi_core.kernels.tracing.vec import column, madd
from isogi_core.kernels.transport.ends import EndWave
from isogi_core.kernels.transport.integrate import gather_met, places_for, trace_paths
from isogi_core.kernels.transport.open_paths import Open
from isogi_core.kernels.transport.paths import SAMPLE_RANGE, PathTree
from isogi_core.kernels.transport.transfer import PLACE, REAL_ROWS, ROW_ARRAY, start_halves
from isogi_core.kernels.transport.wavefront import WAVE_PATHS, columns, make_wave, partition


class Confines(NamedTuple):
    """Where paths may meet surfaces: a ``box`` (2, 3) of index space, its least and its greatest corner.

    Paths go on as a ``PathTree`` says: by its ``bounces``, ``survival`` and ``branches``.
    """

    bounces: int
    survival: float
    branches: int
    box: Any


class Strays(NamedTuple):
    """Which of g starts have a path that met something outside of a ``box``, ``marks`` (g,): it ends there."""

    box: Any
    marks: Any


CONFINES_RECORD = record(Confines, types.int64, types.float64, types.int64, REAL_ROWS)


@kernel()
def is_within(p, box):
    """Whether the point ``p`` lies in a ``box``."""
    return box[0, 0] <= p[0] <= box[1, 0] and box[0, 1] <= p[1] <= box[1, 1] and box[0, 2] <= p[2] <= box[1, 2]


@gather_met.case(Strays)
def mark_strays(scene, state, vertices, bounce, strays):
    """Mark the starts whose rays hit something outside of the box; returns how many go on, of all others."""
    rays, count, staying = state.wave.rays, vertices.count, 0
    origins, directions = columns(vertices.points, count), columns(rays.directions, count)
    for h in range(partition(rays, count)):
        i = rays.hits[h]
        start = rays.owners[i] % strays.marks.shape[0]
        if not is_within(madd(column(origins, i), rays.t[i], column(directions, i)), strays.box):
            strays.marks[start] = True
        rays.hits[staying] = i
        staying += not strays.marks[start]
    return staying


@kernel()
def trace_strays(scene, starts, samples, confines, marks):
    """Mark which of g ``PathStarts`` stray, ``marks`` (g,), by a ``SampleRange`` of the paths of ``trace_ends``."""
    tree = PathTree(confines.bounces, confines.survival, confines.branches)
    total = starts.isovalues.shape[0] * samples.count
    wave = EndWave(make_wave(places_for(total, tree.branches)), total, np.ones((3, 0)))
    trace_paths(scene, starts, samples, tree, Strays(confines.box, marks), wave)


@kernel(types.void(FIELD_RECORD, ACTIVE_CELLS, PLACE, ROW_ARRAY, SAMPLE_RANGE, CONFINES_RECORD, types.boolean[::1]))
def find_strays(field, cells, place, rows, samples, confines, strays):
    """Mark which of the ``rows`` are ``strays`` (m,), by a ``SampleRange`` of each of their two halves.

    ``place`` is what ``locate_texels`` took and wrote, and the paths are those of ``bake_texels``.
    """
    together = max(WAVE_PATHS // (2 * samples.count), 1)
    for i in range(0, rows.shape[0], together):
        some = rows[i : i + together]
        marks = np.zeros(2 * some.shape[0], np.bool_)
        trace_strays(Open(field, cells), start_halves(place, some), samples, confines, marks)
        for k in range(some.shape[0]):
            strays[some[k]] |= marks[2 * k] | marks[2 * k + 1]
