"""The queue: which chunk is baked next.

Newest view first; within a view the chunks with the fewest samples, and among those the ones that
cover most of the picture, its centre counting double. Pure data: no threads, no clock of its own.
"""

from collections.abc import Callable, Hashable, Iterable
from dataclasses import dataclass, field

import numpy as np

from isogi_core.frame.texels import Demand
from worker.tasks import BakeResult, next_goal

FORGET_AFTER = 60.0
"""Seconds after which light that nobody has asked for again is no longer baked."""

MOST_FAILURES = 3
"""Times that a chunk is tried again after its task failed."""


@dataclass(eq=False)
class Want:
    """Light that somebody waits for: texels ``offsets`` of the chunk ``key``, until ``target``."""

    key: Hashable
    offsets: np.ndarray
    target: float
    area: float
    view: int
    asked: float
    fewest: int = 0
    failures: int = 0
    flying: bool = False

    @property
    def goal(self) -> int:
        """The sample count to take the chunk to next."""
        return next_goal(self.fewest)

    @property
    def rank(self) -> tuple[int, int, float]:
        """Order of work; the smallest comes first."""
        return -self.view, self.goal, -self.area


@dataclass(eq=False)
class BakeQueue:
    """Wants by chunk. Call under one lock when several threads use it."""

    clock: Callable[[], float]
    wants: dict[Hashable, Want] = field(default_factory=dict)
    views: int = 0

    def want(self, demands: Iterable[tuple[Hashable, Demand]], target: float) -> None:
        """Take in what the newest view demands."""
        self.views += 1
        now = self.clock()
        for key, demand in demands:
            want = self.wants.get(key)
            if want is None:
                self.wants[key] = Want(key, demand.offsets, target, demand.area, self.views, now)
                continue
            if target < want.target or not np.isin(demand.offsets, want.offsets).all():
                want.fewest = 0
            want.offsets = np.union1d(want.offsets, demand.offsets)
            want.target = min(want.target, target)
            want.area, want.view, want.asked = demand.area, self.views, now

    def take(self) -> Want | None:
        """The next chunk to work on, marked as flying; None where there is nothing to do."""
        self._forget()
        waiting = [want for want in self.wants.values() if not want.flying]
        if not waiting:
            return None
        best = min(waiting, key=lambda want: want.rank)
        best.flying = True
        return best

    def finish(self, key: Hashable, offsets: np.ndarray, target: float, result: BakeResult) -> None:
        """A task for ``offsets`` of a chunk is done: drop the want, or keep what is still open of it."""
        want = self.wants[key]
        want.flying, want.failures = False, 0
        grown = len(want.offsets) > len(offsets) or want.target < target
        if result.unfinished == 0 and not grown:
            del self.wants[key]
        else:
            want.fewest = 0 if grown else result.fewest

    def fail(self, key: Hashable) -> bool:
        """A task failed: try again later, or give the chunk up. Returns whether it was given up."""
        want = self.wants[key]
        want.flying = False
        want.failures += 1
        if want.failures <= MOST_FAILURES:
            return False
        del self.wants[key]
        return True

    def open(self, keys: Iterable[Hashable]) -> int:
        """How many of ``keys`` are still wanted."""
        return sum(key in self.wants for key in keys)

    def _forget(self) -> None:
        horizon = self.clock() - FORGET_AFTER
        for key in [k for k, want in self.wants.items() if want.asked < horizon and not want.flying]:
            del self.wants[key]
