"""What stands at the head of a report: its scene, view and plan, the machine, and the versions of what measured."""

import math
import os
import platform
from collections.abc import Iterable, Iterator, Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from isogi_core.model.view import Camera, View
from isogi_core.plan.scene import Scene
from server.answers import scene_schema
from server.schemas import LayerSchema, Omission, PlanSchema, SavingSchema, SceneSchema, VolumeSchema

WHAT = 46

PARALLEL = 1e-3
"""Degrees of a field of view below which rays count as parallel: those of an orthographic camera are narrower."""


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


PACKAGES = ("isogi", "numpy", "numba", "zarr", "matplotlib", "flip-evaluator")

Rows = tuple[tuple[str, str], ...]


UNTOLD = {"histogram", "ranges", "presets", "stops", "stops_note", "shadings", "defaults"}
"""What of a scene's document is for those that choose a view, not for a report of one."""


def heading(scene: Scene, view: View) -> dict[str, Any]:
    """The head as a document."""
    return {
        "title": f"{scene.name} at {view.isovalue:g}",
        "scene": scene_schema(scene).model_dump(mode="json", exclude=UNTOLD),
        "view": view_facts(view),
        "machine": machine(),
        "versions": versions(),
    }


def view_facts(view: View) -> dict[str, Any]:
    """The view that is measured."""
    camera = view.camera.in_world(view.orientation)
    return {
        "isovalue": view.isovalue,
        "width": view.width,
        "height": view.height,
        "eye": list(camera.eye),
        "target": list(camera.target),
        "up": list(camera.up),
        "fov": camera.fov,
        "light": list(view.light),
    }


def machine() -> dict[str, Any]:
    """The processor, how many of its cores there are, and the system."""
    return {
        "processor": processor(),
        "cores": os.cpu_count() or 1,
        "system": f"{platform.system()} {platform.machine()}",
    }


def processor(listing: Path = Path("/proc/cpuinfo")) -> str:
    """The processor's name as the system has it."""
    try:
        lines = listing.read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    named = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(named, platform.processor() or "unknown")


def versions() -> dict[str, str | None]:
    """Versions of Python and of what measures and draws; None where it is missing."""
    return {"python": platform.python_version(), **{name: installed(name) for name in PACKAGES}}


def installed(name: str) -> str | None:
    """The version of a package; None where it is missing."""
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def scene_rows(scene: Scene, view: View) -> Rows:
    """Name and text of each fact of the scene and its view, for a person."""
    facts = scene_schema(scene)
    return (*named(facts, "scene", "volume", "solid", "albedo", "lights", "target error"), *view_rows(view))


def named(facts: SceneSchema, *names: str) -> Rows:
    """Some of the facts that ``isogi inspect`` prints."""
    rows = dict(summary(facts))
    return tuple((name, rows[name]) for name in names)


def view_rows(view: View) -> Rows:
    """Name and text of each fact of a view."""
    return (
        ("isovalue", f"{view.isovalue:.10g}"),
        ("picture", f"{by((view.width, view.height))} pixels, {standpoint(view.camera.in_world(view.orientation))}"),
    )


def standpoint(camera: Camera) -> str:
    """Where a camera of the world stands, and what it sees; of one with parallel rays, where it looks."""
    if camera.fov > PARALLEL:
        return f"from {listed(camera.eye)}, {camera.fov:g} degrees high"
    height = 2.0 * math.dist(camera.eye, camera.target) * math.tan(math.radians(camera.fov / 2.0))
    return f"orthographic, along {listed(camera.basis()[2])} to {listed(camera.target)}, {height:.4g} high there"


def listed(numbers: Iterable[float]) -> str:
    """Numbers to four digits."""
    return ", ".join(f"{number:.4g}" for number in numbers)


def plan_facts_rows(scene: Scene) -> Rows:
    """Name and text of each fact of the scene's plan, for a person."""
    return tuple(plan_rows(scene_schema(scene).plan))


def left_out_rows(scene: Scene) -> tuple[tuple[str, str, str], ...]:
    """What the plan leaves out, why, and what that saves."""
    omissions = scene_schema(scene).plan.left_out
    return tuple((each.what, each.why, ", ".join(map(amount, each.saves))) for each in omissions)


def machine_rows(head: Mapping[str, Any]) -> Rows:
    """Name and text of machine and versions, for a person."""
    box, known = head["machine"], head["versions"]
    texts = ", ".join(f"{name} {text}" for name, text in known.items() if text is not None)
    missing = [name for name, text in known.items() if text is None]
    rows = (("machine", f"{box['processor']}, {box['cores']} cores, {box['system']}"), ("versions", texts))
    return (*rows, ("missing", ", ".join(missing))) if missing else rows
