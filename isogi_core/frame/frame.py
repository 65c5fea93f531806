"""A frame: the answer to a view, with what is known of its own quality."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.projected_texels import Projection
from isogi_core.frame.rays.control_pixels import (
    ControlPixels,
    TotalError,
    measure_total,
    predict_total,
    spread_errors,
)
from isogi_core.frame.rays.tail_error import TailError, tail_of
from isogi_core.frame.texel_reading import Lacking, Stage
from isogi_core.frame.view_texels import Demand
from isogi_core.kernels.shading.framebuffer import CONVERGING, FINAL, PROVISIONAL, Framebuffer, tally
from isogi_core.model.sky import LUMINANCE
from isogi_core.model.view import View
from isogi_core.prepared.prepared_scene import Index

UNREACHABLE = 4
"""The state of a final pixel that reads a texel which cannot be projected; see ``frame.projected_texels``."""

STATES = {"final": FINAL, "converging": CONVERGING, "provisional": PROVISIONAL}


TAIL = 5.0
"""The error that 99 % of the pixels of a final picture stay below, over its target: 2.6 where errors are normal."""


@dataclass(frozen=True, eq=False)
class EdgeSamples:
    """What the samples of the ``pixels`` (k,) at edges show: linear ``light`` (k, samples, 3), and which are ``on``.

    ``pixels`` are picture indices, ascending; ``on`` (k, samples) says which samples show the surface,
    and ``airy`` (k, samples), where something glows, which of them show that alone, with what is behind. Of surfaces
    that let rays pass ``left`` (k, samples) is the share of what lies behind.
    """

    pixels: np.ndarray
    light: np.ndarray
    on: np.ndarray
    airy: np.ndarray | None = None
    left: np.ndarray | None = None

    @property
    def cover(self) -> np.ndarray:
        """How much of what is behind each sample hides; (k, samples), from 0 to 1."""
        return self.on if self.left is None else np.where(self.on, np.float32(1.0) - self.left, np.float32(0.0))

    @cached_property
    def covered(self) -> np.ndarray:
        """The mean light of each pixel's samples on the surface, and the share of those; (k, 4) float32."""
        sums = np.where(self.on[..., None], self.light, np.float32(0)).sum(axis=1)
        count = self.on.sum(axis=1)[:, None]
        return np.column_stack([sums / np.maximum(count, 1), count / np.float32(self.on.shape[1])]).astype(np.float32)


