"""The checks of views' pictures, among what a renderer keeps: what they ask for, and how much they have left to do."""

import math
from typing import Any, NamedTuple

from isogi_core.bake.noise import RATE
from isogi_core.frame.frame import Frame
from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.rays.own_light import foreseen_paths
from isogi_core.frame.rays.picture_check import PictureCheck, PictureState
from isogi_core.frame.view_keys import check_key, is_checked
from isogi_core.lru_cache import LruCache
from isogi_core.model.view import View

SETTLED = (1.0 + 2.0 ** (-1.0 / RATE)) / 2.0
"""The noise of a picture whose texels are final, over its target: they are so at it, or at what twice the samples make
of it, or between."""


class PathsLeft(NamedTuple):
    """Paths that pixels have left to take of their own, at a ``pace`` of so many seconds each; None if unknown."""

    paths: float
    pace: float | None = None


class ViewChecks:
    """The checks of the pictures of views that are ``kept``."""

    def __init__(self, kept: LruCache[Any]) -> None:
        """Keep them there."""
        self._kept = kept

    def of(self, light: RotatedLight, gbuffer: GBuffer, target: float) -> PictureCheck:
        """What is known of the picture of a view besides its texels' light."""
        return self._kept.get(check_key(light.view, target), lambda: PictureCheck(light, gbuffer, PictureState(target)))

    def held(self, view: View, target: float) -> PictureCheck | None:
        """The same, where anything is known."""
        return self._kept.held(check_key(view, target)) if is_checked(view) else None

    def asks_finer(self, view: View, target: float) -> bool:
        """Whether the check of a view's picture found that finer texels are to be shown in its place."""
        check = self.held(view, target)
        return check is not None and check.coarse

    def decline_finer(self, view: View, target: float) -> None:
        """Have a view's picture reach its target without finer texels: there is no memory for them."""
        if (check := self.held(view, target)) is not None:
            check.decline()

    def left(self, frame: Frame, target: float) -> PathsLeft:
        """The paths that pixels of a ``frame`` have left to take of their own: as they grow, or as they are foreseen.

        Before it is measured they are by the error that is predicted, and by the paths of its texels.
        """
        check = self.held(frame.view, target)
        growth = check.growing if check else None
        if check and growth:
            return PathsLeft(growth.left, check.pace)
        begun = check is not None and check.known.attempt > 0
        if frame.target is None or frame.lacking is None or frame.finer or (begun and not frame.measured):
            return PathsLeft(0.0)
        noise = min(frame.noise, SETTLED * target) if frame.provisional else frame.noise
        error = frame.measured.likely if frame.measured else math.hypot(noise, frame.beside_noise)
        points = len(frame.gbuffer.pixels)
        return PathsLeft(foreseen_paths(points, error, target, frame.lacking.reading.effort))
