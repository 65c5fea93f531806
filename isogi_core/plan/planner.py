"""The planner: derive the least that texels must keep from a scene's lights, albedo and target
error.
"""

import math
from collections.abc import Iterator
from dataclasses import replace

from isogi_core.errors import LightError, SceneError
from isogi_core.model.scene_plan import GLOW_KIND, GlowLayer, Layer, ScenePlan, most_samples
from isogi_core.plan.albedo_nodes import choose_nodes, mixing_error
from isogi_core.plan.bands import FAR_BANDS, FAR_BANDS_ERROR, choose_order, truncation_error
from isogi_core.plan.budget import (
    HARMONICS_SHARE,
    MIXING_SHARE,
    ROUNDING_SHARE,
    bounces_for,
    branches_for,
    even,
    harmonics_error,
    rounding_error,
    survival_for,
    tail_of_bounces,
)
from isogi_core.plan.inputs import PlanInputs, PlanOverrides
from isogi_core.plan.left_out import left_out, percent

MIN_RADIANCE = 1e-32
MAX_RADIANCE = 1e32
"""Range of a white surface's radiance within which frames of single floats show all shades down
to a millionth of white.
"""


def refuse_brightness(inputs: PlanInputs) -> None:
    """Raise LightError if all lights together are too bright for frames to hold, or so dim that
    frames are black.
    """
    if inputs.brightest != 0.0 and not MIN_RADIANCE <= inputs.brightest <= MAX_RADIANCE:
        given = f"The lights give a white surface the radiance {inputs.brightest:.3g}"
        raise LightError(
            f"{given}: scale them to give it from {MIN_RADIANCE:g} to {MAX_RADIANCE:g}, or nothing."
        )


def refuse_overrides(
    representation: str, bounces: int, inputs: PlanInputs, overrides: PlanOverrides
) -> None:
    """Raise SceneError if one of the ``overrides`` does not fit the scene: it cannot show the
    scene's light, contradicts another one, or changes nothing in the plan.

    ``representation`` and ``bounces`` are those of the plan, given or chosen.
    """
    refuse_lights(representation, inputs)
    refuse_orders(representation, bounces, overrides)
    refuse_lobes(representation, inputs, overrides)
    refuse_reflections(bounces, inputs, overrides)
    refuse_albedos(representation, bounces, overrides)
    refuse_glow(bounces, inputs, overrides)


def refuse_lights(representation: str, inputs: PlanInputs) -> None:
    """Raise SceneError if the ``representation`` cannot show the scene's lights."""
    if representation in ("vicinity", "constant") and not even(inputs):
        raise SceneError(
            f"representation = '{representation}' shows constant light alone: leave it out."
        )
    if representation == "transfer" and inputs.lamps.any:
        raise SceneError(
            "representation = 'transfer' needs light from far away, and lamps are near: leave "
            "it out."
        )
    if representation != "irradiance" and inputs.walls:
        raise SceneError(
            f"representation = '{representation}' is for a surface alone, and there are walls "
            "or other surfaces: leave it out."
        )
    if representation == "irradiance" and inputs.rotating:
        raise SceneError(
            "representation = 'irradiance' is for light that does not turn: set rotating = false."
        )


def refuse_orders(representation: str, bounces: int, overrides: PlanOverrides) -> None:
    """Raise SceneError if an order of harmonics is given and no harmonics of that kind are
    kept, or if reflected light is to have a higher order than direct light.
    """
    for name, order in (("order", overrides.order), ("indirect_order", overrides.indirect_order)):
        if order is not None and representation != "transfer":
            raise SceneError(
                f"{name} = {order} concerns harmonics, and this light needs none: leave it out."
            )
    if overrides.indirect_order is not None and not bounces:
        raise SceneError(
            f"indirect_order = {overrides.indirect_order} concerns reflected light, and there is "
            "none: leave it out."
        )
    if (
        overrides.order is not None
        and overrides.indirect_order is not None
        and overrides.indirect_order > overrides.order
    ):
        raise SceneError(
            f"indirect_order = {overrides.indirect_order} is above order = {overrides.order}: "
            "take at most that."
        )


