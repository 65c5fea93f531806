"""The time that a picture takes after its texels' present samples: further ones, paths of pixels, and drawing it."""

import threading
from collections import OrderedDict
from collections.abc import Hashable, Mapping

from isogi_core.cache.costs import Cost
from isogi_core.frame.rays.picture_plan import HEAVIER
from isogi_core.frame.view_checks import PathsLeft
from worker.progress import ASSUMED_WORK_RATIOS, UNREHEARSED_SPREAD, TimeLeft, log_normal_ratios

WAITING_STAGES = ("queue", "bake", "check", "demand")
"""Stages of a frame in which it is not drawn."""


def time_of_paths(left: PathsLeft, spent: Cost, threads: int, drawing: Mapping[str, float]) -> TimeLeft:
    """The time for the paths that are ``left``, on so many ``threads``, and for ``drawing`` by its stages' seconds.

    Before the first path of a pixel one takes a share of a texel's, for all of which so much was ``spent``.
    """
    each = spent.seconds / max(spent.paths, 1) / threads
    once = sum(seconds for stage, seconds in drawing.items() if stage not in WAITING_STAGES)
    work = left.texels * each + left.pixels * (left.pace or each / HEAVIER) + left.times * once
    return TimeLeft.of(work, ASSUMED_WORK_RATIOS if left.pace is None else log_normal_ratios(UNREHEARSED_SPREAD))


MAX_TIME_LEFT_RATIO = 1.1
"""How many times as long as before the time left of a picture may become from one answer to the next."""

MAX_KEPT_PICTURES = 256
"""Pictures whose last answers are kept."""


class Promises:
    """The times left that were reported of pictures: no time leaps up before those that wait. Any thread may use it."""

    def __init__(self) -> None:
        """None reported yet."""
        self._told: OrderedDict[Hashable, TimeLeft] = OrderedDict()
        self._lock = threading.Lock()

    def kept(self, picture: Hashable, left: TimeLeft) -> TimeLeft:
        """The time to report of a ``picture`` with an estimate of what is ``left``: at most MAX_TIME_LEFT_RATIO times
        the last one.
        """
        with self._lock:
            before = self._told.pop(picture, None)
            if before is not None and left.likely > MAX_TIME_LEFT_RATIO * before.likely > 0.0:
                left = left.times(MAX_TIME_LEFT_RATIO * before.likely / left.likely)
            self._told[picture] = left
            if len(self._told) > MAX_KEPT_PICTURES:
                self._told.popitem(last=False)
            return left
