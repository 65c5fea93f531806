"""Paths whose ends are gathered: after how many bounces each left, and in which direction, for any light to come."""

from typing import Any, NamedTuple

import numpy as np

from isogi_core.kernels._jit import Choice, kernel
from isogi_core.kernels.simd.types import PATH_WIDTH
from isogi_core.kernels.tracing.vec import column, put_column
from isogi_core.kernels.transport.integrate import gather_met, limits, places_for, split, trace_paths
from isogi_core.kernels.transport.paths import NO_PATH, PathEnds, PathTree
from isogi_core.kernels.transport.wavefront import Vertices, columns, make_wave, partition


class EndWave(NamedTuple):
    """The ``rays`` of a wave of paths that gather no light, of which ``starting`` ones start and may branch.

    ``carried`` (3, paths) are the albedos that each has met, multiplied, where these differ from place to place.
    """

    rays: Any
    starting: int
    carried: Any


@Choice
def begin_branches(scene, wave, count, source):
    """Say what the ``count`` branches of a wave have gathered and carry."""


@begin_branches.case()
def begin_alike(scene, wave, count, source):
    """Leave all as it is: branches are known by the paths that they are of."""


@limits.case(PathTree)
def limits_of_tree(rules):
    """Say how far a ``PathTree`` goes."""
    return rules.bounces, rules.branches


@kernel()
def blocks(branches):
    """How many parts the ``PathEnds`` have: one of paths as they start, and one for each of their ``branches``."""
    return 1 if branches == 1 else 1 + branches


@kernel()
def make_ends(starts, count, branches):
    """Room for the ``PathEnds`` of ``starts`` starts, ``count`` samples each."""
    n = blocks(branches) * starts * count
    return PathEnds(np.zeros(n, np.int64), np.zeros((3, n + PATH_WIDTH)))


@kernel()
def branch(wave, vertices, room, branches, stride):
    """Let each of the wave's paths go on in a number of ``branches``, from vertices in ``room``, which it returns.

    Branch j of path m is path m + (1 + j) · ``stride``, and draws from sample ``branches`` · s + j.
    """
    hits, count = vertices.count, branches * vertices.count
    points, normals = columns(vertices.points, hits), columns(vertices.normals, hits)
    further, around = columns(room.points, count), columns(room.normals, count)
    for h in range(hits - 1, -1, -1):  # each is read before others are written in its place
        owner, sample, isovalue = wave.owners[h], wave.samples[h], wave.isovalues[h]
        low, high, side, sign = wave.low[h], wave.high[h], wave.sides[h], wave.signs[h]
        for j in range(branches):
            i = branches * h + j
            wave.owners[i], wave.samples[i] = owner + (1 + j) * stride, branches * sample + j
            wave.low[i], wave.high[i], wave.isovalues[i] = low, high, isovalue
            wave.sides[i], wave.signs[i] = side, sign
            put_column(further, i, column(points, h))
            put_column(around, i, column(normals, h))
    return Vertices(room.points, room.normals, count)


@split.case(PathTree)
def branch_once(scene, state, vertices, spare, bounce, rules, source):
    """Let paths branch that go on from what they hit first."""
    if bounce > 0 or rules.branches == 1:
        return vertices, spare
    following = branch(state.wave.rays, vertices, spare, rules.branches, state.wave.starting)
    begin_branches(scene, state.wave, following.count, source)
    return following, vertices


@kernel()
def branch_ends(wave, count, ends):
    """Say of the wave's ``count`` branches that they have not left, and of the paths that they are of nothing."""
    for owner in wave.rays.owners[:count]:
        ends.bounces[owner % wave.starting], ends.bounces[owner] = NO_PATH, -1


@begin_branches.case(PathEnds)
def begin_ends(scene, wave, count, ends):
    """Say of the wave's branches that they have not left."""
    branch_ends(wave, count, ends)


@gather_met.case(PathEnds)
def write_ends(scene, state, vertices, bounce, ends):
    """Write the ends of paths that leave; returns how many go on."""
    rays, count = state.wave.rays, vertices.count
    hits, ways = partition(rays, count), columns(rays.ways, count)
    for i in rays.escaped[: count - hits]:
        m = rays.owners[i]
        ends.bounces[m] = bounce
        put_column(ends.directions, m, column(ways, i))
    return hits


@kernel()
def trace_ends(scene, starts, samples, tree, ends, carried):
    """Walk a ``SampleRange`` of paths from each of g ``PathStarts``, as a ``PathTree`` says, to their ends.

    Isovalues are within the range of the scene's cells. Writes the ``PathEnds`` of at least g · count paths, and what
    these have ``carried``.
    """
    total = starts.isovalues.shape[0] * samples.count
    ends.bounces[:total], ends.bounces[total:] = -1, NO_PATH
    ends.directions[:], carried[:, :total] = 0.0, 1.0
    rays = make_wave(places_for(total, tree.branches))
    wave = EndWave(rays, ends.bounces.shape[0] // blocks(tree.branches), carried)
    trace_paths(scene, starts, samples, tree, ends, wave)
