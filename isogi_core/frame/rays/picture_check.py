"""The check of a picture: control pixels measure its total error, and what is cheapest brings it to the target.

Its texels climb a ladder of samples together (16, 32, 64, …). On each rung control pixels measure the picture as it is
shown, filtered and all. Then all texels climb on, or the pixels that are most wrong get light of their own: whichever
takes fewer paths to the target. A step follows from the texels' light and from the steps on this rung alone: the same
view has the same numbers whoever asks, and after any restart.
"""

import hashlib
import math
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from isogi_core.bake.precision import FIRST_LEVEL, next_level
from isogi_core.frame.frame import Frame
from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.rays.control_pixels import (
    ENOUGH,
    FIRST,
    MOST,
    ControlPixels,
    TotalError,
    chances,
    draw_places,
    paths_for,
    spread_errors,
    trace_controls,
    variance_of_halves,
)
from isogi_core.frame.rays.own_light import AIM, MOST_PATHS, Choice, Growth, PixelLight, choose
from isogi_core.frame.tiles import Tiles
from isogi_core.model.scene_plan import most_samples
from isogi_core.plan.finer import DENSER

STRICTER = 0.9
"""Factor on the error that is aimed at with each attempt."""

QUIETER = 0.5
"""What one rung leaves of the variance of a filtered picture: 0.35 to 0.7 on the engine, the bonsai and the chest."""

SHARED = 0.25
"""What a path of a texel counts beside one of a pixel: other views, and other lights, read the texel too."""

AGAIN = DENSER**2
"""How many times as many texels of a surface there are where the lattice is twice as fine, about: 2.2 to 4."""


def finer_pays(frame: Frame, pixels: int) -> bool:
    """Whether finer texels of a ``frame`` cost less than light of their own for so many of its ``pixels``.

    One of either costs about as much: 2.0 and 2.6 ms of a foam, 0.55 and 0.58 ms of a gyroid, and texels serve other
    views too.
    """
    return frame.lacking is not None and AGAIN * len(frame.lacking.texels.places) < pixels


def noise_of_climbers(frame: Frame) -> float:
    """The share of a picture's noise variance that comes from noisy texels, which alone take more samples; from 0 to 1.

    It is 0 for a picture of no texels.
    """
    if frame.lacking is None:
        return 0.0
    reading = frame.lacking.reading
    variance = np.where(reading.samples > 0, reading.error.astype(np.float64) ** 2, 0.0)
    return float(variance[reading.noisy].sum() / max(variance.sum(), 1e-300))


@dataclass(frozen=True, eq=False)
class PictureState:
    """What a check knows of a picture besides its texels' light; each step replaces it whole, so that who reads it from
    another thread has all of one step.

    ``target`` is the relative error that is to be reached. Texels are to have ``enough`` samples. ``controls`` are of
    this ``attempt``, with so many ``paths`` a half, drawn by the ``uncertainty`` (m,) of all points when texels were to
    have ``drawn`` samples; pixels in ``own`` have light of their own. It has ``ended`` where no step was left.
    """

    target: float
    controls: ControlPixels = field(default_factory=ControlPixels.none)
    uncertainty: np.ndarray = field(default_factory=lambda: np.empty(0))
    own: PixelLight = field(default_factory=PixelLight.none)
    attempt: int = 0
    ended: bool = False
    enough: int = FIRST_LEVEL
    drawn: int = 0
    paths: int = 0

    @property
    def nbytes(self) -> int:
        """Bytes that it takes."""
        return self.controls.nbytes + self.uncertainty.nbytes + self.own.nbytes

    @property
    def outdated(self) -> bool:
        """Whether its controls were drawn when its texels were to have fewer samples."""
        return self.drawn < self.enough

    @property
    def version(self) -> bytes:
        """Names the light that pixels have of their own; empty where none has any."""
        own = self.own
        return b"" if not len(own.places) else repr(own.count).encode() + hashlib.sha256(own.places.data).digest()


