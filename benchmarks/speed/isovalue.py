"""From a new isovalue to a lit picture: ours, light baked, against VTK and against flying edges
with Embree.

    python -m benchmarks.speed isovalue [TARGET] [--threads 2] [--size 512] [--repeats 9] [--json]

In each round all candidates go to the same isovalue, which none has seen in this process, ours
without a map that would serve it, and end with a picture of eight bits in memory. `gi` is lit by
light that was baked before and is in memory, `lambert` by a directional light. VTK: flying edges
with normals, drawn by Mesa's llvmpipe; by its own Phong, with a shadow map of 1024², with ambient
occlusion of 32 samples. Embree: flying edges without normals, a tree of default quality, and of low
quality, by its C interface, 16 rays together, made beforehand, and triangles' own normals.
"""

import tempfile
from collections.abc import Callable
from functools import partial
from typing import Any

import click
import numpy as np

from benchmarks.common.measurement import Measurement
from benchmarks.common.scenes import benchmark_scene
from benchmarks.common.suite import part
from benchmarks.common.timing import milliseconds
from benchmarks.speed import embree, vtk
from benchmarks.speed.embree_frame import EmbreeFrame
from isogi_core.bake.bake_spec import spec_for
from isogi_core.frame.film import develop
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.tiles import Tiles
from isogi_core.model.scene_plan import MIN_SAMPLES
from isogi_core.plan.scene import Scene
from isogi_core.prepared.prepared_scene import PreparedScene
from isogi_report.speed import (
    LOOSEST_GOAL,
    Candidate,
    bake_view,
    isovalues_near,
    make_renderer,
    medians,
    primary_rays,
    seconds,
    view_of,
)

Painter = Callable[[float], np.ndarray]
"""Makes the picture at an isovalue."""


def lit_renderer(
    scene: Scene, size: int, levels: list[float], store: str, threads: int
) -> Renderer:
    """A renderer that has seen no isovalue, with the light of all ``levels`` in memory."""
    renderer = make_renderer(scene, store, threads)
    chunks = {
        d.index
        for v in levels
        for d in bake_view(renderer, view_of(scene, size, isovalue=v), MIN_SAMPLES).demands
    }
    fresh = make_renderer(scene, store, threads)
    fresh.caches.of("gi").ensure(sorted(chunks))
    return fresh


def own(renderer: Renderer, size: int, shading: str) -> Painter:
    """Ours."""
    scene = renderer.prepared.scene

    def paint(isovalue: float) -> np.ndarray:
        frame = renderer.render(
            view_of(scene, size, isovalue=isovalue, shading=shading), LOOSEST_GOAL
        )
        return develop(frame, scene.default_exposure)

    return paint


def painting(paint: Painter, levels: list[float], renderer: Renderer | None) -> Candidate:
    """Goes to another of ``levels`` in each round; ``renderer``, where it is ours, has forgotten
    its maps.
    """

    def work(turn: int) -> float:
        if renderer is not None:
            renderer.prepared.maps.forget()
        return seconds(partial(paint, levels[turn]))

    return work


def peers(scene: Scene, size: int, threads: int) -> dict[str, Painter]:
    """Those of the others that are installed."""
    if not vtk.installed():
        return {}
    vtk.use_threads(threads)
    data = vtk.image(scene.volume)
    view = view_of(scene, size)
    towards, _, _ = RotatedLight(spec_for(PreparedScene(scene), "gi"), view).key_light()
    found = {f"vtk {by}": vtk.Window(data, view, towards, by).picture for by in vtk.PASSES}
    return found | (
        by_embree(scene, size, np.array(towards), Tiles(threads)) if embree.installed() else {}
    )


def by_embree(scene: Scene, size: int, towards: np.ndarray, tiles: Tiles) -> dict[str, Painter]:
    """Flying edges with Embree's tree of default and of low quality."""
    rays = primary_rays(PreparedScene(scene), size)
    step = np.array(scene.volume.spacing)[:, None]
    origins, directions = ((v * step).astype(np.float32) for v in (rays.origins, rays.directions))
    frame = EmbreeFrame(origins, directions, towards, tiles)
    edges = vtk.Edges(vtk.image(scene.volume), normals=False)

    def painter(quality: int) -> Painter:
        return lambda isovalue: frame.picture(edges.mesh(isovalue), quality).reshape(size, size, 3)

    return {"embree": painter(embree.MEDIUM), "embree low": painter(embree.LOW)}


def summarise(taken: dict[str, float]) -> dict[str, Any]:
    """Milliseconds, and how many times longer the others take than our Lambert and our light."""
    figures: dict[str, Any] = dict(milliseconds(taken))
    others = [name for name in taken if name not in ("gi", "lambert")]
    figures |= {
        f"{name} / {mine}": taken[name] / taken[mine]
        for mine in ("lambert", "gi")
        for name in others
    }
    missing = {"vtk": vtk.installed(), "embree": embree.installed() and vtk.installed()}
    return figures | {name: "not installed" for name, there in missing.items() if not there}


@part(size=512, repeats=9)
@click.argument("target", required=False)
@click.option("--threads", default=2, show_default=True, help="Threads of every candidate.")
def isovalue(target: str | None, threads: int, size: int, repeats: int) -> Measurement:
    """From a new isovalue to a lit picture: ours, beside VTK and flying edges with Embree."""
    scene = benchmark_scene(target)
    levels = isovalues_near(scene, repeats + 1)
    with tempfile.TemporaryDirectory() as store:
        ours = {
            "gi": lit_renderer(scene, size, levels, store, threads),
            "lambert": make_renderer(scene, store, threads),
        }
        painters = {name: own(renderer, size, name) for name, renderer in ours.items()} | peers(
            scene, size, threads
        )
        candidates = {
            name: painting(paint, levels, ours.get(name)) for name, paint in painters.items()
        }
        taken = medians(candidates, repeats)
    return Measurement(
        f"{scene.name} near {scene.isovalue:g}, {size} × {size}, {threads} threads",
        summarise(taken),
    )
