"""The things that a plan leaves out, with the reason and the saving of each: the plan is
compared with the same plan and that one thing added.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace

from isogi_core.kernels.tracing.peels import MAX_PEELED_LAYERS
from isogi_core.model.environment import Environment, Lamps
from isogi_core.model.material import Shine
from isogi_core.model.scene_plan import GLOW_KIND, Layer, LeftOut, Saving, ScenePlan
from isogi_core.model.volume import Isovalue
from isogi_core.plan.albedo_nodes import mixing_error
from isogi_core.plan.bands import truncation_error
from isogi_core.plan.budget import (
    LONGEST_PATH,
    ROULETTE_RAYS,
    bounces_for,
    rounding_error,
    tail_of_bounces,
)
from isogi_core.plan.inputs import PlanInputs
from isogi_core.plan.projection import ProjectionPlan
from isogi_core.plan.reachable_texels import TexelCount

LOBE_KERNELS = (
    *(
        "prepare_points",
        "sort_by_turn",
        "see_middles",
        "mark_edges",
        "see_rims",
        "spread_edges",
        "find_sides",
    ),
    *("see_discs", "share_rays", "light_points", "add_halves", "add_lobes"),
)
"""Names of the kernels that are called only under lights with lobes."""


def uncalled(rotating: bool, environment: Environment, lamps: Lamps, lobes: int) -> tuple[str, ...]:
    """Return the names of kernels that no frame calls: constant and fixed lights are not
    rotated.
    """
    called = {"rotate": rotating and bool(environment.image.any()), "project_lamps": lamps.any}
    called |= dict.fromkeys(LOBE_KERNELS, lobes > 0)
    return tuple(name for name, needed in called.items() if not needed)


MEASURED_BANDS = 5
"""Order of the harmonics in S1, the first of the sources that the README lists."""

S1_BYTES = 3 * MEASURED_BANDS**2 * 4
"""Bytes of a texel in S1 for any light: 25 floats for each channel."""

FLOAT_BYTES = 4

MAX_MEASURED_ALBEDO = 0.95
"""Highest albedo at which ROULETTE_RAYS was measured, with at least as many bounces as the
planner chooses.
"""

REASONS = {
    "vicinity": "The light is the same from all sides: a texel keeps the share of it that arrives.",
    "constant": (
        "The light is the same from all sides: a texel keeps how much arrives, not from where."
    ),
    "irradiance": "The light stays where it is: a texel keeps how much arrives, not from where.",
}
"""Reason for which a representation needs no harmonics."""


def left_out(plan: ScenePlan, inputs: PlanInputs) -> tuple[LeftOut, ...]:
    """Return all things that a plan leaves out because of the scene's lights, material and
    target error.
    """
    return tuple(each for find in FINDERS for each in find(plan, inputs))


def harmonics(plan: ScenePlan, _: PlanInputs) -> Iterator[LeftOut]:
    """Yield S1's harmonics, if texels keep none."""
    if plan.representation in REASONS:
        saved = Saving(S1_BYTES - plan.bytes_per_texel, "bytes per texel beside S1")
        yield LeftOut(
            "S1's harmonics in floats of three channels", REASONS[plan.representation], (saved,)
        )


def bands(plan: ScenePlan, inputs: PlanInputs) -> Iterator[LeftOut]:
    """Yield the bands of direct light that S1 keeps and this plan does not, and those of
    reflected light that direct light has.
    """
    if plan.representation != "transfer":
        return
    direct, *reflected = (layer for layer in plan.layers if layer.kind != GLOW_KIND)
    if direct.order < MEASURED_BANDS:
        error = truncation_error(inputs.energy_beside(plan.lobes), direct.order, "direct")
        yield missing_bands(direct, MEASURED_BANDS, error, inputs)
    for layer in reflected:
        if layer.order < direct.order:
            error = truncation_error(inputs.energy, layer.order, "indirect", max(inputs.albedo))
            yield missing_bands(layer, direct.order, error, inputs)


