"""The check of a picture: control pixels tell its total error, and pixels get light of their own until that is small.

One step follows from those before and from the picture alone: the same view tells the same numbers whoever asks, and
after any restart.
"""

import hashlib
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from isogi_core.frame.frame import Frame
from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.rays.control_pixels import (
    EARLY,
    ENOUGH,
    FIRST,
    MOST,
    ControlPixels,
    TotalError,
    chances,
    draw_places,
    paths_for,
    trace_controls,
)
from isogi_core.frame.rays.own_light import AIM, MOST_PATHS, Choice, Growth, PixelLight, choose
from isogi_core.frame.tiles import Tiles
from isogi_core.plan.finer import DENSER

STRICTER = 0.9
"""Factor on the error that is aimed at with each attempt."""

AGAIN = DENSER**2
"""How many times as many texels of a surface there are where the lattice is twice as fine, about: 2.2 to 4."""


def finer_pays(frame: Frame, pixels: int) -> bool:
    """Whether finer texels of a ``frame`` cost less than light of their own for so many of its ``pixels``.

    One of either costs about as much: 2.0 and 2.6 ms of a foam, 0.55 and 0.58 ms of a gyroid, and texels serve other
    views too.
    """
    return frame.lacking is not None and AGAIN * len(frame.lacking.texels.places) < pixels


@dataclass(frozen=True, eq=False)
class PictureState:
    """What a check knows of a picture besides its texels' light; each step replaces it whole, so that who reads it from
    another thread has all of one step.

    ``target`` is the relative error that is to be reached. ``controls`` are of this ``attempt``, drawn by the
    ``uncertainty`` (m,) of all points; pixels in ``own`` have light of their own. It has ``ended`` where no step was
    left. ``early`` controls were drawn while its light converged, None if none were.
    """

    target: float
    controls: ControlPixels = field(default_factory=ControlPixels.none)
    uncertainty: np.ndarray = field(default_factory=lambda: np.empty(0))
    own: PixelLight = field(default_factory=PixelLight.none)
    attempt: int = 0
    ended: bool = False
    early: ControlPixels | None = None

    @property
    def nbytes(self) -> int:
        """Bytes that it takes."""
        early = self.early.nbytes if self.early else 0
        return self.controls.nbytes + self.uncertainty.nbytes + self.own.nbytes + early

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
    ``declined``. Steps of several threads wait for each other.
    """

    light: RotatedLight
    gbuffer: GBuffer
    known: PictureState
    growing: Growth | None = None
    pace: float | None = None
    coarse: bool = False
    declined: bool = False
    lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    @property
    def nbytes(self) -> int:
        """Bytes that it takes."""
        return self.known.nbytes + (self.growing.nbytes if self.growing else 0)

    def step(self, frame: Frame, uncertainty: Callable[[], np.ndarray], tiles: Tiles, finer: bool) -> bool:
        """Come one step nearer to the target from a ``frame`` of this picture; whether there was one to take.

        ``uncertainty`` finds how uncertain the light of each surface point is, (m,); whether there are ``finer``
        texels that may be asked for. Where another thread took a step since the frame was drawn, that was it. Raises
        Cancelled. While light converges the one step is to ``_foretell``.
        """
        if frame.unmeasured:
            return self._foretell(frame, tiles)
        if frame.controls is not self.known.controls:
            return True
        taken = frame.surface > 0 and not frame.final and self._step(frame, uncertainty, tiles, finer)
        self.known = replace(self.known, ended=not taken)
        return taken

    def _foretell(self, frame: Frame, tiles: Tiles) -> bool:
        """Draw early controls of a ``frame``, which tell what it errs by besides noise; True."""
        if self.known.early is None:
            self.known = replace(self.known, early=self._draw(frame.pixel_noise, EARLY, 0, FIRST, tiles))
        return True

    def _step(self, frame: Frame, uncertainty: Callable[[], np.ndarray], tiles: Tiles, finer: bool) -> bool:
        if self.growing is not None:
            return self._grow(self.growing, tiles)
        if frame.measured is None or not self._decided(frame.measured):
            return self._add_controls(uncertainty(), tiles)
        choice = self._choose(frame, frame.measured, uncertainty())
        self.coarse = finer and not self.declined and finer_pays(frame, len(choice.places))
        return not self.coarse and self._grow(Growth(choice, self.known.own), tiles)

    def decline(self) -> None:
        """Go on without finer texels: there is no memory for them."""
        self.coarse, self.declined, self.known = False, True, replace(self.known, ended=False)

    def _decided(self, measured: TotalError) -> bool:
        """Whether a picture that is not at its target needs better light, and no further controls."""
        most = MOST if measured.likely <= self.known.target else ENOUGH
        return measured.low > self.known.target or measured.controls >= most

    def _add_controls(self, uncertainty: np.ndarray, tiles: Tiles) -> bool:
        """Draw as many controls again as there are."""
        known, before = self.known, len(self.known.controls.places)
        more = self._draw(uncertainty, known.attempt, before, max(before, FIRST), tiles)
        self.known = replace(known, uncertainty=uncertainty, controls=known.controls.joined(more))
        return True

    def _draw(self, uncertainty: np.ndarray, attempt: int, before: int, count: int, tiles: Tiles) -> ControlPixels:
        """Draw ``count`` controls, after those that there were ``before``."""
        places = draw_places(self.gbuffer, uncertainty, (attempt, before), count)
        halves = trace_controls(self.light, self.gbuffer, places, paths_for(self.known.target), attempt, tiles)
        return ControlPixels(places, 1.0 / (len(uncertainty) * chances(uncertainty)[places]), halves)

    def _choose(self, frame: Frame, measured: TotalError, uncertainty: np.ndarray) -> Choice:
        """The points that are to have light of their own, all that have it among them.

        They bring the picture to what is aimed at, and nearer by STRICTER at least.
        """
        known = self.known
        aim = min(AIM * STRICTER**known.attempt * known.target, STRICTER * measured.likely)
        paths, allowed = paths_for(known.target), (aim * frame.true_mean) ** 2
        return choose(uncertainty, known.controls, frame.controlled, paths, known.own.places, allowed)

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
            self.known = PictureState(self.known.target, own=light, attempt=self.known.attempt + 1)
            self.growing = None
        return True
