"""Inspection of a scene: every voxel is read, for many isovalues at once; with advice."""

from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from typing import Any

import numpy as np
from pydantic import BaseModel

from isogi_core.frame.tiles import Tiles
from isogi_core.model.volume import Volume
from isogi_core.plan.projection import Expectation, Stiffness, measure_stiffness
from isogi_core.plan.scene import Scene
from isogi_core.prepared.prepared_scene import PreparedScene
from server.answers import scene_schema
from server.schemas import SceneSchema


class ErrorSchema(BaseModel):
    """A relative error: most likely, and the range that it is likely in."""

    low: float
    likely: float
    high: float


class SurfaceSchema(BaseModel):
    """The surface of one isovalue: how many cells it passes, and what share of them is stiff, and
    how.

    ``steep``: the field leaps from one plateau to another; ``plateau``: it hardly changes;
    ``noisy``: normals stray; ``holes``: beside a voxel that is no number. ``box`` names the faces
    of the box that the surface meets, each with the share of the cells that do. ``error`` is the
    expected error of light that is interpolated between texels, null where there is no surface.
    """

    isovalue: float
    cells: int
    steep: float
    plateau: float
    noisy: float
    holes: float
    box: dict[str, float]
    error: ErrorSchema | None


class Remark(BaseModel):
    """Something that a person should know of a volume: what it means, what isogi does about it,
    what they can do.
    """

    about: str
    means: str
    does: str | None = None
    can: list[str] = []


class StiffnessSchema(BaseModel):
    """How stiff a volume is: its surfaces by ascending isovalue, and which of them is the scene's
    ``own``.

    ``void`` is the share of the texels that can be shown that can hold no light, ``steps`` how many
    values the file's type distinguishes between the least and the greatest, outliers left out.
    ``mark`` is a value that looks like a mark of missing data, null where none does. ``remarks``
    are about the scene's own surface.
    """

    surfaces: list[SurfaceSchema]
    own: int
    void: float
    steps: float
    mark: float | None
    remarks: list[Remark] = []


class InspectionSchema(SceneSchema):
    """A scene's document, and how stiff its volume is."""

    stiffness: StiffnessSchema


def percent(share: float) -> str:
    """A share: no digits that it does not have, and never 0 for what is there."""
    if 0.0 < share < 0.001:
        return "<0.1 %"
    if share < 0.0995 and share > 0.0:
        return f"{100.0 * share:.1f} %"
    return f"{100.0 * share:.0f} %"


def span(error: ErrorSchema) -> str:
    """An expected error, and its range."""
    return f"{percent(error.likely)} ({percent(error.low)} – {percent(error.high)})"


REMARKABLE_SHARE = 0.05
"""Share of a surface that is worth a remark."""

MEETS = 0.0005
"""Share of a surface's cells at a face of the box that is worth one: noise alone puts a few
there.
"""

COARSE_STEPS = 2**10
"""Steps of a type that make values coarse, where there are fewer of them."""

BETTER = 0.5
"""How much less of another surface is to be noisy for it to be named."""


def remarks(found: StiffnessSchema) -> list[Remark]:
    """What there is to say, the most important first."""
    own = found.surfaces[found.own]
    finders = SEEN if own.cells else (nothing,)
    return [remark for find in (*finders, *ALWAYS) for remark in find(found, own)]


def nothing(found: StiffnessSchema, own: SurfaceSchema) -> Iterator[Remark]:
    """The remark that the scene's isovalue has no surface."""
    others = [surface.isovalue for surface in found.surfaces if surface.cells]
    if others:
        can = [f"choose an isovalue from {others[0]:.6g} to {others[-1]:.6g}."]
    else:
        can = []
    yield Remark(
        about="nothing", means=f"No surface passes any cell at {own.isovalue:.6g}.", can=can
    )


def error(_: StiffnessSchema, own: SurfaceSchema) -> Iterator[Remark]:
    """What error is to be expected."""
    if own.error is not None:
        means = (
            f"Expect an error of about {span(own.error)} of the light at "
            f"{own.isovalue:.6g}, by interpolation."
        )
        if max(own.steep, own.plateau, own.noisy) >= REMARKABLE_SHARE:
            none = ""
        else:
            none = " Nothing is stiff there."
        can = ["measure it for a view of yours: isogi report."]
        yield Remark(about="error", means=f"{means}{none}", can=can)


def steep(_: StiffnessSchema, own: SurfaceSchema) -> Iterator[Remark]:
    """The remark that the field leaps."""
    if own.steep >= REMARKABLE_SHARE:
        means = (
            f"{percent(own.steep)} of the surface lies on steps: within two voxels the value "
            "leaps from one plateau to"
            " another, and the texels around it have isosurfaces of their own that nobody sees."
        )
        does = (
            "lights the texels at the edge of a plateau half-way of the step, where the surface is."
        )
        yield Remark(about="steep", means=means, does=does, can=list(CURES))


