"""Facts of a scene and its plan as rows of name and text, and rows as lines as wide as a terminal."""

import textwrap
from collections.abc import Iterator

from server.schemas import LayerSchema, Omission, PlanSchema, SavingSchema, SceneSchema, VolumeSchema

WHAT = 46
LINE_COLUMNS, LEAD_COLUMNS = 100, 14
"""Columns of a line, and of the name at its beginning."""


def wrapped(lead: str, text: str) -> list[str]:
    """Lines of at most LINE_COLUMNS, the first after its ``lead`` and the others under the text."""
    return textwrap.wrap(text, LINE_COLUMNS, initial_indent=lead, subsequent_indent=" " * len(lead))


def summary(facts: SceneSchema) -> Iterator[tuple[str, str]]:
    """Name and text of each fact."""
    volume, low_high = facts.volume, facts.ranges["isovalue"]
    yield "scene", facts.name
    yield "volume", f"{volume.name}, {by(volume.size)} voxels of {volume.dtype}, spacing {by(volume.spacing)}"
    yield from axes(volume)
    yield "values", f"{volume.value_range[0]:.10g} to {volume.value_range[1]:.10g}, {volume.holes} not finite"
    yield "isovalue", f"{facts.defaults['isovalue']:.10g}, from {low_high.min:.10g} to {low_high.max:.10g}"
    yield "solid", facts.solid
    yield reflects(facts)
    yield "lights", ", ".join(light.name for light in facts.lights)
    yield "target error", f"{facts.target_error:g}"


def reflects(facts: SceneSchema) -> tuple[str, str]:
    """What the surface reflects: its albedo, or its colours by data."""
    if facts.colours is not None:
        scale = facts.colours
        if scale.labels:
            return "labels", ", ".join(label.name for label in scale.labels if label.shown)
        return "colours", f"{scale.map} of {scale.name}, {scale.low:.4g} to {scale.high:.4g}"
    others = "" if facts.albedos is None else f"; views may ask for {facts.albedos.min:g} to {facts.albedos.max:g}"
    return "albedo", ", ".join(f"{channel:g}" for channel in facts.albedo) + others


def axes(volume: VolumeSchema) -> Iterator[tuple[str, str]]:
    """Name and text of where the volume lies, unless its world is its voxels' indices times spacing."""
    low, high = ((", ".join(f"{number:.6g}" for number in corner)) for corner in volume.bounds)
    pointing = f"voxel axes point to {', '.join(volume.axes)}; " if volume.axes else ""
    if pointing or any(low != 0.0 for low in volume.bounds[0]) or volume.unit:
        unit = f" {volume.unit}" if volume.unit else ""
        yield "world", f"{pointing}from ({low}) to ({high}){unit}{f', {volume.letters}' if volume.letters else ''}"
    if volume.read_as:
        yield "read as", f"{volume.read_as}; lengths {f'in {volume.unit}' if volume.unit else 'without a unit'}"
    yield from (("note", note) for note in volume.notes)


def plan_rows(plan: PlanSchema) -> Iterator[tuple[str, str]]:
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


def kept_as(layer: LayerSchema) -> str:
    """How a layer's numbers are kept, for a person."""
    if layer.coarse is None:
        return f"{layer.precision} floats"
    return f"half floats, and bytes from band {layer.coarse} on"


def omission(left_out: Omission) -> Iterator[str]:
    """What is left out and what that saves, on one line; the reason on the next."""
    saved = ", ".join(map(amount, left_out.saves))
    yield f"  {left_out.what:<{WHAT}} {saved}".rstrip()
    yield f"      {left_out.why}"


def amount(saved: SavingSchema) -> str:
    """What was saved, with three digits, or as whole numbers."""
    number = f"{saved.amount:,.0f}" if saved.amount >= 100 or saved.amount % 1 == 0 else f"{saved.amount:.3g}"
    return f"{number} {saved.unit}{' (measured)' if saved.measured else ''}"


def by(numbers: tuple[float, ...]) -> str:
    """Numbers with × between them."""
    return " × ".join(f"{number:g}" for number in numbers)
