"""Inspection of a scene: every voxel is read, for many isovalues together; with advice."""

import math
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from typing import Any

import numpy as np
from pydantic import BaseModel

from isogi_core.files.spelling import shortest
from isogi_core.frame.tiles import Tiles
from isogi_core.model.volume import Volume
from isogi_core.plan.projection import Expectation, Stiffness, measure_stiffness
from isogi_core.plan.scene import Scene
from isogi_core.prepared.prepared_scene import PreparedScene
from isogi_server.answers import scene_schema
from isogi_server.schemas import SceneSchema


class ErrorSchema(BaseModel):
    """A relative error: the most likely value, and the likely range."""

    low: float
    likely: float
    high: float


class SurfaceSchema(BaseModel):
    """The surface of one isovalue: the number of cells that it passes, and the shares of these that
    are stiff.

    ``spelled`` is the isovalue with the digits that give the same surface.
    ``steep``: the field leaps from one plateau to another; ``plateau``: it hardly changes;
    ``noisy``: normals vary strongly within a cell; ``holes``: a voxel next to it is not a number.
    ``box`` lists the faces of the box that the surface meets, each with the share of cells that do.
    ``error`` is the expected error of light that is interpolated between texels, null without a
    surface.
    """

    isovalue: float
    spelled: str
    cells: int
    steep: float
    plateau: float
    noisy: float
    holes: float
    box: dict[str, float]
    error: ErrorSchema | None


class Remark(BaseModel):
    """A remark about a volume: its meaning, the treatment by isogi, and advice."""

    about: str
    means: str
    does: str | None = None
    can: list[str] = []


class StiffnessSchema(BaseModel):
    """The stiffness of a volume: its surfaces by ascending isovalue; ``own`` is the place of the
    scene's.

    ``void`` is the share of the visible texels that can hold no light, ``steps`` the number of
    values that the file's type distinguishes between the least and the greatest, without outliers.
    ``mark`` is a value that looks like a mark of missing data, null if there is none. ``remarks``
    are about the scene's surface.
    """

    surfaces: list[SurfaceSchema]
    own: int
    void: float
    steps: float
    mark: float | None
    remarks: list[Remark] = []


class InspectionSchema(SceneSchema):
    """A scene's document, and the stiffness of its volume."""

    stiffness: StiffnessSchema


def percent(share: float) -> str:
    """Return a share as text, with few digits, and never as 0 if it is more."""
    if 0.0 < share < 0.001:
        return "<0.1 %"
    if share < 0.0995 and share > 0.0:
        return f"{100.0 * share:.1f} %"
    return f"{100.0 * share:.0f} %"


def span(error: ErrorSchema) -> str:
    """Return an expected error with its range as text."""
    return f"{percent(error.likely)} ({percent(error.low)} – {percent(error.high)})"


REMARKABLE_SHARE = 0.05
"""Share of a surface from which on a remark is made."""

MEETS = 0.0005
"""Share of a surface's cells at a face of the box from which on a remark is made: noise alone
puts a few cells there.
"""

COARSE_STEPS = 2**10
"""Number of steps of a type below which values count as coarse."""

BETTER = 0.5
"""Ratio of noisy shares at which another surface is recommended."""


def remarks(found: StiffnessSchema) -> list[Remark]:
    """Return the remarks about a volume, the most important first."""
    own = found.surfaces[found.own]
    # A scene without a surface gets that remark instead of those on surfaces.
    finders = SEEN if own.cells else (nothing,)
    return [remark for find in (*finders, *ALWAYS) for remark in find(found, own)]


def nothing(found: StiffnessSchema, own: SurfaceSchema) -> Iterator[Remark]:
    """Remark that the scene's isovalue has no surface."""
    others = [surface.spelled for surface in found.surfaces if surface.cells]
    if others:
        can = [f"choose an isovalue from {others[0]} to {others[-1]}."]
    else:
        can = []
    yield Remark(about="nothing", means=f"No surface passes any cell at {own.spelled}.", can=can)


