"""Checks of the pictures of all views: keep them, measure how uncertain pixels are, and predict
the work that is left.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from isogi_core.bake.noise import RATE, Goal
from isogi_core.bake.texel_light import FIRST_LEVEL
from isogi_core.cache.scene_caches import Caches
from isogi_core.frame.frame import Frame
from isogi_core.frame.gbuffer import surface_key
from isogi_core.frame.rays.carried_light import MOST_BENT, TracedLight, TracedPoints, carried_key
from isogi_core.frame.rays.control_pixels import CONTROLS_IF_MISSED, first_controls, paths_for
from isogi_core.frame.rays.own_light import (
    PATHS_RATE,
    PixelLight,
    all_points,
    foreseen_paths,
    paths_alone,
)
from isogi_core.frame.rays.picture_check import PictureCheck
from isogi_core.frame.rays.picture_plan import (
    AWAITED,
    HEAVIER,
    LIGHTER,
    Prices,
    rungs_above,
)
from isogi_core.frame.rays.picture_state import LitBy, PictureState
from isogi_core.frame.rays.point_transfer import (
    FIRST_SAMPLES,
    ViewTransfer,
    may_keep_transfer,
    next_shown,
    transfer_key,
)
from isogi_core.frame.refinement import PathsLeft, Refinement
from isogi_core.frame.shading import texel_disagreement
from isogi_core.frame.shot import Shot
from isogi_core.frame.texel_reading import Reading
from isogi_core.frame.texel_shading import TexelShading
from isogi_core.lru_cache import LruCache
from isogi_core.model.environment import LUMINANCE_WEIGHTS
from isogi_core.model.view import View
from isogi_core.prepared.prepared_scene import Index

PIXELS = 0.25
"""Paths that a pixel takes to an error, over those that a texel takes: the error of a texel
must hold for all rotations of its light.
"""


FILTERED_NOISE_RATIO = 4.0
"""Noise of a texel over the noise of pixels that interpolate it and its neighbours, filtered: 3
to 5 after 16 samples.
"""


WORTH_CARRYING = 4
"""Number of first measurements of a picture whose paths light of other views must spare, to be
carried over.
"""


TRANSFER_SHARE = 0.5
"""Share of the bytes that are kept of views which the transfer of one view may take: that of 80,000
points takes 28 to 50 MB.
"""


@dataclass(frozen=True, eq=False)
class WorkLeft:
    """The work that is left for one part of a picture, without the picture itself, which takes
    megabytes: for its walls, or for one side of a surface.

    ``foreseen`` are its paths when the picture was drawn; ``known`` returns those that its check
    expects now, None before it was measured. Its texels read ``chunks`` of each kind of ``light``,
    by the caches of this; None stands for those of the scene.
    """

    foreseen: PathsLeft
    known: Callable[[], PathsLeft | None] = lambda: None
    light: tuple[Caches | None, ...] = ()
    chunks: tuple[Index, ...] = ()

    @property
    def paths(self) -> PathsLeft:
        """The paths that are left now. Texels take theirs for each kind of light."""
        found = self.known() or self.foreseen
        return found._replace(texels=len(self.light) * found.texels)


class ViewChecks(Refinement[PictureCheck]):
    """The checks of the pictures of views, among the results that renderers keep."""

    def __init__(self, kept: LruCache[Any], texels: TexelShading) -> None:
        """Keep checks in ``kept``; read the light of ``texels`` to see how far neighbours
        differ.
        """
        self._kept = kept
        self._texels = texels

    def of(self, shot: Shot) -> PictureCheck:
        """Return the check of the picture of a ``shot``, kept or begun now: see ``Refinement``."""
        error = shot.goal.error
        lit_by: LitBy | None = None if may_go_without_texels(shot) else "texels"
        begun = PictureState(Goal.checked(error), lit_by=lit_by)
        return self._kept.get(check_key(shot.view, error), lambda: PictureCheck(shot.light, begun))

    def advance(self, found: PictureCheck, frame: Frame, shot: Shot, prices: Prices) -> bool:
        """Take one step of the check ``found``: see ``Refinement``."""
        # Decide first what lights the picture. If that is not light which is there, the picture is
        # drawn again before it is measured.
        if found.known.lit_by is None:
            self._begin(found, frame, shot, prices)
            if frame.undecided or found.known.goes_without_texels:
                return True
        # More paths of the transfer come before the picture is measured.
        if found.known.lit_by == "transfer":
            prices = prices.of_transfer
            if found.known.transferred < found.known.goal.samples:
                self._transfer(found, shot)
                return True
        # Pixels whose light grows were chosen before: nothing is drawn by the uncertainty then.
        if found.growing:
            uncertainty = found.known.uncertainty
        elif found.known.goes_without_texels:
            uncertainty = np.hypot(frame.pixel_noise, doubt_of_carried(found, frame))
            if found.known.lit_by == "transfer":
                uncertainty = np.hypot(uncertainty, doubt_of_transfer(frame))
        else:
            uncertainty = self._uncertainty(frame, found, shot)
        # Light that was traced for other views comes first, as it costs no paths.
        if found.untouched and not frame.provisional and prices.carries:
            # The picture is measured with that light, and perhaps once more without it. If it
            # spares few paths, it costs more than it brings.
            carried = self._carried(shot, uncertainty)
            measurement = first_controls(shot.goal.error)
            if carried.paths >= WORTH_CARRYING * measurement and len(carried.places):
                found.carry(carried)
                return True
        before = found.known.own
        taken = found.advance(frame, uncertainty, shot.tiles, prices)
        if found.known.own is not before and not found.growing:
            self._keep_traced(found, shot)
        # If all points get light of their own, their transfer spares nothing: under other
        # rotations, paths alone are to light the view.
        if found.known.lit_by == "transfer" and found.takes_all_points:
            self._transfer_of(shot).give_up(shot)
        return taken

    def _begin(self, check: PictureCheck, frame: Frame, shot: Shot, prices: Prices) -> None:
        """Begin the ``check`` of a picture. Raises Cancelled.

        Its texels light it if they are to be baked in any case; its transfer does if paths lit the
        view before its light turned, as it may turn on; paths may do if its texels are not baked
        yet; else its texels do, even if light of these is lost later.
        """
        if math.isinf(prices.alone):
            check.light_by_texels()
        elif self._has_turned(shot):
            self._transfer(check, shot)
        elif frame.undecided:
            self._decide(check, frame, shot, prices)
        else:
            check.light_by_texels()

    def _decide(self, check: PictureCheck, frame: Frame, shot: Shot, prices: Prices) -> None:
        """Decide if paths of its pixels light a picture whose texels are not baked yet, in place of
        these; begin with the paths if so. Raises Cancelled.

        A few controls show how many paths a pixel takes to the target. Texels must cost less than
        the paths that they spare: those of the first samples, which the picture waits for, and all
        others that it is foreseen to need afterwards.
        """
        lacking = frame.quality.lacking
        assert lacking is not None, "a picture that reads no texels has nothing to decide"
        target = shot.goal.error
        scouted = check.scout(frame.gbuffer, shot.tiles)
        effort = scouted.effort(PATHS_RATE)
        of_texel = scouted.effort(RATE) / PIXELS
        left = foreseen_work(frame, lacking.reading, target, of_texel)
        # Their paths count in full here: the picture waits for all of them.
        first = FIRST_LEVEL * frame.unlit_texels
        texels = HEAVIER * (first + left.texels) + left.pixels
        texels += prices.task * sum(len(stage.demands) for stage in lacking.stages)
        # Light that was traced for other views spares its paths.
        carried = self._carried(shot, np.ones(len(frame.gbuffer.pixels)))
        points = len(frame.gbuffer.pixels)
        alone = prices.alone * paths_alone(points - len(carried.places), effort, target)
        if scouted.mean <= 0.0 or alone + controls_of(target) >= texels:
            check.light_by_texels()
            return
        # Other rotations of the light may come.
        self._transfer_of(shot)
        error = math.hypot(noise_after(FIRST_LEVEL, of_texel), frame.quality.expected)
        choice = all_points(points, error, target, scouted.mean, effort)
        check.light_by_paths(choice, carried)

    def _transfer_of(self, shot: Shot) -> ViewTransfer:
        """Return the transfer of the points of a ``shot``, kept or begun now."""
        found: ViewTransfer = self._kept.get(
            transfer_key(shot.view), lambda: ViewTransfer(shot.view.light)
        )
        return found

    def _has_turned(self, shot: Shot) -> bool:
        """Return True if the light of a ``shot`` has turned since paths lit the view, so that the
        transfer of its points is to light it.
        """
        found: ViewTransfer | None = self._kept.held(transfer_key(shot.view))
        most = int(TRANSFER_SHARE * self._kept.most)
        return found is not None and found.serves(shot) and may_keep_transfer(shot, most)

    def _transfer(self, check: PictureCheck, shot: Shot) -> None:
        """Light the picture of a ``shot`` by the transfer of its points, with some more paths of
        each if it has fewer than its ``check`` asks for. Raises Cancelled.
        """
        transfer = self._transfer_of(shot)
        shown = check.known.transferred
        # A picture that began with the transfer keeps the paths that it shows if the transfer was
        # given up meanwhile.
        if shown > 0 and transfer.is_vain(shot):
            check.end_transfer()
            return
        # The first paths are shown soon. If memory had no room for the transfer, it begins anew,
        # and must not show less than before.
        wanted = max(check.known.goal.samples, FIRST_SAMPLES)
        samples = max(transfer.newest.samples, shown)
        until = max(min(next_shown(samples), wanted), shown)
        newest = transfer.grow(shot, until)
        check.light_by_transfer(newest.lit(shot), max(wanted, newest.samples))

    def _carried(self, shot: Shot, uncertainty: np.ndarray) -> PixelLight:
        """Return the light that the points of a ``shot`` take over from earlier views; light of no
        points if there is none. For the ``uncertainty`` (m,) see ``TracedLight.carried_to``. Raises
        Cancelled.
        """
        key = carried_key(shot.light)
        if key is None or (traced := self._kept.held(key)) is None:
            return PixelLight.none()
        own: PixelLight = traced.carried_to(shot, uncertainty)
        return own

    def _keep_traced(self, check: PictureCheck, shot: Shot) -> None:
        """Keep the light that a ``check`` has traced for points of a ``shot``, for later views.
        Raises Cancelled.
        """
        known = check.known
        key = carried_key(shot.light)
        if key is None or len(known.own.places) == len(known.carried):
            return
        newest = TracedPoints.of(shot, known.own, known.carried)
        former = self._kept.held(key) or TracedLight(())
        self._kept.drop(key)
        self._kept.get(key, lambda: former.joined(newest))

    def held(self, view: View, goal: Goal) -> PictureCheck | None:
        """Return the check that brings a view's picture to the error of a ``goal``; None if there
        is none.
        """
        if is_checked(view):
            return self._kept.held(check_key(view, goal.error))
        return None

    def _uncertainty(self, frame: Frame, check: PictureCheck, shot: Shot) -> np.ndarray:
        """Return the uncertain luminance of each surface point: the spread of the texels around
        it, and its noise; (m,).
        """
        light = shot.light
        known = check.known
        # Read the texels that the picture shows, with the samples that its check asks for.
        texels = self._texels.under(shot.view, shot.gbuffer, shot.tiles)
        found = self._texels.lit(texels, replace(shot, goal=known.goal))
        # Where texels around a point differ, light between them is uncertain. Light that was traced
        # for a pixel itself is not.
        between = light.spec.unit * texel_disagreement(texels, *found)
        if light.coloured:
            between *= light.tints(shot.gbuffer, shot.tiles) @ LUMINANCE_WEIGHTS
        between[known.own.places] = 0.0
        between += doubt_of_carried(check, frame)
        return np.asarray(np.hypot(between, frame.pixel_noise))

    def require_texels(self, view: View, goal: Goal) -> None:
        """Have a view's picture read texels, even if paths of its pixels light it now."""
        check = self.held(view, goal)
        if check is not None and check.known.lit_by != "texels":
            with check.lock:
                check.light_by_texels()

    def asks_finer(self, view: View, goal: Goal) -> bool:
        """Return True if the check of a view's picture asks for finer texels in its place."""
        check = self.held(view, goal)
        return check is not None and check.coarse

    def decline_finer(self, view: View, goal: Goal) -> None:
        """Tell the check of a view's picture to go on without finer texels: memory has no room
        for them.
        """
        if (check := self.held(view, goal)) is not None:
            check.decline()

    def work_left(
        self,
        frame: Frame,
        goal: Goal,
        light: tuple[Caches | None, ...] = (None,),
        effort: float = 0.0,
    ) -> WorkLeft:
        """Return the work that the surface in a ``frame`` takes to a ``goal``: none if neither
        texels nor paths of pixels light it.

        Its paths are those that its check expects, or, before it was measured, as foreseen from the
        plan's error and from the noise of its texels, which read this ``light``. For ``effort`` see
        ``foreseen``.
        """
        if frame.quality.lacking is None and not frame.goes_without_texels:
            return WorkLeft(PathsLeft())
        measuring = self.measuring_left(frame, goal, light)
        foreseen = self.foreseen(frame, goal, effort)._replace(pace=measuring.foreseen.pace)
        known = partial(self.known_left, frame.view, goal)
        return replace(measuring, foreseen=foreseen, known=known)

    def measuring_left(
        self, frame: Frame, goal: Goal, light: tuple[Caches | None, ...] = (None,)
    ) -> WorkLeft:
        """Return the work by which a ``frame`` is measured, whose texels read this ``light``: none
        if that was done with the samples that they have now.
        """
        check = self.held(frame.view, goal)
        paths = PathsLeft(pace=check.pace if check else None)
        if frame.measured is None or frame.outdated:
            controls = first_controls(max(goal.error, frame.noise))
            paths = paths._replace(pixels=controls, times=1)
        lacking = frame.quality.lacking
        chunks = lacking.texels.chunks if lacking else ()
        return WorkLeft(paths, light=light, chunks=chunks)

    def known_left(self, view: View, goal: Goal) -> PathsLeft | None:
        """Return the paths that the picture of a ``view`` still has to take, as its check expects;
        None before it was measured.
        """
        check = self.held(view, goal)
        if check and check.ahead is not None:
            # Another thread may end the growth meanwhile: read it once.
            growth = check.growing
            growing = growth.left if growth else 0.0
            ahead = check.ahead
            # Paths of a transfer are traced here, as those of pixels are, and no worker bakes them.
            known = check.known
            if known.lit_by == "transfer":
                rungs = max(known.goal.samples - known.transferred, 0) * len(known.base.variance)
                lighter = LIGHTER * (rungs + ahead.texels)
                return PathsLeft(growing + ahead.pixels + lighter, 0.0, ahead.times, check.pace)
            return PathsLeft(growing + ahead.pixels, ahead.texels, ahead.times, check.pace)
        return None

    @staticmethod
    def foreseen(frame: Frame, goal: Goal, effort: float = 0.0) -> PathsLeft:
        """Return the paths that a ``frame`` is foreseen to take, before it was measured. Texels
        none of which has light take those of an ``effort`` (see ``foreseen_work``).
        """
        if frame.target is None or frame.quality.lacking is None:
            return PathsLeft()
        reading = frame.quality.lacking.reading
        left = foreseen_work(frame, reading, goal.error, reading.effort or effort)
        # The picture is measured on each rung, too.
        each = first_controls(goal.error)
        return left._replace(pixels=left.pixels + (left.times - FEWEST_TIMES) * each)


