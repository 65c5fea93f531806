"""The stage: scenes of specimens, what renders them, and their light baked in this process."""

from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from benchmarks.stability.specimen import Specimen
from isogi_core.bake.look import LOOKS
from isogi_core.bake.recipe import Recipe
from isogi_core.cache.caches import Caches
from isogi_core.frame.frame import Frame
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.tiles import Tiles
from isogi_core.model.plan import most_samples
from isogi_core.model.scene import Scene, load_scene
from isogi_core.model.view import View
from isogi_core.model.volume import Volume, make_volume
from isogi_core.plan.planner import plan_scene
from isogi_core.report.bake import NEVER, ViewBake
from isogi_core.report.bench import MEMORY

CONSTANT: Mapping[str, Any] = {"type": "constant"}
STAND = {"azimuth": 40.0, "elevation": 30.0, "distance": 2.4, "fov": 30.0}


def scene_of(volume: Volume, isovalue: float, **settings: Any) -> Scene:
    """A scene of a volume that is in no file, under constant light of radiance 1 unless told."""
    scene = load_scene("demo:orbital", **{"lights": [dict(CONSTANT)], **settings})
    needs = replace(scene.needs, centre=volume.centre, radius=volume.radius)
    plan = plan_scene(needs, scene.told)
    return replace(scene, volume=volume, isovalue=isovalue, isovalues=volume.value_range, needs=needs, plan=plan)


def scenes_of(specimen: Specimen, **settings: Any) -> list[Scene]:
    """The scenes of a specimen, one for each of its isovalues."""
    volume = make_volume(specimen.make(), specimen.spacing, name=specimen.name)
    return [scene_of(volume, each, **{**specimen.settings, **settings}) for each in specimen.isovalues]


def view_of(scene: Scene, size: int, **settings: Any) -> View:
    """A square view of a scene at its isovalue, from the usual stand unless told."""
    stand = {name: settings.pop(name, value) for name, value in STAND.items()}
    return View(scene.isovalue, scene.camera(**stand), width=size, height=size, **settings)


@contextmanager
def renderer_of(scene: Scene) -> Iterator[Renderer]:
    """A renderer of a scene, without light."""
    with closing(Tiles()) as tiles, TemporaryDirectory() as folder:
        yield Renderer(Caches(Recipe(scene, tiles.run), Path(folder), MEMORY), tiles)


@contextmanager
def view_bake(scene: Scene, view: View) -> Iterator[ViewBake]:
    """The texels that a view of the scene reads, none of them baked."""
    with renderer_of(scene) as renderer:
        yield ViewBake(renderer, view)


def frame_of(scene: Scene, view: View, samples: int | None = None) -> Frame:
    """The frame of a view; its light, where texels hold it, is baked.

    To the scene's target error, or with so many samples of each texel.
    """
    if view.shading not in LOOKS:
        with renderer_of(scene) as renderer:
            return renderer.render(view)
    with view_bake(scene, view) as bake:
        if not len(bake.texels):
            return bake.renderer.render(view)
        bake.grow(samples or most_samples(scene.target_error), NEVER if samples else scene.target_error)
        return bake.frame()