def error(_: StiffnessSchema, own: SurfaceSchema) -> Iterator[Remark]:
    """Remark on the error that is to be expected."""
    if own.error is not None:
        means = (
            f"Expect an error of about {span(own.error)} of the light at "
            f"{own.spelled}, by interpolation."
        )
        if max(own.steep, own.plateau, own.noisy) >= REMARKABLE_SHARE:
            none = ""
        else:
            none = " Nothing is stiff there."
        can = ["measure it for your views: isogi report."]
        yield Remark(about="error", means=f"{means}{none}", can=can)


def steep(_: StiffnessSchema, own: SurfaceSchema) -> Iterator[Remark]:
    """Remark that the field leaps."""
    if own.steep >= REMARKABLE_SHARE:
        means = (
            f"{percent(own.steep)} of the surface lies on steps: within two voxels the value "
            "leaps from one plateau to another, and the texels around it lie on isosurfaces that "
            "are not visible."
        )
        does = (
            "lights the texels at the edge of a plateau halfway up the step, where the surface is."
        )
        yield Remark(about="steep", means=means, does=does, can=list(CURES))


def plateau(_: StiffnessSchema, own: SurfaceSchema) -> Iterator[Remark]:
    """Remark that the field hardly changes."""
    if own.plateau >= REMARKABLE_SHARE:
        means = (
            f"{percent(own.plateau)} of the surface lies on a plateau: half of a cell's corners "
            "have the isovalue itself, or one has no gradient. The surface follows the voxels "
            "there, and its place depends on rounding."
        )
        does = (
            "counts a voxel at the isovalue as outside, and leaves out void texels, such as those "
            "without a gradient."
        )
        can = ["choose an isovalue between two values that voxels have, and not one of them."]
        yield Remark(about="plateau", means=means, does=does, can=can)


def noisy(found: StiffnessSchema, own: SurfaceSchema) -> Iterator[Remark]:
    """Remark that the surface is noisy."""
    if own.noisy >= REMARKABLE_SHARE:
        means = (
            f"{percent(own.noisy)} of the surface is noisy, or has detail as fine as two "
            "voxels: normals vary by 26° or more within a cell, and neighbouring texels lie on "
            "surfaces that have little in common."
        )
        does = (
            "takes normals from the gradient smoothed over 4 × 4 × 4 voxels; the surface is "
            "unchanged."
        )
        # The remark on steps has the same cures.
        cures = () if own.steep >= REMARKABLE_SHARE else CURES
        yield Remark(about="noisy", means=means, does=does, can=[*cures, *calmer(found, own)])


def calmer(found: StiffnessSchema, own: SurfaceSchema) -> Iterator[str]:
    """Advise another isovalue: the nearest whose surface is far less noisy."""
    others = [each for each in found.surfaces if each.cells and each.noisy <= BETTER * own.noisy]
    if others:
        best = min(others, key=lambda each: abs(each.isovalue - own.isovalue))
        yield (
            f"choose another isovalue: {best.spelled} is near, and far less noisy, "
            f"{percent(best.noisy)}."
        )


def holes(_: StiffnessSchema, own: SurfaceSchema) -> Iterator[Remark]:
    """Remark that voxels next to the surface are not numbers."""
    if own.holes > 0.0:
        means = f"{percent(own.holes)} of the surface lies next to voxels that are not numbers."
        does = (
            "shows no surface in the eight cells around such a voxel: there is a gap, and "
            "light passes."
        )
        yield Remark(
            about="holes",
            means=means,
            does=does,
            can=["fill them in beforehand, if gaps are not intended."],
        )


def box(_: StiffnessSchema, own: SurfaceSchema) -> Iterator[Remark]:
    """Remark that the surface meets the box."""
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
            can=["pad the volume with voxels outside, if that is not intended."],
        )


