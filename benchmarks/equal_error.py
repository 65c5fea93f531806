"""Time to equal total error: isogi beside Mitsuba 3, one view and 36 views under 12 turns of a probe each.

    python -m benchmarks.equal_error [VOLUME] [--size 512] [--probe FILE] [--isovalue 70] [--views 36] [--turns 12] [--json]

The isosurface is diffuse with albedo 0.7 on both sides and reflects as often in both; seconds are of the wall, on all
cores, in one run. Kernels of both are compiled before.

isogi starts from nothing: it makes its maps, bakes to an empty store what each view needs, and renders every picture
of the set. Its error is the total one: relative RMSE of the luminance over surface pixels against paths from each
pixel that are longer than its own, on some pictures from all over the set ("checks").

Mitsuba path-traces scikit-image's marching-cubes mesh of the same isosurface (`llvm_ad_rgb`, integrator `path`, which
joins every hit to the probe as well, multiple importance sampling). Its error on each of the checks is against its own
converged picture, so that mesh and path length do not count, without the pixels that the outline runs through. It
takes as many samples per pixel as bring that error to isogi's total on the same picture: from a power law through
measured points, rendered, put right and rendered again. Seconds of the whole set are extrapolated: those of its set-up
and its mean seconds per check times all pictures. That is told for its default sampler and for `multijitter`, the best
of its own. That both show the same light is seen in how far the converged pictures are apart.
"""

import math
import os
import statistics
import tempfile
from dataclasses import dataclass, replace
from typing import Any

import click
import numpy as np
from tqdm import tqdm

from benchmarks import mesh, mitsuba_scene
from benchmarks.common import benchmark_scene, shared_data, show
from benchmarks.error_curve import PowerLaw, relative_rmse, without
from benchmarks.mitsuba_scene import SAMPLERS, PathTracer
from benchmarks.picture_set import PictureSet
from benchmarks.plans import LONGEST, SMALL, bake
from isogi_core.frame.frame import Frame
from isogi_core.model.scene import Scene
from isogi_core.model.sky import LUMINANCE
from isogi_core.model.view import View
from server.measure import make_renderer, seconds

UFFIZI = "probe_uffizi_256x128.hdr"
ALBEDO = 0.7
VARIANT = "llvm_ad_rgb"
CURVE = (4, 16, 64)
"""Samples per pixel at which Mitsuba's error is measured first."""

CONVERGED = 512
"""Samples per pixel of each of the two pictures whose mean is Mitsuba's converged one."""


@dataclass(frozen=True, eq=False)
class Check:
    """A picture of the set by isogi, ``lit``, the reference for it, and isogi's total ``error``."""

    view: View
    lit: Frame
    best: Frame

    @property
    def error(self) -> float:
        """Relative RMSE without the reference's own noise."""
        measured = relative_rmse(self.lit.radiance, self.best.radiance, self.best.state > 0)
        return without(measured, self.best.estimated_error)


@dataclass(frozen=True)
class Reached:
    """What Mitsuba took to get to an ``error`` near the one ``wanted``."""

    samples: int
    seconds: float
    error: float
    wanted: float


class Isogi:
    """isogi over an empty ``store``: light to a relative error of the texels, and the seconds that it took."""

    def __init__(self, scene: Scene, store: str, target: float) -> None:
        """Make nothing yet that is not timed."""
        self.renderer, self.target = make_renderer(scene, store), target
        self.baking = self.rendering = 0.0

    def bake(self, view: View) -> None:
        """Bake what a view lacks, and keep it in the store."""
        self.baking += seconds(lambda: self._bake(view))

    def frame(self, view: View) -> Frame:
        """The picture of a view."""
        frames: list[Frame] = []
        self.rendering += seconds(lambda: frames.append(self.renderer.render(view, self.target)))
        return frames[0]

    def _bake(self, view: View) -> None:
        demands = self.renderer.render(view, self.target).demands
        loader = self.renderer.caches.of(view.shading)
        self.renderer.tiles.run(lambda a, b: bake(loader, demands[a:b], self.target), len(demands), 1)


