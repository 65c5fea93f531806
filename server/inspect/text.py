"""``isogi inspect`` as text and rows of numbers, for a person."""

import importlib.util
import math
import textwrap
from collections.abc import Iterator
from pathlib import Path

from isogi_core.plan.scene import Scene
from server.errors import LibraryError, ParameterError
from server.inspect.inspection import (
    MEETS,
    REMARKABLE_SHARE,
    ErrorSchema,
    InspectionSchema,
    Remark,
    StiffnessSchema,
    SurfaceSchema,
    inspection_schema,
    percent,
    span,
)
from server.progress import open_scene
from server.schemas import (
    LayerSchema,
    Omission,
    PlanSchema,
    SavingSchema,
    SceneSchema,
    VolumeSchema,
)

WHAT = 46
LINE_COLUMNS = 100
LEAD_COLUMNS = 14
"""Columns of a line, and of the name at its beginning."""


def wrapped(lead: str, text: str) -> list[str]:
    """Lines of at most LINE_COLUMNS, the first after its ``lead`` and the others under the text."""
    return textwrap.wrap(text, LINE_COLUMNS, initial_indent=lead, subsequent_indent=" " * len(lead))


def summary(facts: SceneSchema) -> Iterator[tuple[str, str]]:
    """Name and text of each fact."""
    volume = facts.volume
    low_high = facts.ranges["isovalue"]
    yield "scene", facts.name
    yield (
        "volume",
        f"{volume.name}, {by(volume.size)} voxels of {volume.dtype}, spacing {by(volume.spacing)}",
    )
    yield from axes(volume)
    yield (
        "values",
        f"{volume.value_range[0]:.10g} to {volume.value_range[1]:.10g}, {volume.holes} not finite",
    )
    yield (
        "isovalue",
        f"{facts.defaults['isovalue']:.10g}, from {low_high.min:.10g} to {low_high.max:.10g}",
    )
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
    if facts.albedos is None:
        others = ""
    else:
        others = f"; views may ask for {facts.albedos.min:g} to {facts.albedos.max:g}"
    return "albedo", ", ".join(f"{channel:g}" for channel in facts.albedo) + others


def axes(volume: VolumeSchema) -> Iterator[tuple[str, str]]:
    """Name and text of where the volume lies, unless its world is its voxels' indices times
    spacing.
    """
    low, high = ((", ".join(f"{number:.6g}" for number in corner)) for corner in volume.bounds)
    if volume.axes:
        pointing = f"voxel axes point to {', '.join(volume.axes)}; "
    else:
        pointing = ""
    if pointing or any(low != 0.0 for low in volume.bounds[0]) or volume.unit:
        unit = f" {volume.unit}" if volume.unit else ""
        yield (
            "world",
            (
                f"{pointing}from ({low}) to "
                f"({high}){unit}{f', {volume.letters}' if volume.letters else ''}"
            ),
        )
    if volume.read_as:
        yield (
            "read as",
            f"{volume.read_as}; lengths {f'in {volume.unit}' if volume.unit else 'without a unit'}",
        )
    yield from (("note", note) for note in volume.notes)


