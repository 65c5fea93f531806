"""Paths of a wave's rays through matter: refraction, reflection and scattering up to a wall or out
of the scene.

Random numbers belong to the path, the bounce and the step.
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
    """The matter on the solid side of an isosurface; lengths are the world's.

    - ``index``: index of refraction.
    - ``absorption`` (3,): absorption per unit of length, linear RGB.
    - ``extinction``: scattering events per unit of length; scattering is isotropic.
    - ``albedo`` (3,): share of light that goes on from a scattering event.
    """

    index: float
    absorption: Any
    extinction: float
    albedo: Any


MATTER_RECORD = record(Matter, types.float64, REAL_ARRAY, types.float64, REAL_ARRAY)


class Passable(NamedTuple):
    """The scene for rays that pass an isosurface: the ``room`` around it,
    and the ``matter`` behind it.
    """

    room: Any
    matter: Any


PASSABLE = record(Passable, ROOM_RECORD, MATTER_RECORD)


@kernel()
def way_inside(shape, o, d, side, came, reach):
    """Return the part (near, far) of the ray o + t·d, t up to ``reach``, inside of the matter; (0,
    0) if it is outside.

    ``side`` is the side of its start, ``came`` the side from which it hit the surface; either may
    be UNKNOWN. Faces of the volume's box of ``shape`` voxels do not refract.
    """
    if side != SOLID_SIGN and came != SOLID_SIGN:
        return 0.0, 0.0
    near, far = clip_box(shape, o, d)
    near = max(near, 0.0)
    far = min(far, reach)
    return (near, far) if near < far else (0.0, 0.0)


@kernel()
def transmitted(matter, way):
    """Return the share of light, linear RGB, that absorption leaves over a ``way``: Beer's law."""
    a = matter.absorption
    return math.exp(-a[0] * way), math.exp(-a[1] * way), math.exp(-a[2] * way)


@kernel()
def meet_interface(field, matter, p, w, came):
    """Return reflectance, reflected and refracted direction of the unit direction ``w`` at the
    interface at ``p``.

    ``came`` is the side that the ray arrives on. The normal is the shading normal. If it points
    away from the ray, as at outlines of smoothed normals, the ray grazes and passes entirely.
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
    """Return the product of two colours."""
    return light[0] * shares[0], light[1] * shares[1], light[2] * shares[2]


@kernel()
def brightest(light):
    """Return the greatest of three channels."""
    return max(light[0], light[1], light[2])


@kernel()
def parted(light, share):
    """Split a ``light`` into the reflected ``share`` and the rest."""
    return scale(light, share), scale(light, 1.0 - share)


class Passage(NamedTuple):
    """Rays of a wave on their way through matter, (n,) or (3, n) each.

    - ``origins``, ``ways``, ``sides``: index-space origins, unit world directions, and sides of the
      starts.
    - ``own``: walls that rays start on.
    - ``met``: walls that rays end on at ``origins``, or NO_WALL.
    - ``straight``: 1 as long as a ray keeps its direction.
    - ``pending`` int64: rays that are still on their way.
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
    """Allocate the passage of ``n`` rays."""
    origins = np.zeros((3, n))
    ways = np.zeros((3, n))
    numbers = np.zeros((3, n))
    sides = np.zeros(n, np.int8)
    pending = np.zeros(n, np.int64)
    return Passage(origins, ways, sides, numbers[0], numbers[1], numbers[2], pending)


@kernel(inline=True)
def draw(wave, i, bounce, step, second):
    """Return pair ``second`` (0 or 1) of the random numbers of ray ``i``
    at a ``step`` of its way.
    """
    rays = wave.rays
    dimension = np.uint64(IN_MATTER + (2 * step + second) * PAIRS_PER_PURPOSE + bounce)
    return point_of_words(
        np.uint64(rays.low[i]), np.uint64(rays.high[i]), np.uint64(rays.samples[i]), dimension
    )