def refuse_lobes(representation: str, inputs: PlanInputs, overrides: PlanOverrides) -> None:
    """Raise SceneError if lobes are asked for and the light has fewer, or needs no harmonics."""
    if overrides.lobes and representation != "transfer":
        raise SceneError(
            f"lobes = {overrides.lobes} go with harmonics, and this light needs none: leave it out."
        )
    if overrides.lobes and overrides.lobes > len(inputs.lobes):
        raise SceneError(
            f"lobes = {overrides.lobes} is more than this light has: take at most "
            f"{len(inputs.lobes)}."
        )


def refuse_reflections(bounces: int, inputs: PlanInputs, overrides: PlanOverrides) -> None:
    """Raise SceneError if an override concerns reflected light and there is none."""
    if overrides.representation == "vicinity" and overrides.bounces:
        raise SceneError(
            "representation = 'vicinity' shows light before it is reflected: leave out 'bounces'."
        )
    if overrides.bounces and max(inputs.reflecting) == 0.0:
        raise SceneError(
            f"bounces = {overrides.bounces} concerns reflected light, and albedo 0 has none: "
            "leave it out."
        )
    if overrides.representation == "constant" and not bounces:
        raise SceneError(
            "representation = 'constant' keeps reflected light too, and there is none: leave "
            "it out."
        )


def refuse_albedos(representation: str, bounces: int, overrides: PlanOverrides) -> None:
    """Raise SceneError if views may choose the albedo while texels keep irradiance with
    reflected light, which holds for one albedo only.
    """
    if overrides.albedos is not None and representation == "irradiance" and bounces:
        given = f"albedos = [{overrides.albedos[0]:g}, {overrides.albedos[1]:g}]"
        advice = "set rotating = true, bounces = 0, or leave it out"
        raise SceneError(
            f"{given} needs light that may turn, and this light is baked in place: {advice}."
        )


def refuse_glow(bounces: int, inputs: PlanInputs, overrides: PlanOverrides) -> None:
    """Raise SceneError if views may choose the albedo while texels keep reflected light of
    glows, which holds for one albedo only.
    """
    if overrides.albedos is not None and inputs.glows and bounces:
        given = f"albedos = [{overrides.albedos[0]:g}, {overrides.albedos[1]:g}]"
        raise SceneError(
            f"{given} is for lights alone, and something glows: set bounces = 0, or leave it out."
        )


DIRECTED_ORDER = 2
"""Least order of harmonics in which reflected light still turns with the light."""

LOWEST_BYTES = 2
"""Lowest band of direct light that may be kept in bytes."""

MOST_BANDS = 6
"""Order of harmonics for light that misses the target at any order: bytes grow as n², while the
error under a sun falls only as 1/√n.
"""

MOST_REFLECTED = 5
"""Highest order of reflected light if lobes are taken out of direct light: reflections of the
lobes stay in harmonics, while direct light needs a lower order without them.
"""

FEWER_LOBES_FACTOR = 1.125
"""Factor on the least possible error of harmonics that is accepted for the sake of fewer lobes."""


