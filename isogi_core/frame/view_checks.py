"""Checks of pictures: each measures the error of a view by control pixels and takes the cheapest
step to its target.

The check of a picture: control pixels measure its total error, and what is cheapest brings it to
the target. Its texels climb a ladder of samples together (16, 32, 64, …). On each rung control
pixels measure the picture as it is shown, filtered and all. Then all texels climb on, or finer ones
take their place, or the pixels that are most wrong get light of their own: whichever takes the
fewest paths to the target. A step follows from the texels' light and from the steps on this rung
alone: the same view has the same numbers whoever asks, and after any restart.
"""

import math
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from isogi_core.bake.noise import RATE, Until
from isogi_core.bake.texel_light import FIRST_LEVEL, next_level
from isogi_core.frame.frame import Frame, PictureState
from isogi_core.frame.gbuffer import GBuffer, surface_key
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
    paths_for,
    spread_errors,
    trace_controls,
    variance_of_halves,
)
from isogi_core.frame.rays.own_light import (
    AIM,
    FILTER_PASSES,
    MOST_PATHS,
    Growth,
    Surroundings,
    foreseen_paths,
)
from isogi_core.frame.rays.picture_plan import (
    AWAITED,
    QUIETER,
    Ahead,
    OwnLight,
    Plan,
    Prices,
    by_finer,
    by_rungs,
    climbs_of,
    controls_to,
    noise_of_climbers,
    rungs_above,
    rungs_at_once,
)
from isogi_core.frame.refinement import Refinement
from isogi_core.frame.shading import texel_disagreement
from isogi_core.frame.texel_reading import Reading
from isogi_core.frame.texel_shading import TexelShading
from isogi_core.frame.tiles import Stopwatch, Tiles
from isogi_core.lru_cache import LruCache
from isogi_core.model.environment import LUMINANCE_WEIGHTS
from isogi_core.model.view import View

STRICTER = 0.9
"""Factor on the error that is aimed at with each attempt."""

DOUBTFUL = 0.5
"""Share of the target below which a small measured error puts the controls in doubt, not the light:
none aims lower.
"""


EARLY_PATHS = 64
"""Paths of each half of controls of a picture whose light is still to come: it errs by 5 % or
more.
"""


