"""``isogi inspect`` as text: a summary, and the full tables."""

import importlib.util
import math
import textwrap
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from isogi_core.files.spelling import shortest
from isogi_core.plan.scene import Scene
from isogi_server.errors import LibraryError, ParameterError
from isogi_server.inspect.inspection import (
    MEETS,
    REMARKABLE_SHARE,
    ErrorSchema,
    InspectionSchema,
    Remark,
    StiffnessSchema,
    SurfaceSchema,
    inspection_schema,
    percent,
    rounded,
    span,
)
from isogi_server.progress import open_scene
from isogi_server.schemas import (
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
"""Columns of the name of an omission, of a line, and of the name at its beginning."""


def wrapped(lead: str, text: str) -> list[str]:
    """Wrap a text to lines of LINE_COLUMNS, the first after its ``lead`` and the others
    indented below the text.
    """
    return textwrap.wrap(text, LINE_COLUMNS, initial_indent=lead, subsequent_indent=" " * len(lead))


def summary(facts: SceneSchema) -> Iterator[tuple[str, str]]:
    """Yield name and text of each fact about a scene."""
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
        f"{span_of(volume)}, {volume.holes} not finite",
    )
    yield (
        "isovalue",
        f"{shortest(float(facts.defaults['isovalue']))}, from {shortest(low_high.min)} to "
        f"{shortest(low_high.max)}",
    )
    yield "solid", facts.solid
    yield reflects(facts)
    yield "lights", ", ".join(light.name for light in facts.lights)
    yield "target error", f"{facts.target_error:g}"


def reflects(facts: SceneSchema) -> tuple[str, str]:
    """Return name and text of the surface's reflection: its albedo, or its colours by data."""
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
    """Yield name and text of the volume's place in the world, unless the world is voxel index
    times spacing.
    """
    low, high = ((", ".join(f"{number:.6g}" for number in corner)) for corner in volume.bounds)
    # Leave the place out if it says nothing: the first voxel at the origin, without unit or patient
    # axes.
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


def span_of(volume: VolumeSchema) -> str:
    """The ends of the range of a volume's values, with the digits that its type has."""
    low, high = (in_type(value, volume.dtype) for value in volume.value_range)
    return f"{low} to {high}"


SHORT_FLOATS = ("float16", "float32")
"""Types with fewer digits than Python's floats."""


def in_type(value: float, dtype: str) -> str:
    """A value with the fewest digits that give it again in a type."""
    if dtype not in SHORT_FLOATS or abs(value) > float(np.finfo(dtype).max):
        return shortest(value)
    kind = np.dtype(dtype).type
    return shortest(value, lambda other: bool(kind(other) == kind(value)))


def plan_rows(plan: PlanSchema) -> Iterator[tuple[str, str]]:
    """Yield name and text of each fact about a plan."""
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
        f"{plan.bytes_per_texel} bytes, instead of {plan.full_bytes_per_texel} for any scene in S1",
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
    """Return the precision in which a layer is kept, as text."""
    if layer.coarse is None:
        return f"{layer.precision} floats"
    return f"half floats, and bytes from band {layer.coarse} on"


def omission(left_out: Omission) -> Iterator[str]:
    """Yield an omission with its saving on one line, and its reason on the next."""
    saved = ", ".join(map(amount, left_out.saves))
    yield f"  {left_out.what:<{WHAT}} {saved}".rstrip()
    yield f"      {left_out.why}"


def amount(saved: SavingSchema) -> str:
    """Return a saving with three digits, or as an integer."""
    if saved.amount >= 100 or saved.amount % 1 == 0:
        number = f"{saved.amount:,.0f}"
    else:
        number = f"{saved.amount:.3g}"
    return f"{number} {saved.unit}{' (measured)' if saved.measured else ''}"


def by(numbers: tuple[float, ...]) -> str:
    """Join numbers by ×."""
    return " × ".join(f"{number:g}" for number in numbers)


HISTOGRAM_BINS = 24
BAR_COLUMNS = 48
MAX_TABLE_ROWS = 10
"""Isovalues in the table, in addition to the scene's and to the one with the largest error."""

MORE_TO_ASK = (
    "--plan shows the plan, the histogram, every remark, and more isovalues; prewarm "
    "--dry-run, the time."
)

ISOVALUE_COLUMNS = 11
"""Columns of an isovalue in the table, at least."""