def plan_scene(inputs: PlanInputs, overrides: PlanOverrides) -> ScenePlan:
    """Derive the plan of a scene from its ``inputs``, with the scene's ``overrides`` in place of
    the planner's choices.

    Raises LightError if the lights are too bright or too dim for frames, and SceneError if the
    overrides do not fit the inputs or change nothing.
    """
    refuse_brightness(inputs)
    # Choose the number of bounces: none if nothing reflects light, or if the scene asks for
    # vicinity shading, which is light before any reflection.
    if overrides.bounces is None:
        bounces = bounces_for(inputs.reflecting, inputs.target_error)
    else:
        bounces = overrides.bounces
    if overrides.representation == "vicinity" or max(inputs.reflecting) == 0.0:
        bounces = 0
    # Choose the kind of light to keep, the lobes that pixels light by shadow rays, and the layers
    # in the least precision that the target allows.
    representation = overrides.representation or choose_representation(inputs, overrides, bounces)
    refuse_overrides(representation, bounces, inputs, overrides)
    if representation == "transfer":
        lobes = lobes_for(inputs, overrides)
    else:
        lobes = 0
    layers = planned_layers(representation, inputs, overrides, bounces, lobes)
    layers = with_precision(layers, inputs, overrides, lobes)
    # Light of glows is a layer next to any other, as frames choose its colour and strength.
    layers += glow_layers(inputs, bounces)
    # The rest of the plan follows from the layers.
    order = max(layer.order for layer in layers)
    samples = most_samples(inputs.target_error)
    survival = survival_for(inputs.reflecting, bounces)
    branches = branches_for(layers, inputs)
    plan = ScenePlan(representation, layers, order, bounces, survival, samples, lobes, branches)
    return complete(plan, inputs, overrides)


def complete(plan: ScenePlan, inputs: PlanInputs, overrides: PlanOverrides) -> ScenePlan:
    """Return the ``plan`` with the parts that follow from its layers: expected errors, notes on
    them, and the list of things left out.
    """
    plan = replace(plan, errors=errors_of(plan, inputs, overrides))
    return replace(plan, notes=notes_on(plan, inputs), left_out=left_out(plan, inputs))


def choose_representation(inputs: PlanInputs, overrides: PlanOverrides, bounces: int) -> str:
    """Return the representation that keeps the fewest numbers per texel."""
    # Walls and other surfaces stay in place, and so does the light that they send.
    if inputs.walls:
        return "irradiance"
    # Light that is the same from all sides needs no direction at all.
    if even(inputs) and (overrides.order is None or inputs.constant):
        return "constant" if bounces else "vicinity"
    if inputs.rotating:
        return "transfer"
    return "irradiance"


def lobes_for(inputs: PlanInputs, overrides: PlanOverrides) -> int:
    """Return the least number of lobes with which direct light's harmonics stay within their share
    of the target.

    If no number reaches the share, return the least whose error is at most FEWER_LOBES_FACTOR times
    the least possible one.
    """
    if overrides.lobes is not None:
        return overrides.lobes
    counts = range(len(inputs.lobes) + 1)
    # Predict the error of direct light's harmonics for each number of lobes.
    errors = [
        truncation_error(inputs.energy_beside(n), overrides.order or MOST_BANDS, "direct")
        for n in counts
    ]
    allowed = max(HARMONICS_SHARE * inputs.target_error, FEWER_LOBES_FACTOR * min(errors))
    return next(n for n in counts if errors[n] <= allowed)


def planned_layers(
    representation: str, inputs: PlanInputs, overrides: PlanOverrides, bounces: int, lobes: int
) -> tuple[Layer, ...]:
    """Return the layers of a ``representation``, before their precision is chosen.

    ``lobes`` is the number of lobes that are taken out of direct light.
    """
    if representation == "vicinity":
        return (Layer("direct"),)
    if representation == "constant" and overrides.albedos is not None:
        return Layer("direct"), reflected(1, inputs, overrides, bounces)
    if representation == "constant":
        return (Layer("whole", channels=1 if inputs.grey else 3),)
    if representation == "irradiance":
        return (
            Layer(
                "irradiance",
                channels=1 if inputs.grey and inputs.grey_light else 3,
                scale=unit_of(inputs),
            ),
        )
    # Light that turns: direct and reflected transfer are kept apart, as they need different orders
    # and only direct light is without the lobes.
    direct = Layer("direct", overrides.order or direct_order(inputs, lobes))
    if not bounces:
        return (direct,)
    if lobes and overrides.order is None:
        most = max(direct.order, MOST_REFLECTED)
    else:
        most = direct.order
    order = overrides.indirect_order or indirect_order(inputs, direct.order, lobes, most)
    return direct, reflected(order, inputs, overrides, bounces)


