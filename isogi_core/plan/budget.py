"""The error budget: how the target error is divided among the causes that a plan accepts, and the
error that each is expected to have.

The target itself is for noise: pixels of final texels are within it, see ``texel_target``. The
errors here come on top of that; their shares are chosen so that all together stay about as large as
the noise, or smaller.
"""

import math
from dataclasses import replace

from isogi_core.model.lights import Colour
from isogi_core.model.scene_plan import GLOW_KIND, Layer
from isogi_core.plan.bands import truncation_error
from isogi_core.plan.inputs import PlanInputs

HARMONICS_SHARE = math.sqrt(0.5)
"""Share of the target for bands that are cut off, for direct and for reflected light each.

Both together are then within the target, as independent errors add in quadrature.
"""

EVEN_LIGHT_SHARE = 0.25
"""Share of the target for treating a light as the same from all sides."""

BOUNCES_SHARE = 0.5
"""Share of the target for bounces that are cut off."""

MIXING_SHARE = 0.25
"""Share of the target for mixing light of an albedo from that of the albedo nodes."""

ROUNDING_SHARE = 1.0 / 3.0
"""Share of the target for rounding."""

HALF_ONE = 3.3e-4
"""Error of the luminance if one number is kept per channel, rounded to a half float after each
sample level.

A root mean square over the mean luminance, as are all errors here; measured on texels of the engine
at 70.
"""

HALF_SUM = 4.5e-4
"""Error of the luminance by rounding to half floats if it is a sum over harmonics of order 6 under
light that turns.

On the same texels it is 4.4e-4 (uffizi, grace) and 4.6e-4 (noon_grass). Relative to the luminance
of each texel that has at least a tenth of the mean, it is 1.0e-3, 0.7e-3 and 0.8e-3.
"""

BYTE_ROUNDING = 0.033
"""Relative error of a coefficient that is kept as a byte.

Codes are 9 % apart, so that one rounding has an error of 2.5 %. Rounding at each of many levels has
3.2 %: the mean moves from one code to the next only if the newer half of its samples is far enough
from it (``tests/stability/test_samples.py``). With bytes from band 3 on this costs 0.27 to 0.33 %
of the luminance (uffizi), 0.37 to 0.45 % (grace) and 0.51 to 0.60 % (noon_grass) on texels of the
engine at 70 and of the CT head at 110 up to order 6; from band 2 on three times as much.
"""

ROULETTE_ALBEDO = 0.5
"""Albedo from which Russian roulette ends paths: from there on it saves more rays than its noise
costs.

On texels of the engine at 70 and the CT head at 110 reflected light took 1.18 and 1.13 times the
paths, but 0.79 and 0.82 times the rays, at albedo 0.7; at 0.9 it took 1.06 and 1.08 times the
paths, but 0.78 and 0.70 times the rays.
"""

ROULETTE_RAYS = 21
"""Percent of rays that roulette saves on these texels: 13 to 30 for albedos from 0.5 to 0.95."""

BRANCHING = 2.0
"""The constant in the variance ratio v_r / (p v_d) = BRANCHING · R² · (energy of reflected
light / energy of direct light) of ``branches_for``. Measured after 64 samples of the engine at
70 under grace.
"""

BRANCHED = 6
"""Order of the harmonics whose energies decide on branches: as many bands as light that turns
usually keeps.
"""

MOST_BRANCHES = 4
"""Most branches of a path. Under grace and noon_grass, paths of 4 branches came to the error
that single paths end with in 0.62 to 0.76 of their time (``accuracy branching``: engine, CT and
chest, brain, carp), and paths of 8 in 0.51 to 0.71. But the first 16 samples, which every
picture waits for, took 0.9 to 2.6 times as long as those of single paths, and 1.2 to 4.4 times
with 8.
"""

LONGEST_PATH = 1000
"""Most bounces of any path. The darkest pixel of thirty volumes in a white furnace, which
should show 1, had 0.78 after 64 bounces, 0.89 after 256 and 0.99 after 1000; paths that find
the light sooner end there.
"""


def rounding_error(layers: tuple[Layer, ...], inputs: PlanInputs, lobes: int = 0) -> float:
    """Return the relative RMS error of the luminance that rounding ``layers`` to half floats
    and bytes causes; 0 for single floats.
    """
    if not any(layer.half for layer in layers):
        return 0.0
    if max(layer.order for layer in layers) > 1:
        half = HALF_SUM
    else:
        half = HALF_ONE
    # Rounding of half floats and of the bytes of each layer are independent.
    return math.sqrt(half**2 + sum(byte_error(layer, inputs, lobes) ** 2 for layer in layers))