TABLE_HEAD = (
    f"  {'isovalue':>11} {'cells':>13} {'steep':>6} {'plateau':>8} {'noisy':>6} "
    f"{'holes':>6}   error about"
)


def full_text(scene: Scene, facts: InspectionSchema) -> str:
    """Return all facts: scene, plan, omissions, histogram, and stiffness of the volume."""
    rows = [f"{name:<14}{text}" for name, text in (*summary(facts), *plan_rows(facts.plan))]
    omissions = ["left out", *(line for each in facts.plan.left_out for line in omission(each))]
    bars = ["histogram (bars are logarithmic)", *histogram(scene)]
    return "\n".join([*rows, *omissions, *bars, *stiffness(facts)])


def histogram(scene: Scene) -> Iterator[str]:
    """Yield one line per bin: its lower edge, a bar of logarithmic length, its count."""
    counts, edges = scene.volume.histogram(HISTOGRAM_BINS)
    longest = math.log1p(counts.max())
    low, high = float(edges[0]), float(edges[-1])
    names = [shortest(rounded(float(edge), high - low)) for edge in edges]
    width = max(12, *map(len, names))
    for count, name in zip(counts, names, strict=False):
        yield (
            f"{name:>{width}} "
            f"{'█' * round(BAR_COLUMNS * math.log1p(count) / longest):<{BAR_COLUMNS}} {count}"
        )


def stiffness(facts: InspectionSchema) -> Iterator[str]:
    """Yield a table of stiffness by isovalue, and remarks about the scene's isovalue."""
    found = facts.stiffness
    yield "stiffness (shares of the cells that a surface passes; > is the scene's isovalue)"
    shown = shown_places(found)
    width = max(ISOVALUE_COLUMNS, *(len(found.surfaces[place].spelled) for place in shown))
    yield TABLE_HEAD.replace("isovalue", f"{'isovalue':>{width + 8 - ISOVALUE_COLUMNS}}", 1)
    yield from (surface_row(found.surfaces[place], place == found.own, width) for place in shown)
    yield from (line for remark in found.remarks for line in lines_of(remark))


def lines_of(remark: Remark) -> Iterator[str]:
    """Yield the lines of a remark: its meaning, the treatment by isogi, and advice."""
    yield from wrapped(f"  {remark.about:<{LEAD_COLUMNS - 2}}", remark.means)
    if remark.does:
        yield from wrapped(f"{'isogi':>{LEAD_COLUMNS - 1}} ", remark.does)
    for can in remark.can:
        yield from wrapped(f"{'you can':>{LEAD_COLUMNS - 1}} ", can)


def shown_places(found: StiffnessSchema) -> list[int]:
    """Return the places of MAX_TABLE_ROWS evenly spaced surfaces, of the scene's, and of the
    one with the largest expected error.
    """
    # Spread MAX_TABLE_ROWS places from the first to the last surface.
    step = (len(found.surfaces) - 1) / (MAX_TABLE_ROWS - 1)
    errors = [0.0 if surface.error is None else surface.error.likely for surface in found.surfaces]
    return sorted(
        {*(round(step * i) for i in range(MAX_TABLE_ROWS)), found.own, errors.index(max(errors))}
    )


def surface_row(surface: SurfaceSchema, own: bool, width: int = ISOVALUE_COLUMNS) -> str:
    """Return a row of the table, its isovalue in ``width`` columns."""
    name = f"{'>' if own else ' '} {surface.spelled:>{width}} {surface.cells:>13,}"
    if surface.error is None:
        return f"{name}   nothing is seen"
    columns = ((surface.steep, 6), (surface.plateau, 8), (surface.noisy, 6), (surface.holes, 6))
    shares = " ".join(f"{percent(share):>{width}}" for share, width in columns)
    return f"{name} {shares}   {span(surface.error)}"


def inspect(
    target: str, picture: Path | None = None, as_json: bool = False, plan: bool = False
) -> str:
    """Return the inspection of ``target``, a volume or a scene, as text; draw the ``picture`` if a
    path is given.

    The text is brief, or complete with ``plan``, or the JSON document with ``as_json``. Raises
    SceneError, VolumeError, LightError, and ParameterError or LibraryError if no picture can be
    drawn.
    """
    if picture is not None:
        check_picture(picture)
    scene = open_scene(target)
    facts = inspection_schema(scene)
    if picture is not None:
        from isogi_server.inspect.picture import save_picture  # noqa: PLC0415 (matplotlib is an extra)

        save_picture(picture, facts)
    if as_json:
        return facts.model_dump_json(indent=2)
    if plan:
        return full_text(scene, facts)
    return f"{brief(scene, facts)}\n{MORE_TO_ASK}"