@dataclass(eq=False)
class PictureCheck:
    """The check of the picture of one view: what it has ``known`` so far, and what its next step
    needs besides.

    Pixels of the next attempt are ``growing``; a path of a pixel takes a ``pace`` of so many
    seconds, None before the first. ``coarse`` says that finer texels are to be shown in this
    picture's place, which is not asked for once they were ``declined``. What is ``ahead`` is None
    before the picture was measured. Steps of several threads wait for each other.
    """

    light: RotatedLight
    known: PictureState
    growing: Growth | None = None
    pace: float | None = None
    coarse: bool = False
    declined: bool = False
    ahead: Ahead | None = None
    lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    @property
    def nbytes(self) -> int:
        """Bytes that it takes."""
        return self.known.nbytes + (self.growing.nbytes if self.growing else 0)

    def is_shown(self, frame: Frame) -> bool:
        """Whether a ``frame`` was drawn by the controls and for the samples that are known now."""
        shown = frame.quality.known
        return (
            shown is not None
            and shown.controls is self.known.controls
            and shown.enough == self.known.enough
        )

    def advance(self, frame: Frame, uncertainty: np.ndarray, tiles: Tiles, prices: Prices) -> bool:
        """Come one step nearer to the target from a ``frame`` of this picture; whether there was
        one to take.

        ``uncertainty`` (m,) says how uncertain the light of each surface point is; ways to the
        target are weighed at these ``prices``. Raises Cancelled.
        """
        taken = (
            frame.surface > 0 and not frame.final and self._step(frame, uncertainty, tiles, prices)
        )
        self.known = replace(self.known, ended=not taken)
        return taken

    def _step(self, frame: Frame, uncertainty: np.ndarray, tiles: Tiles, prices: Prices) -> bool:
        if self.growing is not None:
            return self._grow(self.growing, frame.gbuffer, tiles)
        if self.known.outdated or frame.measured is None:
            return self._begin_rung(frame, uncertainty, tiles)
        if not self.known.attempt:
            climbs = climbs_of(frame, self._rung(frame), self.known.target)
        else:
            climbs = [0.0]
        if not self._decided(frame.measured):
            drawn = 2.0 * self.known.paths * frame.measured.controls
            self.ahead = Ahead(
                max(self._control_paths(frame.measured, frame.measured.likely) - drawn, drawn),
                times=1,
            )
            if self._climbing_decides(
                frame, frame.measured, [prices.path * each for each in climbs]
            ):
                return self._climb(frame)
            return self._add_controls(frame, frame.measured, uncertainty, tiles)
        if self._blurred(frame, frame.measured):
            return self._deepen(frame.gbuffer, tiles)
        plan = self._cheapest(frame, frame.measured, uncertainty, climbs, prices, tiles)
        first = 2.0 * self.known.paths * FIRST_CONTROLS
        last = self._control_paths(frame.measured, self._aim(frame.measured))
        self.coarse = plan.finer
        self.ahead = plan.ahead(first, last)
        if plan.rungs:
            return not plan.finer and self._climb(frame, rungs_at_once(plan.rungs, climbs, first))
        return self._grow(Growth(plan.choice, self.known.own), frame.gbuffer, tiles)

    def decline(self) -> None:
        """Go on without finer texels: there is no memory for them."""
        self.known = replace(self.known, ended=False)
        self.coarse = False
        self.declined = True

    def _decided(self, measured: TotalError) -> bool:
        """Whether a picture that is not at its target needs better light, and no further
        controls.
        """
        if measured.likely <= self.known.target:
            most = MAX_CONTROLS
        else:
            most = CONTROLS_IF_MISSED
        return measured.low > self.known.target or measured.controls >= most

    def _blurred(self, frame: Frame, measured: TotalError) -> bool:
        """Whether a picture seems to be at its target, and what leaves it open is the noise of the
        controls' own paths, which is larger than the picture's error.
        """
        error = measured.likely * frame.true_mean
        return (
            measured.likely <= self.known.target
            and self.known.paths < LAST_PATHS
            and self.known.controls.noise > error**2
        )

    def _deepen(self, gbuffer: GBuffer, tiles: Tiles) -> bool:
        """Have the controls take twice as many paths."""
        known = self.known
        more = self._trace(gbuffer, known.controls.places, (known.paths, known.paths), tiles)
        self.known = replace(known, controls=known.controls.deepened(more), paths=2 * known.paths)
        return True

    def _climbing_decides(
        self, frame: Frame, measured: TotalError, climbs: Sequence[float]
    ) -> bool:
        """Whether a rung would bring the interval below the target, for less than as many controls
        again cost.

        ``climbs`` are what texels cost, in paths of pixels.
        """
        more = 2.0 * self.known.paths * measured.controls
        gained = (1.0 - QUIETER) * noise_of_climbers(frame)
        quiet = measured.high**2 - gained * frame.noise**2 <= self.known.target**2
        return quiet and len(climbs) > 1 and more > climbs[1]

    def _begin_rung(self, frame: Frame, uncertainty: np.ndarray, tiles: Tiles) -> bool:
        """Draw the first controls of a rung, or of an attempt: as exactly as the picture's noise is
        worth. Those of a picture whose light is still to come tell how wrong it is meanwhile.
        """
        known = self.known
        if frame.provisional:
            paths = EARLY_PATHS
            drawn = 0
        else:
            paths = paths_for(max(known.target, frame.noise))
            drawn = known.enough
        first = self._draw(frame.gbuffer, uncertainty, (0, FIRST_CONTROLS), paths, tiles)
        self.known = replace(
            known, uncertainty=uncertainty, controls=first, drawn=drawn, paths=paths
        )
        return True

    def _add_controls(
        self, frame: Frame, measured: TotalError, uncertainty: np.ndarray, tiles: Tiles
    ) -> bool:
        """Draw as many controls again as it takes to decide: at least as many as there are, at most
        three times.
        """
        known = self.known
        before = len(self.known.controls.places)
        if measured.likely <= known.target:
            most = MAX_CONTROLS
        else:
            most = CONTROLS_IF_MISSED
        wanted = min(controls_to(measured, measured.likely, known.target), most)
        count = int(np.clip(wanted - before, before, 3 * before))
        more = self._draw(frame.gbuffer, uncertainty, (before, count), known.paths, tiles)
        self.known = replace(known, uncertainty=uncertainty, controls=known.controls.joined(more))
        return True

    def _draw(
        self,
        gbuffer: GBuffer,
        uncertainty: np.ndarray,
        some: tuple[int, int],
        paths: int,
        tiles: Tiles,
    ) -> ControlPixels:
        """Draw ``some`` controls of so many ``paths`` a half: after how many, and how many."""
        (before, count) = some
        attempt = self.known.attempt
        places = draw_places(gbuffer, uncertainty, (attempt, before), count)
        halves = self._trace(gbuffer, places, (0, paths), tiles)
        return ControlPixels(
            places, 1.0 / (len(uncertainty) * chances(uncertainty)[places]), halves
        )

    def _trace(
        self, gbuffer: GBuffer, places: np.ndarray, some: tuple[int, int], tiles: Tiles
    ) -> np.ndarray:
        """The halves of points at ``places``, by ``some`` paths; see ``trace_controls``."""
        begun = time.perf_counter()
        halves = trace_controls(self.light, gbuffer, places, some, self.known.attempt, tiles)
        self.pace = (time.perf_counter() - begun) / max(2.0 * some[1] * len(places), 1.0)
        return halves

    def _climb(self, frame: Frame, rungs: int = 1) -> bool:
        """Have texels take twice as many samples, for each of so many ``rungs``."""
        self.known = replace(self.known, enough=next_level(self._rung(frame)) << (rungs - 1))
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
        """The plan that costs least at these ``prices`` to what is aimed at: nearer by STRICTER
        than before, at least.

        By its texels, or by finer ones before any pixel has light of its own. Pixels that have some
        keep it.
        """
        known = self.known
        noise = frame.pixel_noise**2
        variance = variance_of_halves(uncertainty, known.controls)
        aim = self._aim(measured)
        own = OwnLight(variance, known.paths, known.own.places, (aim * frame.true_mean) ** 2)
        errors = spread_errors(uncertainty, known.controls, frame.controlled) ** 2
        # controls of few pixels may find less than the noise that halves tell: then errors are as
        # large as that
        errors *= max(
            (measured.likely * frame.true_mean) ** 2 / max(float(errors.mean()), 1e-300), 1.0
        )
        errors, noise = self._by_regions(frame.gbuffer, errors, noise, tiles)
        under = frame.quality.lacking and frame.quality.lacking.texels
        if under:
            texels = len(under.places)
            chunks = len(under.chunks)
        else:
            texels = 0
            chunks = 0
        plans = by_rungs(
            own, errors, np.minimum(noise_of_climbers(frame) * noise, errors), climbs, chunks
        )
        if texels and not (known.attempt or self.declined):
            plans += by_finer(own, errors, noise, texels, chunks, self._rung(frame), known.target)
        return min(plans, key=lambda plan: plan.cost(prices))

    def _by_regions(
        self, gbuffer: GBuffer, errors: np.ndarray, noise: np.ndarray, tiles: Tiles
    ) -> tuple[np.ndarray, np.ndarray]:
        """Squared ``errors`` and variances of ``noise`` (m,), each a mean over pixels around: those
        that get light of their own make whole regions then, and no scattered pixels whose borders
        show. Raises Cancelled.
        """
        around = Surroundings(gbuffer, tiles)
        found = np.column_stack([noise, errors])
        for step, _ in FILTER_PASSES:
            found, _ = around.means(found, noise, step)
        return found[:, 1], found[:, 0]

    def _aim(self, measured: TotalError) -> float:
        """The relative error that the next attempt is to leave."""
        target = self.known.target
        return min(
            AIM * STRICTER**self.known.attempt * target,
            max(STRICTER * measured.likely, DOUBTFUL * target),
        )

    def _control_paths(self, measured: TotalError, likely: float) -> float:
        """Paths of all controls that it takes to say that the target is met by a picture with a
        ``likely`` error.
        """
        return 2.0 * self.known.paths * controls_to(measured, likely, self.known.target)

    def _rung(self, frame: Frame) -> int:
        """The samples that all texels of a ``frame`` have that are not good enough with fewer."""
        lacking = frame.quality.lacking
        if lacking:
            samples = lacking.reading.samples
        else:
            samples = np.empty(0, np.int32)
        lit = samples[samples > 0]
        return max(self.known.enough, int(lit.min()) if len(lit) else 0)

    def _grow(self, growth: Growth, gbuffer: GBuffer, tiles: Tiles) -> bool:
        """Trace further paths from the points of a ``growth``; they are shown, and controls drawn
        anew, once that will do. Whether there was anything to trace.
        """
        count = growth.next
        if count > MOST_PATHS:
            return False
        self.growing = Growth(growth.choice, growth.light)
        begun = time.perf_counter()
        light = growth.light.grown(
            growth.choice, count, self.light, gbuffer, tiles, self.growing.note
        )
        self.pace = (time.perf_counter() - begun) / max(self.growing.traced, 1)
        self.growing = Growth(growth.choice, light)
        if count == MOST_PATHS or self.growing.enough:
            known = self.known
            self.known = PictureState(
                known.target, own=light, attempt=known.attempt + 1, enough=known.enough
            )
            self.growing = None
        return True