def void(found: StiffnessSchema, _: SurfaceSchema) -> Iterator[Remark]:
    """Remark that some texels can hold no light."""
    if found.void > 0.0:
        means = (
            f"{percent(found.void)} of the visible texels have no gradient, no definite side of "
            "a thin wall, or no room in a crease."
        )
        does = "never bakes them, and interpolates between neighbouring texels that hold light."
        yield Remark(about="void", means=means, does=does)


def coarse(found: StiffnessSchema, _: SurfaceSchema) -> Iterator[Remark]:
    """Remark that values are rounded so coarsely that slopes become terraces."""
    if 0.0 < found.steps < COARSE_STEPS:
        means = (
            f"Values come in only {found.steps:,.0f} steps: slopes gentler than one a "
            "voxel are terraces."
        )
        yield Remark(
            about="coarse", means=means, can=["keep more digits in the source of the values."]
        )


def mark(found: StiffnessSchema, _: SurfaceSchema) -> Iterator[Remark]:
    """Remark that a value looks like a mark of missing data."""
    if found.mark is not None:
        means = (
            f"Many voxels have the value {shortest(found.mark)}, far from all others: it may mark "
            "missing data."
        )
        can = [f"set missing = {shortest(found.mark)} in the scene: these voxels are then holes."]
        yield Remark(about="missing", means=means, can=can)


CURES = (
    "smooth the volume by about a voxel before: steps become ramps, and noise goes.",
    (
        "ask for a finer lattice, lattice = 2: eight times the texels, and a third to two thirds "
        "of the error."
    ),
)
"""Advice for stiff surfaces. On seven of them, with errors of 5 to 15 %, a Gaussian of one
voxel reduced errors to 0.05 to 0.6 of these.
"""

Finder = Callable[[StiffnessSchema, SurfaceSchema], Iterator[Remark]]

SEEN: tuple[Finder, ...] = (error, steep, plateau, noisy, holes, box)
"""Functions that yield remarks on a visible surface."""

ALWAYS: tuple[Finder, ...] = (void, coarse, mark)
"""Functions that yield remarks on a volume."""


MARK_SHARE = 0.001
"""Share of voxels with a value from which on it may be a mark: a single voxel is an outlier."""


def mark_of_nothing(volume: Volume) -> float | None:
    """Return the end of the value range that looks like a mark of missing data, in the volume's
    units; None if neither does.

    Many voxels have such a value, and it lies farther from all other values than these lie apart. A
    volume of two values is a mask, and has no mark.
    """
    ends = [(np.nanmin(slab), np.nanmax(slab)) for slab in numbers(volume)]
    least = min(low for low, _ in ends)
    most = max(high for _, high in ends)
    # A negative scale reverses the order of values.
    ends_of_range = volume.value_range[:: 1 if volume.scale > 0 else -1]
    for value, end, other in zip(ends_of_range, (least, most), (most, least), strict=True):
        if is_far(volume, end, other):
            return value
    return None


def numbers(volume: Volume) -> Iterator[np.ndarray]:
    """Yield the volume's slabs that hold any number."""
    return (slab for slab in volume.slabs() if not np.isnan(slab).all())


def is_far(volume: Volume, end: Any, other: Any) -> bool:
    """Return True if many voxels have the value ``end``, one end of the range, and it is far
    from all others.
    """
    if (
        sum(np.count_nonzero(slab == end) for slab in volume.slabs())
        < MARK_SHARE * volume.voxels.size
    ):
        return False
    # Find the value closest to this end.
    if end < other:
        beside = min(np.min(slab, where=slab > end, initial=other) for slab in volume.slabs())
    else:
        beside = max(np.max(slab, where=slab < end, initial=other) for slab in volume.slabs())
    return bool(
        beside != other and abs(float(beside) - float(end)) > abs(float(other) - float(beside))
    )