def check_picture(path: Path) -> None:
    """Raise LibraryError if matplotlib is missing, and ParameterError if ``path`` cannot be a
    PNG file.
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
"""Texels per cell that a surface passes, about, at one texel per voxel: neighbouring cells
share most.
"""

MAX_NAMED_LABELS = 4
"""Labels that are named, at most."""

VOXEL_BYTES = 4
"""Bytes of a voxel in memory."""

URGENT = ("nothing", "missing")
"""Remarks that appear in the summary; the others appear only in the full text."""


def brief(scene: Scene, facts: InspectionSchema) -> str:
    """Return the important facts, each on one line or a few."""
    rows = (*understood(facts), *proposed(scene, facts), *expected(scene, facts))
    return "\n".join(
        line for name, text in rows for line in wrapped(f"{name:<{LEAD_COLUMNS}}", text)
    )


def understood(facts: InspectionSchema) -> Iterator[tuple[str, str]]:
    """Yield name and text of the content of the file."""
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
        holes = f"{volume.holes:,} voxels are not numbers: holes"
    else:
        holes = "no holes"
    yield "values", f"{span_of(volume)}, {holes}"


def proposed(scene: Scene, facts: InspectionSchema) -> Iterator[tuple[str, str]]:
    """Yield name and text of the isovalue, its origin, and the appearance of the surface."""
    # A preset was found in the values, unless the scene gives the isovalue, as demos do.
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
        scene.volume.spell(each.isovalue)
        for each in facts.presets
        if each.isovalue != facts.defaults["isovalue"]
    ]
    if others:
        also = f"; also look at {', '.join(others)}"
    else:
        also = ""
    isovalue = scene.volume.spell(scene.isovalue)
    yield "isovalue", f"{isovalue}, {why}{also}; solid {facts.solid}"
    name, albedo = reflects(facts)
    if name == "labels":
        albedo = few(albedo.split(", "))
    lights = ", ".join(light.name for light in facts.lights)
    yield "light", f"{lights}; {name} {albedo}; target error {percent(facts.target_error)}"


def expected(scene: Scene, facts: InspectionSchema) -> Iterator[tuple[str, str]]:
    """Yield name and text of the surface, its stiffness, and its cost."""
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
    """Return the size of the scene's surface, and the faces of the box that cut it open."""
    faces = [face for face, share in own.box.items() if share >= MEETS]
    if faces:
        met = f", cut open by the box at {', '.join(faces)}"
    else:
        met = ", closed within the box"
    return f"{own.cells:,} cells at {own.spelled}{met if own.cells else ''}"


def stiffness_line(own: SurfaceSchema, error: ErrorSchema) -> str:
    """Return the stiff shares of the surface, and the ``error`` of light to expect from them."""
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
    """Return the first of several names, and the number of the others."""
    if len(names) > MAX_NAMED_LABELS:
        more = f" and {len(names) - MAX_NAMED_LABELS} more"
    else:
        more = ""
    return ", ".join(names[:MAX_NAMED_LABELS]) + more


def cost(scene: Scene, facts: InspectionSchema, own: SurfaceSchema) -> str:
    """Return the bytes of light in the store, for this surface and for all, and of voxels in
    memory.
    """
    each = facts.plan.bytes_per_texel
    texels = facts.plan.texels
    # The number of texels near a surface grows with the square of the lattice density.
    one = min(TEXELS_PER_CELL * own.cells * scene.settings.lattice**2, texels.shown) * each
    whole = (
        f"about {megabytes(one)} of light for this surface, "
        f"{megabytes(texels.shown * each)} for all isovalues"
    )
    return f"{whole}; {megabytes(VOXEL_BYTES * scene.volume.voxels.size)} of voxels"


def megabytes(count: float) -> str:
    """Return bytes in megabytes, with two digits below 10 MB."""
    if count >= 1e7:
        return f"{count / 1e6:,.0f} MB"
    return f"{count / 1e6:.2g} MB"