GLOW_SCALE = 2.0**-6
"""Unit in which light of glows is kept: half floats then hold a millionth of radiance 1 to a
thousandth of its value.
"""


def glow_layers(inputs: PlanInputs, bounces: int) -> tuple[GlowLayer, ...]:
    """Return the layer of glows, as a tuple; an empty one if nothing glows."""
    if not inputs.glows:
        return ()
    # Light that was not reflected, or only by grey surfaces, has the colour that frames give it.
    colours = 1 if inputs.grey or not bounces else 3
    channels = colours * inputs.glows
    return (GlowLayer(GLOW_KIND, channels=channels, scale=GLOW_SCALE, glows=inputs.glows),)


def reflected(order: int, inputs: PlanInputs, overrides: PlanOverrides, bounces: int) -> Layer:
    """Return the layer of reflected light: in its colours, or for grey albedos that light of
    any albedo is mixed from if views may choose it.
    """
    if overrides.albedos is None:
        return Layer("indirect", order, 1 if inputs.grey else 3)
    nodes = choose_nodes(max(inputs.albedo), bounces, MIXING_SHARE * inputs.target_error)
    return Layer("indirect", order, len(nodes), nodes=nodes)


def direct_order(inputs: PlanInputs, lobes: int) -> int:
    """Return the order of direct light next to ``lobes``: the least within its share of the target.

    If MOST_BANDS are too few for that, return the least order up to FAR_BANDS whose error is within
    the target. If there is none, return FAR_BANDS if these bring the error within FAR_BANDS_ERROR,
    else MOST_BANDS.
    """
    energy = inputs.energy_beside(lobes)
    target = inputs.target_error
    order, error = choose_order(energy, HARMONICS_SHARE * target, "direct", MOST_BANDS)
    if error <= HARMONICS_SHARE * target:
        return order
    # The share cannot be reached: take more bands if these bring the error within the whole target,
    # or nearly so.
    further, left = choose_order(energy, target, "direct", FAR_BANDS)
    if left <= max(target, FAR_BANDS_ERROR):
        return max(order, further)
    return order


def indirect_order(inputs: PlanInputs, direct: int, lobes: int, most: int) -> int:
    """Return the order of reflected light, at most ``most``, next to direct light of the order
    ``direct`` without ``lobes``.

    It is the least with which both kinds of light together are within the target. If direct light
    alone misses the target, it is the least with half of direct light's error or less that still
    turns with the light: as independent errors add in quadrature, the sum is then an eighth above
    direct light's error. Under uffizi orders 6 and 2 have an error of 5.1 %, 6 and 3 of 3.5 %, 6
    and 4 of 3.3 %, in 59, 64 and 71 bytes.
    """
    target = inputs.target_error
    error = truncation_error(inputs.energy_beside(lobes), direct, "direct")
    # Leave to reflected light the part of the target that direct light does not use; errors add in
    # quadrature.
    within = error < target
    if within:
        allowed = math.sqrt(target**2 - error**2)
    else:
        allowed = error / 2.0
    order, _ = choose_order(inputs.energy, allowed, "indirect", most, max(inputs.albedo))
    if within:
        return order
    return min(max(order, DIRECTED_ORDER), most)


def unit_of(inputs: PlanInputs) -> float:
    """Return the unit that irradiance is stored in: the power of two for which the brightest
    unshadowed irradiance is 1 to 2 units.

    The whole layer has one unit, so that a texel's bits do not depend on the others in its chunk.
    """
    if inputs.brightest > 0.0:
        return 2.0 ** math.floor(math.log2(inputs.brightest))
    return 1.0