@dataclass(frozen=True, eq=False)
class Frame:
    """A rendered view. All arrays are zero off the surface.

    ``radiance`` (h, w, 3) float32 linear RGB; ``state`` (h, w) uint8, 0 none, 1 provisional,
    2 converging, 3 final; ``error`` (h, w) float32 relative standard error; ``gbuffer`` the surface.
    ``version`` is equal for equal pictures, also after a restart. ``lacking`` is what it was made of, and
    wants more of, None where it reads no texels; ``seconds`` the time of each stage. ``projection`` is of
    texels projected onto the view's isosurface, None where its scene has none there. ``target`` is the total error that
    control pixels are to show, None of frames that have none; ``controls`` are those drawn so far, by the
    ``uncertainty`` (m,) of surface points, and it may be ``given_up``; its texels are to have ``enough`` samples, and
    controls are ``outdated`` that were drawn when fewer were. ``rays`` names those of shine that it shows. ``expected``
    is what it errs by besides its noise, as the plan expects. Of a view that is smooth, ``edges`` have more samples. So
    many pixels of walls, or of what is seen through glass, are ``walls_waiting``: not final yet. So many pixels have
    light of their ``own``. Of surfaces that let rays pass ``left`` (h, w) is the share of what lies behind. Its texels
    are finer than the plan's by ``fineness`` steps; a ``finer`` frame is coming, and waits for its light. What glows
    adds ``glow`` (pixels, 3) float32 to the radiance; None where nothing does.
    """

    view: View
    radiance: np.ndarray
    state: np.ndarray
    error: np.ndarray
    gbuffer: GBuffer
    chunks_needed: int
    chunks_final: int
    lacking: Lacking | None
    version: str
    seconds: Mapping[str, float]
    projection: Projection | None = None
    target: float | None = None
    controls: ControlPixels | None = None
    uncertainty: np.ndarray | None = None
    given_up: bool = False
    enough: int = 0
    outdated: bool = False
    rays: bytes = b""
    expected: float = 0.0
    edges: EdgeSamples | None = None
    walls_waiting: int = 0
    own: int = 0
    left: np.ndarray | None = None
    fineness: int = 0
    finer: "Frame | None" = None
    glow: np.ndarray | None = None

    @cached_property
    def demands(self) -> tuple[Demand, ...]:
        """The light on texels' own isosurfaces that was not final, chunk by chunk, were no texels projected."""
        return self.lacking.demands if self.lacking else ()

    @property
    def stages(self) -> tuple[Stage, ...]:
        """All light that is to be baked until the picture is final, stage after stage."""
        return self.lacking.stages if self.lacking else ()

    @property
    def dark(self) -> frozenset[Index]:
        """The chunks of texels on their own isosurfaces whose light provisional pixels wait for."""
        return self.lacking.dark if self.lacking else frozenset()

    @cached_property
    def reported_state(self) -> np.ndarray:
        """The ``state``, as far as the whole picture is; 4 where a final pixel reads a texel that cannot be projected;
        (h, w).
        """
        if self.improving:
            return np.where(self.state == FINAL, CONVERGING, self.state).astype(np.uint8)
        if self.projection is None:
            return self.state
        kept = (self.state == FINAL) & self.projection.unreachable
        return np.where(kept, UNREACHABLE, self.state).astype(np.uint8)

    @property
    def position(self) -> np.ndarray:
        """World coordinates of the surface in each pixel; (h, w, 3) float32."""
        return self.positions(0, self.state.shape[0])

    def positions(self, first: int, last: int) -> np.ndarray:
        """``position`` in the rows from ``first`` to ``last``, zero off the surface; (last - first, w, 3) float32."""
        found = self.gbuffer.positions(first, last)
        if self.view.orientation.placed:
            on = self.state[first:last] > 0
            on &= self.glow is None or found.any(axis=-1)  # what glows beside the surface is nowhere
            found[on] = self.view.orientation.to_world(found[on].astype(np.float64))
        return found

    @property
    def layers(self) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray | float]]:
        """All that pixels show: their numbers, each once, the points that they show in index space (n, 3), and the
        shares of their light that come from there. What is left of them comes from behind all.
        """
        for each in (self.gbuffer, self.gbuffer.walls, self.gbuffer.faces):
            yield each.pixels, each.points, 1.0

    @cached_property
    def airy(self) -> np.ndarray | None:
        """Which pixels show what glows alone, with the background behind; (h, w) bool, None where nothing glows."""
        if self.glow is None:
            return None
        alone = np.array(self.glow.any(axis=1))
        for each in (self.gbuffer, self.gbuffer.walls, self.gbuffer.faces):
            alone[each.pixels] = False
        return np.asarray(alone.reshape(self.state.shape))

    @cached_property
    def leaving(self) -> np.ndarray:
        """The ``radiance`` that leaves what is seen, without what glows before it; (h, w, 3) float32."""
        return self.radiance if self.glow is None else self.radiance - self.glow.reshape(self.radiance.shape)

    @cached_property
    def _tally(self) -> tuple[np.ndarray, np.ndarray]:
        """Pixels in each state, (4,); sums of luminance and of (luminance · error)² over the surface, (2,)."""
        counts, sums = np.zeros(4, np.int64), np.zeros(2)
        tally(self.framebuffer, counts, sums)
        return counts, sums

    @property
    def counts(self) -> dict[str, int]:
        """Surface pixels in each state, as far as the whole picture is: none is final that may become better."""
        settled = 0 if self.improving else self.settled
        converging = int(self._tally[0][CONVERGING]) + self.settled - settled
        return {"final": settled, "converging": converging, "provisional": int(self._tally[0][PROVISIONAL])}

    @property
    def settled(self) -> int:
        """Surface pixels whose texels have the light that they are to have."""
        return int(self._tally[0][FINAL])

    @property
    def surface(self) -> int:
        """Pixels that show the surface."""
        return int(self._tally[0][PROVISIONAL:].sum())

    @property
    def coverage(self) -> dict[str, float]:
        """Share of the surface pixels in each state; all final where no surface is in the picture."""
        if not self.surface:
            return {"final": 1.0, "converging": 0.0, "provisional": 0.0}
        return {name: count / self.surface for name, count in self.counts.items()}

    @property
    def provisional(self) -> bool:
        """Whether any surface pixel is not final."""
        return self.settled < self.surface

    @property
    def final(self) -> bool:
        """Whether nothing becomes better: all light is as it is to be, and the total error measured at the target."""
        return not self.provisional and (self._reached or not len(self.gbuffer.pixels))

    @property
    def _reached(self) -> bool:
        """Whether the total error is at the target by controls of its texels as they are, and few pixels err far."""
        if self.target is None:
            return True
        if self.measured is None or self.outdated or self.measured.high > self.target:
            return False
        return self.tail is None or self.tail.likely <= TAIL * self.target

    @property
    def improving(self) -> bool:
        """Whether its check goes on, so that any pixel may become better."""
        return self.target is not None and not (self.final or (self.given_up and not self.provisional))

    @property
    def checkable(self) -> bool:
        """Whether texels in the store are final, and walls or control pixels are still to bring it to its target."""
        if self.walls_waiting:
            return self.surface - self.settled == self.walls_waiting
        return not (self.provisional or self.final or self.given_up)

    @property
    def refinable(self) -> bool:
        """Whether a step of refining makes it better or better known now: it is checkable, or its walls lag behind its
        texels.
        """
        return self.checkable or (self.walls_lag and not self.view.moving)

    @cached_property
    def walls_lag(self) -> bool:
        """Whether walls are still coarse, or not final and more wrong in the picture, all together, than its surface.

        Fine ones cost little at first, and what they cost later is spent where the picture's error is largest.
        """
        return self.walls_coarse or (
            self.walls_waiting > 0 and self._wrong(self.gbuffer.walls.pixels) > self._wrong(self.gbuffer.pixels)
        )

    @property
    def walls_coarse(self) -> bool:
        """Whether walls show their first few texels."""
        return self.walls_waiting > 0 and bool((self.state.ravel()[self.gbuffer.walls.pixels] <= PROVISIONAL).any())

    @cached_property
    def controlled(self) -> np.ndarray:
        """The luminance that the control pixels show of the surface itself; (k,) float64."""
        return self._shown_at(self.controls.places if self.controls else np.empty(0, np.int64))

    def _shown_at(self, places: np.ndarray) -> np.ndarray:
        """The luminance that surface points show, by their numbers ``places`` (k,); (k,) float64."""
        return np.asarray(self.leaving.reshape(-1, 3)[self.gbuffer.pixels[places]].astype(np.float64) @ LUMINANCE)

    @property
    def true_mean(self) -> float:
        """The true mean luminance of the surface, as far as control pixels know it; where there is none, of what is."""
        if len(self.gbuffer.pixels) and (self.glow is not None or not self.gbuffer.alone):
            shown = float(self._luminance(self.gbuffer.pixels).mean())
        else:
            shown = float(self._tally[1][0]) / max(self.surface, 1)
        return self.controls.mean(self.controlled, shown) if self.controls and len(self.controlled) else shown

    @cached_property
    def measured(self) -> TotalError | None:
        """The total relative RMSE by control pixels, at least the noise; None before there are any."""
        if self.controls is None or not len(self.controlled):
            return None
        squares = self.controls.weights * self.controls.squares(self.controlled)
        return measure_total(squares, self.true_mean).at_least(self.noise)

    @cached_property
    def tail(self) -> TailError | None:
        """The error that 99 % of the surface pixels stay below, by control pixels; None before there are any."""
        if self.measured is None or self.controls is None or self.uncertainty is None:
            return None
        return tail_of(self.controls, self.controlled, self.uncertainty, self.true_mean)

    @cached_property
    def total_error(self) -> np.ndarray:
        """The relative error of each pixel, whatever its causes, at most 1: measured or expected; (h, w) float32.

        Control pixels measure it where there are some, see ``spread_errors``; it is the noise at least.
        """
        if self.view.shading != "gi":
            return self.error
        error, pixels = self.error.copy(), self.gbuffer.pixels
        if self.measured is None or self.controls is None or self.uncertainty is None:
            other = np.float32(self.expected)
        else:
            errors = spread_errors(self.uncertainty, self.controls, self.controlled)
            other = np.sqrt(np.maximum(errors**2 - self.pixel_noise**2, 0.0)) / np.maximum(
                self._luminance(pixels), 1e-30
            )
        known = self.state.ravel()[pixels] > PROVISIONAL
        error.ravel()[pixels] = np.where(known, np.minimum(np.hypot(error.ravel()[pixels], other), 1.0), 1.0)
        return error

    @property
    def pixel_noise(self) -> np.ndarray:
        """The standard error of each surface point's luminance; (m,) float64."""
        return self.error.ravel()[self.gbuffer.pixels] * self._luminance(self.gbuffer.pixels)

    def _wrong(self, pixels: np.ndarray) -> float:
        """The sum of the squared errors of these pixels, in luminance."""
        return float(((self.error.ravel()[pixels] * self._luminance(pixels)) ** 2).sum())

    def _luminance(self, pixels: np.ndarray) -> np.ndarray:
        """The luminance of these pixels; float64."""
        return np.asarray(self.radiance.reshape(-1, 3)[pixels].astype(np.float64) @ LUMINANCE)

    @cached_property
    def total(self) -> TotalError:
        """The total relative RMSE of the frame: measured or predicted; without global illumination all noise."""
        if self.view.shading != "gi":
            return TotalError(self.noise, self.noise, self.noise)
        return self.measured or predict_total(self.noise, self.expected)

    @property
    def framebuffer(self) -> Framebuffer:
        """Radiance, state and error, pixel by pixel."""
        return Framebuffer(self.radiance.reshape(-1, 3), self.state.ravel(), self.error.ravel())

    @cached_property
    def noise(self) -> float:
        """Estimated relative RMSE of the frame by noise alone, in luminance: root mean square of pixels over the mean.

        A provisional pixel counts as wrong by all of its light; the whole is at most 1. Of 210 frames of 15 scenes
        after 16 to 256 samples, or baked to 10 % or 5 %, the true noise was 1.00 times the estimate, a median, and
        0.7 to 1.4 times it for 99 %; 91.9 % of the pixels were within 1.96 times their own error
        (``benchmarks.accuracy calibration --size 24 --most 256``).
        """
        light, wrong = self._tally[1].tolist()
        return min(math.sqrt(wrong * self.surface) / light, 1.0) if light > 0.0 else 0.0