def missing_bands(layer: Layer, order: int, error: float, inputs: PlanInputs) -> LeftOut:
    """Return the entry for the bands below ``order`` that a ``layer`` of direct or reflected light
    does not keep, with the relative ``error`` that this causes.
    """
    if layer.order < order - 1:
        names = f"bands {layer.order} to {order - 1}"
    else:
        names = f"band {layer.order}"
    kind = "reflected" if layer.kind == "indirect" else "direct"
    why = (
        f"Without them the error of the lit surface is {percent(error)}; the target is "
        f"{percent(inputs.target_error)}."
    )
    return LeftOut(f"{names} of {kind} light", why, (added(layer, replace(layer, order=order)),))


def lobes(plan: ScenePlan, inputs: PlanInputs) -> Iterator[LeftOut]:
    """Yield the lobes that the light has and the plan does not take out."""
    # Compare the error of direct light's harmonics with that if all lobes were taken out.
    more = len(inputs.lobes) - plan.lobes
    if plan.representation == "transfer" and more:
        errors = [
            truncation_error(inputs.energy_beside(n), plan.order, "direct")
            for n in (plan.lobes, plan.lobes + more)
        ]
        if more > 1:
            what = f"lobes {plan.lobes + 1} to {plan.lobes + more}"
        else:
            what = f"lobe {plan.lobes + 1}"
        why = (
            "Lit by shadow rays they would bring the error of direct light's harmonics "
            f"from {percent(errors[0])} to"
        )
        yield LeftOut(
            f"{what} of the light",
            f"{why} {percent(errors[1])}.",
            (Saving(more, "shadow rays per pixel, or more"),),
        )


def channels(plan: ScenePlan, _: PlanInputs) -> Iterator[LeftOut]:
    """Yield the colour channels that would all be the same."""
    for layer in plan.layers:
        if layer.colours == 1 and not layer.nodes:
            what, why = SINGLE_CHANNELS[layer.kind]
            more = added(layer, replace(layer, channels=3 * layer.channels))
            yield LeftOut(f"two of three channels of {what}", why, (more,))


SINGLE_CHANNELS = {
    "direct": ("direct light", "Light that was not reflected has no colour of the surface."),
    "indirect": (
        "reflected light",
        "The albedo is grey, so that reflected light keeps its colour.",
    ),
    "whole": ("light", "The albedo is grey, so that reflected light keeps its colour."),
    "irradiance": ("irradiance", "The albedo and all lights are grey."),
    GLOW_KIND: ("what glows", "The albedo is grey: glows have the colours that frames give them."),
}
"""Name of a layer's light by its kind, and the reason for which one channel is enough."""


def one_albedo(plan: ScenePlan, inputs: PlanInputs) -> Iterator[LeftOut]:
    """Yield the choice of albedos by views, if the surface has colours."""
    if inputs.by_data and plan.bounces:
        one = [layer for layer in plan.layers if layer.reflected and layer.channels == 3]
        more = sum(added(replace(layer, channels=1), layer).amount for layer in one)
        if more:
            cost = f", which takes {more:g} bytes a texel more than that of one grey albedo"
        else:
            cost = ""
        why = f"Reflected light carries the colours of surfaces{cost}: it is baked for these alone."
        yield LeftOut("albedos that views choose", why)


def nodes(plan: ScenePlan, _: PlanInputs) -> Iterator[LeftOut]:
    """Yield light after each bounce, if light of any albedo is mixed from that of a few nodes."""
    for layer in plan.layers:
        if 0 < len(layer.nodes) < plan.bounces:
            albedos = ", ".join(f"{node:.2g}" for node in layer.nodes)
            error = mixing_error(layer.nodes, plan.bounces)
            mixed = f"Light of any other albedo is mixed from that of {albedos}"
            why = f"{mixed}, at an error of {percent(error)} if all hits are alike."
            yield LeftOut(
                "light after each bounce",
                why,
                (added(layer, replace(layer, channels=plan.bounces)),),
            )


