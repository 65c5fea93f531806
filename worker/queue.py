"""The queue: which chunk is baked next, and how far.

Newest view first; within a view what has no light yet, and then where a second of work takes most visible error
off the picture. Pure data: no threads, no clock of its own.
"""

import operator
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np

from isogi_core.bake.effort import Effort
from isogi_core.bake.precision import FIRST_RUNG
from isogi_core.bake.recipe import Index
from isogi_core.frame.texels import Demand, most_seen
from isogi_core.model.plan import MOST
from worker.tasks import BakeResult

Key = tuple[str, Index]
"""A chunk of a bake, by its name."""

FORGET_AFTER = 60.0
"""Seconds after which light that nobody has asked for again is no longer baked."""

MOST_FAILURES = 3
"""Tries after which a chunk whose task fails is given up, until it is forgotten."""

STEP = 1.0 / 8.0
"""What a task brings the worth of the next paths of a chunk's texels down to, as a share of their mean.

Small steps follow the error more closely, large ones waste less on tasks of few texels each: to the end of a view of
82 texels a chunk (the engine at 96 pixels a side) 1/8 took 1.35 times, and 1/32 1.25 times, what single tasks took.
"""


@dataclass(eq=False)
class Want:
    """Light that somebody waits for: texels ``offsets`` of the chunk ``key``, until ``target``.

    ``worth`` is the squared visible error that waits for it, over the paths taken, and ``effort`` what it takes, as
    far as is known; ``footprints`` say how much of each texel is seen. ``least`` is the worth that paths must have to
    be taken next, None until each texel has its first light.
    """

    key: Key
    offsets: np.ndarray
    footprints: np.ndarray
    target: float
    worth: float
    effort: Effort
    view: int
    asked: float
    least: float | None = None
    failures: int = 0
    trouble: str = ""
    flying: bool = False

    @property
    def until(self) -> int:
        """The sample count beyond which no texel is taken next."""
        return FIRST_RUNG if self.least is None else MOST

    @property
    def given_up(self) -> bool:
        """Whether its task failed so often that it is not tried again."""
        return self.failures >= MOST_FAILURES

    def grow(self, demand: Demand, target: float, view: int, now: float) -> None:
        """Take in what a newer ``view`` demands of the same chunk."""
        same = np.array_equal(demand.offsets, self.offsets)
        if target < self.target or not (same or np.isin(demand.offsets, self.offsets).all()):
            self.least = None
        offsets = self.offsets if same else np.union1d(self.offsets, demand.offsets)
        views = (self.offsets, self.footprints), (demand.offsets, demand.footprints)
        self.offsets, self.footprints = offsets, most_seen(offsets, *views)
        self.target = min(self.target, target)
        self.worth, self.effort, self.view, self.asked = worth_of(demand), demand.effort, view, now

    def descend(self, result: BakeResult, grown: bool) -> None:
        """Take in what a task left: the next one goes further down.

        What a newer view has told meanwhile of a want that has ``grown`` stands, and its new texels are lit first.
        """
        if grown:
            self.least = None
            return
        self.worth, self.effort = result.worth, result.effort
        self.least = STEP * result.worth


def worth_of(demand: Demand) -> float:
    """The squared visible error over the paths that the light is of, or those of its first.

    The squared error falls with a power of the samples: that is what the next path takes off, times that power.
    """
    return demand.weight / (demand.effort.taken + FIRST_RUNG * demand.effort.unlit or FIRST_RUNG)


@dataclass(eq=False)
class BakeQueue:
    """Wants by chunk. Call under one lock when several threads use it.

    ``shared`` says whether two bakes have a layer in common: of those, one at a time works on a chunk, for the
    one that wrote last would undo what the other has added. ``rate`` tells the seconds that a chunk's path takes.
    """

    clock: Callable[[], float]
    shared: Callable[[str, str], bool] = operator.eq
    rate: Callable[[Key], float | None] = lambda _: None
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
                seen = demand.offsets, demand.footprints
                self.wants[key] = Want(key, *seen, target, worth_of(demand), demand.effort, self.views, now)
            elif not want.given_up:
                want.grow(demand, target, self.views, now)

    def take(self) -> Want | None:
        """The next chunk to work on, marked as flying; None where there is nothing to do."""
        self._forget()
        flying = [want.key for want in self.wants.values() if want.flying]
        waiting = [want for want in self.wants.values() if not want.given_up and not self._busy(want.key, flying)]
        if not waiting:
            return None
        best = min(waiting, key=self.rank)
        best.flying = True
        return best

    def rank(self, want: Want) -> tuple[int, bool, float]:
        """Order of work; the smallest comes first."""
        return -want.view, not want.effort.unlit, -want.worth / (self.rate(want.key) or 1.0)

    def finish(self, key: Key, offsets: np.ndarray, target: float, result: BakeResult) -> None:
        """A task for ``offsets`` of a chunk is done: drop the want, or keep what is still open of it."""
        want = self.wants[key]
        want.flying, want.failures = False, 0
        grown = len(want.offsets) > len(offsets) or want.target < target
        if result.unfinished == 0 and not grown:
            del self.wants[key]
        else:
            want.descend(result, grown)

    def renew(self, keys: Iterable[Key]) -> None:
        """Say that light of ``keys`` is waited for as before."""
        for want in self.open(keys):
            want.asked = self.clock()

    def fail(self, key: Key, trouble: str) -> bool:
        """A task failed, and why: try again later, or give the chunk up. Returns whether it was given up."""
        want = self.wants[key]
        want.flying, want.trouble = False, trouble
        want.failures += 1
        return want.given_up

    def open(self, keys: Iterable[Key]) -> list[Want]:
        """What of ``keys`` is still wanted, and not given up."""
        found = (self.wants[key] for key in keys if key in self.wants)
        return [want for want in found if not want.given_up]

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
