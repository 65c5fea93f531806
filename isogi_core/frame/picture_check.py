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
from isogi_core.frame.frame import Frame
from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.pixel_light import FIRST as FIRST_PATHS
from isogi_core.frame.pixel_light import MOST_PATHS, REST, PixelLight, choose_places, enough
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.shading.framebuffer import Framebuffer

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

    def step(self, frame: Frame, uncertainty: Callable[[], np.ndarray], tiles: Tiles) -> bool:
        """Come one step nearer to the target from a ``frame`` of this picture; whether there was one to take.

        ``uncertainty`` finds how uncertain the light of each surface point is, (m,). Raises Cancelled.
        """
        taken = frame.surface > 0 and not frame.final and self._step(frame, uncertainty, tiles)
        self.ended = not taken
        return taken

    def _step(self, frame: Frame, uncertainty: Callable[[], np.ndarray], tiles: Tiles) -> bool:
        if self.growing is not None:
            return self._grow(frame, self.growing.places, 2 * self.growing.count, tiles)
        decided = frame.measured is not None and frame.measured.low > self.target
        if decided or len(self.controls.places) >= MOST:
            return self._grow(frame, self._choose(frame, uncertainty()), max(self.own.count, FIRST_PATHS), tiles)
        return self._add_controls(uncertainty(), tiles)

    def _add_controls(self, uncertainty: np.ndarray, tiles: Tiles) -> bool:
        """Draw as many controls again as there are."""
        before = len(self.controls.places)
        places = draw_places(self.gbuffer, uncertainty, (self.attempt, before), max(before, FIRST))
        halves = trace_controls(self.light, self.gbuffer, places, paths_for(self.target), self.attempt, tiles)
        weights = 1.0 / (len(uncertainty) * chances(uncertainty)[places])
        self.controls = self.controls.joined(ControlPixels(places, weights, halves))
        return True

    def _choose(self, frame: Frame, uncertainty: np.ndarray) -> np.ndarray:
        """The points that are to have light of their own, all that have it among them."""
        allowed = (REST * self._strictness * self.target * frame.true_mean) ** 2
        return np.union1d(choose_places(uncertainty, self.controls, frame.controlled, allowed), self.own.places)

    def _grow(self, frame: Frame, places: np.ndarray, count: int, tiles: Tiles) -> bool:
        """Trace the points at ``places`` up to ``count`` paths; they are shown, and controls drawn anew, once that will
        do. Whether there was anything to trace.
        """
        if count > MOST_PATHS:
            return False
        grown = (self.growing or self.own).grown(places, count, self.light, self.gbuffer, tiles)
        self.growing = grown
        if count == MOST_PATHS or enough(grown, frame.true_mean, self._strictness * self.target, frame.surface):
            self.own, self.growing = grown, None
            self.attempt, self.controls = self.attempt + 1, ControlPixels.none()
        return True

    @property
    def _strictness(self) -> float:
        return float(STRICTER**self.attempt)
