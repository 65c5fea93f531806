"""A smooth dielectric interface: what it mirrors, and where what it lets pass goes on.

Directions are unit vectors of the world; ``n`` is the normal on the side that light comes from, and ``ratio`` the index
of refraction on the other side over that on this one. Source: Born and Wolf, "Principles of Optics", section 1.5.
"""

import math

from isogi_core.kernels._jit import kernel
from isogi_core.kernels.tracing.vec import madd, normalize, scale


@kernel()
def refracted_cosine(cosine, ratio):
    """Cosine of the refracted ray to the normal, by Snell's law, where the other one's is ``cosine``; 0 where all of
    the light is mirrored.
    """
    square = 1.0 - (1.0 - cosine * cosine) / (ratio * ratio)
    return math.sqrt(square) if square > 0.0 else 0.0


@kernel()
def fresnel(cosine, ratio):
    """Share of unpolarised light that is mirrored, from its ``cosine`` to the normal: ½ (r_s² + r_p²), 1 beyond the
    critical angle.
    """
    other = refracted_cosine(cosine, ratio)
    if not other > 0.0:
        return 1.0
    across = (cosine - ratio * other) / (cosine + ratio * other)
    along = (ratio * cosine - other) / (ratio * cosine + other)
    return 0.5 * (across * across + along * along)


@kernel()
def mirror(w, n, cosine):
    """The direction in which ``w`` is mirrored at ``cosine`` = -w·n."""
    return normalize(madd(w, 2.0 * cosine, n))


@kernel()
def refract(w, n, cosine, ratio):
    """The direction in which ``w`` goes on behind the interface, at ``cosine`` = -w·n, up to the critical angle."""
    other = refracted_cosine(cosine, ratio)
    return normalize(madd(scale(w, 1.0 / ratio), cosine / ratio - other, n))