def reflections(plan: ScenePlan, inputs: PlanInputs) -> Iterator[LeftOut]:
    """Yield reflected light, or the light of paths with more bounces than the plan's."""
    # The tail bounds the light of all longer paths; without bounces this is all reflected light.
    tail = tail_of_bounces(inputs.reflecting, plan.bounces)
    if plan.bounces == 0:
        if tail == 0.0:
            why = "Nothing is reflected at albedo 0."
        else:
            why = f"It would be at most {percent(tail)} of the light."
        if not (tail <= inputs.target_error):
            why = "The scene asks for light before it is reflected."
        yield LeftOut(
            "reflected light",
            why,
            (Saving(LONGEST_PATH, "rays per path, at most"), *unreflected(plan, inputs)),
        )
    else:
        why = f"They would bring at most {percent(tail)} of the light."
        longer = Saving(LONGEST_PATH - plan.bounces, "rays per path, at most")
        yield LeftOut(
            f"bounces after number {plan.bounces}", why, (longer,) if longer.amount > 0 else ()
        )


def ends(plan: ScenePlan, inputs: PlanInputs) -> Iterator[LeftOut]:
    """Yield the rest of paths that roulette ends, with the rays that this saves if that was
    measured: see MAX_MEASURED_ALBEDO.
    """
    if plan.survival == 1.0:
        return
    why = (
        f"From its second hit on a path continues with probability {plan.survival:.2g}, and "
        "stands for those that end."
    )
    # The saving was measured on paths of at least as many bounces as the target error needs. A
    # scene may ask for fewer, and shorter paths save less.
    long_enough = plan.bounces >= bounces_for(inputs.reflecting, inputs.target_error)
    saved: tuple[Saving, ...] = ()
    if long_enough and max(inputs.reflecting) <= MAX_MEASURED_ALBEDO:
        saved = (Saving(ROULETTE_RAYS, "percent of rays", True),)
    yield LeftOut("the rest of paths that end by chance", why, saved)


def unreflected(plan: ScenePlan, inputs: PlanInputs) -> Iterator[Saving]:
    """Yield the bytes of reflected light, if that would be a layer of its own."""
    if plan.representation == "transfer":
        layer = Layer("indirect", plan.order, 1 if inputs.grey else 3, plan.half)
        yield Saving(layer.bytes_per_texel, "bytes per texel")


def halves(plan: ScenePlan, inputs: PlanInputs) -> Iterator[LeftOut]:
    """Yield the second half of each float, and the second byte of each coefficient that is kept
    in a byte.
    """
    if not plan.half:
        return
    # First compare half floats with single ones, then the plan's bytes with half floats.
    halved = tuple(replace(layer, coarse=None) for layer in plan.layers)
    saved = sum(added(layer, replace(layer, half=False)).amount for layer in plan.layers)
    error = rounding_error(halved, inputs, plan.lobes)
    target = inputs.target_error
    why = f"The error of half floats is {percent(error)}; the target is {percent(target)}."
    yield LeftOut("half of each float", why, (Saving(saved, "bytes per texel"),))
    if plan.layers != halved:
        saved = sum(added(*pair).amount for pair in zip(plan.layers, halved, strict=True))
        error = rounding_error(plan.layers, inputs, plan.lobes)
        why = (
            "Higher bands carry little: with them in bytes, the error of rounding is "
            f"{percent(error)} in all."
        )
        yield LeftOut("second bytes of higher bands", why, (Saving(saved, "bytes per texel"),))