def with_precision(
    layers: tuple[Layer, ...], inputs: PlanInputs, overrides: PlanOverrides, lobes: int
) -> tuple[Layer, ...]:
    """Return the ``layers`` in the least precision whose rounding error is within its share of
    the target, or in the precision that the scene asks for. Raises SceneError if that is bytes, and
    no layer has a band that may be kept in them.
    """
    if overrides.precision is None:
        return next(tried for tried in precisions(layers) if fits(tried, inputs, lobes))
    # The smallest precision has bytes, unless no layer has a band that may be kept in them.
    if overrides.precision == "bytes":
        smallest = next(precisions(layers))
        if all(layer.coarse is None for layer in smallest):
            raise SceneError(
                "precision = 'bytes' is for higher bands, and there are none: leave it out."
            )
        return smallest
    return tuple(replace(layer, half=overrides.precision == "half") for layer in layers)


def precisions(layers: tuple[Layer, ...]) -> Iterator[tuple[Layer, ...]]:
    """Yield the ``layers`` in all precisions, smallest first: higher bands in bytes, then half
    floats, then single floats.
    """
    for band in range(LOWEST_BYTES, max(layer.order for layer in layers)):
        yield tuple(in_bytes(layer, band) for layer in layers)
    yield tuple(replace(layer, half=True) for layer in layers)
    yield tuple(replace(layer, half=False) for layer in layers)


def in_bytes(layer: Layer, band: int) -> Layer:
    """Return the ``layer`` with its bands from ``band`` on in bytes. Reflected light is softer,
    and has them from one band earlier on.
    """
    if layer.kind == "indirect":
        first = band - 1
    else:
        first = band
    return replace(layer, half=True, coarse=first if first < layer.order else None)


def fits(layers: tuple[Layer, ...], inputs: PlanInputs, lobes: int) -> bool:
    """Return True if the rounding error of the ``layers`` is within its share of the target;
    single floats always fit.
    """
    return (
        not layers[0].half
        or rounding_error(layers, inputs, lobes) <= ROUNDING_SHARE * inputs.target_error
    )


def errors_of(
    plan: ScenePlan, inputs: PlanInputs, overrides: PlanOverrides
) -> tuple[tuple[str, float], ...]:
    """Return the expected relative errors of a plan, by cause; causes without an error are left
    out.

    The error of bounces is an upper bound, and is given only if the planner chose their number. A
    layer may keep more bands than the plan's order; these are not read, and so do not count.
    """
    chosen = overrides.bounces is None and plan.representation != "vicinity"
    # Frames read the bands below the plan's order alone.
    read = tuple(replace(layer, order=min(layer.order, plan.order)) for layer in plan.layers)
    errors = (
        ("harmonics", harmonics_error(read, inputs, plan.lobes)),
        ("bounces", tail_of_bounces(inputs.reflecting, plan.bounces) if chosen else 0.0),
        ("albedo", mixing_error(plan.nodes, plan.bounces) if plan.nodes else 0.0),
        ("rounding", rounding_error(read, inputs, plan.lobes)),
    )
    return tuple((cause, error) for cause, error in errors if error > 0.0)


def notes_on(plan: ScenePlan, inputs: PlanInputs) -> tuple[str, ...]:
    """Return a sentence for each expected error that is above the target."""
    above = {cause: percent(error) for cause, error in plan.errors if error > inputs.target_error}
    target = f"more than the target of {percent(inputs.target_error)}."
    notes = []
    if "harmonics" in above:
        if inputs.rotating:
            advice = " If it need not turn, rotating = false bakes it in place."
        else:
            advice = ""
        sharp = f"The light is too sharp for harmonics of order {plan.order}"
        notes.append(f"{sharp}: expect an error of {above['harmonics']}, {target}{advice}")
    if "bounces" in above:
        notes.append(
            f"Paths end after {plan.bounces} bounces: at most {above['bounces']} of the "
            f"light is lost, {target}"
        )
    return tuple(notes)


def vicinity_plan(plan: ScenePlan) -> ScenePlan:
    """Return the plan of vicinity shading in a scene of this ``plan``: band 0 of direct light,
    read from a layer that the scene keeps anyway if there is one.
    """
    direct = next(
        (layer for layer in plan.layers if layer.kind == "direct"), Layer("direct", half=plan.half)
    )
    return ScenePlan("vicinity", (direct,), 1, 0, 1.0, plan.samples)