def plateau(_: StiffnessSchema, own: SurfaceSchema) -> Iterator[Remark]:
    """The remark that the field hardly changes."""
    if own.plateau >= REMARKABLE_SHARE:
        means = (
            f"{percent(own.plateau)} of the surface lies on a plateau: half of a cell's "
            "corners have the isovalue"
            " itself, or one has no gradient. The surface follows the voxels there, and "
            "rounding says where it lies."
        )
        does = (
            "counts a voxel at the isovalue as outside, and leaves out void texels, such as "
            "have no gradient."
        )
        can = ["choose an isovalue between two values that voxels have, and not one of them."]
        yield Remark(about="plateau", means=means, does=does, can=can)


def noisy(found: StiffnessSchema, own: SurfaceSchema) -> Iterator[Remark]:
    """The remark that the surface is noisy: normals stray."""
    if own.noisy >= REMARKABLE_SHARE:
        means = (
            f"{percent(own.noisy)} of the surface is noisy, or has detail as fine as two "
            "voxels: normals stray by 26°"
            " or more within a cell, and texels side by side lie on surfaces that have little "
            "in common."
        )
        does = (
            "takes normals from the gradient smoothed over 4 × 4 × 4 voxels; the surface "
            "stays as it is."
        )
        cures = () if own.steep >= REMARKABLE_SHARE else CURES  # they are given once
        yield Remark(about="noisy", means=means, does=does, can=[*cures, *calmer(found, own)])


def calmer(found: StiffnessSchema, own: SurfaceSchema) -> Iterator[str]:
    """Another isovalue, the nearest with a surface of which far less is noisy."""
    others = [each for each in found.surfaces if each.cells and each.noisy <= BETTER * own.noisy]
    if others:
        best = min(others, key=lambda each: abs(each.isovalue - own.isovalue))
        yield (
            f"choose another isovalue: {best.isovalue:.6g} is near, and far less noisy, "
            f"{percent(best.noisy)}."
        )


def holes(_: StiffnessSchema, own: SurfaceSchema) -> Iterator[Remark]:
    """The remark that voxels next to the surface are no numbers."""
    if own.holes > 0.0:
        means = f"{percent(own.holes)} of the surface lies next to voxels that are no numbers."
        does = (
            "shows no surface in the eight cells around such a voxel: there is a gap, and "
            "light passes."
        )
        yield Remark(
            about="holes",
            means=means,
            does=does,
            can=["fill them in before, where gaps are not meant."],
        )


def box(_: StiffnessSchema, own: SurfaceSchema) -> Iterator[Remark]:
    """The remark that the surface meets the box."""
    met = [
        f"{face} ({percent(share)} of its cells)"
        for face, share in own.box.items()
        if share >= MEETS
    ]
    if met:
        means = (
            f"The surface meets the box at {', '.join(met)}: it is cut open there, and "
            "light enters."
        )
        yield Remark(
            about="box",
            means=means,
            can=["pad the volume with voxels outside, where that is not meant."],
        )


def void(found: StiffnessSchema, _: SurfaceSchema) -> Iterator[Remark]:
    """The remark that some texels can hold no light."""
    if found.void > 0.0:
        means = (
            f"{percent(found.void)} of the texels that can be shown have no gradient, no side "
            "of their own in a"
            " thin wall, or no room in a crease."
        )
        does = "never bakes them, and interpolates between the texels around that hold light."
        yield Remark(about="void", means=means, does=does)


def coarse(found: StiffnessSchema, _: SurfaceSchema) -> Iterator[Remark]:
    """The remark that values are rounded so coarsely that slopes may be terraces."""
    if 0.0 < found.steps < COARSE_STEPS:
        means = (
            f"Values come in only {found.steps:,.0f} steps: slopes gentler than one a "
            "voxel are terraces."
        )
        yield Remark(
            about="coarse", means=means, can=["keep more digits, where the values come from."]
        )


def mark(found: StiffnessSchema, _: SurfaceSchema) -> Iterator[Remark]:
    """The remark that a value looks like a mark of missing data."""
    if found.mark is not None:
        means = (
            f"Many voxels have the value {found.mark:.10g}, which is far from all others: "
            "it looks like a mark."
        )
        can = [f"say so in the scene, missing = {found.mark:.10g}: these voxels are then holes."]
        yield Remark(about="missing", means=means, can=can)


CURES = (
    "smooth the volume by about a voxel before: steps become ramps, and noise goes.",
    (
        "ask for a finer lattice, lattice = 2: eight times the texels, and a third to two thirds "
        "of the error."
    ),
)
"""What helped on seven stiff surfaces, errors 5 to 15 %: a Gaussian of one voxel left 0.05 to 0.6
of them.
"""

Finder = Callable[[StiffnessSchema, SurfaceSchema], Iterator[Remark]]

SEEN: tuple[Finder, ...] = (error, steep, plateau, noisy, holes, box)
"""Each finds what is to be said of a surface that can be seen."""

ALWAYS: tuple[Finder, ...] = (void, coarse, mark)
"""Each finds what is to be said of a volume."""


MARK_SHARE = 0.001
"""Share of the voxels that have the value, at least: a single voxel is an outlier and not a
mark.
"""


