"""Paths in the open: their rays meet one isosurface, and nothing else."""

from typing import Any, NamedTuple

from isogi_core.kernels._jit import Choice, record
from isogi_core.kernels.tracing.active_cells import ACTIVE_CELLS
from isogi_core.kernels.tracing.field import FIELD_RECORD
from isogi_core.kernels.transport.integrate import advance, begin_wave, launch_starts, make_state, meet
from isogi_core.kernels.transport.paths import PathRules
from isogi_core.kernels.transport.wavefront import compact, intersect, launch_all, next_vertex


class Open(NamedTuple):
    """One isosurface of a ``field``, within its active ``cells``, and nothing else that rays meet.

    What paths carry by PathRules after k bounces is row k of their weights (bounces + 1, 3): R^k over the chance to get
    there (see ``russian_roulette``).
    """

    field: Any
    cells: Any


OPEN = record(Open, FIELD_RECORD, ACTIVE_CELLS)


class Alone(NamedTuple):
    """The state of a ``wave`` that needs nothing else."""

    wave: Any


@Choice
def cast_wave(scene, state, points, count):
    """Cast ``count`` rays of a wave from ``points`` to what they meet first."""


@make_state.case()
def make_alone(scene, starts, wave):
    """The state of a wave that needs nothing else."""
    return Alone(wave)


@launch_starts.case()
def launch_off(scene, starts):
    """Where first rays start, (3, g): off the surface, see ``launch``, and on walls."""
    return launch_all(scene.field, starts)


@begin_wave.case()
def begin_in_the_open(scene, state, vertices, starts, first):
    """Leave the vertices as they are: all stand on the surface."""


@cast_wave.case()
def cast_at_surface(scene, state, points, count):
    """Cast a wave's rays from ``points`` at the isosurface."""
    intersect(scene.field, scene.cells, state.wave.rays, points, count)


@meet.case()
def meet_nearest(scene, state, vertices, bounce):
    """Cast the rays of a wave to what they meet first."""
    cast_wave(scene, state, vertices.points, vertices.count)


@advance.case()
def advance_in_the_open(scene, state, vertices, following, bounce, rules):
    """Move the paths that hit the surface there."""
    compact(state.wave.rays, vertices, following)
    next_vertex(scene.field, state.wave.rays, vertices.count, following)


@advance.case(Open, PathRules)
def advance_by_weights(scene, state, vertices, following, bounce, rules):
    """Move the paths that hit the surface there, to carry the weight of one more bounce."""
    rays, carried = state.wave.rays, state.wave.carried
    for i in rays.hits[: following.count]:
        for c in range(3):
            carried[c, rays.owners[i]] = rules.weights[bounce + 1, c]
    advance_in_the_open(scene, state, vertices, following, bounce, rules)