def doubt_of_carried(check: PictureCheck, frame: Frame) -> np.ndarray:
    """Return the uncertainty of luminance of the points of a ``frame`` with carried light, as
    light may change unevenly on the way; 0 for the others; (m,).
    """
    places = check.known.carried
    doubt = np.zeros(len(frame.gbuffer.pixels))
    luminance = frame.luminance(frame.gbuffer.pixels[places])
    # Count half of the largest error that is allowed: few points have all of it.
    doubt[places] = 0.5 * MOST_BENT * check.known.goal.error * luminance
    return doubt


def doubt_of_transfer(frame: Frame) -> np.ndarray:
    """Return the uncertainty of luminance of the points of a ``frame`` that their transfer lights,
    besides its noise; (m,). Controls are drawn by it.

    It is half of the error that the plan expects, mostly of light that is sharper than harmonics:
    less than the error itself, as the noise is to tell most of where controls are drawn. It is the
    same for all points, as nothing tells where light is that sharp.
    """
    light = frame.luminance(frame.gbuffer.pixels)
    return np.full(len(light), 0.5 * frame.quality.expected * float(light.mean()))


def goal_of_texels(goal: Goal, view: View, known: PictureState | None) -> Goal:
    """Return the goal of the texels of a ``view`` whose picture has a ``goal``. ``known`` is the
    state of the picture's check, None before it began.

    The total error of a picture with global illumination is measured, so its texels need only the
    samples that the check asks for. Other pictures, as of vicinity shading, are not measured: there
    each texel must reach the error by itself.
    """
    if view.shading != "gi":
        return Goal(goal.error)
    return Goal(goal.error, max(goal.samples, known.goal.samples if known else 0))


