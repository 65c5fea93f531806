"""The planner: from a scene's lights, albedo and target error to the least that its texels must keep."""

import math
from collections.abc import Iterator
from dataclasses import replace

from isogi_core.model.plan import Layer, ScenePlan, most_samples
from isogi_core.plan.albedos import choose_nodes, mixing_error
from isogi_core.plan.bands import choose_order, truncation_error
from isogi_core.plan.budget import (
    HARMONICS,
    MIXING,
    ROUNDING,
    bounces_for,
    even,
    harmonics_error,
    rounding_error,
    survival_for,
    tail_of_bounces,
)
from isogi_core.plan.needs import Needs, Told
from isogi_core.plan.refusals import refuse_brightness, refuse_idle, refuse_no_bytes
from isogi_core.plan.savings import left_out, percent

DIRECTED = 2
"""The least order of reflected light that turns with the light."""

LOWEST_BYTES = 2
"""The lowest band of direct light that bytes may hold."""

MOST_BANDS = 6
"""The order of light that stays beyond the target whatever is kept: bytes grow as n², while the error under a sun falls
as 1 / √n."""

FAR_BANDS = 8
"""The most that a plan takes where that pays; orders beyond it are for a scene to tell.

Under uffizi orders 6 and 8 err by 3.2 and 1.7 %, with 48 and 79 bytes of direct light.
"""

REACH = 0.02
"""The error that FAR_BANDS pay for at any target below, so that a smaller one never takes fewer bands."""

MOST_REFLECTED = 5
"""The order of reflected light where lobes, whose reflections stay in harmonics, left less to direct light, at most."""

MUCH = 1.125
"""How much more than need be harmonics may err by for the sake of fewer lobes."""


def plan_scene(needs: Needs, told: Told) -> ScenePlan:
    """Derive the plan.

    Raises LightError where the lights are beyond what frames can hold, and SceneError where what is told does not fit
    them, or does nothing.
    """
    refuse_brightness(needs)
    bounces = bounces_for(needs.albedo, needs.target_error) if told.bounces is None else told.bounces
    if told.representation == "vicinity" or max(needs.albedo) == 0.0:
        bounces = 0
    representation = told.representation or choose(needs, told, bounces)
    refuse_idle(representation, bounces, needs, told)
    lobes = lobes_for(needs, told) if representation == "transfer" else 0
    layers = rounded(layers_of(representation, needs, told, bounces, lobes), needs, told, lobes)
    order, samples = max(layer.order for layer in layers), most_samples(needs.target_error)
    plan = ScenePlan(representation, layers, order, bounces, survival_for(needs.albedo, bounces), samples, lobes)
    return complete(plan, needs, told)


def complete(plan: ScenePlan, needs: Needs, told: Told) -> ScenePlan:
    """The plan with what its layers mean: errors that are expected, notes on them, and what is left out."""
    plan = replace(plan, errors=errors_of(plan, needs, told))
    return replace(plan, notes=notes_on(plan, needs), left_out=left_out(plan, needs))


def choose(needs: Needs, told: Told, bounces: int) -> str:
    """The representation that keeps least."""
    if even(needs) and (told.order is None or needs.constant):
        return "constant" if bounces else "vicinity"
    return "transfer" if needs.rotating else "irradiance"


def lobes_for(needs: Needs, told: Told) -> int:
    """How many lobes pay: the fewest with which direct light's harmonics err within their share of the target.

    Where none do, the fewest with which they err at most an eighth more than with all.
    """
    if told.lobes is not None:
        return told.lobes
    counts = range(len(needs.lobes) + 1)
    errors = [truncation_error(needs.energy_beside(n), told.order or MOST_BANDS, "direct") for n in counts]
    allowed = max(HARMONICS * needs.target_error, MUCH * min(errors))
    return next(n for n in counts if errors[n] <= allowed)


def layers_of(representation: str, needs: Needs, told: Told, bounces: int, lobes: int) -> tuple[Layer, ...]:
    """The layers of a representation."""
    if representation == "vicinity":
        return (Layer("direct"),)
    if representation == "constant" and told.albedos is not None:
        return Layer("direct"), reflected(1, needs, told, bounces)
    if representation == "constant":
        return (Layer("whole", channels=1 if needs.grey else 3),)
    if representation == "irradiance":
        return (Layer("irradiance", channels=1 if needs.grey and needs.grey_light else 3, scale=unit_of(needs)),)
    direct = Layer("direct", told.order or direct_order(needs, lobes))
    if not bounces:
        return (direct,)
    most = max(direct.order, MOST_REFLECTED) if lobes and told.order is None else direct.order
    order = told.indirect_order or indirect_order(needs, direct.order, lobes, most)
    return direct, reflected(order, needs, told, bounces)


def reflected(order: int, needs: Needs, told: Told, bounces: int) -> Layer:
    """The layer of reflected light alone: in its colours, or for any albedo that views may ask for."""
    if told.albedos is None:
        return Layer("indirect", order, 1 if needs.grey else 3)
    nodes = choose_nodes(max(needs.albedo), bounces, MIXING * needs.target_error)
    return Layer("indirect", order, len(nodes), nodes=nodes)


