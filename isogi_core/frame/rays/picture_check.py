"""The check of one picture: measure its total error by control pixels, and take the step that
brings it to its target at the lowest cost.

All texels of the picture climb a ladder of sample counts together (16, 32, 64, …). On each rung,
control pixels measure the error of the picture as it is shown, filtered or not. Then one of three
ways is taken: all texels climb on, finer texels replace them, or the pixels with the largest errors
get light from paths of their own. The way with the fewest expected paths to the target wins. If
paths alone light the picture (``light_by_paths``), they grow until their noise is small enough, and
control pixels measure it then.

Each step follows from the light of the texels, from light that was carried over, and from the
earlier steps on the same rung alone.
"""

import math
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from isogi_core.bake.noise import Goal
from isogi_core.bake.texel_light import next_level
from isogi_core.frame.frame import Frame
from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.rays.control_pixels import (
    CONTROLS_IF_MISSED,
    FIRST_CONTROLS,
    LAST_PATHS,
    MAX_CONTROLS,
    ControlPixels,
    TotalError,
    chances,
    draw_places,
    first_controls,
    paths_for,
    spread_errors,
    trace_controls,
    variance_of_halves,
)
from isogi_core.frame.rays.own_light import AIM, Choice, Growth, PixelLight
from isogi_core.frame.rays.picture_plan import (
    QUIETER,
    Ahead,
    PixelLightCost,
    Plan,
    Prices,
    by_finer,
    by_rungs,
    climbs_of,
    controls_to,
    noise_of_climbers,
    rungs_at_once,
    until_decided,
)
from isogi_core.frame.rays.picture_state import PictureState
from isogi_core.frame.rays.pixel_filter import FILTER_PASSES, Surroundings
from isogi_core.frame.rays.point_transfer import TransferredLight
from isogi_core.frame.tiles import Tiles

STRICTER = 0.9
"""Factor on the error that is aimed at, for each attempt with light of pixels' own."""


DOUBTFUL = 0.5
"""Share of the target below which no attempt aims. If the measured error is smaller than that,
the controls are in doubt, not the light.
"""


FILTERED_ERROR = 1.4
"""Squared error of filtered light of points over its variance, as the filter leaves a bias of 0.5
to 0.7 of the noise.
"""


CARRIED_ATTEMPTS = 1
CARRIED_ATTEMPTS_BY_PATHS = 2
"""Attempts with light that was carried over from other views, before it is dropped; and the same if
paths alone light the picture, as points that took nothing over make up for the others first.
"""

EARLY_PATHS = 64
"""Paths of each half of a control while light of the picture is still to come: its error is 5 % or
more.
"""


class Scouted(NamedTuple):
    """What a few controls show of a picture without light: its ``mean`` luminance, and the relative
    ``error`` of a point after EARLY_PATHS paths.
    """

    mean: float
    error: float

    def effort(self, rate: float) -> float:
        """Return the number of paths, times e^``rate``, that bring a point to a relative error
        e.
        """
        return float(EARLY_PATHS * self.error**rate)