def may_go_without_texels(shot: Shot) -> bool:
    """Return True if paths of its pixels may light the picture of a ``shot`` in place of texels: if
    it shows one surface alone, evenly reflecting.
    """
    return shot.plain and not shot.scene.surfaces.material.refracts


def controls_of(target: float) -> float:
    """Return the number of paths of all controls of a picture with this ``target``, if it misses
    it.
    """
    return 2.0 * paths_for(target) * CONTROLS_IF_MISSED


def known_error(frame: Frame, effort: float) -> float:
    """Return the relative error of a ``frame`` as far as it is known: the upper end of its interval
    if it was measured, the likely one if it was not, and that after the first samples of its texels
    if it lacks light. For ``effort`` see ``foreseen_work``.
    """
    if frame.measured is not None:
        return frame.measured.high
    lacking = frame.quality.lacking
    if lacking is None or not frame.provisional:
        return frame.total.likely
    return math.hypot(
        noise_after(FIRST_LEVEL, lacking.reading.effort or effort), frame.quality.expected
    )


def noise_after(samples: int, effort: float) -> float:
    """Return the relative noise of pixels whose texels have ``samples`` each, filtered; a texel
    takes ``effort`` / e^RATE of them to a relative error e.
    """
    return float((effort / samples) ** (1.0 / RATE)) / FILTERED_NOISE_RATIO


