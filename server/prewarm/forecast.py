"""A forecast: what baking takes, told by rehearsing a few chunks."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING

import numpy as np

from isogi_core.frame.texels import Demand
from server.prewarm.rehearsal import Rehearsal, rehearse
from server.settings import cores
from worker.outlook import TimeLeft
from worker.tasks import load_kernels

if TYPE_CHECKING:
    from isogi_core.frame.renderer import Renderer

MOST_TRIED, FEWEST_TRIED = 48, 8
"""Chunks that are rehearsed, at most, and before it may be called enough."""

SURE = 0.04
"""Standard error of the mean, over the mean, at which it is enough."""

PER_TASK, DISPATCH = 0.008, 0.006
"""Processor seconds that a task takes beside its paths: of its worker, and of who hands it out and needs a core too."""

START = 1.5
"""Seconds until workers have come, and have their kernels, beyond those in which views are looked at meanwhile."""

ELSE = 0.2
"""What else is not known, as a share: the spread of what came about what was told (``benchmarks.prewarm``)."""

FOUR_OF_FIVE = 1.28
"""Standard deviations to either side that four of five come to lie in."""


@dataclass(frozen=True)
class Forecast:
    """What baking takes: ``seconds`` of workers, all together, by the clock, and of the ``processor`` for the paths.

    ``unsure`` is the relative standard error of these; ``maps`` are seconds that each worker spends once, and so many
    bytes are ``stored``.
    """

    seconds: float = 0.0
    processor: float = 0.0
    unsure: float = 0.0
    maps: float = 0.0
    stored: int = 0

    def time_left(self, workers: int, around: float) -> TimeLeft:
        """Seconds for all of it with so many ``workers``, and those spent ``around`` the baking."""
        likely = self.seconds / workers
        spread = math.exp(FOUR_OF_FIVE * math.hypot(self.unsure, ELSE))
        rest = around + self.maps
        return TimeLeft(likely / spread + rest, likely + rest, likely * spread + rest)


def forecast(
    renderer: Renderer,
    demands: Sequence[Demand],
    target: float,
    workers: int,
    budget: float,
    cancelled: threading.Event,
) -> Forecast:
    """What the demands take to a ``target`` error, told within about ``budget`` seconds.

    As many chunks are rehearsed at once as there are workers, for these share what a core has.
    """
    if not demands:
        return Forecast()
    load_kernels({layer.kind for layer in renderer.caches.look("gi").plan.layers})
    threads, chosen = min(workers, cores()), stratified(demands)
    tried = Tried(budget, cancelled)
    with ThreadPoolExecutor(threads, "rehearsal") as pool:
        for ended in [pool.submit(tried.go_through, renderer, chosen, target) for _ in range(threads)]:
            ended.result()
    texels, per_task = sum(len(demand.offsets) for demand in demands), PER_TASK + DISPATCH * (workers >= cores())
    return extrapolated(tried.all, texels, len(tried.all) == len(demands), per_task)


class Tried:
    """Rehearsals, of as many chunks as it takes; ``budget`` seconds are for all of them."""

    def __init__(self, budget: float, cancelled: threading.Event) -> None:
        """Have tried nothing yet."""
        self.all: list[Rehearsal] = []
        self._each, self._end, self._cancelled = budget / 4.0, time.monotonic() + budget, cancelled
        self._lock = threading.Lock()

    def go_through(self, renderer: Renderer, demands: Iterator[Demand], target: float) -> None:
        """Rehearse what comes next until it is enough; several threads may."""
        while not self._enough() and (demand := self._next(demands)):
            one = rehearse(renderer, demand, target, self._each, self._cancelled)
            with self._lock:
                self.all.append(one)

    def _next(self, demands: Iterator[Demand]) -> Demand | None:
        with self._lock:
            return next(demands, None)

    def _enough(self) -> bool:
        """Whether the time is over, or the mean is known well enough."""
        with self._lock:
            known = len(self.all) >= FEWEST_TRIED and unsure(rates(self.all)) <= SURE
        return known or (bool(self.all) and time.monotonic() > self._end) or self._cancelled.is_set()


def extrapolated(tried: Sequence[Rehearsal], texels: int, whole: bool, per_task: float) -> Forecast:
    """What so many texels take by what was ``tried``, which is the ``whole`` of it, or a sample.

    Chunks came into the sample by how many texels they have: the mean of what a texel takes in each is that of all.
    """
    if not tried:
        return Forecast()
    known, each = sum(one.texels for one in tried), rates(tried, per_task)
    seconds = sum(one.texels * rate for one, rate in zip(tried, each, strict=True))
    total = seconds if whole else float(each.mean()) * texels
    return Forecast(
        seconds=total,
        processor=total / seconds * sum(one.processor for one in tried),
        unsure=0.0 if whole else unsure(each),
        maps=sum(one.maps for one in tried),
        stored=round(sum(one.stored for one in tried) / known * texels),
    )


def rates(tried: Sequence[Rehearsal], per_task: float = PER_TASK) -> np.ndarray:
    """Seconds of a worker for a texel of each chunk; (chunks,) float64. What tasks take is as slow as paths are."""
    slow = sum(one.seconds for one in tried) / max(sum(one.processor for one in tried), 1e-9)
    return np.array([(one.seconds + max(slow, 1.0) * per_task * one.tasks) / one.texels for one in tried])


def unsure(each: np.ndarray) -> float:
    """The standard error of a mean, over the mean; 1 where a single number tells nothing of it."""
    return float(each.std(ddof=1) / each.mean() / math.sqrt(len(each))) if len(each) > 1 else 1.0


def stratified(demands: Sequence[Demand]) -> Iterator[Demand]:
    """At most MOST_TRIED demands, spread evenly over all texels, so that large chunks come more often than small ones.

    All of them where they are few.
    """
    if len(demands) <= FEWEST_TRIED:
        return iter(demands)
    ordered = sorted(demands, key=lambda demand: demand.index)
    ends = np.cumsum([len(demand.offsets) for demand in ordered])
    places = (radical_inverse(n) * ends[-1] for n in range(1, 8 * MOST_TRIED))
    taken = dict.fromkeys(int(np.searchsorted(ends, place, "right")) for place in places)
    return islice((ordered[number] for number in taken), MOST_TRIED)


def radical_inverse(number: int) -> float:
    """Van der Corput's sequence to base 2: each part of it is spread evenly over [0, 1)."""
    return int(f"{number:032b}"[::-1], 2) / 2.0**32