def records(plan: ScenePlan, _: PlanInputs) -> Iterator[LeftOut]:
    """Yield facts of a texel that can be recovered without being stored."""
    why = "A texel lies on the isosurface of the volume's value at it."
    yield LeftOut("isovalue of each texel", why, (Saving(FLOAT_BYTES, "bytes per texel"),))
    codes = sum(layer.noises + 1 for layer in plan.layers)
    why = "A byte holds noise to 5 %, and sample counts, which are powers of two, exactly."
    yield LeftOut(
        "noise and samples as floats", why, (Saving((FLOAT_BYTES - 1) * codes, "bytes per texel"),)
    )
    spreads = sum(layer.coefficients - layer.noises for layer in plan.layers if layer.order > 1)
    if spreads:
        why = "The noise of band 0 and that of the bands above give the noise of the luminance."
        yield LeftOut(
            "noise of each coefficient", why, (Saving(FLOAT_BYTES * spreads, "bytes per texel"),)
        )


def turning(plan: ScenePlan, inputs: PlanInputs) -> Iterator[LeftOut]:
    """Yield rotation of the light."""
    if plan.representation in ("vicinity", "constant"):
        yield LeftOut(
            "turning of the light", "It is the same from all sides, however it is turned."
        )
    elif not inputs.rotating:
        yield LeftOut("turning of the light", "The light that is kept does not turn.")


def shadow_rays(plan: ScenePlan, inputs: PlanInputs) -> Iterator[LeftOut]:
    """Yield the table by which shadow rays would be aimed at bright parts of the environment, if
    that is not ``sharp``; and all shadow rays, if there are no lamps either.
    """
    if inputs.environment.sharp:
        return
    # Lamps always get shadow rays: without lamps no hit sends any.
    if not inputs.lamps.any:
        why = "No light is sharp: the rays that the surface draws find it."
        yield LeftOut("shadow rays", why, (Saving(1, "ray per hit"),))
    # The table has cumulative shares of 8 bytes, with guides of 4 bytes, over the rows and within
    # each row; the borders of rows; and 16 bytes for each pixel. An image of one pixel is constant.
    height, width = inputs.environment.image.shape[:2]
    if height * width > 1:
        size = 12 * (height + 1 + height * (width + 1)) + 8 * (height + 1) + 16 * height * width
        why = "No ray is aimed at the environment, as it is not sharp."
        yield LeftOut("sampling table of the environment", why, (Saving(size / 1e6, "megabytes"),))


def kernels(plan: ScenePlan, inputs: PlanInputs) -> Iterator[LeftOut]:
    """Yield kernels that neither frames under global illumination nor their bake call."""
    # Irradiance and transfer are baked by different kernels. Walls, several surfaces and colours
    # need further ones, and then the plain one of the representation is idle, too.
    if plan.representation == "irradiance":
        bakes = ["bake_texels"]
    else:
        bakes = ["bake_irradiance"]
    if plan.representation == "irradiance" and (inputs.walls or inputs.by_data):
        bakes += ["bake_irradiance"]
    if plan.representation != "irradiance" and inputs.by_data and plan.bounces:
        bakes += ["bake_texels"]
    idle = (*bakes, *uncalled(inputs.rotating, inputs.environment, inputs.lamps, plan.lobes))
    why = (
        "Neither frames under global illumination nor their bake call them: a server of this "
        "scene alone does not"
        " compile them for either."
    )
    yield LeftOut(f"kernels {', '.join(idle)}", why, (Saving(len(idle), "kernels"),))


def unseen(texels: TexelCount, plan: ScenePlan) -> tuple[LeftOut, ...]:
    """Return the texels and chunks that no view ever shows, and the texels that can hold no
    light.
    """
    empty = texels.chunks - texels.shown_chunks
    kept = Saving(
        lattice_bytes(empty, texels.chunk, plan.bytes_per_texel) / 1e6,
        "megabytes before compression",
    )
    left = (
        (
            "unseen",
            "No isovalue that views may show has a surface at them.",
            texels.total - texels.shown,
        ),
        (
            "void",
            "They have no gradient, no separate side in a thin wall, or no room in a crease.",
            texels.void,
        ),
    )
    found = [
        LeftOut(f"{sort} texels", why, (Saving(count, "texels", sort == "void"),))
        for sort, why, count in left
        if count
    ]
    if empty:
        why = "None of their texels is ever shown: they are neither baked nor written."
        found.append(LeftOut("empty chunks", why, (Saving(empty, "chunks"), kept)))
    return tuple(found)


