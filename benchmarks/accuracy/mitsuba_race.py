"""Mitsuba's side of a race to equal error: the samples and seconds that its pictures take to a
wanted error.
"""

import os
from dataclasses import dataclass

import click
import numpy as np

from benchmarks.accuracy.errors import PowerLaw, relative_rmse, without
from benchmarks.common import mesh
from benchmarks.common.mitsuba import SAMPLERS, PathTracer
from benchmarks.common.timing import Seconds
from isogi_core.model.view import View
from isogi_core.plan.scene import Scene

VARIANT = "llvm_ad_rgb"
CURVE = (4, 16, 64)
"""Samples per pixel at which the error is measured first."""

CONVERGED = 256
"""Samples per pixel of each of the two pictures whose mean is the converged one."""

INSIDE = 0.999
"""The least alpha of pixels that the outline does not run through."""


@dataclass(frozen=True)
class Reached:
    """What a picture takes to the error ``wanted``: samples per pixel, and their cost.

    That is of a picture drawn with nearly so many, which has the ``error``, in proportion to the
    samples.
    """

    samples: int
    cost: Seconds
    error: float
    wanted: float


@dataclass(frozen=True, eq=False)
class Converged:
    """The converged picture (h, w, 4) of a view, its own relative ``noise``, and the pixels
    compared, ``on``.
    """

    picture: np.ndarray
    noise: float
    on: np.ndarray

    def error(self, picture: np.ndarray) -> float:
        """Relative RMSE of a picture, without the noise of the converged one."""
        return without(relative_rmse(picture, self.picture, self.on), self.noise)


class Mitsuba:
    """Path tracers on the mesh of a scene's isosurface, one for each of SAMPLERS; ``set_up`` is
    what a scene costs.
    """

    def __init__(self, scene: Scene, view: View) -> None:
        """Make mesh and scene, once for each sampler, and compile the kernels with a picture of one
        sample.
        """
        self.tracers: dict[str, PathTracer] = {}
        for sampler in SAMPLERS:
            self.set_up = Seconds()
            with self.set_up.counting():
                self._add(scene, view, sampler)
            draw(self.tracers[sampler], 1, 0)

    def converge(self, view: View, on: np.ndarray) -> Converged:
        """Look at ``view``; what is seen there, to be compared on those pixels of ``on`` that lie
        in the outline.
        """
        for tracer in self.tracers.values():
            tracer.spec(view)
        return converge(self.tracers[SAMPLERS[1]], CONVERGED, on)

    def reach(self, sampler: str, best: Converged, wanted: float) -> Reached:
        """Draw what was last looked at with so many samples that its error is near the one
        ``wanted``, above 0.

        Raises ClickException where there is no error to reach, or none left to measure.
        """

        def _error(samples: int) -> float:
            return measured(best, draw(self.tracers[sampler], samples, 3))

        if not wanted > 0.0:
            raise click.ClickException(
                "isogi's error is below its reference's noise: raise --paths."
            )
        law = PowerLaw.fit(CURVE, [_error(samples) for samples in CURVE])
        near = law.count_for(wanted)
        cost = Seconds()
        with cost.counting():
            picture = draw(self.tracers[sampler], near, 4)
        error = measured(best, picture)
        samples = law.through(near, error).count_for(wanted)
        return Reached(samples, cost * (samples / near), error, wanted)

    def _add(self, scene: Scene, view: View, sampler: str) -> None:
        points, triangles = mesh.make_mesh(
            scene.volume, scene.volume.normalise_isovalue(scene.isovalue)
        )
        world = points * np.array(scene.volume.spacing, np.float32), triangles
        probe = scene.lighting.environment.constant + scene.lighting.environment.image
        albedo = scene.surfaces.albedo[0]
        self.tracers[sampler] = PathTracer(
            VARIANT, world, view, albedo, scene.bounces + 2, probe, sampler
        )


def converge(tracer: PathTracer, samples: int, on: np.ndarray) -> Converged:
    """The mean of two pictures of so many ``samples``, to be compared on those pixels of ``on`` in
    the outline.
    """
    one, other = (draw(tracer, samples, seed) for seed in (1, 2))
    mean = (one + other) / 2.0
    inside = on & (mean[..., 3] > INSIDE)
    return Converged(mean, relative_rmse(one, mean, inside), inside)


def draw(tracer: PathTracer, samples: int, seed: int) -> np.ndarray:
    """A picture on all cores."""
    return tracer.picture(samples, os.cpu_count() or 1, seed)


def measured(best: Converged, picture: np.ndarray) -> float:
    """The error of a picture; ClickException where the converged one's own noise hides it."""
    error = best.error(picture)
    if not error > 0.0:
        raise click.ClickException(
            "Mitsuba's error is below the noise of its converged picture: choose fewer samples."
        )
    return error
