"""The planner: from a scene's lights, albedo and target error to the least that its texels must keep."""

import math
from dataclasses import replace

from isogi_core.model.plan import Layer, ScenePlan, most_samples
from isogi_core.plan.bands import choose_order, truncation_error
from isogi_core.plan.budget import (
    HARMONICS,
    ROUNDING,
    bounces_for,
    even,
    harmonics_error,
    rounding_error,
    tail_of_bounces,
)
from isogi_core.plan.needs import Needs, Told
from isogi_core.plan.refusals import refuse_idle
from isogi_core.plan.savings import left_out

DIRECTED = 2
"""The least order of reflected light that turns with the light."""

MOST_BANDS = 5
"""Orders beyond this are for a scene to tell: bytes grow as n², while the error under a sun falls as 1 / √n."""


def plan_scene(needs: Needs, told: Told) -> ScenePlan:
    """Derive the plan. Raises SceneError where what is told does not fit the scene's lights, or does nothing."""
    bounces = bounces_for(needs.albedo, needs.target_error) if told.bounces is None else told.bounces
    if told.representation == "vicinity" or max(needs.albedo) == 0.0:
        bounces = 0
    representation = told.representation or choose(needs, told, bounces)
    refuse_idle(representation, bounces, needs, told)
    layers = rounded(layers_of(representation, needs, told, bounces), needs, told)
    window = (1.0,) * max(layer.order for layer in layers)
    plan = ScenePlan(representation, layers, bounces, window, most_samples(needs.target_error))
    plan = replace(plan, errors=errors_of(plan, needs, told))
    return replace(plan, notes=notes_on(plan, needs), left_out=left_out(plan, needs))


def choose(needs: Needs, told: Told, bounces: int) -> str:
    """The representation that keeps least."""
    if even(needs) and (told.order is None or needs.constant):
        return "constant" if bounces else "vicinity"
    return "transfer" if needs.rotating else "irradiance"


def layers_of(representation: str, needs: Needs, told: Told, bounces: int) -> tuple[Layer, ...]:
    """The layers of a representation."""
    channels = 1 if needs.grey else 3
    if representation == "vicinity":
        return (Layer("direct"),)
    if representation == "constant":
        return (Layer("whole", channels=channels),)
    if representation == "irradiance":
        return (Layer("irradiance", channels=1 if needs.grey and needs.grey_light else 3, scale=unit_of(needs)),)
    direct = Layer("direct", told.order or direct_order(needs))
    if not bounces:
        return (direct,)
    return direct, Layer("indirect", told.indirect_order or indirect_order(needs, direct.order), channels)


def direct_order(needs: Needs) -> int:
    """The order of light that arrives unreflected: the least whose error is within its share of the target."""
    return choose_order(needs.energy, HARMONICS * needs.target_error, "direct", MOST_BANDS)[0]


def indirect_order(needs: Needs, direct: int) -> int:
    """The order of reflected light: the least with which both kinds are within the target.

    Where direct light errs more than that, the least that errs no more than direct light does, and still turns
    with the light: to keep more gains little. Under uffizi orders 5 and 2 err by 6.0 %, 5 and 3 by 4.7 %, 5 and
    5 by 4.5 %, in 64, 74 and 106 bytes.
    """
    target, error = needs.target_error, truncation_error(needs.energy, direct, "direct")
    within = error < target
    allowed = math.sqrt(target**2 - error**2) if within else error
    order, _ = choose_order(needs.energy, allowed, "indirect", direct, max(needs.albedo))
    return order if within else max(order, DIRECTED)


def unit_of(needs: Needs) -> float:
    """What irradiance is kept in multiples of: a power of two, so that the brightest unshadowed has 1 to 2 of it.

    One for the whole layer: a texel's bits may not depend on which others are in its chunk.
    """
    return 2.0 ** math.floor(math.log2(needs.brightest)) if needs.brightest > 0.0 else 1.0


def rounded(layers: tuple[Layer, ...], needs: Needs, told: Told) -> tuple[Layer, ...]:
    """The layers as half floats where their error is within its share of the target, or where told."""
    fits = rounding_error(layers) <= ROUNDING * needs.target_error
    half = fits if told.precision is None else told.precision == "half"
    return tuple(replace(layer, half=half) for layer in layers)


def errors_of(plan: ScenePlan, needs: Needs, told: Told) -> tuple[tuple[str, float], ...]:
    """Relative errors that the plan expects by what is cut off; of bounces, where it chose them, the most.

    Those that are 0 are left.
    """
    chosen = told.bounces is None and plan.representation != "vicinity"
    errors = (
        ("harmonics", harmonics_error(plan.layers, needs)),
        ("bounces", tail_of_bounces(needs.albedo, plan.bounces) if chosen else 0.0),
        ("rounding", rounding_error(plan.layers)),
    )
    return tuple((cause, error) for cause, error in errors if error > 0.0)


def notes_on(plan: ScenePlan, needs: Needs) -> tuple[str, ...]:
    """Sentences on what stays above the target."""
    error = dict(plan.errors).get("harmonics", 0.0)
    if error <= needs.target_error:
        return ()
    return (
        f"The light is too sharp for harmonics of order {plan.order}: expect an error of {error:.1%}, more than the"
        f" target of {needs.target_error:.1%}. Where it need not turn, rotating = false bakes the light as it is.",
    )


def vicinity_plan(plan: ScenePlan) -> ScenePlan:
    """The plan of vicinity shading in a scene: band 0 of direct light, out of a layer that is kept anyway if it may."""
    direct = next((layer for layer in plan.layers if layer.kind == "direct"), Layer("direct", half=plan.half))
    return ScenePlan("vicinity", (direct,), 0, (1.0,), plan.samples)
