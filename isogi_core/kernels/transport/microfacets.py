"""Microfacets: the GGX lobe of a rough mirror, its sampling, and its reflectance.

Directions are local unit vectors with z along the normal; ``v`` points to the viewer, above the
surface, and ``l`` to the light. Sources: Walter et al. 2007 (GGX); Heitz 2014 (masking) and 2018
(sampling); Schlick 1994 (Fresnel).
"""

import math
from typing import Any, NamedTuple

from numba import types

from isogi_core.kernels._jit import REAL_TRIPLE, kernel, record
from isogi_core.kernels.tracing.vec import add, cross, dot, madd, normalize, scale
from isogi_core.kernels.transport.sampling import sample_disc

ENERGY_STEPS = 128
"""Steps of the energy table, uniform in √cosθ: it changes most at grazing views."""

MIN_VIEW_COSINE = 1e-3
"""Least cosine between normal and viewer at which lobes are evaluated."""

GRID = 40
"""Facets along each side of the square over which an entry of the table is a mean."""


class ShineLobe(NamedTuple):
    """A microfacet lobe of roughness² ``alpha`` and linear RGB reflectance ``facing`` at normal
    incidence.

    ``strength`` scales the lobe. Under a ``metal`` lobe diffuse light falls to 1 - strength, else
    to the share that the lobe leaves (see ``light_below``). ``energy`` (ENERGY_STEPS + 1, 2) comes
    from ``fill_energy``. The share ``aside`` of its rays is aimed at lights.
    """

    alpha: float
    facing: Any
    strength: float
    metal: bool
    aside: float
    energy: Any


ENERGY = types.float64[:, ::1]
SHINE_LOBE = record(
    ShineLobe, types.float64, REAL_TRIPLE, types.float64, types.boolean, types.float64, ENERGY
)


@kernel()
def facets_facing(alpha, cosine):
    """Return D(h) of GGX: facets with normals at ``cosine`` to the surface normal, per
    steradian and area.
    """
    square = alpha * alpha
    width = cosine * cosine * (square - 1.0) + 1.0
    return square / (math.pi * width * width)


@kernel()
def hidden(alpha, cosine):
    """Return Λ of Smith's masking of GGX for a direction at ``cosine`` to the normal:
    (√(1 + α² tan²θ) - 1)/2.
    """
    square = cosine * cosine
    return 0.5 * (math.sqrt(1.0 + alpha * alpha * max(1.0 - square, 0.0) / square) - 1.0)


@kernel()
def seen_from(alpha, cosine):
    """Return G₁, the share of facets turned towards a direction at ``cosine``
    that are visible from there.
    """
    return 1.0 / (1.0 + hidden(alpha, cosine))


@kernel()
def seen_and_lit(alpha, to_viewer, to_light):
    """Return G₂, the share of facets that are both visible and lit, by the cosines
    ``to_viewer`` and ``to_light``: masking and shadowing correlated by height.
    """
    return 1.0 / (1.0 + hidden(alpha, to_viewer) + hidden(alpha, to_light))


@kernel()
def grazing(cosine):
    """Return (1 - cosθ)⁵ of Schlick's Fresnel F₀ + (1 - F₀)(1 - cosθ)⁵,
    θ between facet and light.
    """
    rest = 1.0 - min(max(cosine, 0.0), 1.0)
    return rest * rest * rest * rest * rest


@kernel()
def facet_between(v, l):
    """Return the normal of facets that mirror ``v`` to ``l``."""
    return normalize(add(v, l))


@kernel()
def reflected(alpha, v, l):
    """Return D G₂/(4 cosθ_v): the BRDF without Fresnel, times cosθ_l."""
    if not l[2] > 0.0:
        return 0.0
    return (
        facets_facing(alpha, facet_between(v, l)[2])
        * seen_and_lit(alpha, v[2], l[2])
        / (4.0 * v[2])
    )


@kernel()
def reflected_pdf(alpha, v, l):
    """Return the density of ``sample_reflected`` per steradian:
    G₁ D/(4 cosθ_v), also below the surface.
    """
    h = facet_between(v, l)
    if not (h[2] > 0.0 and dot(v, h) > 0.0):
        return 0.0
    return seen_from(alpha, v[2]) * facets_facing(alpha, h[2]) / (4.0 * v[2])


