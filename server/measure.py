"""What ``isogi bench`` and the benchmarks share: taking turns, the view they look at, its light and its rays."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from tqdm import tqdm

from isogi_core.bake.light import Light
from isogi_core.bake.look import look_for
from isogi_core.bake.maps import Run, serially
from isogi_core.bake.recipe import Recipe
from isogi_core.bake.refine import refine
from isogi_core.cache.caches import Caches
from isogi_core.frame.frame import Frame
from isogi_core.frame.gbuffer import pinhole
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.texels import Demand
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.bounces import bounce_rays
from isogi_core.kernels.intersect import UNKNOWN
from isogi_core.kernels.packets import cast_rays
from isogi_core.model.scene import Scene
from isogi_core.model.view import View
from isogi_core.report.bake import NEVER

MEMORY = 1 << 30
"""Bytes of light that a measured renderer may hold."""


@dataclass(frozen=True, eq=False)
class Rays:
    """``origins`` and ``directions`` (3, n) in index space, ``levels`` (n,) normalised isovalues of the surfaces that
    they look for, all float64, and ``sides`` (n,) int8 that they start on."""

    origins: np.ndarray
    directions: np.ndarray
    levels: np.ndarray
    sides: np.ndarray

    def __len__(self) -> int:
        return len(self.sides)

    def part(self, which: Any) -> "Rays":
        """Some of the rays, as arrays of their own."""
        origins, directions = (np.ascontiguousarray(v[:, which]) for v in (self.origins, self.directions))
        return Rays(origins, directions, self.levels[which].copy(), self.sides[which].copy())


def view_of(scene: Scene, size: int, **knobs: Any) -> View:
    """The view that is measured: azimuth 40, elevation 30, three radii away, 30 degrees wide."""
    return View(**{"isovalue": scene.isovalue, "camera": scene.camera(40, 30, 3, 30), **knobs}, width=size, height=size)


def isovalues_near(scene: Scene, count: int) -> list[float]:
    """Isovalues that differ, farther and farther to both sides of the scene's, within a tenth of its range."""
    low, high = scene.isovalues
    down, up = scene.isovalue - low, high - scene.isovalue
    reach = 0.1 * (min(down, up) or max(down, up))
    ways = (1.0 if up else -1.0, -1.0 if down else 1.0)
    return [scene.isovalue + ways[i % 2] * reach * (i + 1) / count for i in range(count)]


def make_renderer(scene: Scene, store: str, threads: int | None = None) -> Renderer:
    """A renderer over a store, with nothing else around it."""
    tiles = Tiles(threads)
    return Renderer(Caches(Recipe(scene, tiles.run), store, MEMORY), tiles)


def bake_view(renderer: Renderer, view: View, until: int) -> Frame:
    """Bake in this process what ``view`` lacks, to ``until`` samples a texel, and render it."""
    demands = renderer.render(view, NEVER).demands
    with tqdm(desc="baking", unit="chunk", total=len(demands), leave=False) as bar:

        def piece(a: int, b: int) -> None:
            for demand in demands[a:b]:
                bake_chunk(renderer, view.shading, demand, until)
                bar.update()

        renderer.tiles.run(piece, len(demands), 1)
    return renderer.render(view, NEVER)


def bake_chunk(renderer: Renderer, shading: str, demand: Demand, until: int) -> None:
    """Bake what is demanded of a chunk by a view of this ``shading``, and keep it in the store."""
    loader = renderer.caches.of(shading)
    chunk = loader.store.load(demand.index).with_texels(demand.offsets)
    texels = renderer.recipe.lattice.positions(chunk.index, chunk.offsets)
    refine(chunk.light, texels, loader.store.look, until, NEVER)
    loader.store.save(chunk)
    loader.refresh(demand.index)


def bake_texels(recipe: Recipe, texels: np.ndarray, until: int) -> Light:
    """The light of ``texels`` (m, 3; z, y, x) after ``until`` samples each."""
    light = Light.dark(recipe.scene.plan, len(texels))
    refine(light, texels, look_for(recipe, "gi"), until, NEVER)
    return light


def bake_pieces(recipe: Recipe, pieces: Sequence[np.ndarray], until: int, run: Run = serially) -> int:
    """Bake ``pieces`` of texels one by one, by means of ``run``; the paths that were taken."""
    paths: list[int] = []

    def bake(a: int, b: int) -> None:
        for piece in pieces[a:b]:
            paths.append(int(np.maximum(bake_texels(recipe, piece, until).samples, 0).sum()))

    run(bake, len(pieces), 1)
    return sum(paths)


def primary_rays(recipe: Recipe, size: int) -> Rays:
    """The rays of the view that is measured, in the order of its pixels."""
    volume = recipe.scene.volume
    camera = pinhole(view_of(recipe.scene, size).camera, size, size, volume.spacing)
    y, x = (np.mgrid[:size, :size] + 0.5).reshape(2, -1)
    corner, right, down, eye = (np.array(v)[:, None] for v in (camera.corner, camera.right, camera.down, camera.eye))
    levels = np.full(len(x), volume.normalise_isovalue(recipe.scene.isovalue))
    origins, directions = np.repeat(eye, len(x), axis=1), corner + x * right + y * down
    return Rays(origins, directions, levels, np.full(len(x), UNKNOWN, np.int8))


def cast(recipe: Recipe, rays: Rays, by: Callable[..., None] = cast_rays) -> tuple[np.ndarray, np.ndarray]:
    """Where ``rays`` meet their surfaces: (t, came), on one thread."""
    t, came = np.empty(len(rays)), np.empty(len(rays), np.int8)
    bricks = recipe.bricks(float(rays.levels.min()), float(rays.levels.max()))
    by(recipe.field, bricks, rays.levels, rays.origins, rays.directions, rays.sides, t, came)
    return t, came


def bounce(recipe: Recipe, rays: Rays, rng: np.random.Generator) -> Rays:
    """Cosine rays from where ``rays`` hit."""
    t, came = cast(recipe, rays)
    hit = np.isfinite(t)
    on = rays.part(hit)
    bounce_rays(recipe.field, on.levels, on.origins, on.directions, t[hit], came[hit], rng.random((2, len(on))))
    return Rays(on.origins, on.directions, on.levels, came[hit])