ISOVALUES = 32
"""Isovalues that are examined, over the range that views may ask for, in addition to the
scene's.
"""

EXAMINED_ISOVALUES = 4
"""Integer volumes are examined at integer isovalues, if the range has as many for each of
ISOVALUES.
"""


def inspection_schema(scene: Scene) -> InspectionSchema:
    """Return the document of a scene and the stiffness of its volume; every voxel is read."""
    found = stiffness_schema(scene)
    return InspectionSchema(
        **dict(scene_schema(scene)), stiffness=found.model_copy(update={"remarks": remarks(found)})
    )


def stiffness_schema(scene: Scene) -> StiffnessSchema:
    """Return the stiffness of the scene's volume; of a field that repeats, that of the part that is
    shown, without the margin that is cut away around it.
    """
    asked = isovalues_of(scene)
    cell = scene.volume.cell
    if cell is not None:
        shown = np.ascontiguousarray(cell.of(scene.volume.voxels))
        scene = replace(scene, volume=replace(scene.volume, voxels=shown))
    levels = np.array([scene.volume.normalise_isovalue(each) for each in asked], np.float32)
    with closing(Tiles()) as tiles:
        found = measure_stiffness(PreparedScene(scene).field, levels, tiles.run)
    # Normalised isovalues may coincide; several surfaces then share a place.
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
    """Return ISOVALUES evenly spaced isovalues that views may ask for, and the scene's, in
    ascending order without repeats.
    """
    low, high = scene.isovalues
    spread = np.linspace(0.0, 1.0, ISOVALUES + 2)[1:-1]
    # Combine the ends, as their difference may overflow.
    values = low * (1.0 - spread) + high * spread
    if (
        not scene.volume.dtype.startswith(("float", "bool"))
        and high / ISOVALUES - low / ISOVALUES >= EXAMINED_ISOVALUES
    ):
        values = np.round(values)
    else:
        values = np.array([rounded(value, high - low) for value in values.tolist()])
    return sorted({*values.tolist(), scene.isovalue})


def rounded(value: float, span: float) -> float:
    """A value with no more digits than tell a ten-thousandth of a ``span``, so that it is short to
    type.
    """
    if not 0.0 < span < math.inf:
        return value
    # Python's rounding to decimals is exact, also far from 0, where a quotient has no such digits.
    return round(value, -math.floor(math.log10(span) - 4.0))


def surface_schema(scene: Scene, found: Stiffness, isovalue: float, place: int) -> SurfaceSchema:
    """Return the document of the surface of one isovalue, at a ``place`` in ``found``."""
    cells = int(found.cells[place])
    counts = (found.steep, found.plateau, found.noisy, found.holed)
    steep, plateau, noisy, holes = (float(found.share(each)[place]) for each in counts)
    met = zip(faces_of(scene.volume.size), found.share(found.faces)[:, place].tolist(), strict=True)
    return SurfaceSchema(
        isovalue=isovalue,
        spelled=scene.volume.spell(isovalue),
        cells=cells,
        steep=steep,
        plateau=plateau,
        noisy=noisy,
        holes=holes,
        box={face: share for face, share in met if share > 0.0 and ends(scene.volume, face)},
        error=error_schema(found.expectation(place)) if cells else None,
    )


def error_schema(expected: Expectation) -> ErrorSchema:
    """Return an expected error as a document."""
    return ErrorSchema(low=expected.low, likely=expected.likely, high=expected.high)


def ends(volume: Volume, face: str) -> bool:
    """Whether the field ends at a ``face`` of the box, and does not repeat there."""
    return volume.cell is None or not volume.cell.periodic["xyz".index(face[0])]


def faces_of(size: tuple[int, int, int]) -> list[str]:
    """Return the names of the box's faces, by the voxels on them."""
    return [f"{axis} = {end}" for axis, n in zip("xyz", size, strict=True) for end in (0, n - 1)]
