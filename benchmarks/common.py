"""What the benchmarks share: the scene they run on, baking it in this process, and tables."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from isogi_core.bake.recipe import Recipe
from isogi_core.bake.refine import refine
from isogi_core.cache.loader import Loader
from isogi_core.cache.pages import PagePool
from isogi_core.cache.store import ChunkStore
from isogi_core.frame.frame import Frame
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.tiles import Tiles
from isogi_core.model.scene import Scene, load_scene
from isogi_core.model.view import View

MEMORY = 1 << 30
ENGINE = "engine_256x256x128_uint8.nhdr"
GRACE = "probe_grace_256x128.hdr"


def shared_data() -> Path | None:
    """The folder of real volumes and probes (``$ISOGI_SHARED_DATA``), None where there is none."""
    folder = Path(os.environ.get("ISOGI_SHARED_DATA", Path(__file__).parents[2] / "shared" / "data"))
    return folder if folder.is_dir() else None


def benchmark_scene(target: str | None, light: str = "probe", **overrides: Any) -> Scene:
    """``target``, or the engine block at 70 under grace (``light`` "probe") or constant light; else the casting."""
    data = shared_data()
    if target is None and data is not None:
        lights = {"probe": {"type": "probe", "file": str(data / GRACE)}, "constant": {"type": "constant"}}
        engine = {"isovalue": 70, "albedo": 0.7, "bounces": 4, "lights": [lights[light]]}
        return load_scene(data / ENGINE, **{**engine, **overrides})
    return load_scene(target, **overrides)


def view_of(scene: Scene, size: int, **knobs: Any) -> View:
    """The benchmarks' view: azimuth 40, elevation 30, three radii away, 30 degrees wide."""
    return View(scene.isovalue, scene.camera(40.0, 30.0, 3.0, 30.0), width=size, height=size, **knobs)


def make_renderer(scene: Scene, store: str, threads: int | None = None) -> Renderer:
    """A renderer over a store, with nothing else around it."""
    recipe = Recipe(scene)
    return Renderer(recipe, Loader(ChunkStore(store, recipe), PagePool(recipe, MEMORY)), Tiles(threads))


def bake_view(renderer: Renderer, view: View, until: int, target: float) -> Frame:
    """Bake in this process what ``view`` lacks, up to ``until`` samples, and render it."""
    frame = renderer.render(view, target)
    store = renderer.loader.store
    with click.progressbar(frame.demands, label="baking", file=click.get_text_stream("stderr")) as demands:
        for demand in demands:
            chunk = store.load(demand.index).with_texels(demand.offsets)
            refine(chunk.light, chunk.positions(chunk.offsets), renderer.recipe, until, target)
            store.save(chunk)
            renderer.loader.refresh(demand.index)
    return renderer.render(view, target)


def show(title: str, figures: Mapping[str, Any]) -> None:
    """Print a table of figures, one a line."""
    click.echo(f"\n{title}")
    width = max(map(len, figures))
    for name, value in figures.items():
        text = f"{value:.4g}" if isinstance(value, float) else str(value)
        click.echo(f"  {name:<{width}}  {text}")
