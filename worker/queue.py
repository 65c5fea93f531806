"""The queue: which chunk is baked next.

Newest view first; within a view the chunks with the fewest samples, and among those the ones that
cover most of the picture, its centre counting double. Pure data: no threads, no clock of its own.
"""

import operator
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np

from isogi_core.bake.recipe import Index
from isogi_core.frame.texels import Demand
from worker.tasks import BakeResult, next_goal

Key = tuple[str, Index]
"""A chunk of a bake, by its name."""

FORGET_AFTER = 60.0
"""Seconds after which light that nobody has asked for again is no longer baked."""

MOST_FAILURES = 3
"""Tries after which a chunk whose task fails is given up, until it is forgotten."""


@dataclass(eq=False)
class Want:
    """Light that somebody waits for: texels ``offsets`` of the chunk ``key``, until ``target``."""

    key: Key
    offsets: np.ndarray
    target: float
    area: float
    view: int
    asked: float
    fewest: int = 0
    failures: int = 0
    trouble: str = ""
    flying: bool = False

    @property
    def goal(self) -> int:
        """The sample count to take the chunk to next."""
        return next_goal(self.fewest)

    @property
    def given_up(self) -> bool:
        """Whether its task failed so often that it is not tried again."""
        return self.failures >= MOST_FAILURES

    @property
    def rank(self) -> tuple[int, int, float]:
        """Order of work; the smallest comes first."""
        return -self.view, self.goal, -self.area

    def grow(self, demand: Demand, target: float, view: int, now: float) -> None:
        """Take in what a newer ``view`` demands of the same chunk."""
        if target < self.target or not np.isin(demand.offsets, self.offsets).all():
            self.fewest = 0
        self.offsets = np.union1d(self.offsets, demand.offsets)
        self.target = min(self.target, target)
        self.area, self.view, self.asked = demand.area, view, now


@dataclass(eq=False)
class BakeQueue:
    """Wants by chunk. Call under one lock when several threads use it.

    ``shared`` says whether two bakes have a layer in common: of those, one at a time works on a chunk, for the
    one that wrote last would undo what the other has added.
    """

    clock: Callable[[], float]
    shared: Callable[[str, str], bool] = operator.eq
    wants: dict[Key, Want] = field(default_factory=dict)
    views: int = 0

    def want(self, demands: Iterable[tuple[Key, Demand]], target: float) -> None:
        """Take in what the newest view demands."""
        self._forget()
        self.views += 1
        now = self.clock()
        for key, demand in demands:
            want = self.wants.get(key)
            if want is None:
                self.wants[key] = Want(key, demand.offsets, target, demand.area, self.views, now)
            elif not want.given_up:
                want.grow(demand, target, self.views, now)

    def take(self) -> Want | None:
        """The next chunk to work on, marked as flying; None where there is nothing to do."""
        self._forget()
        flying = [want.key for want in self.wants.values() if want.flying]
        waiting = [want for want in self.wants.values() if not want.given_up and not self._busy(want.key, flying)]
        if not waiting:
            return None
        best = min(waiting, key=lambda want: want.rank)
        best.flying = True
        return best

    def finish(self, key: Key, offsets: np.ndarray, target: float, result: BakeResult) -> None:
        """A task for ``offsets`` of a chunk is done: drop the want, or keep what is still open of it."""
        want = self.wants[key]
        want.flying, want.failures = False, 0
        grown = len(want.offsets) > len(offsets) or want.target < target
        if result.unfinished == 0 and not grown:
            del self.wants[key]
        else:
            want.fewest = 0 if grown else result.fewest

    def fail(self, key: Key, trouble: str) -> bool:
        """A task failed, and why: try again later, or give the chunk up. Returns whether it was given up."""
        want = self.wants[key]
        want.flying, want.trouble = False, trouble
        want.failures += 1
        return want.given_up

    def open(self, keys: Iterable[Key]) -> int:
        """How many of ``keys`` are still wanted, and not given up."""
        return sum(key in self.wants and not self.wants[key].given_up for key in keys)

    def trouble(self) -> str:
        """Why a chunk was given up, the one asked for last; empty when none is."""
        self._forget()
        given_up = [want for want in self.wants.values() if want.given_up]
        return max(given_up, key=lambda want: want.asked).trouble if given_up else ""

    def _busy(self, key: Key, flying: list[Key]) -> bool:
        """Whether a task is at the light of this chunk."""
        return any(index == key[1] and self.shared(bake, key[0]) for bake, index in flying)

    def _forget(self) -> None:
        horizon = self.clock() - FORGET_AFTER
        for key in [k for k, want in self.wants.items() if want.asked < horizon and not want.flying]:
            del self.wants[key]