def direct_order(needs: Needs, lobes: int) -> int:
    """The order of light that arrives unreflected, ``lobes`` beside: the least within its share of the target.

    Where MOST_BANDS are too few for that, the least up to FAR_BANDS that is within the target; else those, where they
    bring it within REACH, or MOST_BANDS.
    """
    energy, target = needs.energy_beside(lobes), needs.target_error
    order, error = choose_order(energy, HARMONICS * target, "direct", MOST_BANDS)
    if error <= HARMONICS * target:
        return order
    further, left = choose_order(energy, target, "direct", FAR_BANDS)
    return max(order, further) if left <= max(target, REACH) else order


def indirect_order(needs: Needs, direct: int, lobes: int, most: int) -> int:
    """The order of reflected light, at ``most`` so much: the least with which both kinds are within the target.

    Where direct light errs more than that, the least that errs by half as much and still turns with the light:
    both together then err by an eighth more than direct light alone. Under uffizi orders 6 and 2 err by 5.1 %, 6
    and 3 by 3.5 %, 6 and 4 by 3.3 %, in 59, 64 and 71 bytes.
    """
    target, error = needs.target_error, truncation_error(needs.energy_beside(lobes), direct, "direct")
    within = error < target
    allowed = math.sqrt(target**2 - error**2) if within else error / 2.0
    order, _ = choose_order(needs.energy, allowed, "indirect", most, max(needs.albedo))
    return order if within else min(max(order, DIRECTED), most)


def unit_of(needs: Needs) -> float:
    """What irradiance is kept in multiples of: a power of two, so that the brightest unshadowed has 1 to 2 of it.

    One for the whole layer: a texel's bits may not depend on which others are in its chunk.
    """
    return 2.0 ** math.floor(math.log2(needs.brightest)) if needs.brightest > 0.0 else 1.0


def rounded(layers: tuple[Layer, ...], needs: Needs, told: Told, lobes: int) -> tuple[Layer, ...]:
    """The layers in the least precision whose error is within its share of the target, or in that told."""
    if told.precision is None:
        return next(kept for kept in precisions(layers) if fits(kept, needs, lobes))
    if told.precision == "bytes":
        return refuse_no_bytes(next(precisions(layers)))
    return tuple(replace(layer, half=told.precision == "half") for layer in layers)


def precisions(layers: tuple[Layer, ...]) -> Iterator[tuple[Layer, ...]]:
    """The layers with their higher bands in bytes, from as low a band as is of use on; as half and as single floats."""
    for band in range(LOWEST_BYTES, max(layer.order for layer in layers)):
        yield tuple(in_bytes(layer, band) for layer in layers)
    yield tuple(replace(layer, half=True) for layer in layers)
    yield tuple(replace(layer, half=False) for layer in layers)


def in_bytes(layer: Layer, band: int) -> Layer:
    """The layer with its bands from ``band`` on in bytes, reflected light's one band earlier: it is softer."""
    first = band - 1 if layer.kind == "indirect" else band
    return replace(layer, half=True, coarse=first if first < layer.order else None)


def fits(layers: tuple[Layer, ...], needs: Needs, lobes: int) -> bool:
    """Whether rounding errs within its share of the target; nothing is rounded less than to single floats."""
    return not layers[0].half or rounding_error(layers, needs, lobes) <= ROUNDING * needs.target_error


def errors_of(plan: ScenePlan, needs: Needs, told: Told) -> tuple[tuple[str, float], ...]:
    """Relative errors that the plan expects by what is cut off; of bounces, where it chose them, the most.

    Those that are 0 are left. Bands of a layer beyond the plan's order are kept and not read.
    """
    chosen = told.bounces is None and plan.representation != "vicinity"
    read = tuple(replace(layer, order=min(layer.order, plan.order)) for layer in plan.layers)
    errors = (
        ("harmonics", harmonics_error(read, needs, plan.lobes)),
        ("bounces", tail_of_bounces(needs.albedo, plan.bounces) if chosen else 0.0),
        ("albedo", mixing_error(plan.nodes, plan.bounces) if plan.nodes else 0.0),
        ("rounding", rounding_error(read, needs, plan.lobes)),
    )
    return tuple((cause, error) for cause, error in errors if error > 0.0)


def notes_on(plan: ScenePlan, needs: Needs) -> tuple[str, ...]:
    """Sentences on what stays above the target."""
    above = {cause: percent(error) for cause, error in plan.errors if error > needs.target_error}
    target = f"more than the target of {percent(needs.target_error)}."
    notes = []
    if "harmonics" in above:
        advice = " Where it need not turn, rotating = false bakes the light as it is." if needs.rotating else ""
        sharp = f"The light is too sharp for harmonics of order {plan.order}"
        notes.append(f"{sharp}: expect an error of {above['harmonics']}, {target}{advice}")
    if "bounces" in above:
        notes.append(f"Paths end after {plan.bounces} bounces: what is lost is {above['bounces']} at most, {target}")
    return tuple(notes)


def vicinity_plan(plan: ScenePlan) -> ScenePlan:
    """The plan of vicinity shading in a scene: band 0 of direct light, out of a layer that is kept anyway if it may."""
    direct = next((layer for layer in plan.layers if layer.kind == "direct"), Layer("direct", half=plan.half))
    return ScenePlan("vicinity", (direct,), 1, 0, 1.0, plan.samples)
