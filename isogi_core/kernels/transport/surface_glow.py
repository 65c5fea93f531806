"""Paths that gather the light of glowing regions alone, among several isosurfaces in a room: see ``glow_paths``.

What glows may be behind surfaces that let rays pass: a ray that passes one by chance gathers on, and one that is aimed
at a region gathers on with the share that passes.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel
from isogi_core.kernels.tracing.field import FIELD
from isogi_core.kernels.tracing.glow import GLOWS
from isogi_core.kernels.tracing.walls import ROWS
from isogi_core.kernels.transport.glow_paths import aim_at_glow, gather, gather_all
from isogi_core.kernels.transport.paths import PATH_RULES, SAMPLE_RANGE, SampleRange
from isogi_core.kernels.transport.room_paths import STARTS, add_gathered, first_carried, launch_in_room
from isogi_core.kernels.transport.surface_paths import (
    CROSSINGS,
    SURFACES,
    cast_at_all,
    cast_on,
    follow,
    go_on,
    goes_on,
    make_company,
    set_out,
)
from isogi_core.kernels.transport.wavefront import (
    WAVE,
    Vertices,
    columns,
    make_vertices,
    sample_direction,
    whole,
)


class GlowAmong(NamedTuple):
    """What paths meet and what they gather: the ``surfaces`` of a ``field`` in a dark room, and ``glows``."""

    field: Any
    surfaces: Any
    glows: Any


@kernel()
def gather_to_crossings(company, vertices, k, scene, bounce, crossing, going):
    """Add what pending rays gather of region ``k``, each time what ends at their next crossing: how many go on."""
    wave, staying = company.wave, 0
    for j in range(going):
        i = company.pending[j]
        before = company.passed[i]
        company.pending[staying] = i
        on = goes_on(scene.surfaces, company, i, bounce, crossing, True)
        staying += on
        ends = before - company.passed[i] if on else before
        gather(wave, vertices, i, k, scene, wave.shadow.wave.t[i], ends)
    return staying


@kernel()
def gather_aimed(company, vertices, bounce, scene):
    """Add what rays towards each of the regions gather before what ends them, share by share."""
    shadow, count = company.wave.shadow, vertices.count
    for k in range(scene.glows.rates.shape[0]):
        if aim_at_glow(company.wave, vertices, bounce, scene.glows, k, scene.field.spacing) == 0:
            continue
        origins, going = columns(shadow.starts, count), 0
        origins[:, count:] = math.inf
        cast_at_all(scene.field, scene.surfaces, company, origins, count)
        for i in range(count):
            company.passed[i], shadow.reach[i], company.pending[going] = 1.0, math.inf, i
            going += origins[0, i] < math.inf
        for crossing in range(CROSSINGS):
            going = gather_to_crossings(company, vertices, k, scene, bounce, crossing, going)
            if going == 0:
                break
            for surface in range(scene.surfaces.clears.shape[0]):
                cast_on(scene.field, scene.surfaces, company, surface, origins, count, going)


@kernel()
def glow_wave(company, vertices, spare, scene, rules):
    """Walk the paths of a wave to their ends and gather glow, as ``surface_paths.light_wave`` does light."""
    rays, last = company.wave.shadow.wave, rules.weights.shape[0] - 1
    for bounce in range(last + 1):
        count = vertices.count
        gather_aimed(company, vertices, bounce, scene)
        sample_direction(rays, vertices, bounce, scene.field.spacing)
        follow(scene.field, scene.surfaces, company, vertices.points, bounce, count, False)
        hits = gather_all(company.wave, vertices, bounce, scene, scene.surfaces.room, rules.survival)
        if hits == 0 or bounce == last:
            return
        following = Vertices(spare.points, spare.normals, hits)
        go_on(scene.field, scene.surfaces, company, vertices, following, bounce, rules.survival)
        vertices, spare = following, vertices


@kernel()
def glow_paths(scene, starts, samples, rules, gathered):
    """Write what each path of a ``SampleRange`` gathers to ``gathered`` (3 k, at least g · count)."""
    total = starts.isovalues.shape[0] * samples.count
    carried = first_carried(rules, total, gathered)
    origins, n = launch_in_room(scene.field, starts), whole(min(WAVE, total))
    company, space, spare = make_company(n, scene.surfaces, carried, gathered), make_vertices(n), make_vertices(n)
    for first in range(0, total, WAVE):
        vertices = Vertices(space.points, space.normals, min(WAVE, total - first))
        set_out(scene.field, scene.surfaces, company, vertices, starts, origins, samples.first, first)
        glow_wave(company, vertices, spare, scene, rules)


@kernel(types.void(FIELD, SURFACES, STARTS, SAMPLE_RANGE, PATH_RULES, GLOWS, ROWS))
def glow_among_surfaces(field, surfaces, starts, samples, rules, glows, sums):
    """Add E/π of each of k ``glows``, of radiance 1, at each of g ``RoomStarts`` to ``sums`` (g, 3 k).

    Rays meet ``surfaces`` as those of ``light_among_surfaces`` do, and gather as those of ``glow_in_room``; the room
    about the surfaces gives off no light. Source: Kajiya 1986; a lesion behind clear surfaces as in Beason et al. 2006
    (S3).
    """
    g, last = starts.isovalues.shape[0], samples.first + samples.count
    step = max(WAVE // max(g, 1), 1)
    scene, gathered = GlowAmong(field, surfaces, glows), np.empty((sums.shape[1], g * step))
    for first in range(samples.first, last, step):
        some = SampleRange(first, min(step, last - first))
        glow_paths(scene, starts, some, rules, gathered)
        add_gathered(gathered, some.count, sums)
