"""The loop of all paths: what their rays meet, and what they gather, are chosen by record.

``scene`` is what rays meet, with its ``field``: Open, Coloured, InRoom, Among, or Through. ``source`` is what paths
gather: the light of Surroundings or of Glows, their PathEnds, or Strays. ``rules`` say how they go on: PathRules, or a
PathTree. Each of these says in its module how the steps of the loop are taken: see ``Choice``.
"""

from typing import Any, NamedTuple

import numpy as np

from isogi_core.kernels._jit import Choice, kernel
from isogi_core.kernels.tracing.walls import NO_WALL
from isogi_core.kernels.transport.paths import PathRules, SampleRange
from isogi_core.kernels.transport.wavefront import (
    WAVE_PATHS,
    Vertices,
    generate,
    make_vertices,
    make_wave,
    russian_roulette,
    sample_direction,
    whole,
)


class ShadowRays(NamedTuple):
    """Shadow rays of a wave: room (3 n,) for where they start and what they carry, and how far they reach, (n,)."""

    starts: Any
    light: Any
    reach: Any


class PathWave(NamedTuple):
    """The ``rays`` of a wave of paths that gather light, and its ``shadow`` rays.

    (n,) are the walls that vertices stand on, ``own``, and that rays ``met``. ``carried`` (3, paths) is what light at a
    path's vertex counts in what it has ``gathered`` (channels, paths).
    """

    rays: Any
    shadow: Any
    own: Any
    met: Any
    carried: Any
    gathered: Any


@Choice
def limits(rules):
    """How many bounces paths have at most, and in how many branches they go on from what they hit first."""


@Choice
def make_state(scene, starts, wave):
    """The state of a wave in a scene: a record with that ``wave``, and room for what rays need besides."""


@Choice
def launch_starts(scene, starts):
    """Where first rays start, (3, g)."""


@Choice
def begin_wave(scene, state, vertices, starts, first):
    """Say on what the first vertices of a wave stand, whose first path has the number ``first``."""


@Choice
def gather_sources(scene, state, vertices, bounce, source):
    """Add what rays towards the sources bring to the vertices of a wave."""


@Choice
def meet(scene, state, vertices, bounce):
    """Cast the rays of a wave, and write what each of them meets first."""


@Choice
def gather_met(scene, state, vertices, bounce, source):
    """Gather what the cast rays brought; list the rays whose paths go on from what they hit: returns how many."""


@Choice
def advance(scene, state, vertices, following, bounce, rules):
    """Move the paths that go on to the vertices ``following``; what they carry is multiplied by the albedo there."""


@Choice
def split(scene, state, vertices, spare, bounce, rules, source):
    """Let paths that go on from ``vertices`` branch: returns their vertices then, and the ``spare`` vertices."""


@limits.case(PathRules)
def limits_of_weights(rules):
    """Paths have as many bounces as there are weights beside the first, and no branches."""
    return rules.weights.shape[0] - 1, 1


@split.case()
def stay_single(scene, state, vertices, spare, bounce, rules, source):
    """Let no path branch."""
    return vertices, spare


@gather_sources.case()
def gather_nothing(scene, state, vertices, bounce, source):
    """Cast no rays towards sources: there are none."""


@kernel()
def make_shadow_rays(n):
    """Room for the shadow rays of a wave of ``n`` paths."""
    return ShadowRays(np.zeros(3 * n), np.empty(3 * n), np.empty(n))


@kernel()
def make_paths(n, rules, total, gathered):
    """The waves of ``n`` of ``total`` paths, which carry the first weight, and have ``gathered`` nothing yet."""
    gathered[:, :total] = 0.0
    carried = np.empty((3, total))
    for c in range(3):
        carried[c] = rules.weights[0, c]
    return PathWave(make_wave(n), make_shadow_rays(n), np.full(n, NO_WALL), np.full(n, NO_WALL), carried, gathered)


@kernel()
def add_carried(wave, i, light):
    """Add ``light`` that arrives at the vertex of path ``i`` of a wave to what it has gathered."""
    m = wave.rays.owners[i]
    for c in range(3):
        wave.gathered[c, m] += wave.carried[c, m] * light[c]


@kernel()
def walk(scene, state, vertices, spare, rules, source):
    """Walk the paths of a wave to their ends, and gather on the way; ``spare`` is room for other vertices."""
    rays, (last, _) = state.wave.rays, limits(rules)
    for bounce in range(last + 1):
        gather_sources(scene, state, vertices, bounce, source)
        sample_direction(rays, vertices, bounce, scene.field.spacing)
        meet(scene, state, vertices, bounce)
        hits = gather_met(scene, state, vertices, bounce, source)
        hits = russian_roulette(rays, hits, bounce, rules.survival)
        if hits == 0 or bounce == last:
            return
        following = Vertices(spare.points, spare.normals, hits)
        advance(scene, state, vertices, following, bounce, rules)
        vertices, spare = split(scene, state, following, vertices, bounce, rules, source)


@kernel()
def places_for(total, branches):
    """The places of a wave, at most WAVE_PATHS or so, for ``total`` paths that go on in this number of ``branches``."""
    return whole(min(WAVE_PATHS // branches, total)) * branches


@kernel()
def trace_paths(scene, starts, samples, rules, source, wave):
    """Walk a ``SampleRange`` of paths from each of g ``starts``, in waves that fill the places of ``wave``.

    Path s · g + i is the sample ``first + s`` of start i.
    """
    total, n, most = (
        starts.isovalues.shape[0] * samples.count,
        wave.rays.owners.shape[0],
        WAVE_PATHS // limits(rules)[1],
    )
    origins, room, spare = launch_starts(scene, starts), make_vertices(n), make_vertices(n)
    state = make_state(scene, starts, wave)
    for first in range(0, total, most):
        vertices = Vertices(room.points, room.normals, min(most, total - first))
        generate(wave.rays, vertices, starts, origins, samples.first, first)
        begin_wave(scene, state, vertices, starts, first)
        walk(scene, state, vertices, spare, rules, source)


@kernel()
def gather_paths(scene, starts, samples, rules, source, gathered):
    """Write what each path of ``trace_paths`` gathers to ``gathered`` (channels, at least g · count)."""
    total = starts.isovalues.shape[0] * samples.count
    trace_paths(scene, starts, samples, rules, source, make_paths(places_for(total, 1), rules, total, gathered))


@kernel()
def add_paths(scene, starts, samples, rules, source, sums):
    """Add what a ``SampleRange`` of paths gathers at each of g ``starts`` to its ``sums`` (g, channels).

    Sums grow sample by sample: the company of a start changes no bit. Source: Kajiya 1986.
    """
    g, last = sums.shape[0], samples.first + samples.count
    step = max(WAVE_PATHS // max(g, 1), 1)
    gathered = np.empty((sums.shape[1], g * step))
    for first in range(samples.first, last, step):
        some = SampleRange(first, min(step, last - first))
        gather_paths(scene, starts, some, rules, source, gathered)
        for m in range(g * some.count):
            for j in range(sums.shape[1]):
                sums[m % g, j] += gathered[j, m]
