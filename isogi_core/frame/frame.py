"""A frame: the picture that answers a view, and its quality: the size of its error, as far as
it is known, and the work that is left until it is final.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from isogi_core.frame.demand import Demand
from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.projected_texels import Projection
from isogi_core.frame.rays.control_pixels import (
    TotalError,
    measure_total,
    predict_total,
    spread_errors,
)
from isogi_core.frame.rays.picture_state import PictureState
from isogi_core.frame.rays.tail_error import TailError, tail_of
from isogi_core.frame.texel_reading import Lacking, Stage
from isogi_core.kernels.shading.framebuffer import (
    CONVERGING,
    FINAL,
    PROVISIONAL,
    Framebuffer,
    tally,
)
from isogi_core.model.environment import LUMINANCE_WEIGHTS
from isogi_core.model.view import View
from isogi_core.prepared.prepared_scene import Index

Layer = tuple[np.ndarray, np.ndarray, np.ndarray | float]
"""Part of the content of pixels: picture indices (n,), the points (n, 3) in index space that
these pixels show, and the shares (n,) of their light that come from there.
"""


UNREACHABLE = 4
"""The state, in ``Frame.reported_state``, of a final pixel that reads a texel which cannot be
projected; see ``frame.projected_texels``.
"""


QUICK_TEXELS = 1 << 15
"""Texels without light that are baked in any case: it takes about a second, and they light later
views at once.
"""


STATE_CODES = {"final": FINAL, "converging": CONVERGING, "provisional": PROVISIONAL}


TAIL = 5.0
"""Limit of the tail: 99 % of the pixels of a final picture have an error below TAIL times the
target. Normally distributed errors would stay below 2.6 times.
"""


@dataclass(frozen=True, eq=False)
class EdgeSamples:
    """Samples of the pixels at edges of a picture; each pixel shows the mean of its samples.

    - ``pixels`` (k,) uint32: picture indices, ascending.
    - ``light`` (k, samples, 3) float32: linear RGB of each sample.
    - ``on`` (k, samples) bool: True if the sample shows anything but the background.
    - ``airy`` (k, samples) bool: True if the sample shows glow alone, in front of the background;
      None if nothing glows, or if the scene has several surfaces.
    - ``left`` (k, samples) float32: share of the light behind that passes all surfaces; None if the
      scene has one surface.
    """

    pixels: np.ndarray
    light: np.ndarray
    on: np.ndarray
    airy: np.ndarray | None = None
    left: np.ndarray | None = None

    @property
    def cover(self) -> np.ndarray:
        """The share of the background that each sample hides, from 0 to 1; (k, samples)."""
        if self.airy is not None:
            return self.on & ~self.airy
        if self.left is None:
            return self.on
        return np.where(self.on, np.float32(1.0) - self.left, np.float32(0.0))

    @cached_property
    def covered(self) -> np.ndarray:
        """The mean light of the samples of each pixel that are on a surface, and the share of
        these samples; (k, 4) float32.
        """
        sums = np.where(self.on[..., None], self.light, np.float32(0)).sum(axis=1)
        count = self.on.sum(axis=1)[:, None]
        return np.column_stack(
            [sums / np.maximum(count, 1), count / np.float32(self.on.shape[1])]
        ).astype(np.float32)


@dataclass(frozen=True, eq=False)
class Quality:
    """The quality of a frame: the states of all its refinements, and the error that is expected.
    Data alone: a ``Frame`` answers what follows from it.

    - ``lacking``: light that its texels still lack; None if the frame reads no texels.
    - ``chunks``: number of chunks that the frame reads, and how many of these are final.
    - ``projection``: how far its texels are projected onto the isosurface; None if none are.
    - ``known``: state of the check of the picture; None if control pixels do not check it.
    - ``rays``: name of the rays of shine, or through glass, that it shows.
    - ``expected``: relative error besides noise that the plan predicts.
    - ``waiting``: number of pixels of walls, or of surfaces seen through, that are not final yet.
    - ``fineness``: number of doublings of the lattice by which its texels are finer than the
      plan's.
    - ``finer``: a frame of finer texels that replaces this one when its light has come; else None.
    """

    lacking: Lacking | None = None
    chunks: tuple[int, int] = (0, 0)
    projection: Projection | None = None
    known: PictureState | None = None
    rays: bytes = b""
    expected: float = 0.0
    waiting: int = 0
    fineness: int = 0
    finer: "Frame | None" = None

    @property
    def samples(self) -> int:
        """The samples that texels are to have; 0 if control pixels do not check the frame."""
        return self.known.goal.samples if self.known else 0

    @property
    def dark(self) -> frozenset[Index]:
        """The chunks whose light provisional pixels wait for, of texels on their own
        isosurfaces.
        """
        if self.lacking:
            return self.lacking.dark
        return frozenset()


@dataclass(frozen=True, eq=False)
class Frame:
    """A rendered view. All arrays are zero off the surface.

    - ``radiance`` (h, w, 3) float32: linear RGB.
    - ``state`` (h, w) uint8: 0 none, 1 provisional, 2 converging, 3 final.
    - ``error`` (h, w) float32: relative standard error of each pixel by noise.
    - ``gbuffer``: the surface points that pixels show.
    - ``version``: a name that is equal for equal pictures, also after a restart.
    - ``seconds``: time of each stage of the rendering.
    - ``quality``: states of its refinements, which decide if it is final.
    - ``edges``: more samples of pixels at edges; None if the view is not smooth.
    - ``left`` (h, w): share of the background that shows through; None if the scene has one
      surface.
    - ``glow`` (pixels, 3) float32: part of the radiance that glow adds; None if nothing glows.
    """

    view: View
    radiance: np.ndarray
    state: np.ndarray
    error: np.ndarray
    gbuffer: GBuffer
    version: str
    seconds: Mapping[str, float]
    quality: Quality = field(default_factory=Quality)
    edges: EdgeSamples | None = None
    left: np.ndarray | None = None
    glow: np.ndarray | None = None

    @property
    def target(self) -> float | None:
        """The total error that control pixels must show before the frame is final; None if they
        do not check it.
        """
        return self.quality.known.goal.error if self.quality.known else None

    @property
    def given_up(self) -> bool:
        """True if the check ended although the error is above the target."""
        return self.quality.known is not None and self.quality.known.ended

    @property
    def outdated(self) -> bool:
        """True if the controls were drawn when texels were to have fewer samples."""
        return self.quality.known is not None and self.quality.known.outdated

    @property
    def traced_pixels(self) -> int:
        """The number of pixels that have light from paths of their own."""
        if self.quality.known:
            return len(self.quality.known.own.places)
        return 0

    @property
    def demands(self) -> tuple[Demand, ...]:
        """The light of texels on their own isosurfaces that is not final, chunk by chunk, as if
        no texel were projected.
        """
        if self.quality.lacking:
            return self.quality.lacking.demands
        return ()

    @property
    def stages(self) -> tuple[Stage, ...]:
        """All light that must be baked until the picture is final, stage after stage."""
        if self.quality.lacking:
            return self.quality.lacking.stages
        return ()

    @property
    def chunks_needed(self) -> int:
        """The number of chunks that it reads, or that the finer frame reads which is to replace
        it.
        """
        return (self.quality.finer or self).quality.chunks[0]

    @property
    def chunks_final(self) -> int:
        """How many of ``chunks_needed`` have final light."""
        return (self.quality.finer or self).quality.chunks[1]

    @cached_property
    def reported_state(self) -> np.ndarray:
        """The ``state`` as clients see it; (h, w) uint8. While the whole picture may still
        improve, no pixel is final; UNREACHABLE marks final pixels that read a texel which
        cannot be projected.
        """
        if self.improving:
            return np.where(self.state == FINAL, CONVERGING, self.state).astype(np.uint8)
        projection = self.quality.projection
        if projection is None:
            return self.state
        kept = (self.state == FINAL) & projection.unreachable
        return np.where(kept, UNREACHABLE, self.state).astype(np.uint8)

    @property
    def position(self) -> np.ndarray:
        """World coordinates of the surface point in each pixel; (h, w, 3) float32."""
        return self.positions(0, self.state.shape[0])

    def positions(self, first: int, last: int) -> np.ndarray:
        """Return ``position`` in the rows from ``first`` to ``last``, zero off the surface;
        (last - first, w, 3) float32.
        """
        found = self.gbuffer.positions(first, last)
        if self.view.orientation.placed:
            on = self.state[first:last] > 0
            # Pixels that show glow alone have no position.
            on &= self.glow is None or found.any(axis=-1)
            found[on] = self.view.orientation.to_world(found[on].astype(np.float64))
        return found

    @property
    def layers(self) -> Iterator[Layer]:
        """All that pixels show, layer by layer: each pixel is in a layer at most once. What the
        shares of a pixel leave of 1 comes from behind everything.
        """
        for each in (self.gbuffer, self.gbuffer.walls, self.gbuffer.faces):
            yield each.pixels, each.points, 1.0

    @cached_property
    def airy(self) -> np.ndarray | None:
        """Mark the pixels that show glow and no surface, wall or face behind it, so that the
        background shines through; (h, w) bool, None if nothing glows.
        """
        if self.glow is None:
            return None
        alone = np.array(self.glow.any(axis=1))
        for each in (self.gbuffer, self.gbuffer.walls, self.gbuffer.faces):
            alone[each.pixels] = False
        return np.asarray(alone.reshape(self.state.shape))

    @cached_property
    def leaving(self) -> np.ndarray:
        """The ``radiance`` that leaves surfaces and walls, without the glow before them; (h, w,
        3) float32.
        """
        if self.glow is None:
            return self.radiance
        return self.radiance - self.glow.reshape(self.radiance.shape)

    @cached_property
    def _tally(self) -> tuple[np.ndarray, np.ndarray]:
        """The number of pixels in each state, (4,); and the sums of luminance and of (luminance
        · error)² over all pixels that have a state, those of walls too, (2,).
        """
        counts = np.zeros(4, np.int64)
        sums = np.zeros(2)
        tally(self.framebuffer, counts, sums)
        return counts, sums

    @property
    def counts(self) -> dict[str, int]:
        """The number of surface pixels in each state. While the whole picture may still
        improve, final pixels count as converging.
        """
        if self.improving:
            final = 0
        else:
            final = self.settled
        converging = int(self._tally[0][CONVERGING]) + self.settled - final
        return {
            "final": final,
            "converging": converging,
            "provisional": int(self._tally[0][PROVISIONAL]),
        }

    @property
    def settled(self) -> int:
        """The number of surface pixels whose texels have all the light that they are to have."""
        return int(self._tally[0][FINAL])

    @property
    def surface(self) -> int:
        """The number of pixels that show a surface or a wall."""
        return int(self._tally[0][PROVISIONAL:].sum())

    @property
    def coverage(self) -> dict[str, float]:
        """The share of the surface pixels in each state; all final if the picture shows no
        surface.
        """
        if not self.surface:
            return {"final": 1.0, "converging": 0.0, "provisional": 0.0}
        return {name: count / self.surface for name, count in self.counts.items()}

    @property
    def provisional(self) -> bool:
        """True if any surface pixel lacks light that it is to have."""
        return self.settled < self.surface

    @property
    def final(self) -> bool:
        """True if nothing will improve the picture any more: all of its light is there, and its
        total error is measured to be at the target.
        """
        return not self.provisional and (self._reached or not len(self.gbuffer.pixels))

    @property
    def _reached(self) -> bool:
        """True if control pixels show that the error is at the target and the tail within its
        limit; also if no control pixels check the picture.
        """
        target = self.target
        if target is None:
            return True
        # The upper end of the 95 % interval must be below the target, by controls of the texels as
        # they are now.
        if self.measured is None or self.outdated or self.measured.high > target:
            return False
        return self.tail is None or self.tail.likely <= TAIL * target

    @property
    def improving(self) -> bool:
        """True if the check of the picture goes on, so that any pixel may still change."""
        ended = self.final or (self.given_up and not self.provisional)
        return self.target is not None and not ended

    @property
    def checkable(self) -> bool:
        """True if a step of a check can improve the picture now: its texels have the light that
        they are to have, or paths of its pixels need none, and it is not at its target.
        """
        # Walls that are not final are refined first, as soon as nothing but walls is left to wait
        # for.
        if self.quality.waiting:
            return self.surface - self.settled == self.quality.waiting
        # Paths of pixels need no light of texels.
        ended = self.final or self.given_up
        return not ended and (self.undecided or self.goes_without_texels or not self.provisional)

    @property
    def undecided(self) -> bool:
        """True if light is to come, and its check has still to decide if paths of pixels bring it
        sooner than texels.
        """
        known = self.quality.known
        if known is None or known.lit_by is not None or not self.provisional:
            return False
        return self.unlit_texels > QUICK_TEXELS

    @cached_property
    def unlit_texels(self) -> float:
        """The number of texels without light that the picture reads, those of all stages."""
        return sum(demand.effort.unlit for stage in self.stages for demand in stage.demands)

    @property
    def goes_without_texels(self) -> bool:
        """True if paths of its pixels light the picture, or their transfer, and no texels."""
        known = self.quality.known
        return known is not None and known.goes_without_texels

    @property
    def transferred(self) -> int:
        """The number of paths of each point whose transfer lights the picture; 0 if none does."""
        return self.quality.known.transferred if self.quality.known else 0

    @property
    def variance_of_transfer(self) -> float:
        """The sum of the variances of luminance by the transfer of points; 0 if none lights the
        picture.
        """
        return float(self.quality.known.base.variance.sum()) if self.quality.known else 0.0

    @property
    def refinable(self) -> bool:
        """True if a step of refining helps now: the picture is checkable, its present light is not
        measured yet, or the view rests and its walls lag behind the surface.
        """
        return self.checkable or self.unmeasured or (self.walls_lag and not self.view.moving)

    @property
    def unmeasured(self) -> bool:
        """True if a part of the light is there, another part is still to come, and no control
        pixels measure the error of the whole meanwhile.
        """
        known = self.quality.known
        if known is None or len(known.controls.places) or self.quality.waiting or self.undecided:
            return False
        # Walls and cut faces are drawn without texels: they are no light that has come.
        return self.provisional and self.unlit < len(self.gbuffer.pixels)

    @property
    def unlit(self) -> int:
        """The number of surface pixels whose texels have no light: the provisional ones."""
        return int(self._tally[0][PROVISIONAL])

    @cached_property
    def walls_lag(self) -> bool:
        """True if walls are coarse, or if they are not final and their summed squared error is
        larger than that of the surface.

        The first fine texels of walls are cheap; later steps go where the error of the picture is
        largest.
        """
        if self.walls_coarse or not self.quality.waiting:
            return self.walls_coarse
        of_walls = self.squared_error(self.gbuffer.walls.pixels)
        return of_walls > self.squared_error(self.gbuffer.pixels)

    @property
    def walls_coarse(self) -> bool:
        """True if the walls still show their first, coarse texels."""
        states = self.state.ravel()[self.gbuffer.walls.pixels]
        return self.quality.waiting > 0 and bool((states <= PROVISIONAL).any())

    @cached_property
    def controlled(self) -> np.ndarray:
        """The luminance that leaves the surface at the control pixels of the picture, as it is
        shown; (k,) float64.

        Glow before the surface is left out, as paths of controls start from the surface.
        """
        known = self.quality.known
        if known is None:
            return np.empty(0)
        return self._shown_at(known.controls.places)

    def _shown_at(self, places: np.ndarray) -> np.ndarray:
        """Return the luminance that the picture shows of the surface points in rows ``places``
        (k,); (k,) float64.
        """
        return np.asarray(
            self.leaving.reshape(-1, 3)[self.gbuffer.pixels[places]].astype(np.float64)
            @ LUMINANCE_WEIGHTS
        )

    @property
    def shown_mean(self) -> float:
        """The mean luminance of the pixels that show a surface or a wall."""
        return float(self._tally[1][0]) / max(self.surface, 1)

    @cached_property
    def true_mean(self) -> float:
        """The mean luminance of the surface, with the mean error that control pixels find taken
        out; of everything that is shown if there is no surface.
        """
        # Walls, faces and glow have no control pixels: take the mean over the surface alone if they
        # are in the picture.
        if len(self.gbuffer.pixels) and (self.glow is not None or not self.gbuffer.alone):
            shown = float(self.luminance(self.gbuffer.pixels).mean())
        else:
            shown = self.shown_mean
        # Control pixels know how much too bright, or too dark, the surface is on the average.
        if self.quality.known and len(self.controlled):
            return self.quality.known.controls.mean(self.controlled, shown)
        return shown

    @cached_property
    def measured(self) -> TotalError | None:
        """The total relative RMSE by control pixels, at least the noise once all texels have their
        samples; None if there are no control pixels.
        """
        known = self.quality.known
        if known is None or not len(self.controlled):
            return None
        # Weights undo the uneven drawing of the controls, so that the mean is one over all points.
        squares = known.controls.weights * known.controls.squares(self.controlled)
        found = measure_total(squares, self.true_mean)
        # The noise counts all light that is lacking or borrowed: it bounds no provisional picture.
        if self.provisional:
            return found
        return found.at_least(self.noise)

    @cached_property
    def tail(self) -> TailError | None:
        """The error that 99 % of the surface pixels stay below, by control pixels; None if
        there are none.
        """
        known = self.quality.known
        if self.measured is None or known is None:
            return None
        tail = tail_of(known.controls, self.controlled, known.uncertainty, self.true_mean)
        return tail.within(self.measured)

    @cached_property
    def total_error(self) -> np.ndarray:
        """The relative error of each pixel, whatever its causes, at most 1; (h, w) float32.

        It is measured if the picture has control pixels (see ``spread_errors``), else as the plan
        predicts; and it is never below the noise.
        """
        if self.view.shading != "gi":
            return self.error
        known = self.quality.known
        error = self.error.copy()
        pixels = self.gbuffer.pixels
        # Besides its noise, a pixel has an error that the plan predicts or that control pixels have
        # measured; the noise is part of the measured error, and is taken out of it.
        if self.measured is None or known is None:
            other = np.float32(self.quality.expected)
        else:
            errors = spread_errors(known.uncertainty, known.controls, self.controlled)
            other = np.sqrt(np.maximum(errors**2 - self.pixel_noise**2, 0.0)) / np.maximum(
                self.luminance(pixels), 1e-30
            )
        # The causes are independent, so their squares add up. A provisional pixel counts as all
        # wrong.
        lit = self.state.ravel()[pixels] > PROVISIONAL
        error.ravel()[pixels] = np.where(
            lit, np.minimum(np.hypot(error.ravel()[pixels], other), 1.0), 1.0
        )
        return error

    @property
    def pixel_noise(self) -> np.ndarray:
        """The standard error of the luminance of each surface point; (m,) float64."""
        return self.error.ravel()[self.gbuffer.pixels] * self.luminance(self.gbuffer.pixels)

    def squared_error(self, pixels: np.ndarray) -> float:
        """Return the sum of the squared errors of the luminance of some ``pixels``."""
        return float(((self.error.ravel()[pixels] * self.luminance(pixels)) ** 2).sum())

    def luminance(self, pixels: np.ndarray) -> np.ndarray:
        """Return the luminance of some ``pixels``; float64."""
        return np.asarray(
            self.radiance.reshape(-1, 3)[pixels].astype(np.float64) @ LUMINANCE_WEIGHTS
        )

    @cached_property
    def total(self) -> TotalError:
        """The total relative RMSE of the frame: measured, or predicted before there are control
        pixels.

        It is the noise alone without global illumination, or if no surface is in the picture: the
        plan's prediction is about surfaces.
        """
        if self.view.shading != "gi" or not len(self.gbuffer.pixels):
            return TotalError(self.noise, self.noise, self.noise)
        return self.measured or predict_total(self.noise, self.quality.expected)

    @property
    def framebuffer(self) -> Framebuffer:
        """Radiance, state and error, one row per pixel; views of the frame's arrays."""
        return Framebuffer(self.radiance.reshape(-1, 3), self.state.ravel(), self.error.ravel())

    @cached_property
    def noise(self) -> float:
        """The relative RMSE of the frame that noise alone makes, in luminance: the root mean square
        error of pixels over their mean; at most 1.

        A provisional pixel counts as wrong by all of its light. Of 210 frames of 15 scenes after 16
        to 256 samples, or baked to 10 % or 5 %, the true noise was 1.00 times the estimate, a
        median, and 0.7 to 1.4 times it for 99 %; 91.9 % of the pixels were within 1.96 times their
        error (``benchmarks.accuracy calibration --size 24 --most 256``).
        """
        light, wrong = self._tally[1].tolist()
        if light > 0.0:
            return min(math.sqrt(wrong * self.surface) / light, 1.0)
        return 0.0
