"""Rows of text about a scene: its facts and its plan, for a person."""

from collections.abc import Iterator

from server.facts import LayerFacts, Omission, PlanFacts, SavingFacts, SceneFacts

WHAT = 46


def summary(facts: SceneFacts) -> Iterator[tuple[str, str]]:
    """Name and text of each fact."""
    volume, low_high = facts.volume, facts.ranges["isovalue"]
    yield "scene", facts.name
    yield "volume", f"{volume.name}, {by(volume.size)} voxels of {volume.dtype}, spacing {by(volume.spacing)}"
    yield "values", f"{volume.value_range[0]:.10g} to {volume.value_range[1]:.10g}, {volume.holes} not finite"
    yield "isovalue", f"{facts.defaults['isovalue']:.10g}, from {low_high.min:.10g} to {low_high.max:.10g}"
    yield "solid", facts.solid
    others = "" if facts.albedos is None else f"; views may ask for {facts.albedos.min:g} to {facts.albedos.max:g}"
    yield "albedo", ", ".join(f"{channel:g}" for channel in facts.albedo) + others
    yield "lights", ", ".join(light.name for light in facts.lights)
    yield "target error", f"{facts.target_error:g}"


def plan_rows(plan: PlanFacts) -> Iterator[tuple[str, str]]:
    """Name and text of each fact of a plan."""
    yield "plan", f"{plan.representation}, {plan.bounces} bounces, at most {plan.samples} samples"
    for layer in plan.layers:
        albedos = f" for albedo {', '.join(map('{:.2g}'.format, layer.nodes))}" if layer.nodes else ""
        numbers = f"order {layer.order}, {layer.channels} channel(s){albedos}, {kept_as(layer)}"
        yield "layer", f"{layer.kind}: {numbers}, {layer.bytes_per_texel} bytes"
    for lobe in plan.lobes:
        yield (
            "lobe",
            f"{lobe.angle:.2g}° across, azimuth {lobe.azimuth:.1f}°, elevation {lobe.elevation:.1f}°: shadow rays",
        )
    yield "texel", f"{plan.bytes_per_texel} bytes, beside {plan.full_bytes_per_texel} for any scene in S1"
    yield (
        "texels",
        f"{plan.texels.shown:,} of {plan.texels.total:,} can be shown, {plan.texels.void:,} of these are void",
    )
    yield "chunks", f"{plan.texels.shown_chunks:,} of {plan.texels.chunks:,} can be shown"
    if plan.errors:
        yield "errors", ", ".join(f"{cause} {error:.2%}" for cause, error in plan.errors.items())
    yield from (("note", note) for note in plan.notes)


def kept_as(layer: LayerFacts) -> str:
    """How a layer's numbers are kept, for a person."""
    if layer.coarse is None:
        return f"{layer.precision} floats"
    return f"half floats, and bytes from band {layer.coarse} on"


def omission(left_out: Omission) -> Iterator[str]:
    """What is left out and what that saves, on one line; the reason on the next."""
    saved = ", ".join(map(amount, left_out.saves))
    yield f"  {left_out.what:<{WHAT}} {saved}".rstrip()
    yield f"      {left_out.why}"


def amount(saved: SavingFacts) -> str:
    """What was saved, with three digits, or as whole numbers."""
    number = f"{saved.amount:,.0f}" if saved.amount >= 100 or saved.amount % 1 == 0 else f"{saved.amount:.3g}"
    return f"{number} {saved.unit}{' (measured)' if saved.measured else ''}"


def by(numbers: tuple[float, ...]) -> str:
    """Numbers with × between them."""
    return " × ".join(f"{number:g}" for number in numbers)