@dataclass(eq=False)
class PictureCheck:
    """The check of the picture of one view: what it has ``known`` so far, and what its next step needs besides.

    Pixels of the next attempt are ``growing``, at a ``pace`` of so many seconds a path, None before the first;
    ``coarse`` says that finer texels are to be shown in this picture's place, which is not asked for once they were
    ``declined``. After this rung it is expected to take so many paths ``ahead``, None before it was measured. Steps of
    several threads wait for each other.
    """

    light: RotatedLight
    gbuffer: GBuffer
    known: PictureState
    growing: Growth | None = None
    pace: float | None = None
    coarse: bool = False
    declined: bool = False
    ahead: float | None = None
    lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    @property
    def nbytes(self) -> int:
        """Bytes that it takes."""
        return self.known.nbytes + (self.growing.nbytes if self.growing else 0)

    def step(self, frame: Frame, uncertainty: Callable[[], np.ndarray], tiles: Tiles, finer: bool) -> bool:
        """Come one step nearer to the target from a ``frame`` of this picture; whether there was one to take.

        ``uncertainty`` finds how uncertain the light of each surface point is, (m,); whether there are ``finer``
        texels that may be asked for. Where another thread took a step since the frame was drawn, that was it. Raises
        Cancelled.
        """
        if frame.controls is not self.known.controls or frame.enough != self.known.enough:
            return True
        taken = frame.surface > 0 and not frame.final and self._step(frame, uncertainty, tiles, finer)
        self.known = replace(self.known, ended=not taken)
        return taken

    def _step(self, frame: Frame, uncertainty: Callable[[], np.ndarray], tiles: Tiles, finer: bool) -> bool:
        if self.growing is not None:
            return self._grow(self.growing, tiles)
        if self.known.outdated or frame.measured is None:
            return self._begin_rung(frame, uncertainty(), tiles)
        climbs = self._climbs(frame)
        if not self._decided(frame.measured):
            self.ahead = more = 2.0 * self.known.paths * frame.measured.controls
            gained = (1.0 - QUIETER) * noise_of_climbers(frame) * frame.noise**2
            quiet = frame.measured.high**2 - gained <= self.known.target**2
            return self._climb(frame) if quiet and more > climbs[1] else self._add_controls(uncertainty(), tiles)
        rungs, choice = self._cheapest(frame, frame.measured, uncertainty(), climbs)
        if rungs:
            return self._climb(frame)
        self.coarse = finer and not self.declined and finer_pays(frame, len(choice.places))
        return not self.coarse and self._grow(Growth(choice, self.known.own), tiles)

    def decline(self) -> None:
        """Go on without finer texels: there is no memory for them."""
        self.coarse, self.declined, self.known = False, True, replace(self.known, ended=False)

    def _decided(self, measured: TotalError) -> bool:
        """Whether a picture that is not at its target needs better light, and no further controls."""
        most = MOST if measured.likely <= self.known.target else ENOUGH
        return measured.low > self.known.target or measured.controls >= most

    def _begin_rung(self, frame: Frame, uncertainty: np.ndarray, tiles: Tiles) -> bool:
        """Draw the first controls of a rung, or of an attempt: as exactly as the picture's noise is worth."""
        known, paths = self.known, paths_for(max(self.known.target, frame.noise))
        first = self._draw(uncertainty, 0, FIRST, paths, tiles)
        self.known = replace(known, uncertainty=uncertainty, controls=first, drawn=known.enough, paths=paths)
        return True

    def _add_controls(self, uncertainty: np.ndarray, tiles: Tiles) -> bool:
        """Draw as many controls again as there are."""
        known, before = self.known, len(self.known.controls.places)
        more = self._draw(uncertainty, before, before, known.paths, tiles)
        self.known = replace(known, uncertainty=uncertainty, controls=known.controls.joined(more))
        return True

    def _draw(self, uncertainty: np.ndarray, before: int, count: int, paths: int, tiles: Tiles) -> ControlPixels:
        """Draw ``count`` controls of so many ``paths`` a half, after those that there were ``before``."""
        attempt = self.known.attempt
        places = draw_places(self.gbuffer, uncertainty, (attempt, before), count)
        halves = trace_controls(self.light, self.gbuffer, places, paths, attempt, tiles)
        return ControlPixels(places, 1.0 / (len(uncertainty) * chances(uncertainty)[places]), halves)

    def _climb(self, frame: Frame) -> bool:
        """Have texels take twice as many samples."""
        self.known = replace(self.known, enough=next_level(self._rung(frame)))
        return True

    def _cheapest(
        self, frame: Frame, measured: TotalError, uncertainty: np.ndarray, climbs: Sequence[float]
    ) -> tuple[int, Choice]:
        """How many rungs texels are to climb until pixels get light of their own, and which pixels then do.

        They bring the picture to what is aimed at, and nearer by STRICTER at least, with the fewest paths. Pixels with
        light of their own keep it.
        """
        known, noise = self.known, noise_of_climbers(frame) * frame.pixel_noise**2
        aim = min(AIM * STRICTER**known.attempt * known.target, STRICTER * measured.likely)
        errors = spread_errors(uncertainty, known.controls, frame.controlled) ** 2
        variance, allowed = variance_of_halves(uncertainty, known.controls), (aim * frame.true_mean) ** 2
        noise = np.minimum(noise, errors)
        choices = [
            choose(errors - (1.0 - QUIETER**rungs) * noise, variance, known.paths, known.own.places, allowed)
            for rungs in range(len(climbs))
        ]
        totals = [climb + choice.paths for climb, choice in zip(climbs, choices, strict=True)]
        best = int(np.argmin(totals))
        self.ahead = totals[best] - (climbs[1] if best else 0.0)
        return best, choices[best]

    def _rung(self, frame: Frame) -> int:
        """The samples that all texels of a ``frame`` have that are not good enough with fewer."""
        samples = frame.lacking.reading.samples if frame.lacking else np.empty(0, np.int32)
        lit = samples[samples > 0]
        return max(self.known.enough, int(lit.min()) if len(lit) else 0)

    def _climbs(self, frame: Frame) -> list[float]:
        """What it costs that its texels climb no rung, one, two, and so on to the last, in paths of pixels.

        The list ends with what is impossible: none climbs once pixels have light of their own.
        """
        if self.known.attempt or frame.lacking is None:
            return [0.0, math.inf]
        reading = frame.lacking.reading
        samples = reading.samples[reading.noisy].astype(np.float64)
        rung, paths = self._rung(frame), [0.0]
        while (rung := next_level(rung)) <= most_samples(self.known.target) and len(samples):
            paths.append(SHARED * float(np.maximum(rung - samples, 0.0).sum()))
        return [*paths, math.inf]

    def _grow(self, growth: Growth, tiles: Tiles) -> bool:
        """Trace further paths from the points of a ``growth``; they are shown, and controls drawn anew, once that will
        do. Whether there was anything to trace.
        """
        count = growth.next
        if count > MOST_PATHS:
            return False
        self.growing, begun = Growth(growth.choice, growth.light), time.perf_counter()
        light = growth.light.grown(growth.choice.places, count, self.light, self.gbuffer, tiles, self.growing.note)
        self.pace = (time.perf_counter() - begun) / max(self.growing.traced, 1)
        self.growing = Growth(growth.choice, light)
        if count == MOST_PATHS or self.growing.enough:
            known = self.known
            self.known = PictureState(known.target, own=light, attempt=known.attempt + 1, enough=known.enough)
            self.growing = None
        return True
