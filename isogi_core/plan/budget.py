"""The error budget: how the target error is split among what a plan cuts off, and the errors that
are expected then.

The target itself is of noise: pixels of final texels are within it, see ``texel_target``. What is
cut off adds to that; its shares are chosen so that it stays about as large as the noise, or
smaller.
"""

import math
from dataclasses import replace

from isogi_core.model.lights import Colour
from isogi_core.model.scene_plan import GLOW_KIND, Layer
from isogi_core.plan.bands import truncation_error
from isogi_core.plan.inputs import PlanInputs

HARMONICS = math.sqrt(0.5)
"""Share of the target for bands that are cut off, of direct and of reflected light each.

Both together are then within the target, as independent errors add.
"""

EVEN_LIGHT_SHARE = 0.25
"""Share of the target for taking a light as the same from all sides."""

BOUNCES_SHARE = 0.5
"""Share of the target for bounces that are cut off."""

MIXING = 0.25
"""Share of the target for light of albedos between those that it is kept for."""

ROUNDING_SHARE = 1.0 / 3.0
"""Share of the target for rounding."""

HALF_ONE = 3.3e-4
"""Error of the luminance where one number is kept, rounded to a half float after each sample level.

A root mean square over the mean luminance, as are all errors here; measured on texels of the engine
at 70.
"""

HALF_SUM = 4.5e-4
"""Error of the luminance by rounding to half floats, of a sum over harmonics of order 6 under light
that turns.

4.4e-4 (uffizi, grace) and 4.6e-4 (noon_grass) on those texels; of the luminance of each texel,
where it is a tenth of the mean or more, 1.0e-3, 0.7e-3 and 0.8e-3.
"""

BYTE_ROUNDING = 0.033
"""Relative error of a coefficient that is kept as a byte.

Codes are 9 % apart, so that the error of one rounding is 2.5 %, and of many levels 3.2 %: from code
to code a mean moves only when the newer half of its samples asks for it
(``tests/stability/test_samples.py``). From band 3 on it costs 0.27 to 0.33 % of the luminance
(uffizi), 0.37 to 0.45 % (grace) and 0.51 to 0.60 % (noon_grass) on texels of the engine at 70 and
of the CT head at 110 to order 6; from band 2 on three times that.
"""

ROULETTE_ALBEDO = 0.5
"""The albedo from which on Russian roulette ends paths: it then saves more rays than the noise that
it adds costs.

On texels of the engine at 70 and the CT head at 110 reflected light took 1.18 and 1.13 times the
paths of 0.79 and 0.82 times the rays at albedo 0.7, and 1.06 and 1.08 times the paths of 0.78 and
0.70 times the rays at 0.9.
"""

ROULETTE_RAYS = 21
"""Percent of rays that roulette saves, for albedos from 0.5 to 0.95 on those texels: 13 to 30."""

BRANCHING = 2.0
"""v_r / (p v_d) over R² and the ratio of energies, see ``branches_for``: so much after 64 samples
of the engine at 70 under grace.
"""

BRANCHED = 6
"""The bands that are asked whether paths branch: as many as light that turns usually keeps."""

MOST_BRANCHES = 4
"""The most branches of a path. Under grace and noon_grass, 4 came to the error that single paths
end with in 0.62 to 0.76 of their time (``accuracy branching``: engine, CT and chest, brain, carp).
8 took 0.51 to 0.71 of it. The first 16 samples, which all wait for, took 0.9 to 2.6 times what
those of single paths do, and 1.2 to 4.4 times with 8.
"""

LONGEST_PATH = 1000
"""The most bounces of any path. The darkest pixel of thirty volumes in a white furnace was 0.78
after 64, 0.89 after 256 and 0.99 after these; paths that find the light sooner end there.
"""


def rounding_error(layers: tuple[Layer, ...], inputs: PlanInputs, lobes: int = 0) -> float:
    """Relative RMS error of the luminance by rounding to half floats and bytes; 0 for single
    floats.
    """
    if not any(layer.half for layer in layers):
        return 0.0
    if max(layer.order for layer in layers) > 1:
        half = HALF_SUM
    else:
        half = HALF_ONE
    return math.sqrt(half**2 + sum(byte_error(layer, inputs, lobes) ** 2 for layer in layers))


