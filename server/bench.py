"""``isogi bench``: how fast this machine is at what isogi does, from the primary ray to the encoded picture.

Light is baked into a temporary folder; the user's own store is left alone.
"""

import resource
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from tqdm import tqdm

from isogi_core.bake.look import LOOKS
from isogi_core.bake.precision import FIRST_RUNG
from isogi_core.errors import ViewError
from isogi_core.frame.film import develop
from isogi_core.frame.frame import Frame
from isogi_core.frame.renderer import Renderer
from isogi_core.kernels.lanes import WIDTH
from isogi_core.model.scene import Scene
from isogi_core.model.view import SHADINGS, View
from isogi_core.report.turns import Candidate, medians, new_camera, relight, seconds, timed
from server.measure import bake_pieces, bake_view, bounce, cast, isovalues_near, make_renderer, primary_rays, view_of
from server.opening import open_scene
from server.params import FORMATS
from server.pictures import encode
from server.settings import cores

QUICK = tuple(name for name in SHADINGS if name != "path_traced")
"""Shadings whose frames are timed: all but the reference, which takes as long as it has paths."""

TEXELS, SAMPLES = 8192, 64
"""Texels that are baked to tell the speed of a bake, and samples of each: the fewest that make one final."""

Figures = dict[str, Any]


def bench(target: str | None, isovalue: float | None, size: int, repeats: int) -> Figures:
    """The figures of a scene at an isovalue, pictures of ``size`` × ``size`` pixels; see ``Bench``.

    Raises SceneError, VolumeError and LightError; ViewError where the view shows no surface.
    """
    scene = open_scene(target, None, **({} if isovalue is None else {"isovalue": isovalue}))
    with tempfile.TemporaryDirectory(prefix="isogi-bench-") as store:
        return Bench(make_renderer(scene, store, cores()), size, repeats).figures()


class Bench:
    """Measures one scene. Candidates of one figure take turns; each figure is a median."""

    def __init__(self, renderer: Renderer, size: int, repeats: int) -> None:
        """Measure what ``renderer`` shows at ``size`` × ``size`` pixels, in ``repeats`` rounds."""
        self.renderer, self.size, self.repeats = renderer, size, repeats

    @property
    def scene(self) -> Scene:
        """What is measured."""
        return self.renderer.recipe.scene

    @property
    def view(self) -> View:
        """The view that is measured."""
        return view_of(self.scene, self.size)

    @cached_property
    def frame(self) -> Frame:
        """The view's frame, all of its texels baked; ViewError where there are none."""
        frame = bake_view(self.renderer, self.view, FIRST_RUNG)
        if not frame.surface:
            raise ViewError(f"Nothing is to be seen at isovalue {self.scene.isovalue:g}: choose another.")
        return frame

    def figures(self) -> Figures:
        """All figures, by their names."""
        stages: tuple[Callable[[], Figures], ...]
        stages = (self.setting, self.frames, self.isovalues, self.encodings, self.rays, self.bakes, memory)
        figures: Figures = {}
        for stage in tqdm(stages, desc="measuring", unit="stage"):
            figures |= stage()
        return figures

    def setting(self) -> Figures:
        """What is measured, and on how much of a machine."""
        return {
            "scene": self.scene.name,
            "isovalue": self.scene.isovalue,
            "size": self.size,
            "bounces": self.scene.bounces,
            "survival": self.scene.plan.survival,
            "threads": self.renderer.tiles.threads,
            "lanes": WIDTH or 0,
            "surface_pixels": self.frame.surface,
        }

    def frames(self) -> Figures:
        """``frame_ms``, by shading, of a camera that is new, light baked; ``relight_ms``: only the light is turned."""
        views = {name: replace(self.view, shading=name) for name in QUICK}
        for look in LOOKS:
            bake_view(self.renderer, views[look], FIRST_RUNG)
        candidates = {name: new_camera(self.renderer, view) for name, view in views.items()}
        taken = milliseconds({**candidates, "relight": relight(self.renderer, self.view)}, self.repeats)
        return {"relight_ms": taken.pop("relight"), "frame_ms": taken}

    def isovalues(self) -> Figures:
        """``isovalue_ms``: from an isovalue to its picture, its map made anew, lit by Lambert's law."""
        levels = isovalues_near(self.scene, self.repeats + 1)

        def show(turn: int) -> float:
            view = replace(self.view, shading="lambert", isovalue=levels[turn])
            self.renderer.recipe.maps.forget()
            return seconds(lambda: develop(self.renderer.render(view), self.scene.default_exposure))

        return {"isovalue_ms": milliseconds({"": show}, self.repeats)[""]}

    def encodings(self) -> Figures:
        """``encode_ms``, by format: a frame's tone curve and its bytes."""

        candidates = {
            form: timed(partial(encode, self.frame, form, self.scene.default_exposure))
            for form in FORMATS
            if form != "npy"
        }
        return {"encode_ms": milliseconds(candidates, self.repeats)}

    def rays(self) -> Figures:
        """Millions of rays a second and core: of the view, and cosine rays from what they hit."""
        recipe = self.renderer.recipe
        primary = primary_rays(recipe, self.size)
        rays = {"primary": primary, "diffuse": bounce(recipe, primary, np.random.default_rng(1))}

        taken = medians({name: timed(partial(cast, recipe, those)) for name, those in rays.items()}, self.repeats)
        return {f"{name}_mrays_per_core": len(rays[name]) / taken[name] / 1e6 for name in rays}

    def bakes(self) -> Figures:
        """Millions of paths a second on one core, and texels of 64 samples a second on all cores together."""
        recipe, pieces = self.renderer.recipe, list(self._texels())
        bake = partial(bake_pieces, recipe, pieces, SAMPLES)
        paths = bake()
        taken = medians({"one": timed(bake), "all": timed(partial(bake, self.renderer.tiles.run))}, self.repeats)
        return {
            "bake_mpaths_per_core": paths / taken["one"] / 1e6,
            "bake_texels_per_s": sum(map(len, pieces)) / taken["all"],
        }

    def _texels(self) -> Iterator[np.ndarray]:
        """Texels of the view, (m, 3), chunk by chunk, those of which it reads most first."""
        count = 0
        for demand in sorted(self.frame.demands, key=lambda demand: -len(demand.offsets)):
            if count < TEXELS:
                count += len(demand.offsets)
                yield self.renderer.recipe.lattice.positions(demand.index, demand.offsets)


def milliseconds(candidates: dict[str, Candidate], repeats: int) -> dict[str, float]:
    """Median milliseconds of candidates that take turns."""
    return {name: 1000.0 * taken for name, taken in medians(candidates, repeats).items()}


def memory() -> Figures:
    """``peak_mb``: the most megabytes of memory that this process has had at once."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return {"peak_mb": peak / (1e6 if sys.platform == "darwin" else 1e6 / 1024)}


def table(figures: Figures) -> str:
    """Figures for a person, one a line; those by shading or format as ``name.which``."""
    rows: Figures = {}
    for name, value in figures.items():
        rows |= {f"{name}.{which}": v for which, v in value.items()} if isinstance(value, dict) else {name: value}
    width = max(map(len, rows))
    return "\n".join(f"{name:<{width}}  {f'{v:.4g}' if isinstance(v, float) else v}" for name, v in rows.items())
