"""Inspecting a scene: every voxel of its volume is looked at, for many isovalues at once."""

from contextlib import closing

import numpy as np

from isogi_core.bake.recipe import Recipe
from isogi_core.frame.tiles import Tiles
from isogi_core.model.scene import Scene
from isogi_core.plan.stiffness import Expectation, Stiffness, measure_stiffness
from server.facts import scene_facts
from server.inspect.advice import remarks
from server.inspect.facts import ErrorFacts, InspectionFacts, StiffnessFacts, SurfaceFacts
from server.inspect.marks import mark_of_nothing

ISOVALUES = 32
"""Isovalues that are looked at, over the range that views may ask for, besides the scene's own."""

WHOLE = 4
"""Integers are asked for whole isovalues: these are looked at, where the range holds so many for each of them."""


def inspection_facts(scene: Scene) -> InspectionFacts:
    """The document of a scene; every voxel is looked at."""
    found = stiffness_facts(scene)
    return InspectionFacts(**dict(scene_facts(scene)), stiffness=found.model_copy(update={"remarks": remarks(found)}))


def stiffness_facts(scene: Scene) -> StiffnessFacts:
    """How stiff the scene's volume is."""
    asked = isovalues_of(scene)
    levels = np.array([scene.volume.normalise_isovalue(each) for each in asked], np.float32)
    with closing(Tiles()) as tiles:
        found = measure_stiffness(Recipe(scene, tiles.run).field, levels, tiles.run)
    places = np.searchsorted(found.levels, levels)
    return StiffnessFacts(
        surfaces=[surface_facts(scene, found, *each) for each in zip(asked, places.tolist(), strict=True)],
        own=asked.index(scene.isovalue),
        void=scene.texels.void / max(scene.texels.shown, 1),
        steps=scene.volume.steps,
        mark=mark_of_nothing(scene.volume),
    )


def isovalues_of(scene: Scene) -> list[float]:
    """ISOVALUES of those that views may ask for, evenly spread, and the scene's own: ascending, each once."""
    low, high = scene.isovalues
    spread = np.linspace(0.0, 1.0, ISOVALUES + 2)[1:-1]
    values = low * (1.0 - spread) + high * spread
    if not scene.volume.dtype.startswith(("float", "bool")) and high / ISOVALUES - low / ISOVALUES >= WHOLE:
        values = np.round(values)
    return sorted({*values.tolist(), scene.isovalue})


def surface_facts(scene: Scene, found: Stiffness, isovalue: float, place: int) -> SurfaceFacts:
    """The surface of one isovalue, which ``found`` holds at a ``place``."""
    cells, counts = int(found.cells[place]), (found.steep, found.plateau, found.noisy, found.holed)
    steep, plateau, noisy, holes = (float(found.share(each)[place]) for each in counts)
    met = zip(faces_of(scene.volume.size), found.share(found.faces)[:, place].tolist(), strict=True)
    return SurfaceFacts(
        isovalue=isovalue,
        cells=cells,
        steep=steep,
        plateau=plateau,
        noisy=noisy,
        holes=holes,
        box={face: share for face, share in met if share > 0.0},
        error=error_facts(found.expectation(place)) if cells else None,
    )


def error_facts(expected: Expectation) -> ErrorFacts:
    """An expected error, as a document."""
    return ErrorFacts(low=expected.low, likely=expected.likely, high=expected.high)


def faces_of(size: tuple[int, int, int]) -> list[str]:
    """Names of the box's faces, by the voxels that lie on them."""
    return [f"{axis} = {end}" for axis, n in zip("xyz", size, strict=True) for end in (0, n - 1)]