@kernel()
def gather_rays(field, wave, passage, going):
    """Return the first ``going`` pending rays as whole vectors of ``Rays``,
    and the walls that they start on.
    """
    n = whole(going)
    rays = Rays(np.zeros(n), np.full((3, n), math.inf), np.ones((3, n)), np.zeros(n, np.int8))
    walls = np.full(n, NO_WALL)
    for j in range(going):
        i = passage.pending[j]
        rays.isovalues[j] = wave.isovalues[i]
        rays.sides[j] = passage.sides[i]
        walls[j] = passage.own[i]
        put_column(rays.origins, j, column(passage.origins, i))
        put_column(rays.directions, j, to_index(column(passage.ways, i), field.spacing))
    # Fill up the last vector with rays that start at infinity.
    for j in range(going, n):
        rays.isovalues[j] = rays.isovalues[0]
    return rays, walls


@kernel(inline=True)
def dim(wave, i, shares):
    """Multiply the throughput of ray ``i`` by ``shares``."""
    m = wave.rays.owners[i]
    for c in range(3):
        wave.carried[c, m] *= shares[c]


@kernel(inline=True)
def end_at(passage, i, p, wall):
    """End ray ``i`` at ``p``, on a ``wall`` or NO_WALL; return False."""
    put_column(passage.origins, i, p)
    passage.met[i] = wall
    return False


@kernel(inline=True)
def scatter(matter, wave, passage, i, bounce, step):
    """Scatter ray ``i`` into a new direction, or absorb it at random by its brightest channel;
    return True if it goes on.

    The throughput is divided by the probability to go on.
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
    """Move ray ``i`` to its next event, ``ray`` = (o, d, t, side it came from, wall); return True
    if it goes on.

    ``place`` is (bounce, step) of its random numbers.
    """
    (o, d, t, came, wall) = ray
    (bounce, step) = place
    w = column(passage.ways, i)
    passage.own[i] = NO_WALL
    near, far = way_inside(field.voxels.shape, o, d, passage.sides[i], came, t)
    # Sample the free flight in a scattering medium; scatter if it ends before the next hit.
    u, v = draw(wave, i, bounce, step, 0)
    if matter.extinction > 0.0 and far > near:
        flight = -math.log(1.0 - u) / matter.extinction
        if flight < far - near:
            dim(wave, i, transmitted(matter, flight))
            put_column(passage.origins, i, madd(o, near + flight, d))
            return scatter(matter, wave, passage, i, bounce, step)
    # Absorb along the way; a ray that hits a wall or leaves ends there.
    dim(wave, i, transmitted(matter, far - near))
    if not t < math.inf or wall != NO_WALL:
        return end_at(passage, i, madd(o, t, d) if t < math.inf else o, wall)
    # Reflect or refract at the interface, at random by the Fresnel reflectance.
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
    """Follow the first ``count`` rays of a ``PathWave`` through matter to walls or out of the
    scene. The ``passage`` then has the walls they ``met``, and as ``origins`` the points there.

    ``bounce`` is the number of the vertex that they start from. Throughputs shrink on the way; a
    ray that is absorbed, or not out after MAX_STEPS, counts as out of the scene with throughput 0.
    """
    for i in range(count):
        passage.pending[i] = i
    going = count
    # Cast all pending rays to their next interface or wall, and handle one event of each.
    for step in range(MAX_STEPS):
        rays, starts = gather_rays(field, wave.rays, passage, going)
        n = starts.shape[0]
        t = np.empty(n)
        came = np.empty(n, np.int8)
        met = np.empty(n)
        cast_batch(field, cells, rays, t, came)
        meet_walls(walls, rays.origins, rays.directions, starts, t, met)
        staying = 0
        for j in range(going):
            i = passage.pending[j]
            ray = column(rays.origins, j), column(rays.directions, j), t[j], came[j], met[j]
            passage.pending[staying] = i
            staying += go_on(field, matter, wave, passage, ray, i, (bounce, step))
        going = staying
        if going == 0:
            return
    # Drop the light of rays that do not end within MAX_STEPS.
    for j in range(going):
        i = passage.pending[j]
        dim(wave, i, (0.0, 0.0, 0.0))
        passage.met[i] = NO_WALL