PIXELS = 0.25
"""Paths that a pixel takes to an error over those that a texel takes, which is to hold for all
turns of its light.
"""

FILTERED_NOISE_RATIO = 4.0
"""A texel's noise over the noise of pixels that mix it and its neighbours, filtered: 3 to 5 after
16 samples.
"""


class PathsLeft(NamedTuple):
    """Paths that a picture has left to take after its texels' present samples: of ``pixels``, and
    of ``texels``.

    It is drawn so many ``times`` meanwhile. A path of a pixel takes a ``pace`` of so many seconds;
    None if that is unknown.
    """

    pixels: float = 0.0
    texels: float = 0.0
    times: int = 0
    pace: float | None = None


class ViewChecks(Refinement[PictureCheck]):
    """The checks of the pictures of views that are ``kept``, shaded by their ``texels``."""

    def __init__(self, kept: LruCache[Any], texels: TexelShading) -> None:
        """Keep them there, and ask ``texels`` how far they differ."""
        self._kept = kept
        self._texels = texels

    def check(self, light: RotatedLight, target: float) -> PictureCheck:
        """What is known of the picture of a view besides its texels' light."""
        return self._kept.get(
            check_key(light.view, target), lambda: PictureCheck(light, PictureState(target))
        )

    def of(self, frame: Frame, light: RotatedLight, target: float, tiles: Tiles) -> PictureCheck:
        """See ``Refinement``."""
        return self.check(light, target)

    def advance(
        self, found: PictureCheck, frame: Frame, target: float, tiles: Tiles, prices: Prices
    ) -> bool:
        """See ``Refinement``. Pixels whose light grows were chosen before: nothing is drawn by the
        uncertainty then.
        """
        if found.growing:
            uncertainty = found.known.uncertainty
        else:
            uncertainty = self._uncertainty(frame, found, tiles)
        return found.advance(frame, uncertainty, tiles, prices)

    def held(self, view: View, target: float) -> PictureCheck | None:
        """The check of a view's picture, where anything is known of it."""
        if is_checked(view):
            return self._kept.held(check_key(view, target))
        return None

    def _uncertainty(self, frame: Frame, check: PictureCheck, tiles: Tiles) -> np.ndarray:
        """How uncertain the light of each surface point is, by how texels around it differ, and its
        noise; (m,).
        """
        light = check.light
        known = check.known
        texels = self._texels.under(light.view, frame.gbuffer, tiles)
        found = self._texels.lit(
            texels, light, Until(known.target, known.enough), tiles, Stopwatch()
        )
        between = light.spec.unit * texel_disagreement(texels, *found)
        if light.coloured:
            between *= light.tints(frame.gbuffer, tiles) @ LUMINANCE_WEIGHTS
        between[known.own.places] = 0.0
        return np.asarray(np.hypot(between, frame.pixel_noise))

    def asks_finer(self, view: View, target: float) -> bool:
        """Whether the check of a view's picture found that finer texels are to be shown in its
        place.
        """
        check = self.held(view, target)
        return check is not None and check.coarse

    def decline_finer(self, view: View, target: float) -> None:
        """Have a view's picture reach its target without finer texels: there is no memory for
        them.
        """
        if (check := self.held(view, target)) is not None:
            check.decline()

    def left(self, frame: Frame, target: float) -> PathsLeft:
        """The paths that a ``frame`` has left to take: as pixels' light grows, as its check
        expects, or as foreseen.

        Before it is measured they are foreseen by the error that the plan expects, and by the noise
        of its texels.
        """
        return self.known_left(frame.view, target) or self.foreseen(frame, target)

    def known_left(self, view: View, target: float) -> PathsLeft | None:
        """The paths that the picture of a ``view`` has left, as its check expects; None before it
        is measured.
        """
        check = self.held(view, target)
        if check and check.ahead is not None:
            if check.growing:
                growing = check.growing.left
            else:
                growing = 0.0
            ahead = check.ahead
            return PathsLeft(growing + ahead.pixels, ahead.texels, ahead.times, check.pace)
        return None

    @staticmethod
    def foreseen(frame: Frame, target: float) -> PathsLeft:
        """The paths that a ``frame`` will take, before anything measured it."""
        if frame.quality.target is None or frame.quality.lacking is None:
            return PathsLeft()
        return foreseen_work(frame, frame.quality.lacking.reading, target)