def unprojected(projection: ProjectionPlan, isovalue: Isovalue) -> tuple[LeftOut, ...]:
    """Return surface-projected texels, if views of an ``isovalue`` have none."""
    if projection.projects(isovalue):
        return ()
    error = projection.error(isovalue)
    allowed = projection.allowed
    why = (
        f"The error of interpolation is about {percent(error)} where views start; "
        f"{percent(allowed)} is allowed."
    )
    if not allowed:
        why = "The scene forbids them."
    return (
        LeftOut(
            "surface-projected texels", why, (Saving(100, "percent of a view's texels, at most"),)
        ),
    )


def left_out_of_shine(shine: Shine | None) -> tuple[LeftOut, ...]:
    """Return mirrored rays, if the surface has no ``shine``; else baked light of shine, as its
    rays read diffuse light.
    """
    if shine is not None:
        return (
            LeftOut(
                "baked light of shine", "Its rays read the diffuse light of texels where they end."
            ),
        )
    why = "The surface is diffuse: no ray is mirrored, and no kernel of shine is compiled."
    return (LeftOut("shine", why, (Saving(1, "ray per pixel, or more"),)),)


def left_out_of_several(pinned: int, levels: int, plan: ScenePlan) -> tuple[LeftOut, ...]:
    """Return the parts of several surfaces that are not shown or kept.

    These are surfaces behind the first ones in a pixel, and, if some are ``pinned``, their light at
    isovalues between the ``levels``.
    """
    why = (
        "The last that a pixel shows is the first opaque one that is left; what counts less "
        "than 1/512 is left out."
    )
    deep = LeftOut(
        f"surfaces behind the first {MAX_PEELED_LAYERS} in a pixel",
        why,
        (Saving(1, "surface a pixel, or more"),),
    )
    if not pinned:
        return (deep,)
    size = plan.bytes_per_texel
    kept = (
        f"either side keeps {size} bytes a texel at each of {levels} levels that views "
        "need, and views mix two"
    )
    why = f"The surface that slides moves about a voxel from level to level: {kept}."
    return (deep, LeftOut("light of pinned surfaces at each isovalue", why))


def left_out_of_sides(plan: ScenePlan) -> tuple[LeftOut, ...]:
    """Return the irradiance of each side by itself, which texels of a transmitting surface do
    not distinguish.
    """
    why = (
        "A texel keeps the light that leaves its side: some of its paths start on the other "
        "side, in proportion to the transmission."
    )
    return (
        LeftOut(
            "irradiance of each side by itself",
            why,
            (Saving(plan.bytes_per_texel, "bytes per texel"),),
        ),
    )


def lattice_bytes(chunks: int, side: int, bytes_per_texel: int) -> int:
    """Return the bytes of ``chunks`` chunks before compression; each has room for all of its
    texels.
    """
    return chunks * side**3 * bytes_per_texel


def percent(share: float) -> str:
    """Format a share in percent with three digits."""
    return f"{100.0 * share:.3g}%"


def added(layer: Layer, larger: Layer) -> Saving:
    """Return the bytes that the ``larger`` layer would add to a ``layer``."""
    return Saving(larger.bytes_per_texel - layer.bytes_per_texel, "bytes per texel")


FINDERS: tuple[Callable[[ScenePlan, PlanInputs], Iterator[LeftOut]], ...] = (
    *(harmonics, bands, lobes, channels, one_albedo, nodes, reflections, ends, halves, records),
    *(turning, shadow_rays, kernels),
)
"""The finders of ``left_out``: each yields one sort of thing that a plan leaves out."""
