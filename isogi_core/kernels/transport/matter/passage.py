"""The way of a wave's rays through matter: refracted, mirrored, scattered by chance until they meet
a wall or leave.

What is random there belongs to the path, the bounce and the step, as all random numbers do.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import REAL_ARRAY, kernel, record
from isogi_core.kernels.tracing.cast import cast_batch
from isogi_core.kernels.tracing.field import to_index
from isogi_core.kernels.tracing.intersect import SOLID_SIGN, shading_normal
from isogi_core.kernels.tracing.ray_stream import Rays
from isogi_core.kernels.tracing.slabs import clip_box
from isogi_core.kernels.tracing.vec import column, dot, madd, put_column, scale
from isogi_core.kernels.tracing.walls import NO_WALL, meet_walls
from isogi_core.kernels.transport.integrator import whole
from isogi_core.kernels.transport.rng import point_of_words
from isogi_core.kernels.transport.room_paths import ROOM_RECORD
from isogi_core.kernels.transport.sampling import fresnel, mirror, refract, sample_uniform_sphere
from isogi_core.kernels.transport.streams import IN_MATTER, MAX_STEPS, PAIRS_PER_PURPOSE


class Matter(NamedTuple):
    """What fills the solid side of an isosurface; lengths are the world's.

    Its ``index`` of refraction; the ``absorption`` (3,) per unit of length, linear RGB; how often
    light is scattered, ``extinction`` per unit of length, evenly to all sides, and the share of it
    that goes on then, ``albedo`` (3,).
    """

    index: float
    absorption: Any
    extinction: float
    albedo: Any


MATTER_RECORD = record(Matter, types.float64, REAL_ARRAY, types.float64, REAL_ARRAY)


class Passable(NamedTuple):
    """What rays meet that pass an isosurface: the ``room`` about it, and the ``matter`` behind
    it.
    """

    room: Any
    matter: Any


PASSABLE = record(Passable, ROOM_RECORD, MATTER_RECORD)


@kernel()
def way_inside(shape, o, d, side, came, reach):
    """Part (near, far) of the ray o + t·d, t up to ``reach``, in what is solid; (0, 0) where it is
    outside.

    ``side`` is where it starts, and ``came`` the side that it met the surface from, both UNKNOWN
    where that is not known. Faces of the volume's box, of ``shape``, let light pass as it goes.
    """
    if side != SOLID_SIGN and came != SOLID_SIGN:
        return 0.0, 0.0
    near, far = clip_box(shape, o, d)
    near = max(near, 0.0)
    far = min(far, reach)
    return (near, far) if near < far else (0.0, 0.0)


@kernel()
def transmitted(matter, way):
    """Share of light, linear RGB, that absorption leaves over a ``way``: Beer's law."""
    a = matter.absorption
    return math.exp(-a[0] * way), math.exp(-a[1] * way), math.exp(-a[2] * way)


@kernel()
def meet_interface(field, matter, p, w, came):
    """Where the unit way ``w`` meets the surface at ``p``: (share mirrored, mirrored way, way that
    goes on).

    The normal is that of shading. Where it is turned away from the ray, as at outlines of smoothed
    normals, the ray grazes: all of it is passed on.
    """
    n = shading_normal(field, p, came, w)
    cosine = -dot(n, w)
    if matter.index == 1.0 or not cosine > 0.0:
        return 0.0, w, w
    if came == SOLID_SIGN:
        ratio = 1.0 / matter.index
    else:
        ratio = matter.index
    share = fresnel(cosine, ratio)
    back = mirror(w, n, cosine)
    return share, back, refract(w, n, cosine, ratio) if share < 1.0 else back


@kernel()
def dimmed(light, shares):
    """The product of two colours."""
    return light[0] * shares[0], light[1] * shares[1], light[2] * shares[2]


@kernel()
def brightest(light):
    """The greatest of three channels."""
    return max(light[0], light[1], light[2])


@kernel()
def parted(light, share):
    """What is mirrored of a ``light``, and what goes on."""
    return scale(light, share), scale(light, 1.0 - share)


class Passage(NamedTuple):
    """Rays of a wave on their way, (n,) or (3, n) each: ``origins`` in index space, unit world
    ``ways``, ``sides``.

    ``own`` are the walls that they start on, ``straight`` is 1 as long as nothing turned them.
    ``pending`` (n,) int64 are those that go on. At the end ``met`` are the walls that they meet at
    ``origins``, or NO_WALL.
    """

    origins: Any
    ways: Any
    sides: Any
    own: Any
    met: Any
    straight: Any
    pending: Any


@kernel()
def make_passage(n):
    """Room for ``n`` rays."""
    origins = np.zeros((3, n))
    ways = np.zeros((3, n))
    numbers = np.zeros((3, n))
    sides = np.zeros(n, np.int8)
    pending = np.zeros(n, np.int64)
    return Passage(origins, ways, sides, numbers[0], numbers[1], numbers[2], pending)


