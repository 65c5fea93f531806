"""The check of a picture: control pixels tell its total error, and pixels get light of their own until that is small.

One step follows from those before and from the picture alone: the same view tells the same numbers whoever asks, and
after any restart.
"""

import hashlib
import math
import threading
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from isogi_core.frame.frame import Frame
from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.rays.control_pixels import (
    BINS,
    ENOUGH,
    FIRST,
    MOST,
    ControlPixels,
    TotalError,
    bounces_of_truth,
    chances,
    classes_of,
    draw_places,
    paths_for,
    squares_of,
    trace_controls,
)
from isogi_core.frame.rays.pixel_rays import Paths, variance_of_mean
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.shading.framebuffer import FINAL, Framebuffer
from isogi_core.kernels.shading.lattice import DARKEST
from isogi_core.model.sky import LUMINANCE
from isogi_core.plan.finer import DENSER

STREAM = 1 << 18
"""Number of the first randomisation: controls and references draw other random numbers."""

REPLICAS, FIRST_PATHS = 4, 16
"""Independent randomisations of each pixel, and paths of each after the first step."""

MOST_PATHS = 1 << 14
"""Paths of each replica, at most: 65,536 from a pixel."""

REST, NOISE = 0.6, 0.5
"""Shares of the target error that remain: of pixels with light of texels, and of the noise of those with their own."""


@dataclass(frozen=True, eq=False)
class PixelLight:
    """Surface points with light of their own: their rows ``places`` (k,), ascending, and the ``sums`` of their paths.

    Sums (k, REPLICAS, 3) are of ``count`` paths of each replica.
    """

    places: np.ndarray
    sums: np.ndarray
    count: int

    @classmethod
    def none(cls) -> "PixelLight":
        """No pixel has light of its own."""
        return cls(np.empty(0, np.int64), np.empty((0, REPLICAS, 3)), 0)

    @property
    def nbytes(self) -> int:
        """Bytes that it takes."""
        return self.places.nbytes + self.sums.nbytes

    @property
    def means(self) -> np.ndarray:
        """Linear RGB by each replica; (k, REPLICAS, 3)."""
        return np.asarray(self.sums / max(self.count, 1))

    @property
    def variance(self) -> np.ndarray:
        """Variance of each point's luminance; (k,) float64."""
        return variance_of_mean(self.means)

    def grown(
        self, places: np.ndarray, count: int, light: RotatedLight, gbuffer: GBuffer, tiles: Tiles
    ) -> "PixelLight":
        """The same of more points, or after more paths: those known are not traced again. Raises Cancelled."""
        paths = Paths(light, gbuffer.part(places, tiles), tiles, bounces_of_truth(light))
        sums = np.zeros((len(places), REPLICAS, 3))
        known = np.isin(places, self.places, assume_unique=True)
        sums[known] = self.sums[np.isin(self.places, places, assume_unique=True)]
        for rows, first in ((np.flatnonzero(known), self.count), (np.flatnonzero(~known), 0)):
            if len(rows) and first < count:
                some = sums[rows]
                paths.of(rows).add(some, STREAM, first, count - first)
                sums[rows] = some
        return PixelLight(places, sums, count)

    def put(self, framebuffer: Framebuffer, pixels: np.ndarray, unit: float) -> None:
        """Write it into a picture whose surface points show in ``pixels`` (m,), as final light."""
        own, light = pixels[self.places], self.means.mean(axis=1)
        error = np.sqrt(self.variance) / np.maximum(light @ LUMINANCE, DARKEST * unit)
        framebuffer.radiance[own] = np.minimum(light, np.finfo(np.float32).max)
        framebuffer.state[own] = FINAL
        framebuffer.error[own] = np.clip(error, 0.0, 1.0)


def choose_places(uncertainty: np.ndarray, controls: ControlPixels, shown: np.ndarray, allowed: float) -> np.ndarray:
    """The points that are to have light of their own, so that the others' mean squared error is within ``allowed``.

    Points are classed by ``uncertainty`` (m,), as many controls in each class; what a class errs by is measured by its
    controls, whose luminance is ``shown`` (k,). Classes that err most come first. Ascending rows, (≤ m,) int64.
    """
    classes = classes_of(uncertainty, controls)
    errors = squares_of(classes, controls, shown)
    counts, worst = np.bincount(classes, minlength=BINS), np.argsort(-errors, kind="stable")
    rest = np.cumsum((errors * counts)[worst][::-1])[::-1]
    return np.flatnonzero(np.isin(classes, worst[rest > allowed * len(uncertainty)]))


def enough(light: PixelLight, allowed: float, points: int) -> bool:
    """Whether such pixels' noise is within an ``allowed`` error of the luminance, of a picture of so many points."""
    return math.sqrt(light.variance.sum() / max(points, 1)) <= allowed


AGAIN = DENSER**2
"""How many times as many texels of a surface there are where the lattice is twice as fine, about: 2.2 to 4."""

STRICTER = 0.7
"""Factor on what is allowed to pixels with light of texels with each attempt, or else to the noise of the others."""