def texels_until(until: Until, view: View, known: PictureState | None) -> Until:
    """When texels of a ``view`` need no more samples: once they have as many as are enough for its
    check, where that is ``known``; each at the target alone where nothing checks pictures, as of
    vicinity shading.
    """
    if view.shading != "gi":
        return Until(until.target)
    return Until(until.target, max(until.enough, known.enough if known else 0))


def foreseen_work(frame: Frame, reading: Reading, target: float) -> PathsLeft:
    """Paths that a ``frame`` will take after its first ones, by the noise of its texels'
    ``reading``: the fewest.
    """
    points = len(frame.gbuffer.pixels)
    effort = reading.effort
    ways = []
    controls = 2.0 * paths_for(target) * CONTROLS_IF_MISSED
    for times, rung in enumerate([FIRST_LEVEL, *rungs_above(FIRST_LEVEL, target)], start=2):
        noise = (effort / rung) ** (1.0 / RATE) / FILTERED_NOISE_RATIO
        own = foreseen_paths(
            points, math.hypot(noise, frame.quality.expected), target, PIXELS * effort
        )
        ways.append(
            PathsLeft(own + controls, float(rung - FIRST_LEVEL) * len(reading.samples), times)
        )
    return min(ways, key=lambda way: way.pixels + AWAITED.path * way.texels)


def is_checked(view: View) -> bool:
    """Whether control pixels tell the total error of a view: of global illumination, at rest."""
    return view.shading == "gi" and not view.moving


def check_key(view: View, target: float) -> tuple[Any, ...]:
    """What the check of a picture depends on."""
    return "PictureCheck", surface_key(view), view.light, view.albedo, view.shine, view.glow, target
