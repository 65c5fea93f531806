"""What an isosurface bounds, glass that refracts and absorbs or a cloud that scatters, as rays meet it."""

import math
from typing import Any, NamedTuple

from numba import types

from isogi_core.kernels._jit import kernel, record
from isogi_core.kernels.tracing.intersect import SOLID_SIGN, shading_normal
from isogi_core.kernels.tracing.slabs import clip_box
from isogi_core.kernels.tracing.vec import dot, scale
from isogi_core.kernels.transport.matter.dielectric import fresnel, mirror, refract
from isogi_core.kernels.transport.room_paths import ROOM_RECORD

REAL_ARRAY = types.float64[::1]


class Matter(NamedTuple):
    """What fills the solid side of an isosurface; lengths are the world's.

    Its ``index`` of refraction; the ``absorption`` (3,) per unit of length, linear RGB; how often light is scattered,
    ``extinction`` per unit of length, evenly to all sides, and the share of it that goes on then, ``albedo`` (3,).
    """

    index: float
    absorption: Any
    extinction: float
    albedo: Any


MATTER_RECORD = record(Matter, types.float64, REAL_ARRAY, types.float64, REAL_ARRAY)


class Passable(NamedTuple):
    """What rays meet that pass an isosurface: the ``room`` about it, and the ``matter`` behind it."""

    room: Any
    matter: Any


PASSABLE = record(Passable, ROOM_RECORD, MATTER_RECORD)


@kernel()
def way_inside(shape, o, d, side, came, reach):
    """Part (near, far) of the ray o + t·d, t up to ``reach``, in what is solid; (0, 0) where it is outside.

    ``side`` is where it starts, and ``came`` the side that it met the surface from, both UNKNOWN where that is not
    known. Faces of the volume's box, of ``shape``, let light pass as it goes.
    """
    if side != SOLID_SIGN and came != SOLID_SIGN:
        return 0.0, 0.0
    near, far = clip_box(shape, o, d)
    near, far = max(near, 0.0), min(far, reach)
    return (near, far) if near < far else (0.0, 0.0)


@kernel()
def transmitted(matter, way):
    """Share of light, linear RGB, that absorption leaves over a ``way``: Beer's law."""
    a = matter.absorption
    return math.exp(-a[0] * way), math.exp(-a[1] * way), math.exp(-a[2] * way)


@kernel()
def meet_interface(field, matter, p, w, came):
    """Where the unit way ``w`` meets the surface at ``p``: (share mirrored, mirrored way, way that goes on).

    The normal is that of shading. Where it is turned away from the ray, as at outlines of smoothed normals, the ray
    grazes: all of it is passed on.
    """
    n = shading_normal(field, p, came, w)
    cosine = -dot(n, w)
    if matter.index == 1.0 or not cosine > 0.0:
        return 0.0, w, w
    ratio = 1.0 / matter.index if came == SOLID_SIGN else matter.index
    share, back = fresnel(cosine, ratio), mirror(w, n, cosine)
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