def finer_pays(frame: Frame, pixels: int) -> bool:
    """Whether finer texels of a ``frame`` cost less than light of their own for so many of its ``pixels``.

    One of either costs about as much: 2.0 and 2.6 ms of a foam, 0.55 and 0.58 ms of a gyroid, and texels serve other
    views too.
    """
    return frame.lacking is not None and AGAIN * len(frame.lacking.texels.places) < pixels


@dataclass(eq=False)
class PictureCheck:
    """What is known of a picture of one view besides its texels' light; ``target`` is its relative error.

    ``controls`` are of this ``attempt`` to reach the target, drawn by the ``uncertainty`` (m,) of all points; pixels in
    ``own`` have light of their own, whose ``noise`` is to be within this share of the target, and those of a next
    attempt are ``growing``. It has ``ended`` where no step was left; ``coarse`` says that finer texels are to be
    shown in this picture's place, which is not asked for once they were ``declined``. Steps of several threads wait for
    each other.
    """

    light: RotatedLight
    gbuffer: GBuffer
    target: float
    controls: ControlPixels = field(default_factory=ControlPixels.none)
    uncertainty: np.ndarray = field(default_factory=lambda: np.empty(0))
    own: PixelLight = field(default_factory=PixelLight.none)
    growing: PixelLight | None = None
    attempt: int = 0
    noise: float = NOISE
    ended: bool = False
    coarse: bool = False
    declined: bool = False
    lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    @property
    def nbytes(self) -> int:
        """Bytes that it takes."""
        parts = (self.controls, self.uncertainty, self.own, self.growing)
        return sum(each.nbytes for each in parts if each is not None)

    @property
    def version(self) -> bytes:
        """Names the light that pixels have of their own; empty where none has any."""
        own = self.own
        return b"" if not len(own.places) else repr(own.count).encode() + hashlib.sha256(own.places.data).digest()

    def put(self, framebuffer: Framebuffer) -> None:
        """Write the light of pixels that have their own into a picture."""
        if len(self.own.places):
            self.own.put(framebuffer, self.gbuffer.pixels, self.light.spec.unit)

    def step(self, frame: Frame, uncertainty: Callable[[], np.ndarray], tiles: Tiles, finer: bool) -> bool:
        """Come one step nearer to the target from a ``frame`` of this picture; whether there was one to take.

        ``uncertainty`` finds how uncertain the light of each surface point is, (m,); whether there are ``finer``
        texels that may be asked for. Raises Cancelled.
        """
        taken = frame.surface > 0 and not frame.final and self._step(frame, uncertainty, tiles, finer)
        self.ended = not taken
        return taken

    def _step(self, frame: Frame, uncertainty: Callable[[], np.ndarray], tiles: Tiles, finer: bool) -> bool:
        if self.growing is not None:
            return self._grow(frame, self.growing.places, 2 * self.growing.count, tiles)
        if frame.measured is None or not self._decided(frame.measured):
            return self._add_controls(uncertainty(), tiles)
        places = self._choose(frame, uncertainty())
        self.coarse = finer and not self.declined and finer_pays(frame, len(places))
        return not self.coarse and self._grow(frame, places, max(self.own.count, FIRST_PATHS), tiles)

    def decline(self) -> None:
        """Go on without finer texels: there is no memory for them."""
        self.coarse, self.ended, self.declined = False, False, True

    def _decided(self, measured: TotalError) -> bool:
        """Whether a picture that is not at its target needs better light, and no further controls."""
        most = MOST if measured.likely <= self.target else ENOUGH
        return measured.low > self.target or measured.controls >= most

    def _add_controls(self, uncertainty: np.ndarray, tiles: Tiles) -> bool:
        """Draw as many controls again as there are."""
        before = len(self.controls.places)
        places = draw_places(self.gbuffer, uncertainty, (self.attempt, before), max(before, FIRST))
        halves = trace_controls(self.light, self.gbuffer, places, paths_for(self.target), self.attempt, tiles)
        weights = 1.0 / (len(uncertainty) * chances(uncertainty)[places])
        self.controls, self.uncertainty = self.controls.joined(ControlPixels(places, weights, halves)), uncertainty
        return True

    def _choose(self, frame: Frame, uncertainty: np.ndarray) -> np.ndarray:
        """The points that are to have light of their own, all that have it among them; less noise where these are all.

        Each attempt allows less error to the others.
        """
        allowed = (REST * STRICTER**self.attempt * self.target * frame.true_mean) ** 2
        places = np.union1d(choose_places(uncertainty, self.controls, frame.controlled, allowed), self.own.places)
        if len(places) == len(self.own.places):
            self.noise *= STRICTER
        return places

    def _grow(self, frame: Frame, places: np.ndarray, count: int, tiles: Tiles) -> bool:
        """Trace the points at ``places`` up to ``count`` paths; they are shown, and controls drawn anew, once that will
        do. Whether there was anything to trace.
        """
        if count > MOST_PATHS:
            return False
        grown = (self.growing or self.own).grown(places, count, self.light, self.gbuffer, tiles)
        self.growing = grown
        if count == MOST_PATHS or enough(grown, self.noise * self.target * frame.true_mean, frame.surface):
            self.own, self.growing = grown, None
            self.attempt, self.controls = self.attempt + 1, ControlPixels.none()
        return True
