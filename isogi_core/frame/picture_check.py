"""The check of a picture: control pixels tell its total error, and pixels get light of their own until that is small.

One step follows from those before and from the picture alone: the same view tells the same numbers whoever asks, and
after any restart.
"""

import hashlib
import threading
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from isogi_core.frame.control_pixels import FIRST, MOST, ControlPixels, chances, draw_places, paths_for, trace_controls
from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.pixel_light import FIRST as FIRST_PATHS
from isogi_core.frame.pixel_light import MOST_PATHS, REST, PixelLight, choose_places, enough
from isogi_core.frame.tiles import Tiles
from isogi_core.frame.total_error import TotalError, measure_total
from isogi_core.kernels.shading.framebuffer import Framebuffer
from isogi_core.model.sky import LUMINANCE

STRICTER = 0.7
"""Factor on what is allowed to pixels, of texels or of noise, with each attempt."""


@dataclass(eq=False)
class PictureCheck:
    """What is known of a picture of one view besides its texels' light; ``target`` is its relative error.

    ``controls`` are of this ``attempt`` to reach the target; pixels in ``own`` have light of their own, and
    those of a next attempt are ``growing``. It has ``ended`` where no step was left. Steps of
    several threads wait for each other.
    """

    light: RotatedLight
    gbuffer: GBuffer
    target: float
    controls: ControlPixels = field(default_factory=ControlPixels.none)
    own: PixelLight = field(default_factory=PixelLight.none)
    growing: PixelLight | None = None
    attempt: int = 0
    ended: bool = False
    lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    @property
    def nbytes(self) -> int:
        """Bytes that it takes."""
        return sum(each.nbytes for each in (self.controls, self.own, self.growing) if each is not None)

    @property
    def version(self) -> bytes:
        """Names the light that pixels have of their own; empty where none has any."""
        own = self.own
        return b"" if not len(own.places) else repr(own.count).encode() + hashlib.sha256(own.places.data).digest()

    def put(self, framebuffer: Framebuffer) -> None:
        """Write the light of pixels that have their own into a picture."""
        if len(self.own.places):
            self.own.put(framebuffer, self.gbuffer.pixels, self.light.spec.unit)

    def total(self, shown: np.ndarray) -> TotalError | None:
        """The total error of a picture whose surface points show this luminance, (m,); None without controls."""
        if not len(self.controls.places):
            return None
        return measure_total(self.controls.weights * self.controls.squares(shown), self.controls.mean(shown))

    def step(self, framebuffer: Framebuffer, uncertainty: Callable[[], np.ndarray], tiles: Tiles) -> bool:
        """Come one step nearer to the target with a picture in the ``framebuffer``; whether there was one to take.

        ``uncertainty`` finds how uncertain the light of each surface point is, (m,). Raises Cancelled.
        """
        taken = self._step(luminance_of(framebuffer, self.gbuffer.pixels), uncertainty, tiles)
        self.ended = not taken
        return taken

    def _step(self, shown: np.ndarray, uncertainty: Callable[[], np.ndarray], tiles: Tiles) -> bool:
        total, drawn = self.total(shown), len(self.controls.places)
        if not len(shown) or (total is not None and total.high <= self.target):
            return False
        if self.growing is not None:
            return self._grow(shown, self.growing.places, 2 * self.growing.count, tiles)
        if drawn >= MOST or (total is not None and total.low > self.target):
            return self._grow(shown, self._choose(shown, uncertainty()), max(self.own.count, FIRST_PATHS), tiles)
        return self._add_controls(uncertainty(), tiles)

    def _add_controls(self, uncertainty: np.ndarray, tiles: Tiles) -> bool:
        """Draw as many controls again as there are."""
        before = len(self.controls.places)
        places = draw_places(self.gbuffer, uncertainty, (self.attempt, before), max(before, FIRST))
        halves = trace_controls(self.light, self.gbuffer, places, paths_for(self.target), self.attempt, tiles)
        weights = 1.0 / (len(uncertainty) * chances(uncertainty)[places])
        self.controls = self.controls.joined(ControlPixels(places, weights, halves))
        return True

    def _choose(self, shown: np.ndarray, uncertainty: np.ndarray) -> np.ndarray:
        """The points that are to have light of their own, all that have it among them."""
        allowed = (REST * self._strictness * self.target * self.controls.mean(shown)) ** 2
        return np.union1d(choose_places(uncertainty, self.controls, shown, allowed), self.own.places)

    def _grow(self, shown: np.ndarray, places: np.ndarray, count: int, tiles: Tiles) -> bool:
        """Trace the points at ``places`` up to ``count`` paths; they are shown, and controls drawn anew, once that will
        do. Whether there was anything to trace.
        """
        if count > MOST_PATHS:
            return False
        grown = (self.growing or self.own).grown(places, count, self.light, self.gbuffer, tiles)
        self.growing = grown
        if count == MOST_PATHS or enough(grown, self.controls.mean(shown), self._strictness * self.target, len(shown)):
            self.own, self.growing = grown, None
            self.attempt, self.controls = self.attempt + 1, ControlPixels.none()
        return True

    @property
    def _strictness(self) -> float:
        return float(STRICTER**self.attempt)


def luminance_of(framebuffer: Framebuffer, pixels: np.ndarray) -> np.ndarray:
    """The luminance of these pixels of a picture; (m,) float64."""
    return np.asarray(framebuffer.radiance[pixels].astype(np.float64) @ LUMINANCE)