@dataclass(eq=False)
class PictureCheck:
    """The check of one picture.

    - ``light``: of the view.
    - ``known``: what the check has found so far.
    - ``growing``: light of pixels that is being traced for the next attempt; None if there is none.
    - ``pace``: seconds for each path of the step that was traced last, of controls or of pixels'
      own light; it only foretells time. None before any was traced.
    - ``coarse``: True if finer texels are to be shown in place of this picture.
    - ``declined``: True if finer texels were refused.
    - ``ahead``: work that is expected to remain; None before the picture was measured.
    - ``whole``: the choice of all points, if paths alone light the picture.

    Only the thread that holds the ``lock`` takes a step.
    """

    light: RotatedLight
    known: PictureState
    growing: Growth | None = None
    pace: float | None = None
    coarse: bool = False
    declined: bool = False
    ahead: Ahead | None = None
    whole: Choice | None = None
    lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    @property
    def nbytes(self) -> int:
        """The size of its arrays in bytes."""
        growth = self.growing  # another thread may end it meanwhile
        return self.known.nbytes + (growth.nbytes if growth else 0)

    def is_shown(self, frame: Frame) -> bool:
        """Return True if a ``frame`` was drawn with the controls, the rung and the transfer that
        are known now.
        """
        shown = frame.quality.known
        return (
            shown is not None
            and shown.controls is self.known.controls
            and shown.goal == self.known.goal
            and shown.transferred == self.known.transferred
        )

    def advance(self, frame: Frame, uncertainty: np.ndarray, tiles: Tiles, prices: Prices) -> bool:
        """Take one step from a ``frame`` of this picture towards its target; return False if there
        is no step to take: the frame shows nothing or is final, all means are spent, or finer
        texels are to be shown in its place (``coarse``).

        ``uncertainty`` (m,) is the standard error that is guessed for the luminance of each surface
        point; controls are drawn by it. ``prices`` weigh the ways to the target. The caller holds
        the ``lock``. Raises Cancelled.
        """
        # Record that the check has ended: later frames then say that nothing will improve them,
        # although their error may be above the target.
        taken = (
            frame.surface > 0 and not frame.final and self._step(frame, uncertainty, tiles, prices)
        )
        self.known = replace(self.known, ended=not taken)
        return taken

    def _step(self, frame: Frame, uncertainty: np.ndarray, tiles: Tiles, prices: Prices) -> bool:
        """Take the step that is due; return False if there is none."""
        # Light of pixels that was begun is finished first.
        if self.growing is not None:
            return self._grow(self.growing, frame.gbuffer, tiles)
        # On a new rung, or with new light of pixels, the picture is measured again.
        if self.known.outdated or frame.measured is None:
            return self._begin_rung(frame, uncertainty, tiles)
        # Once pixels have light of their own, texels climb no more: it would be traced in vain.
        if not self.known.attempt:
            climbs = climbs_of(frame, self._rung(frame), self.known.goal.error)
        else:
            climbs = [0.0]
        first = 2.0 * self.known.paths * FIRST_CONTROLS
        # While the interval holds the target, draw more controls, unless a rung decides for less.
        if not self._decided(frame.measured):
            costs = [prices.path * each for each in climbs]
            if self._climbing_decides(frame, frame.measured, costs):
                self.ahead = Ahead(first, times=1)
                return self._climb(frame)
            drawn = 2.0 * self.known.paths * frame.measured.controls
            wanted = self._control_paths(frame.measured, frame.measured.likely)
            self.ahead = until_decided(max(wanted - drawn, drawn), climbs, prices, first)
            return self._add_controls(frame, frame.measured, uncertainty, tiles)
        # If only the noise of the controls leaves the target open, they take more paths.
        if self._blurred(frame, frame.measured):
            return self._deepen(frame.gbuffer, tiles)
        # Light that was carried over from other views is a fraction of a pixel aside. If it keeps
        # the picture from its target, the light of these pixels is traced anew.
        attempts = CARRIED_ATTEMPTS
        if self.known.lit_by == "paths":
            attempts = CARRIED_ATTEMPTS_BY_PATHS
        if len(self.known.carried) and self.known.attempt >= attempts:
            self._drop_carried(frame.gbuffer, tiles)
            return True
        # The picture misses its target. Take the first step of the cheapest plan: rungs, or light
        # of pixels. If finer texels are cheaper, the check ends with ``coarse`` set, and the caller
        # shows them.
        plan = self._cheapest(frame, frame.measured, uncertainty, climbs, prices, tiles)
        if not plan.rungs:
            plan = replace(plan, choice=plan.choice.with_rim(frame.gbuffer, tiles))
        last = self._control_paths(frame.measured, self._aim(frame.measured))
        self.coarse = plan.finer
        self.ahead = plan.ahead(first, last)
        if plan.rungs:
            return not plan.finer and self._climb(frame, rungs_at_once(plan.rungs, climbs, first))
        # Light of other views gains little by a few paths more: points without it come first.
        growth = Growth(plan.choice, self.known.own, earlier=self.known.carried)
        return self._grow(growth, frame.gbuffer, tiles)

    def scout(self, gbuffer: GBuffer, tiles: Tiles) -> "Scouted":
        """Trace a few controls, drawn evenly from a picture that has no light yet, and return what
        they show. Raises Cancelled.
        """
        even = np.ones(len(gbuffer.pixels))
        controls = self._draw(gbuffer, even, (0, FIRST_CONTROLS), EARLY_PATHS, tiles)
        self.known = replace(
            self.known, uncertainty=even, controls=controls, drawn=0, paths=EARLY_PATHS
        )
        mean = float((controls.weights * controls.halves.mean(axis=1)).mean())
        deviation = math.sqrt(max(controls.noise, 0.0))
        return Scouted(mean, deviation / max(mean, np.finfo(np.float64).tiny))

    def light_by_texels(self) -> None:
        """Have the picture read texels; forget paths that light it alone."""
        if self.known.goes_without_texels:
            self.known = PictureState(Goal.checked(self.known.goal.error))
            self.growing = None
        else:
            self.known = replace(self.known, lit_by="texels")

    def light_by_paths(self, choice: Choice, carried: PixelLight) -> None:
        """Have all points of a picture lit by paths of their own, until they are as precise as a
        ``choice`` of all points asks. Points with light ``carried`` over from other views begin
        with it.
        """
        self.whole = choice
        self.known = replace(self.known, own=carried, carried=carried.places, lit_by="paths")
        self.growing = Growth(choice, carried, shown=True, earlier=carried.places)
        self.ahead = Ahead(first_controls(self.known.goal.error), times=1)

    def light_by_transfer(self, base: TransferredLight, samples: int) -> None:
        """Show the ``base``, light of all points by their transfer, which is to have at least
        ``samples`` paths of each point before the picture is measured.
        """
        goal = self.known.goal
        goal = goal._replace(samples=max(goal.samples, samples))
        self.known = replace(self.known, goal=goal, base=base, lit_by="transfer")
        self.ahead = Ahead(first_controls(goal.error), times=1)

    def end_transfer(self) -> None:
        """Go on with the paths of the transfer that are shown: it grows no more."""
        goal = self.known.goal._replace(samples=self.known.transferred)
        self.known = replace(self.known, goal=goal)

    def decline(self) -> None:
        """Go on without finer texels: memory has no room for them."""
        self.known = replace(self.known, ended=False)
        self.coarse = False
        self.declined = True

    def _decided(self, measured: TotalError) -> bool:
        """Return True if more controls would not help a picture that is not at its target: its
        interval lies above the target, or as many controls are drawn as may be.
        """
        most = self._most_controls(measured)
        return measured.low > self.known.goal.error or measured.controls >= most

    def _most_controls(self, measured: TotalError) -> int:
        """Return the most controls that are worth their paths: more for a picture that seems to be
        at its target, as they are all that is left to show it.
        """
        if measured.likely <= self.known.goal.error:
            return MAX_CONTROLS
        return CONTROLS_IF_MISSED

    def _blurred(self, frame: Frame, measured: TotalError) -> bool:
        """Return True if a picture seems to be at its target, and the noise of the controls' paths,
        which is larger than the error of the picture, leaves that open.
        """
        error = measured.likely * frame.true_mean
        return (
            measured.likely <= self.known.goal.error
            and self.known.paths < LAST_PATHS
            and self.known.controls.noise > error**2
        )

    def _deepen(self, gbuffer: GBuffer, tiles: Tiles) -> bool:
        """Double the paths of the controls."""
        known = self.known
        more = self._trace(gbuffer, known.controls.places, (known.paths, known.paths), tiles)
        self.known = replace(known, controls=known.controls.deepened(more), paths=2 * known.paths)
        return True

    def _climbing_decides(
        self, frame: Frame, measured: TotalError, climbs: Sequence[float]
    ) -> bool:
        """Return True if one rung would bring the interval below the target at a lower cost than
        doubling the controls.

        ``climbs`` are the costs of no rung, of one, and so on, in paths of pixels.
        """
        more = 2.0 * self.known.paths * measured.controls
        gained = (1.0 - QUIETER) * noise_of_climbers(frame)
        quiet = measured.high**2 - gained * frame.noise**2 <= self.known.goal.error**2
        return quiet and len(climbs) > 1 and more > climbs[1]

    def _begin_rung(self, frame: Frame, uncertainty: np.ndarray, tiles: Tiles) -> bool:
        """Draw the first controls of a rung, or of an attempt, with paths for the larger of
        target and noise. While light of the picture is still to come, controls measure its error
        so far.
        """
        known = self.known
        # Controls of a picture that is still provisional count as drawn on no rung, so that new
        # ones are drawn once all its light is there.
        if frame.provisional:
            paths = EARLY_PATHS
            drawn = 0
        else:
            paths = paths_for(max(known.goal.error, frame.noise))
            drawn = known.goal.samples
        first = self._draw(frame.gbuffer, uncertainty, (0, FIRST_CONTROLS), paths, tiles)
        self.known = replace(
            known, uncertainty=uncertainty, controls=first, drawn=drawn, paths=paths
        )
        return True

    def _add_controls(
        self, frame: Frame, measured: TotalError, uncertainty: np.ndarray, tiles: Tiles
    ) -> bool:
        """Draw as many more controls as it takes to decide: at least as many as there are, at
        most three times as many.
        """
        known = self.known
        before = len(self.known.controls.places)
        # Predict the number that decides, within the most that are worth their paths.
        decisive = controls_to(measured, measured.likely, known.goal.error)
        wanted = min(decisive, self._most_controls(measured))
        count = int(np.clip(wanted - before, before, 3 * before))
        more = self._draw(frame.gbuffer, uncertainty, (before, count), known.paths, tiles)
        self.known = replace(known, uncertainty=uncertainty, controls=known.controls.joined(more))
        return True

    def _draw(
        self,
        gbuffer: GBuffer,
        uncertainty: np.ndarray,
        span: tuple[int, int],
        paths: int,
        tiles: Tiles,
    ) -> ControlPixels:
        """Draw controls of ``paths`` paths in each half. ``span`` is the number of controls that
        there are, and the number to draw.
        """
        before, count = span
        places = draw_places(gbuffer, uncertainty, (self.known.attempt, before), count)
        halves = self._trace(gbuffer, places, (0, paths), tiles)
        # A weight is the chance of a point if all are drawn evenly, over its chance here.
        weights = 1.0 / (len(uncertainty) * chances(uncertainty)[places])
        return ControlPixels(places, weights, halves)

    def _trace(
        self, gbuffer: GBuffer, places: np.ndarray, span: tuple[int, int], tiles: Tiles
    ) -> np.ndarray:
        """Trace two halves of paths from controls at ``places`` (k,), set the ``pace`` by their
        time, and return their luminance, (k, 2). ``places`` and ``span`` are as in
        ``trace_controls``. Raises Cancelled.
        """
        # A point that was drawn twice is traced once, and counts twice here, as it does where
        # numbers of paths are predicted from numbers of controls.
        begun = time.perf_counter()
        halves = trace_controls(self.light, gbuffer, places, span, self.known.attempt, tiles)
        self.pace = (time.perf_counter() - begun) / max(2.0 * span[1] * len(places), 1.0)
        return halves

    def _climb(self, frame: Frame, rungs: int = 1) -> bool:
        """Have texels double their samples once for each of the ``rungs``; they are baked when
        asked for.
        """
        rung = next_level(self._rung(frame)) << (rungs - 1)
        self.known = replace(self.known, goal=self.known.goal._replace(samples=rung))
        return True

    def _cheapest(
        self,
        frame: Frame,
        measured: TotalError,
        uncertainty: np.ndarray,
        climbs: Sequence[float],
        prices: Prices,
        tiles: Tiles,
    ) -> Plan:
        """Return the plan that costs least at these ``prices`` and brings the picture to the error
        that is aimed at.

        A plan takes a number of rungs, with the present texels or with finer ones, and then traces
        light for the pixels whose errors are still too large. ``climbs`` are the costs of no rung,
        of one, and so on, in paths of texels. Pixels that have traced light keep it; finer texels
        are no choice then, as they would begin without it. Raises Cancelled.
        """
        # Estimate the squared error of each point by the controls, and the part of it that noise
        # makes; and the variance that a path of the point leaves.
        known = self.known
        noise = frame.pixel_noise**2
        variance = variance_of_halves(uncertainty, known.controls)
        aim = self._aim(measured)
        allowed = (aim * frame.true_mean) ** 2
        pixels = PixelLightCost(variance, known.paths, known.own.places, allowed)
        errors = spread_errors(uncertainty, known.controls, frame.controlled) ** 2
        # Few controls may find an error below the noise that is known to be there: scale all errors
        # up to it.
        known_error = (measured.likely * frame.true_mean) ** 2
        errors *= max(known_error / max(float(errors.mean()), 1e-300), 1.0)
        errors, noise = self._by_regions(frame.gbuffer, errors, noise, tiles)
        # Count the texels and chunks that the picture reads; it reads none if it shows no texels.
        texels = 0
        chunks = 0
        if frame.quality.lacking:
            texels = len(frame.quality.lacking.texels.places)
            chunks = len(frame.quality.lacking.texels.chunks)
        # More samples reduce the noise of texels that may still climb, and nothing else. Weigh all
        # numbers of rungs, for these texels and for finer ones.
        noisy = noise_of_climbers(frame)
        # The filter of pixels makes a part of the noise a bias, which falls with it.
        if frame.transferred:
            noisy *= FILTERED_ERROR
        falling = np.minimum(noisy * noise, errors)
        plans = by_rungs(pixels, errors, falling, climbs, chunks)
        if texels and not (known.attempt or self.declined):
            plans += by_finer(
                pixels, errors, noise, texels, chunks, self._rung(frame), known.goal.error
            )
        return min(plans, key=lambda plan: plan.cost(prices))

    def _by_regions(
        self, gbuffer: GBuffer, errors: np.ndarray, noise: np.ndarray, tiles: Tiles
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the squared ``errors`` and the variances of ``noise`` (m,), averaged over
        neighbouring pixels of the same surface.

        Pixels are chosen by these. Averages make the chosen ones form regions. Single errors would
        scatter them, and each border between traced light and the light of texels may be visible.
        Raises Cancelled.
        """
        # Average by the passes of the filter of pixels. The second result, the variance of the
        # mean, is not used.
        around = Surroundings(gbuffer, tiles)
        found = np.column_stack([noise, errors])
        for step, _ in FILTER_PASSES:
            found, _ = around.means(found, noise, step)
        return found[:, 1], found[:, 0]

    def _aim(self, measured: TotalError) -> float:
        """Return the relative error that the next attempt aims at: below the target, lower with
        each attempt, and not far below the ``measured`` error.
        """
        target = self.known.goal.error
        return min(
            AIM * STRICTER**self.known.attempt * target,
            max(STRICTER * measured.likely, DOUBTFUL * target),
        )

    def _control_paths(self, measured: TotalError, likely: float) -> float:
        """Return the number of paths of all controls that show a picture with a ``likely``
        error to be at its target.
        """
        return 2.0 * self.known.paths * controls_to(measured, likely, self.known.goal.error)

    def _rung(self, frame: Frame) -> int:
        """Return the present rung, from which texels of the ``frame`` climb: the samples of the
        goal, or the fewest samples of any texel if other views have lit all of them further.

        Texels with little noise stay behind on lower rungs, so the fewest samples alone may be too
        low. Texels without samples, such as those inside matter, do not count.
        """
        if frame.quality.lacking is None:
            return self.known.goal.samples
        samples = frame.quality.lacking.reading.samples
        lit = samples[samples > 0]
        if not len(lit):
            return self.known.goal.samples
        return max(self.known.goal.samples, int(lit.min()))

    def _grow(self, growth: Growth, gbuffer: GBuffer, tiles: Tiles) -> bool:
        """Trace further paths from the points of a ``growth``; return False if they have all that
        they may.

        Once their noise is small enough, the picture shows their light, and is measured again as
        the next attempt.
        """
        if growth.exhausted:
            return False
        wanted = growth.next
        # Count the paths of this step apart, so that other threads see its progress.
        self.growing = replace(growth, traced=0)
        begun = time.perf_counter()
        light = growth.light.grown(
            growth.choice, wanted, self.light, gbuffer, tiles, self.growing.note
        )
        self.pace = (time.perf_counter() - begun) / max(self.growing.traced, 1)
        self.growing = replace(growth, light=light, traced=0)
        # A picture by paths alone has no other light to show meanwhile. It is not final before the
        # growth ends, whatever the controls say that the growth was chosen by.
        if self.known.lit_by == "paths":
            carried = self.known.carried[np.isin(self.known.carried, growth.light.places)]
            self.known = replace(self.known, own=light, carried=carried, drawn=0)
        # The light is good enough: show it, and drop the controls, which measured the picture
        # without it.
        if self.growing.exhausted or self.growing.enough:
            known = self.known
            self.known = PictureState(
                known.goal,
                own=light,
                carried=known.carried,
                attempt=known.attempt + 1,
                lit_by=known.lit_by,
                base=known.base,
            )
            self.growing = None
        return True

    @property
    def takes_all_points(self) -> bool:
        """True if all points of the picture have light of their own, or it is being traced."""
        growth = self.growing
        if growth is not None:
            return len(growth.choice.places) == len(growth.choice.errors)
        return self.known.all_points

    @property
    def untouched(self) -> bool:
        """True if the check has neither measured the picture with all its light nor traced light
        for its pixels.
        """
        known = self.known
        return not (known.drawn or known.attempt or len(known.carried) or self.growing)

    def carry(self, own: PixelLight) -> None:
        """Show light of pixels' ``own`` that was carried over from other views; the picture is
        measured with it.
        """
        none = ControlPixels.none()
        self.known = replace(self.known, own=own, carried=own.places, controls=none)

    def _drop_carried(self, gbuffer: GBuffer, tiles: Tiles) -> None:
        """Forget the light that was carried over. Pixels whose light was traced for themselves
        keep it. The others are traced next if paths alone light the picture. Raises Cancelled.
        """
        known = self.known
        own = known.own.without(known.carried, self.light, gbuffer, tiles)
        # A picture by paths has nothing else to show until the first step of the new growth.
        if known.lit_by == "paths" and self.whole is not None:
            self.known = replace(known, drawn=0)
            self.growing = Growth(self.whole, own, shown=True, earlier=own.places)
        else:
            self.known = PictureState(
                known.goal, own=own, attempt=known.attempt, lit_by=known.lit_by, base=known.base
            )