def run_isogi(pictures: PictureSet, target: float, picks: list[tuple[int, int]]) -> tuple[list[Frame], dict[str, float]]:
    """Render the whole set, the camera of the first pick before all others; the frames of ``picks``, and figures."""
    kept: dict[tuple[int, int], Frame] = {}
    first = picks[0][0]
    with tempfile.TemporaryDirectory() as store:
        isogi, alone = Isogi(pictures.scene, store, target), 0.0
        for camera in tqdm([first, *(c for c in range(pictures.views) if c != first)], desc="isogi", unit="view"):
            isogi.bake(pictures.view(camera))
            for turn in range(pictures.turns):
                frame = isogi.frame(pictures.view(camera, turn))
                alone = alone or isogi.baking + isogi.rendering
                if (camera, turn) in picks:
                    kept[camera, turn] = frame
    times = {"one view, s": alone, "whole set, s": isogi.baking + isogi.rendering, "baking, s": isogi.baking}
    return [kept[pick] for pick in picks], times


def check(scene: Scene, frames: list[Frame], paths: int) -> list[Check]:
    """The frames with their references, of so many ``paths`` per pixel, with more bounces than the scene has."""
    longer = replace(scene, plan=replace(scene.plan, bounces=max(scene.bounces, LONGEST)))
    with tempfile.TemporaryDirectory() as store:
        renderer = make_renderer(longer, store)
        views = [replace(frame.view, shading="path_traced", samples=paths) for frame in frames]
        bests = [renderer.render(view) for view in tqdm(views, desc="references", unit="picture")]
    return [Check(lit.view, lit, best) for lit, best in zip(frames, bests, strict=True)]


class Rival:
    """Mitsuba on the mesh of the isosurface, with each of its SAMPLERS; ``set_up`` seconds were taken before pictures.
    """

    def __init__(self, scene: Scene, view: View) -> None:
        """Make the mesh and the scene, twice, and compile the kernels with a picture of few samples."""
        tracers: list[PathTracer] = []
        self.set_up = seconds(lambda: tracers.append(self._tracer(scene, view, SAMPLERS[0])))
        tracers.append(self._tracer(scene, view, SAMPLERS[1]))
        self.tracers = dict(zip(SAMPLERS, tracers, strict=True))
        for tracer in tracers:
            self.picture(tracer, 1, 0)

    def picture(self, tracer: PathTracer, samples: int, seed: int) -> np.ndarray:
        """A picture on all cores."""
        return tracer.picture(samples, os.cpu_count() or 1, seed)

    def compete(self, rivalry: Check) -> tuple[dict[str, Reached], np.ndarray]:
        """What each sampler takes to isogi's error on a picture; and the converged picture."""
        for tracer in self.tracers.values():
            tracer.look(rivalry.view)
        pair = [self.picture(self.tracers[SAMPLERS[1]], CONVERGED, seed) for seed in (1, 2)]
        best = np.mean(pair, axis=0)
        on = (best[..., 3] > 0.999) & (rivalry.lit.state > 0)
        noise = relative_rmse(pair[0], best, on)
        reached = {name: self._reach(tracer, best, on, noise, rivalry.error) for name, tracer in self.tracers.items()}
        return reached, best

    def _reach(self, tracer: PathTracer, best: np.ndarray, on: np.ndarray, noise: float, wanted: float) -> Reached:
        """Render with so many samples that the error over the pixels ``on`` is as ``wanted``."""

        def _error(samples: int) -> tuple[float, float]:
            pictures: list[np.ndarray] = []
            taken = seconds(lambda: pictures.append(self.picture(tracer, samples, samples + 2)))
            return without(relative_rmse(pictures[0], best, on), noise), taken

        law = PowerLaw.fit(CURVE, [_error(samples)[0] for samples in CURVE])
        first = law.count_for(wanted)
        samples = law.through(first, _error(first)[0]).count_for(wanted)
        error, taken = _error(samples)
        return Reached(samples, taken, error, wanted)

    @staticmethod
    def _tracer(scene: Scene, view: View, sampler: str) -> PathTracer:
        points, triangles = mesh.make_mesh(scene.volume, scene.volume.normalise_isovalue(scene.isovalue))
        world = points * np.array(scene.volume.spacing, np.float32), triangles
        return PathTracer(VARIANT, world, view, ALBEDO, scene.bounces + 2, scene.environment.image, sampler)