def mark_of_nothing(volume: Volume) -> float | None:
    """The end of the value range that looks like a mark of missing data, in the volume's own units;
    None where none.

    Many voxels have it, and it lies farther from all other values than these lie apart. Two values
    make a mask.
    """
    ends = [(np.nanmin(slab), np.nanmax(slab)) for slab in numbers(volume)]
    least = min(low for low, _ in ends)
    most = max(high for _, high in ends)
    ends_of_range = volume.value_range[:: 1 if volume.scale > 0 else -1]
    for value, end, other in zip(ends_of_range, (least, most), (most, least), strict=True):
        if is_far(volume, end, other):
            return value
    return None


def numbers(volume: Volume) -> Iterator[np.ndarray]:
    """The volume's slabs that hold any number."""
    return (slab for slab in volume.slabs() if not np.isnan(slab).all())


def is_far(volume: Volume, end: Any, other: Any) -> bool:
    """Whether one ``end`` of the range of a volume's voxels is that of many, and far from all
    others.
    """
    if (
        sum(np.count_nonzero(slab == end) for slab in volume.slabs())
        < MARK_SHARE * volume.voxels.size
    ):
        return False
    if end < other:
        beside = min(np.min(slab, where=slab > end, initial=other) for slab in volume.slabs())
    else:
        beside = max(np.max(slab, where=slab < end, initial=other) for slab in volume.slabs())
    return bool(
        beside != other and abs(float(beside) - float(end)) > abs(float(other) - float(beside))
    )


ISOVALUES = 32
"""Isovalues that are examined, over the range that views may ask for, besides the scene's own."""

EXAMINED_ISOVALUES = 4
"""Integers are asked for whole isovalues: these are examined, where the range holds so many for
each of them.
"""


def inspection_schema(scene: Scene) -> InspectionSchema:
    """The document of a scene; every voxel is read."""
    found = stiffness_schema(scene)
    return InspectionSchema(
        **dict(scene_schema(scene)), stiffness=found.model_copy(update={"remarks": remarks(found)})
    )


def stiffness_schema(scene: Scene) -> StiffnessSchema:
    """How stiff the scene's volume is: what is shown of a field that repeats, not what is cut away
    around it.
    """
    asked = isovalues_of(scene)
    cell = scene.volume.cell
    if cell is not None:
        shown = np.ascontiguousarray(cell.of(scene.volume.voxels))
        scene = replace(scene, volume=replace(scene.volume, voxels=shown))
    levels = np.array([scene.volume.normalise_isovalue(each) for each in asked], np.float32)
    with closing(Tiles()) as tiles:
        found = measure_stiffness(PreparedScene(scene).field, levels, tiles.run)
    places = np.searchsorted(found.levels, levels)
    return StiffnessSchema(
        surfaces=[
            surface_schema(scene, found, *each) for each in zip(asked, places.tolist(), strict=True)
        ],
        own=asked.index(scene.isovalue),
        void=scene.texels.void / max(scene.texels.shown, 1),
        steps=scene.volume.steps,
        mark=mark_of_nothing(scene.volume),
    )


def isovalues_of(scene: Scene) -> list[float]:
    """ISOVALUES of those that views may ask for, evenly spread, and the scene's own: ascending,
    each once.
    """
    low, high = scene.isovalues
    spread = np.linspace(0.0, 1.0, ISOVALUES + 2)[1:-1]
    values = low * (1.0 - spread) + high * spread
    if (
        not scene.volume.dtype.startswith(("float", "bool"))
        and high / ISOVALUES - low / ISOVALUES >= EXAMINED_ISOVALUES
    ):
        values = np.round(values)
    return sorted({*values.tolist(), scene.isovalue})


def surface_schema(scene: Scene, found: Stiffness, isovalue: float, place: int) -> SurfaceSchema:
    """The surface of one isovalue, which ``found`` holds at a ``place``."""
    cells = int(found.cells[place])
    counts = (found.steep, found.plateau, found.noisy, found.holed)
    steep, plateau, noisy, holes = (float(found.share(each)[place]) for each in counts)
    met = zip(faces_of(scene.volume.size), found.share(found.faces)[:, place].tolist(), strict=True)
    return SurfaceSchema(
        isovalue=isovalue,
        cells=cells,
        steep=steep,
        plateau=plateau,
        noisy=noisy,
        holes=holes,
        box={face: share for face, share in met if share > 0.0 and ends(scene.volume, face)},
        error=error_schema(found.expectation(place)) if cells else None,
    )


def error_schema(expected: Expectation) -> ErrorSchema:
    """An expected error, as a document."""
    return ErrorSchema(low=expected.low, likely=expected.likely, high=expected.high)


def ends(volume: Volume, face: str) -> bool:
    """Whether the field ends at a ``face`` of the box, and does not repeat there."""
    return volume.cell is None or not volume.cell.periodic["xyz".index(face[0])]


def faces_of(size: tuple[int, int, int]) -> list[str]:
    """Names of the box's faces, by the voxels that lie on them."""
    return [f"{axis} = {end}" for axis, n in zip("xyz", size, strict=True) for end in (0, n - 1)]