FEWEST_TIMES = 2
"""Times that a picture is drawn if its texels climb no rung: to be measured, and with the light of
its pixels.
"""


def foreseen_work(frame: Frame, reading: Reading, target: float, effort: float) -> PathsLeft:
    """Predict the paths that a ``frame`` will take after the first samples of the texels of a
    ``reading``: those of the cheapest way. A texel takes ``effort`` / e^RATE samples to a relative
    error e.
    """
    points = len(frame.gbuffer.pixels)
    ways = []
    controls = controls_of(target)
    # Try all rungs: more samples of texels leave fewer pixels that need light of their own.
    for times, rung in enumerate([FIRST_LEVEL, *rungs_above(FIRST_LEVEL, target)], FEWEST_TIMES):
        error = math.hypot(noise_after(rung, effort), frame.quality.expected)
        pixels = controls + foreseen_paths(points, error, target, PIXELS * effort)
        texels = float(rung - FIRST_LEVEL) * len(reading.samples)
        ways.append(PathsLeft(pixels, texels, times))
    return min(ways, key=lambda way: way.pixels + AWAITED.path * way.texels)


def is_checked(view: View) -> bool:
    """Return True if control pixels measure the total error of a ``view``: global illumination,
    at rest.
    """
    return view.shading == "gi" and not view.moving


def check_key(view: View, target: float) -> tuple[Any, ...]:
    """Return the cache key of the check of a picture: all that it depends on."""
    return PictureCheck, surface_key(view), view.light, view.albedo, view.shine, view.glow, target
