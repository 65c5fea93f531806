"""Paths among walls about matter that light passes: they wander over walls, and their rays pass what they meet."""

import math

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel
from isogi_core.kernels.tracing.active_cells import ACTIVE_CELLS
from isogi_core.kernels.tracing.field import FIELD
from isogi_core.kernels.tracing.intersect import SOLID, UNKNOWN
from isogi_core.kernels.tracing.vec import column, dot, put_column, scale
from isogi_core.kernels.tracing.walls import NOWHERE, ROWS
from isogi_core.kernels.transport.integrator import about
from isogi_core.kernels.transport.light_paths import SURROUNDINGS, make_shadow_rays
from isogi_core.kernels.transport.lights import arriving, radiance, row
from isogi_core.kernels.transport.matter.inside import PASSABLE
from isogi_core.kernels.transport.matter.passage import make_passage, pass_matter
from isogi_core.kernels.transport.paths import PATH_RULES, SAMPLE_RANGE, SampleRange
from isogi_core.kernels.transport.rng import point_of_words
from isogi_core.kernels.transport.room_paths import (
    STARTS,
    RoomWave,
    add_carried,
    add_gathered,
    balance_area,
    first_carried,
    gather_sources,
    lit_from,
)
from isogi_core.kernels.transport.sampling import sample_cosine_hemisphere
from isogi_core.kernels.transport.wavefront import (
    WAVE,
    Vertices,
    columns,
    compact,
    generate,
    make_vertices,
    partition,
    russian_roulette,
    sample_direction,
    whole,
)

INWARD, ALONG = -2.0, -3.0
"""In place of a wall's number: a start on the isosurface whose rays go in, cosine-weighted about its inner normal; and
one from anywhere whose ray goes along its ``normal``."""


@kernel()
def begin(wave, vertices, starts, first):
    """Say where the vertices of a wave stand, whose first path has the number ``first``.

    Those that are on no wall lose their normals: nothing is sent straight to them.
    """
    g, normals = starts.walls.shape[0], columns(vertices.normals, vertices.count)
    for m in range(vertices.count):
        wave.own[m] = starts.walls[(first + m) % g]
        wave.shadow.wave.sides[m] = UNKNOWN
        if wave.own[m] < 0.0:
            put_column(normals, m, (0.0, 0.0, 0.0))


@kernel()
def first_way(rays, starts, k, i):
    """The first way of path ``i`` of a wave, which starts at ``k``, on no wall."""
    n = column(starts.normals, k)
    if starts.walls[k] == ALONG:
        return n
    low, high, sample = np.uint64(rays.low[i]), np.uint64(rays.high[i]), np.uint64(rays.samples[i])
    u, v = point_of_words(low, high, sample, np.uint64(0))
    return about(scale(n, -1.0), sample_cosine_hemisphere(u, v))


@kernel()
def set_out(wave, vertices, passage, starts, bounce):
    """Put the wave's rays at the start of their passage; the first ones of paths that start on no wall too."""
    rays, count, g = wave.shadow.wave, vertices.count, starts.walls.shape[0]
    points, ways = columns(vertices.points, count), columns(rays.ways, count)
    for i in range(count):
        k = rays.owners[i] % g
        free = bounce == 0 and starts.walls[k] < 0.0
        if free:
            put_column(ways, i, first_way(rays, starts, k, i))
        put_column(passage.origins, i, column(points, i))
        put_column(passage.ways, i, column(ways, i))
        passage.sides[i] = SOLID if free and starts.walls[k] == INWARD else UNKNOWN
        passage.own[i], passage.straight[i] = NOWHERE if free else wave.own[i], 0.0 if free else 1.0


@kernel()
def arrive(wave, passage, count):
    """Write where rays of a passage came to the wave's: 0 on a wall, inf for those that left."""
    rays = wave.shadow.wave
    for i in range(count):
        wave.met[i] = passage.met[i]
        rays.t[i] = math.inf if passage.met[i] == NOWHERE else 0.0


@kernel()
def gather_ends(wave, vertices, passage, escaped, light):
    """Add the environment that the ``escaped`` paths leave to: all of it where no shadow ray could bring it."""
    normals = columns(vertices.normals, vertices.count)
    for i in wave.shadow.wave.escaped[:escaped]:
        w = column(passage.ways, i)
        if passage.straight[i] > 0.0:
            cosine = dot(column(normals, i), w)
            add_carried(wave, i, arriving(light.constant, light.image, light.matrix, light.table, w, cosine))
        else:
            add_carried(wave, i, radiance(light.constant, light.image, light.matrix, w))