@kernel()
def sample_reflected(alpha, v, a, b):
    """Sample a direction to which a facet visible from ``v`` mirrors it, by (a, b) in [0, 1)²;
    some lie below the surface.
    """
    # Stretch the view direction so that facets become a hemisphere.
    around = normalize((alpha * v[0], alpha * v[1], v[2]))
    flat = math.sqrt(around[0] * around[0] + around[1] * around[1])
    if flat > 0.0:
        s = (-around[1] / flat, around[0] / flat, 0.0)
    else:
        s = (1.0, 0.0, 0.0)
    t = cross(around, s)
    # Sample the projection of the visible hemisphere, and stretch back (Heitz 2018).
    x, y = sample_disc(a, b)
    share = 0.5 * (1.0 + around[2])
    y = (1.0 - share) * math.sqrt(max(1.0 - x * x, 0.0)) + share * y
    facet = madd(madd(scale(s, x), y, t), math.sqrt(max(1.0 - x * x - y * y, 0.0)), around)
    h = normalize((alpha * facet[0], alpha * facet[1], max(facet[2], 1e-12)))
    return madd(scale(v, -1.0), 2.0 * dot(v, h), h)


@kernel()
def schlick_fresnel(facing, v, l):
    """Return Schlick's Fresnel reflectance of facets that mirror ``v`` to ``l``; linear RGB."""
    edge = grazing(dot(v, facet_between(v, l)))
    return (
        facing[0] + (1.0 - facing[0]) * edge,
        facing[1] + (1.0 - facing[1]) * edge,
        facing[2] + (1.0 - facing[2]) * edge,
    )


@kernel()
def towards_ends(k):
    """Return place ``k`` of GRID in [0, 1], denser towards both ends by t²(3 - 2t),
    and its weight.
    """
    t = (k + 0.5) / GRID
    return t * t * (3.0 - 2.0 * t), 6.0 * t * (1.0 - t)


@kernel()
def mean_energy(alpha, cosine):
    """Return (A, B): a lobe seen at ``cosine`` reflects F₀ A + B of uniform light.

    Takes the mean over facets that are visible from there, at GRID² places (x, y) of the square
    that ``sample_reflected`` maps to facets by ``sample_disc``. The sides of the square become the
    rim of the disc, where facets are steep and change most: places are denser towards the sides,
    and have smaller weights there.
    """
    v = (math.sqrt(1.0 - cosine * cosine), 0.0, cosine)
    a = 0.0
    b = 0.0
    total = 0.0
    for i in range(GRID):
        for j in range(GRID):
            (x, width) = towards_ends(i)
            (y, height) = towards_ends(j)
            l = sample_reflected(alpha, v, x, y)
            total = total + width * height
            if l[2] > 0.0:
                # A sampled direction counts G₂/G₁ F, the lobe over its density. Schlick's
                # F = F₀ (1 - edge) + edge splits it into A and B.
                share = width * height * seen_and_lit(alpha, v[2], l[2]) / seen_from(alpha, v[2])
                edge = grazing(dot(v, facet_between(v, l)))
                a = a + share * (1.0 - edge)
                b = b + share * edge
    return a / total, b / total


@kernel(types.void(types.float64, ENERGY))
def fill_energy(alpha, energy):
    """Fill ``energy`` (ENERGY_STEPS + 1, 2) with ``mean_energy`` at the cosines (k/ENERGY_STEPS)²:
    single scattering.

    The split is Karis's, "Real Shading in Unreal Engine 4", 2013.
    """
    for k in range(ENERGY_STEPS + 1):
        energy[k, 0], energy[k, 1] = mean_energy(
            alpha, max((k / ENERGY_STEPS) ** 2, MIN_VIEW_COSINE)
        )


@kernel()
def energy_at(energy, cosine):
    """Interpolate (A, B) at ``cosine`` from the table."""
    place = ENERGY_STEPS * math.sqrt(min(max(cosine, 0.0), 1.0))
    k = min(int(place), ENERGY_STEPS - 1)
    way = place - k
    return (
        (1.0 - way) * energy[k, 0] + way * energy[k + 1, 0],
        (1.0 - way) * energy[k, 1] + way * energy[k + 1, 1],
    )


@kernel()
def light_below(lobe, cosine):
    """Return the share of diffuse light that a lobe leaves to the eye at ``cosine``; linear RGB.

    Under a metal 1 - strength; under a coat 1 - strength · (F₀ A + B), so that a white surface
    stays white in white light.
    """
    a, b = energy_at(lobe.energy, cosine)
    strength = lobe.strength
    if lobe.metal:
        return 1.0 - strength, 1.0 - strength, 1.0 - strength
    return (
        1.0 - strength * (lobe.facing[0] * a + b),
        1.0 - strength * (lobe.facing[1] * a + b),
        1.0 - strength * (lobe.facing[2] * a + b),
    )