def byte_error(layer: Layer, inputs: PlanInputs, lobes: int = 0) -> float:
    """The part of the rounding error that a layer's bytes cause: BYTE_ROUNDING times what these
    bands carry.
    """
    if layer.coarse is None:
        return 0.0
    below, above = (
        cut_error(replace(layer, order=n), inputs, lobes) for n in (layer.coarse, layer.order)
    )
    return BYTE_ROUNDING * math.sqrt(max(below**2 - above**2, 0.0))


def bounces_for(albedo: Colour, target_error: float) -> int:
    """The fewest bounces for which the rest, at most R^(bounces + 1) of the light, is within its
    share.
    """
    brightest = max(albedo)
    if brightest <= 0.0:
        return 0
    if brightest >= 1.0:
        return LONGEST_PATH
    return min(
        max(math.ceil(math.log(target_error * BOUNCES_SHARE) / math.log(brightest)) - 1, 0),
        LONGEST_PATH,
    )


def survival_for(albedo: Colour, bounces: int) -> float:
    """The probability that a path goes on after its second and later hits; 1 where roulette does
    not pay.
    """
    brightest = max(albedo)
    if bounces > 1 and brightest >= ROULETTE_ALBEDO:
        return brightest
    return 1.0


def branches_for(layers: tuple[Layer, ...], inputs: PlanInputs) -> int:
    """In how many ways paths go on from the first surface that they hit: a power of two, at most
    MOST_BRANCHES.

    Where v_d and v_r are the variances that what comes straight and what was reflected bring by
    each path, and a path takes one ray and then p more, b branches cost (v_d + v_r / b)(1 + p b)
    for an error: least at √(v_r / (p v_d)). Noise is alike in all bands, so that v_r / v_d is R²
    times the energy of the bands that either meets, and falls with p as v_r does; band 0, which
    varies by whether first rays hit anything, gains little. Light that lobes are taken out of gains
    most. Lobes that a plan leaves in harmonics are not asked for, nor how many bands it keeps:
    plans of one light share their layers.
    """
    straight, met = (
        energy[1:BRANCHED].sum()
        for energy in (inputs.energy_beside(len(inputs.lobes)), inputs.energy)
    )
    if met == 0.0 or all(layer.kind != "indirect" for layer in layers):
        return 1
    best = max(inputs.albedo) * math.sqrt(BRANCHING * met / max(straight, 1e-9 * met))
    return min(1 << round(math.log2(max(best, 1.0))), MOST_BRANCHES)


def tail_of_bounces(albedo: Colour, bounces: int) -> float:
    """Upper bound of the light that longer paths would bring: R^(bounces + 1), the tail of a
    geometric series.
    """
    return float(max(albedo) ** (bounces + 1))


def even(inputs: PlanInputs) -> bool:
    """Whether the light may be taken as the same from all sides."""
    return (
        not inputs.lamps.any
        and truncation_error(inputs.energy, 1, "direct") <= EVEN_LIGHT_SHARE * inputs.target_error
    )


UNCUT_KINDS = ("irradiance", GLOW_KIND)
"""The kinds of layers that no harmonics are cut off from."""


def harmonics_error(layers: tuple[Layer, ...], inputs: PlanInputs, lobes: int = 0) -> float:
    """Relative error of cutting off the bands beyond the layers', a root mean square over rotations
    of the light.

    Errors of direct and of reflected light are taken as independent. Layers that are UNCUT_KINDS
    cut off nothing. The first ``lobes`` lobes are lit apart from direct light's harmonics.
    """
    return math.sqrt(
        sum(
            cut_error(layer, inputs, lobes) ** 2
            for layer in layers
            if layer.kind not in UNCUT_KINDS
        )
    )


def cut_error(layer: Layer, inputs: PlanInputs, lobes: int = 0) -> float:
    """The part of the error that one layer causes: the bands from its order on."""
    if layer.kind == "indirect":
        return truncation_error(inputs.energy, layer.order, "indirect", max(inputs.albedo))
    return truncation_error(inputs.energy_beside(lobes), layer.order, "direct")