def plan_rows(plan: PlanSchema) -> Iterator[tuple[str, str]]:
    """Name and text of each fact of a plan."""
    yield "plan", f"{plan.representation}, {plan.bounces} bounces, at most {plan.samples} samples"
    for layer in plan.layers:
        if layer.nodes:
            albedos = f" for albedo {', '.join(map('{:.2g}'.format, layer.nodes))}"
        else:
            albedos = ""
        numbers = f"order {layer.order}, {layer.channels} channel(s){albedos}, {kept_as(layer)}"
        yield "layer", f"{layer.kind}: {numbers}, {layer.bytes_per_texel} bytes"
    for lobe in plan.lobes:
        yield (
            "lobe",
            (
                f"{lobe.angle:.2g}° across, azimuth {lobe.azimuth:.1f}°, elevation "
                f"{lobe.elevation:.1f}°: shadow rays"
            ),
        )
    yield (
        "texel",
        f"{plan.bytes_per_texel} bytes, beside {plan.full_bytes_per_texel} for any scene in S1",
    )
    yield (
        "texels",
        (
            f"{plan.texels.shown:,} of {plan.texels.total:,} can be shown, {plan.texels.void:,} of "
            "these are void"
        ),
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
    if saved.amount >= 100 or saved.amount % 1 == 0:
        number = f"{saved.amount:,.0f}"
    else:
        number = f"{saved.amount:.3g}"
    return f"{number} {saved.unit}{' (measured)' if saved.measured else ''}"


def by(numbers: tuple[float, ...]) -> str:
    """Numbers with × between them."""
    return " × ".join(f"{number:g}" for number in numbers)


HISTOGRAM_BINS = 24
BAR_COLUMNS = 48
MAX_TABLE_ROWS = 10
"""Isovalues in the table, besides the scene's own and the stiffest."""

MORE_TO_ASK = (
    "--plan shows the plan, the histogram, every remark, and more isovalues; prewarm "
    "--dry-run, the time."
)

TABLE_HEAD = (
    f"  {'isovalue':>11} {'cells':>13} {'steep':>6} {'plateau':>8} {'noisy':>6} "
    f"{'holes':>6}   error about"
)


def full_text(scene: Scene, facts: InspectionSchema) -> str:
    """Facts, plan, what it leaves out, histogram of a scene, and how stiff its volume is."""
    rows = [f"{name:<14}{text}" for name, text in (*summary(facts), *plan_rows(facts.plan))]
    omissions = ["left out", *(line for each in facts.plan.left_out for line in omission(each))]
    bars = ["histogram (bars are logarithmic)", *histogram(scene)]
    return "\n".join([*rows, *omissions, *bars, *stiffness(facts)])


def histogram(scene: Scene) -> Iterator[str]:
    """One line per bin: its lower edge, a bar, its count."""
    counts, edges = scene.volume.histogram(HISTOGRAM_BINS)
    longest = math.log1p(counts.max())
    for count, edge in zip(counts, edges, strict=False):
        yield (
            f"{edge:>12.5g} "
            f"{'█' * round(BAR_COLUMNS * math.log1p(count) / longest):<{BAR_COLUMNS}} {count}"
        )


def stiffness(facts: InspectionSchema) -> Iterator[str]:
    """How stiff the volume is: a row for some of the isovalues, and what that means for the scene's
    own.
    """
    found = facts.stiffness
    yield "stiffness (shares of the cells that a surface passes; > is the scene's isovalue)"
    yield TABLE_HEAD
    yield from (
        surface_row(found.surfaces[place], place == found.own) for place in shown_places(found)
    )
    yield from (line for remark in found.remarks for line in lines_of(remark))


def lines_of(remark: Remark) -> Iterator[str]:
    """A remark: what it means, what isogi does, and what a person can do, each on lines of its
    own.
    """
    yield from wrapped(f"  {remark.about:<{LEAD_COLUMNS - 2}}", remark.means)
    if remark.does:
        yield from wrapped(f"{'isogi':>{LEAD_COLUMNS - 1}} ", remark.does)
    for can in remark.can:
        yield from wrapped(f"{'you can':>{LEAD_COLUMNS - 1}} ", can)


def shown_places(found: StiffnessSchema) -> list[int]:
    """Places of MAX_TABLE_ROWS surfaces, evenly taken, of the scene, and of the largest expected
    error.
    """
    step = (len(found.surfaces) - 1) / (MAX_TABLE_ROWS - 1)
    errors = [0.0 if surface.error is None else surface.error.likely for surface in found.surfaces]
    return sorted(
        {*(round(step * i) for i in range(MAX_TABLE_ROWS)), found.own, errors.index(max(errors))}
    )


def surface_row(surface: SurfaceSchema, own: bool) -> str:
    """A row of the table."""
    name = f"{'>' if own else ' '} {surface.isovalue:>11.6g} {surface.cells:>13,}"
    if surface.error is None:
        return f"{name}   nothing is seen"
    columns = ((surface.steep, 6), (surface.plateau, 8), (surface.noisy, 6), (surface.holes, 6))
    shares = " ".join(f"{percent(share):>{width}}" for share, width in columns)
    return f"{name} {shares}   {span(surface.error)}"


def inspect(
    target: str, picture: Path | None = None, as_json: bool = False, plan: bool = False
) -> str:
    """The inspection of ``target``, a volume or a scene; draws the ``picture`` where one is asked
    for.

    It is in brief, unless the ``plan`` and all facts are asked for, or their document ``as_json``.
    Raises SceneError, VolumeError, LightError, and ParameterError or LibraryError where no picture
    can be drawn.
    """
    if picture is not None:
        check_picture(picture)
    scene = open_scene(target)
    facts = inspection_schema(scene)
    if picture is not None:
        from server.inspect.picture import save_picture  # noqa: PLC0415 (matplotlib is an extra)

        save_picture(picture, facts)
    if as_json:
        return facts.model_dump_json(indent=2)
    if plan:
        return full_text(scene, facts)
    return f"{brief(scene, facts)}\n{MORE_TO_ASK}"


def check_picture(path: Path) -> None:
    """LibraryError where matplotlib is missing, ParameterError where ``path`` is no place for a PNG
    file.
    """
    if importlib.util.find_spec("matplotlib") is None:
        raise LibraryError(
            "A picture of the stiffness is drawn with matplotlib: pip install 'isogi[report]'."
        )
    if path.suffix.lower() != ".png" or not path.parent.is_dir():
        raise ParameterError(
            f"{path} is no place for a picture: give a name that ends in .png, in a folder "
            "that is there."
        )


TEXELS_PER_CELL = 2
"""Texels of a cell that a surface passes, about, where voxels have one texel: neighbouring cells
share most.
"""

MAX_NAMED_LABELS = 4
"""Labels that are named, at most."""

VOXEL_BYTES = 4
"""Bytes of a voxel in memory."""

URGENT = ("nothing", "missing")
"""Remarks that stand in the ten lines; the others are in the full text."""


def brief(scene: Scene, facts: InspectionSchema) -> str:
    """The facts that matter, each on a line, or on a few where it is long."""
    rows = (*understood(facts), *proposed(scene, facts), *expected(scene, facts))
    return "\n".join(
        line for name, text in rows for line in wrapped(f"{name:<{LEAD_COLUMNS}}", text)
    )


def understood(facts: InspectionSchema) -> Iterator[tuple[str, str]]:
    """Name and text of what the file holds."""
    volume = facts.volume
    if facts.name != volume.name:
        yield "scene", facts.name
    if volume.times > 1:
        step = f", step {volume.time} of 0 to {volume.times - 1}"
    else:
        step = ""
    yield (
        "volume",
        (
            f"{volume.name}, {by(volume.size)} voxels of {volume.dtype}, spacing "
            f"{by(volume.spacing)}{step}"
        ),
    )
    yield from axes(volume)
    if volume.holes:
        holes = f"{volume.holes:,} voxels are no numbers: holes"
    else:
        holes = "no holes"
    yield "values", f"{volume.value_range[0]:.10g} to {volume.value_range[1]:.10g}, {holes}"


def proposed(scene: Scene, facts: InspectionSchema) -> Iterator[tuple[str, str]]:
    """Name and text of the isovalue, and of how the surface is shown."""
    given = "isovalue" in scene.source.document or str(
        scene.source.document.get("volume")
    ).startswith("demo:")
    if scene.source.found:
        why = "chosen for such values"
    elif given:
        why = "as the scene says"
    else:
        why = "proposed from the values"
    others = [
        f"{each.isovalue:.6g}"
        for each in facts.presets
        if each.isovalue != facts.defaults["isovalue"]
    ]
    if others:
        also = f"; also look at {', '.join(others)}"
    else:
        also = ""
    yield "isovalue", f"{facts.defaults['isovalue']:.6g}, {why}{also}; solid {facts.solid}"
    name, albedo = reflects(facts)
    if name == "labels":
        albedo = few(albedo.split(", "))
    lights = ", ".join(light.name for light in facts.lights)
    yield "light", f"{lights}; {name} {albedo}; target error {percent(facts.target_error)}"


def expected(scene: Scene, facts: InspectionSchema) -> Iterator[tuple[str, str]]:
    """Name and text of the surface, how stiff it is, and what it costs."""
    found = facts.stiffness
    own = found.surfaces[found.own]
    yield "surface", surface(own)
    if own.error is not None:
        yield "stiffness", stiffness_line(own, own.error)
    for remark in found.remarks:
        if remark.about in URGENT:
            yield remark.about, " ".join([remark.means, *(f"You can {can}" for can in remark.can)])
    yield "cost", cost(scene, facts, own)


def surface(own: SurfaceSchema) -> str:
    """How large the scene's surface is, and where the box cuts it open."""
    faces = [face for face, share in own.box.items() if share >= MEETS]
    if faces:
        met = f", cut open by the box at {', '.join(faces)}"
    else:
        met = ", closed within the box"
    return f"{own.cells:,} cells at {own.isovalue:.6g}{met if own.cells else ''}"


def stiffness_line(own: SurfaceSchema, error: ErrorSchema) -> str:
    """What share of the surface is stiff, and which ``error`` of light to expect for that."""
    shares = {
        "on steps": own.steep,
        "on plateaus": own.plateau,
        "noisy": own.noisy,
        "next to holes": own.holes,
    }
    stiff = ", ".join(
        f"{percent(share)} {name}" for name, share in shares.items() if share >= REMARKABLE_SHARE
    )
    return f"{stiff or 'nothing is stiff'}: error of interpolated light about {span(error)}"


def few(names: list[str]) -> str:
    """The first of many names, and how many others there are."""
    if len(names) > MAX_NAMED_LABELS:
        more = f" and {len(names) - MAX_NAMED_LABELS} more"
    else:
        more = ""
    return ", ".join(names[:MAX_NAMED_LABELS]) + more


def cost(scene: Scene, facts: InspectionSchema, own: SurfaceSchema) -> str:
    """What light takes in the store, of this surface and of all, and what voxels take in memory."""
    each = facts.plan.bytes_per_texel
    texels = facts.plan.texels
    one = min(TEXELS_PER_CELL * own.cells * scene.settings.lattice**2, texels.shown) * each
    whole = (
        f"about {megabytes(one)} of light for this surface, "
        f"{megabytes(texels.shown * each)} for all isovalues"
    )
    return f"{whole}; {megabytes(VOXEL_BYTES * scene.volume.voxels.size)} of voxels"


def megabytes(count: float) -> str:
    """Bytes in megabytes, with two digits where there are few."""
    if count >= 1e7:
        return f"{count / 1e6:,.0f} MB"
    return f"{count / 1e6:.2g} MB"
