"""``isogi inspect`` in ten lines: what was understood of a volume or a scene, what is proposed, and what it costs."""

from collections.abc import Iterator

from isogi_core.plan.scene import Scene
from server.inspect.inspection import MEETS, WORTH, ErrorSchema, InspectionSchema, SurfaceSchema, percent, span
from server.inspect.rows import LEAD, axes, by, reflects, wrapped

TEXELS = 2
"""Texels of a cell that a surface passes, about, where voxels have one texel: neighbouring cells share most."""

NAMED = 4
"""Labels that are named, at most."""

VOXEL = 4
"""Bytes of a voxel in memory."""

URGENT = ("nothing", "missing")
"""Remarks that stand in the ten lines; the others are in the full text."""


def brief(scene: Scene, facts: InspectionSchema) -> str:
    """The facts that matter, each on a line, or on a few where it is long."""
    rows = (*understood(facts), *proposed(scene, facts), *expected(scene, facts))
    return "\n".join(line for name, text in rows for line in wrapped(f"{name:<{LEAD}}", text))


def understood(facts: InspectionSchema) -> Iterator[tuple[str, str]]:
    """Name and text of what the file holds."""
    volume = facts.volume
    if facts.name != volume.name:
        yield "scene", facts.name
    step = f", step {volume.time} of 0 to {volume.times - 1}" if volume.times > 1 else ""
    yield "volume", f"{volume.name}, {by(volume.size)} voxels of {volume.dtype}, spacing {by(volume.spacing)}{step}"
    yield from axes(volume)
    holes = f"{volume.holes:,} voxels are no numbers: holes" if volume.holes else "no holes"
    yield "values", f"{volume.value_range[0]:.10g} to {volume.value_range[1]:.10g}, {holes}"


def proposed(scene: Scene, facts: InspectionSchema) -> Iterator[tuple[str, str]]:
    """Name and text of the isovalue, and of how the surface is shown."""
    given = "isovalue" in scene.source.document or str(scene.source.document.get("volume")).startswith("demo:")
    why = "as the scene says" if given else "proposed from the values"
    others = [f"{each.isovalue:.6g}" for each in facts.presets if each.isovalue != facts.defaults["isovalue"]]
    also = f"; also look at {', '.join(others)}" if others else ""
    yield "isovalue", f"{facts.defaults['isovalue']:.6g}, {why}{also}; solid {facts.solid}"
    name, albedo = reflects(facts)
    albedo = few(albedo.split(", ")) if name == "labels" else albedo
    lights = ", ".join(light.name for light in facts.lights)
    yield "light", f"{lights}; {name} {albedo}; target error {percent(facts.target_error)}"


def expected(scene: Scene, facts: InspectionSchema) -> Iterator[tuple[str, str]]:
    """Name and text of the surface, how stiff it is, and what it costs."""
    found = facts.stiffness
    own = found.surfaces[found.own]
    yield "surface", surface(own)
    if own.error is not None:
        yield "stiffness", stiffness(own, own.error)
    for remark in found.remarks:
        if remark.about in URGENT:
            yield remark.about, " ".join([remark.means, *(f"You can {can}" for can in remark.can)])
    yield "cost", cost(scene, facts, own)


def surface(own: SurfaceSchema) -> str:
    """How large the scene's surface is, and where the box cuts it open."""
    faces = [face for face, share in own.box.items() if share >= MEETS]
    met = f", cut open by the box at {', '.join(faces)}" if faces else ", closed within the box"
    return f"{own.cells:,} cells at {own.isovalue:.6g}{met if own.cells else ''}"


def stiffness(own: SurfaceSchema, error: ErrorSchema) -> str:
    """What share of the surface is stiff, and which ``error`` of light to expect for that."""
    shares = {"on steps": own.steep, "on plateaus": own.plateau, "noisy": own.noisy, "next to holes": own.holes}
    stiff = ", ".join(f"{percent(share)} {name}" for name, share in shares.items() if share >= WORTH)
    return f"{stiff or 'nothing is stiff'}: error of interpolated light about {span(error)}"


def few(names: list[str]) -> str:
    """The first of many names, and how many others there are."""
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return ", ".join(names[:NAMED]) + more


def cost(scene: Scene, facts: InspectionSchema, own: SurfaceSchema) -> str:
    """What light takes in the store, of this surface and of all, and what voxels take in memory."""
    each, texels = facts.plan.bytes_per_texel, facts.plan.texels
    one = min(TEXELS * own.cells * scene.settings.lattice**2, texels.shown) * each
    whole = f"about {megabytes(one)} of light for this surface, {megabytes(texels.shown * each)} for all isovalues"
    return f"{whole}; {megabytes(VOXEL * scene.volume.voxels.size)} of voxels"


def megabytes(count: float) -> str:
    """Bytes in megabytes, with two digits where there are few."""
    return f"{count / 1e6:,.0f} MB" if count >= 1e7 else f"{count / 1e6:.2g} MB"