def byte_error(layer: Layer, inputs: PlanInputs, lobes: int = 0) -> float:
    """Return the part of the rounding error that a layer's bytes cause: BYTE_ROUNDING times the
    light in the bands that are kept in bytes.
    """
    if layer.coarse is None:
        return 0.0
    # The light in these bands follows from the squared errors of cutting before and after them.
    below, above = (
        cut_error(replace(layer, order=n), inputs, lobes) for n in (layer.coarse, layer.order)
    )
    return BYTE_ROUNDING * math.sqrt(max(below**2 - above**2, 0.0))


def bounces_for(albedo: Colour, target_error: float) -> int:
    """Return the least number of bounces for which the light of longer paths, at most
    R^(bounces + 1) of all light, is within BOUNCES_SHARE of the target.
    """
    brightest = max(albedo)
    if brightest <= 0.0:
        return 0
    if brightest >= 1.0:
        return LONGEST_PATH
    # Solve R^(bounces + 1) <= target · BOUNCES_SHARE.
    return min(
        max(math.ceil(math.log(target_error * BOUNCES_SHARE) / math.log(brightest)) - 1, 0),
        LONGEST_PATH,
    )


def survival_for(albedo: Colour, bounces: int) -> float:
    """Return the probability that a path continues after its second and later hits; 1 if
    roulette does not pay.
    """
    brightest = max(albedo)
    if bounces > 1 and brightest >= ROULETTE_ALBEDO:
        return brightest
    return 1.0


def branches_for(layers: tuple[Layer, ...], inputs: PlanInputs) -> int:
    """Return the number of branches in which paths continue from their first hit: a power of two,
    at most MOST_BRANCHES.

    Let v_d and v_r be the variances per path of direct and of reflected light, and let a path take
    one ray to its first hit and p more after it. With b branches the cost of a given error is (v_d
    + v_r / b)(1 + p b), which is least at b = √(v_r / (p v_d)). Noise is alike in all bands, and
    v_r grows in proportion to p, so that v_r / (p v_d) is BRANCHING · R² times the ratio of the
    energies that reflected and direct light meet. Band 0 is left out: its variance comes from
    hits and misses of the first ray, which branches do not change. Light gains most from branches
    if its lobes are taken out.

    All lobes of the light count as taken out, however many the plan takes, and the number of bands
    that it keeps does not matter: plans under one light then share their layers.
    """
    # Compare the energy that direct light meets, without lobes, with that of reflected light, which
    # meets all.
    straight, met = (
        energy[1:BRANCHED].sum()
        for energy in (inputs.energy_beside(len(inputs.lobes)), inputs.energy)
    )
    if met == 0.0 or all(layer.kind != "indirect" for layer in layers):
        return 1
    best = max(inputs.albedo) * math.sqrt(BRANCHING * met / max(straight, 1e-9 * met))
    return min(1 << round(math.log2(max(best, 1.0))), MOST_BRANCHES)


def tail_of_bounces(albedo: Colour, bounces: int) -> float:
    """Return an upper bound of the share of light that longer paths would bring: R^(bounces +
    1), the tail of a geometric series.
    """
    return float(max(albedo) ** (bounces + 1))


def even(inputs: PlanInputs) -> bool:
    """Return True if the light may be treated as the same from all sides."""
    return (
        not inputs.lamps.any
        and truncation_error(inputs.energy, 1, "direct") <= EVEN_LIGHT_SHARE * inputs.target_error
    )


UNCUT_KINDS = ("irradiance", GLOW_KIND)
"""Kinds of layers that keep no harmonics, and so lose none."""


def harmonics_error(layers: tuple[Layer, ...], inputs: PlanInputs, lobes: int = 0) -> float:
    """Return the relative error of cutting off the bands beyond those of the ``layers``, a root
    mean square over rotations of the light.

    Errors of direct and of reflected light count as independent. The first ``lobes`` lobes are not
    part of direct light's harmonics.
    """
    return math.sqrt(
        sum(
            cut_error(layer, inputs, lobes) ** 2
            for layer in layers
            if layer.kind not in UNCUT_KINDS
        )
    )


def cut_error(layer: Layer, inputs: PlanInputs, lobes: int = 0) -> float:
    """Return the relative error of cutting off the bands from a layer's order on."""
    if layer.kind == "indirect":
        return truncation_error(inputs.energy, layer.order, "indirect", max(inputs.albedo))
    return truncation_error(inputs.energy_beside(lobes), layer.order, "direct")
