"""Paths that gather the light of glowing regions alone, among several isosurfaces in a room: see ``glow_paths``.

What glows may be behind surfaces that let rays pass: a ray that passes one by chance gathers on, and one that is aimed
at a region gathers on with the share that passes.
"""

import math

from numba import types

from isogi_core.kernels._jit import kernel
from isogi_core.kernels.tracing.glow import GLOWS, Glows
from isogi_core.kernels.tracing.walls import REAL_ROWS
from isogi_core.kernels.transport.glow_paths import add_glow, aim_at_glow
from isogi_core.kernels.transport.integrate import add_paths, gather_sources
from isogi_core.kernels.transport.paths import PATH_RULES, SAMPLE_RANGE
from isogi_core.kernels.transport.room_paths import STARTS_RECORD
from isogi_core.kernels.transport.streams import MAX_CROSSINGS
from isogi_core.kernels.transport.surface_paths import AMONG_RECORD, Among, cast_at_all, cast_past, goes_on
from isogi_core.kernels.transport.wavefront import columns


@kernel()
def gather_to_crossings(scene, company, vertices, k, glows, place, going):
    """Add what pending rays gather of region ``k``, each time what ends at their next crossing: how many go on.

    Their ``place`` is the bounce and the crossing.
    """
    wave, staying, (bounce, crossing) = company.wave, 0, place
    for j in range(going):
        i = company.pending[j]
        before = company.passed[i]
        company.pending[staying] = i
        on = goes_on(scene.surfaces, company, i, bounce, crossing, True)
        staying += on
        ends = before - company.passed[i] if on else before
        add_glow(wave, vertices, i, k, scene, glows, ends)
    return staying


@gather_sources.case(Among, Glows)
def gather_aimed_among(scene, state, vertices, bounce, glows):
    """Add what rays towards each of the regions gather before what ends them, share by share."""
    shadow, count = state.wave.shadow, vertices.count
    for k in range(glows.rates.shape[0]):
        if aim_at_glow(state.wave, vertices, bounce, glows, k, scene.field.spacing) == 0:
            continue
        origins, going = columns(shadow.starts, count), 0
        origins[:, count:] = math.inf
        cast_at_all(scene, state, origins, count)
        for i in range(count):
            state.passed[i], shadow.reach[i], state.pending[going] = 1.0, math.inf, i
            going += origins[0, i] < math.inf
        for crossing in range(MAX_CROSSINGS):
            going = gather_to_crossings(scene, state, vertices, k, glows, (bounce, crossing), going)
            if going == 0:
                break
            for surface in range(scene.surfaces.clears.shape[0]):
                cast_past(scene, state, surface, origins, count, going)


@kernel(types.void(AMONG_RECORD, STARTS_RECORD, SAMPLE_RANGE, PATH_RULES, GLOWS, REAL_ROWS))
def glow_among_surfaces(scene, starts, samples, rules, glows, sums):
    """Add E/π of each of k ``glows``, of radiance 1, at each of g ``RoomStarts`` to ``sums`` (g, 3 k).

    Rays meet the surfaces of the ``scene``, which is Among, as those of ``light_among_surfaces`` do, and gather as
    those of ``glow_in_room``; the room about the surfaces gives off no light. Source: Kajiya 1986; a lesion behind
    clear surfaces as in Beason et al. 2006 (S3).
    """
    add_paths(scene, starts, samples, rules, glows, sums)