@kernel(inline=True)
def draw(wave, i, bounce, step, second):
    """A pair of random numbers in [0, 1) of ray ``i`` of a wave at a ``step`` of its way; each step
    has two.
    """
    rays = wave.rays
    dimension = np.uint64(IN_MATTER + (2 * step + second) * PAIRS_PER_PURPOSE + bounce)
    return point_of_words(
        np.uint64(rays.low[i]), np.uint64(rays.high[i]), np.uint64(rays.samples[i]), dimension
    )


@kernel()
def gather_rays(field, wave, passage, going):
    """The first ``going`` pending rays side by side, in whole vectors: ``Rays``, and the walls that
    they start on.
    """
    n = whole(going)
    rays = Rays(np.zeros(n), np.full((3, n), math.inf), np.ones((3, n)), np.zeros(n, np.int8))
    own = np.full(n, NO_WALL)
    for j in range(going):
        i = passage.pending[j]
        rays.isovalues[j] = wave.isovalues[i]
        rays.sides[j] = passage.sides[i]
        own[j] = passage.own[i]
        put_column(rays.origins, j, column(passage.origins, i))
        put_column(rays.directions, j, to_index(column(passage.ways, i), field.spacing))
    for j in range(going, n):
        rays.isovalues[j] = rays.isovalues[0]
    return rays, own


@kernel(inline=True)
def dim(wave, i, shares):
    """Multiply what ray ``i`` of a wave carries by ``shares``."""
    m = wave.rays.owners[i]
    for c in range(3):
        wave.carried[c, m] *= shares[c]


@kernel(inline=True)
def end_at(passage, i, p, wall):
    """End ray ``i`` at ``p``, on a ``wall`` or NO_WALL."""
    put_column(passage.origins, i, p)
    passage.met[i] = wall
    return False


@kernel(inline=True)
def scatter(matter, wave, passage, i, bounce, step):
    """Turn ray ``i`` where it is scattered, or end it by chance: in as many cases as the brightest
    channel is absorbed.

    What it carries is divided by the chance to go on. Returns whether it does.
    """
    albedo = matter.albedo[0], matter.albedo[1], matter.albedo[2]
    chance = brightest(albedo)
    u, v = draw(wave, i, bounce, step, 1)
    if not u < chance:
        dim(wave, i, (0.0, 0.0, 0.0))
        return end_at(passage, i, column(passage.origins, i), NO_WALL)
    dim(wave, i, (albedo[0] / chance, albedo[1] / chance, albedo[2] / chance))
    put_column(passage.ways, i, sample_uniform_sphere(u / chance, v))
    passage.sides[i] = SOLID_SIGN
    passage.straight[i] = 0.0
    return True


@kernel(inline=True)
def go_on(field, matter, wave, passage, ray, i, place):
    """Bring ray ``i`` to what it met, ``ray`` = (o, d, t, side it came from, wall); returns whether
    it goes on there.

    The ``place`` of its random numbers is its bounce and step.
    """
    (o, d, t, came, wall) = ray
    (bounce, step) = place
    w = column(passage.ways, i)
    passage.own[i] = NO_WALL
    near, far = way_inside(field.voxels.shape, o, d, passage.sides[i], came, t)
    u, v = draw(wave, i, bounce, step, 0)
    if matter.extinction > 0.0 and far > near:
        flight = -math.log(1.0 - u) / matter.extinction
        if flight < far - near:
            dim(wave, i, transmitted(matter, flight))
            put_column(passage.origins, i, madd(o, near + flight, d))
            return scatter(matter, wave, passage, i, bounce, step)
    dim(wave, i, transmitted(matter, far - near))
    if not t < math.inf or wall != NO_WALL:
        return end_at(passage, i, madd(o, t, d) if t < math.inf else o, wall)
    p = madd(o, t, d)
    share, mirrored, passed = meet_interface(field, matter, p, w, came)
    back = v < share
    passage.sides[i] = came if back else -came
    passage.straight[i] = 0.0
    put_column(passage.origins, i, p)
    put_column(passage.ways, i, mirrored if back else passed)
    return True


@kernel()
def pass_matter(field, cells, walls, matter, wave, passage, bounce, count):
    """Follow the first ``count`` rays of a ``PathWave`` on their passage to where they meet walls
    or leave.

    What they carry dims on the way; ``bounce`` is the number of the vertex that they come from.
    """
    for i in range(count):
        passage.pending[i] = i
    going = count
    for step in range(MAX_STEPS):
        rays, own = gather_rays(field, wave.rays, passage, going)
        n = own.shape[0]
        t = np.empty(n)
        came = np.empty(n, np.int8)
        met = np.empty(n)
        cast_batch(field, cells, rays, t, came)
        meet_walls(walls, rays.origins, rays.directions, own, t, met)
        staying = 0
        for j in range(going):
            i = passage.pending[j]
            ray = column(rays.origins, j), column(rays.directions, j), t[j], came[j], met[j]
            passage.pending[staying] = i
            staying += go_on(field, matter, wave, passage, ray, i, (bounce, step))
        going = staying
        if going == 0:
            return
    for j in range(going):
        i = passage.pending[j]
        dim(wave, i, (0.0, 0.0, 0.0))
        passage.met[i] = NO_WALL
