"""References: a view path-traced from each pixel, with what is known of its own noise."""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from isogi_core.errors import ReportError
from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.paths import Paths, variance_of_mean
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.surroundings import Turned
from isogi_core.model.scene import Scene, digest_of
from isogi_core.model.sky import LUMINANCE
from isogi_core.model.view import View

REPLICAS = 8
"""Independent randomisations of a reference."""

STREAM = 1 << 16
"""Number of the first of them: frames of the same view draw other random numbers."""

FORMAT = 1
"""Counts up when paths of a reference, or what is kept of them, change."""


@dataclass(frozen=True, eq=False)
class Reference:
    """The mean of ``samples`` paths from each pixel, over independent randomisations.

    ``mean`` (h, w, 3) float32 linear RGB, ``variance`` (h, w) float32 that of the mean's luminance, 0 off the
    surface; ``on`` (h, w) bool is where the surface is; ``seconds`` of the processor were spent. It grows from
    ``sums`` (surface pixels, replicas, 3) float64, and is of what ``subject`` names (see ``subject_of``).
    """

    mean: np.ndarray
    variance: np.ndarray
    on: np.ndarray
    samples: int
    seconds: float
    sums: np.ndarray = field(default_factory=lambda: np.zeros((0, REPLICAS, 3)), repr=False)
    subject: str = ""

    @property
    def standard_error(self) -> np.ndarray:
        """Standard error of each pixel's luminance, (h, w) float32."""
        return np.asarray(np.sqrt(self.variance))

    @property
    def noise(self) -> float:
        """Relative standard error of the whole: root mean square over the surface, over the mean luminance."""
        light = float((self.mean[self.on] @ LUMINANCE).mean()) if self.on.any() else 0.0
        return float(np.sqrt(self.variance[self.on].mean(dtype=np.float64))) / light if light > 0.0 else 0.0


def trace_reference(
    renderer: Renderer,
    view: View,
    samples: int,
    former: Reference | None = None,
    cancelled: threading.Event | None = None,
    progress: Callable[[int], object] | None = None,
) -> Reference:
    """The reference of ``view`` with ``samples`` paths per pixel, a multiple of REPLICAS, or the next one above.

    It continues the sequences of the ``former`` one: in as many goes as you like, its bits are the same.
    Bounces are those of the renderer's scene. ``progress`` is told of paths as they are traced. Raises ReportError
    where ``former`` is of something else, and Cancelled, leaving ``former`` as it is, once ``cancelled`` is set.
    """
    subject, gbuffer = subject_of(renderer.recipe.scene, view), renderer.gbuffer(view, cancelled)
    if former is None:
        former = from_sums(gbuffer, np.zeros((len(gbuffer.points), REPLICAS, 3)), 0, 0.0, subject)
    if former.subject != subject:
        raise ReportError("The reference to go on from is of another scene or view: begin a new one.")
    taken, wanted = former.samples // REPLICAS, -(-samples // REPLICAS)
    if wanted <= taken:
        return former
    paths, sums = Paths(Turned(renderer.caches.look("gi"), view), gbuffer, renderer.tiles), former.sums.copy()
    paths.prepare(cancelled)
    begun = time.process_time()
    paths.add(sums, STREAM, taken, wanted - taken, cancelled, progress)
    return from_sums(gbuffer, sums, wanted, former.seconds + time.process_time() - begun, subject)


def from_sums(gbuffer: GBuffer, sums: np.ndarray, count: int, seconds: float, subject: str) -> Reference:
    """The reference whose replicas have ``count`` samples each, of these ``sums``."""
    height, width = gbuffer.shape
    mean, variance = np.zeros((height * width, 3), np.float32), np.zeros(height * width, np.float32)
    on = np.zeros(height * width, np.bool_)
    mean[gbuffer.pixels] = sums.mean(axis=1) / max(count, 1)
    variance[gbuffer.pixels] = variance_of_mean(sums / max(count, 1))
    on[gbuffer.pixels] = True
    picture = mean.reshape(height, width, 3), variance.reshape(height, width), on.reshape(height, width)
    return Reference(*picture, count * REPLICAS, seconds, sums, subject)


def subject_of(scene: Scene, view: View) -> str:
    """Hex name of all that a reference's light depends on."""
    world = [scene.volume.digest, scene.environment.digest, scene.lamps.digest, scene.albedo]
    camera = [view.camera.eye, view.camera.target, view.camera.up, view.camera.fov]
    picture = [view.isovalue, *camera, view.light, view.width, view.height]
    return digest_of([FORMAT, *world, scene.bounces, scene.plan.survival, *picture])