@kernel()
def gather_walls(wave, vertices, passage, hits, room, spacing):
    """Add the light of luminaires that paths meet; ``hits`` stay that meet a lit side: returns how many."""
    rays, staying, count = wave.shadow.wave, 0, vertices.count
    normals, starts = columns(vertices.normals, count), columns(vertices.points, count)
    for h in range(hits):
        i = rays.hits[h]
        k, w = int(passage.met[i]), column(passage.ways, i)
        slope = dot(row(room.normals, k), w)
        rays.hits[staying] = i
        if lit_from(room, k, slope):
            staying += 1
            share = 1.0
            if passage.straight[i] > 0.0:
                x, y, z = column(passage.origins, i)
                a, b, c = column(starts, i)
                sx, sy, sz = spacing
                way = math.sqrt(((x - a) * sx) ** 2 + ((y - b) * sy) ** 2 + ((z - c) * sz) ** 2)
                share = balance_area(room, k, dot(column(normals, i), w), slope, way)
            add_carried(wave, i, scale(row(room.radiances, k), share))
    return staying


@kernel()
def stand_on_walls(wave, passage, following, room, chance):
    """Put the vertices ``following`` on the walls that were met, whose albedo over the ``chance`` paths now carry."""
    rays, hits = wave.shadow.wave, following.count
    points, normals = columns(following.points, hits), columns(following.normals, hits)
    for h in range(hits):
        i, m = rays.hits[h], rays.owners[h]
        k = int(passage.met[i])
        n = row(room.normals, k)
        put_column(points, h, column(passage.origins, i))
        put_column(normals, h, scale(n, 1.0 if dot(n, column(passage.ways, i)) < 0.0 else -1.0))
        wave.own[h], rays.sides[h] = k, UNKNOWN
        for c in range(3):
            wave.carried[c, m] *= room.albedos[k, c] / chance


@kernel()
def light_wave(field, cells, wave, passage, vertices, spare, scene, rules):
    """Walk the paths of a wave to their ends and gather light on the way; ``scene`` is (Passable, starts, light)."""
    rays, last = wave.shadow.wave, rules.weights.shape[0] - 1
    (room, matter), starts, light = scene
    for bounce in range(last + 1):
        count = vertices.count
        gather_sources(field, cells, wave, vertices, bounce, room, light)
        sample_direction(rays, vertices, bounce, field.spacing)
        set_out(wave, vertices, passage, starts, bounce)
        pass_matter(field, cells, room.walls, matter, wave, passage, bounce, count)
        arrive(wave, passage, count)
        hits = partition(rays, count)
        gather_ends(wave, vertices, passage, count - hits, light)
        hits = gather_walls(wave, vertices, passage, hits, room, field.spacing)
        hits = russian_roulette(rays, hits, bounce, rules.survival)
        if hits == 0 or bounce == last:
            return
        following = Vertices(spare.points, spare.normals, hits)
        compact(rays, vertices, following)
        stand_on_walls(wave, passage, following, room, rules.survival if bounce > 0 else 1.0)
        vertices, spare = following, vertices


@kernel()
def light_paths(field, cells, scene, samples, rules, gathered):
    """Write what each path of a ``SampleRange`` gathers to ``gathered`` (3, at least g · count)."""
    _, starts, _ = scene
    total = starts.isovalues.shape[0] * samples.count
    carried = first_carried(rules, total, gathered)
    n = whole(min(WAVE, total))
    shadow, space, spare, passage = make_shadow_rays(n), make_vertices(n), make_vertices(n), make_passage(n)
    wave = RoomWave(shadow, np.full(n, -1.0), np.full(n, -1.0), carried, gathered)
    for first in range(0, total, WAVE):
        vertices = Vertices(space.points, space.normals, min(WAVE, total - first))
        generate(shadow.wave, vertices, starts, starts.points, samples.first, first)
        begin(wave, vertices, starts, first)
        light_wave(field, cells, wave, passage, vertices, spare, scene, rules)


@kernel(types.void(FIELD, ACTIVE_CELLS, PASSABLE, STARTS, SAMPLE_RANGE, PATH_RULES, SURROUNDINGS, ROWS))
def light_through_matter(field, cells, met, starts, samples, rules, light, sums):
    """Add what a ``SampleRange`` of paths brings to each of g ``RoomStarts`` to ``sums`` (g, 3).

    Of a start on a wall that is E/π, with all light that is reflected by walls. Of one that goes INWARD it is the
    radiance of the solid side over π and cosines there, B/π, of one ALONG a way the radiance that arrives from there.
    Rays meet the isosurface as ``Matter`` does: refracted and mirrored by Fresnel's share, absorbed and scattered. So
    what arrives through it of luminaires and of what lies outside, caustics, comes by chance alone, and lamps that no
    ray can meet cast shadows. Bounces, weights and sums are as in ``light_in_room``. Source: Kajiya 1986; Beason et al.
    2006 (S3).
    """
    g, last = starts.isovalues.shape[0], samples.first + samples.count
    step = max(WAVE // max(g, 1), 1)
    scene, gathered = (met, starts, light), np.empty((3, g * step))
    for first in range(samples.first, last, step):
        some = SampleRange(first, min(step, last - first))
        light_paths(field, cells, scene, some, rules, gathered)
        add_gathered(gathered, some.count, sums)
