"""Progress of baking: counts, and the one estimator of its cost and of the time that is left."""

import math
import statistics
import time
from collections import OrderedDict, deque
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from isogi_core.bake.noise import RATE, Effort
from isogi_core.bake.precision import FIRST_LEVEL
from isogi_core.cache.costs import Costs
from isogi_core.model.scene_plan import FEWEST, most_samples
from isogi_core.prepared.prepared_scene import Index


@dataclass(frozen=True)
class Tally:
    """Counts of a baker's work.

    Chunks ``waiting`` and ``given_up``, and the ``age`` of the oldest request in seconds; tasks ``in_flight``, ``done``
    and ``failed``; done tasks whose light was there already (``duplicate``) or was damaged and is baked again
    (``healed``); the ``paths`` that were baked; the present ``workers``, and the ``deaths`` of workers.
    """

    waiting: int
    given_up: int
    age: float
    in_flight: int
    done: int
    failed: int
    duplicate: int
    healed: int
    paths: int
    workers: int
    deaths: int


# --- time left


@dataclass(frozen=True)
class TimeLeft:
    """Seconds until work is done: most likely, and the range within which four of five estimates come true."""

    low: float
    likely: float
    high: float

    @classmethod
    def of(cls, work: float, ratios: Sequence[float], rest: float = 0.0) -> "TimeLeft":
        """The time for so many seconds of ``work``, by ``ratios`` of true to estimated times, and a fixed ``rest``."""
        low, *_, high = statistics.quantiles(ratios, n=10, method="inclusive")
        return cls(low * work + rest, statistics.median(ratios) * work + rest, high * work + rest)


def log_normal_ratios(spread: float) -> tuple[float, ...]:
    """The deciles of ratios of true to estimated times whose logarithm has the standard deviation ``spread``."""
    normal = statistics.NormalDist()
    return tuple(math.exp(spread * normal.inv_cdf(p / 100)) for p in (5, *range(10, 100, 10), 95))


PRIOR = (0.25, 0.5, 1.0, 2.0, 4.0)
"""Assumed ratios of true to estimated times, besides the known ones: the range is wide at first."""

KEPT = 50
"""Known ratios that are kept; the oldest are dropped first."""

APART, SHARE = 0.5, 0.25
"""Least seconds between two estimates of one subject that are judged later, and the same as a share of their work."""

JUDGED = 0.25
"""Share of the estimated work that must be done before an estimate is judged, unless it is long overdue."""

AWAY = 60.0
"""Seconds without an estimate after which a subject is new: what happened meanwhile says nothing of work."""

SUBJECTS = 16
"""Subjects whose estimates are kept; the one not used for the longest time is dropped first."""


class Estimate(NamedTuple):
    """An estimate of so many seconds of ``work`` left, when it was made, and what had been ``worked`` by then."""

    work: float
    made: float
    worked: float = 0.0


@dataclass
class Subject:
    """The ``estimates`` of a subject that are yet to be judged, and the time of the last one."""

    asked: float
    estimates: list[Estimate] = field(default_factory=list)


class TimeEstimator:
    """Estimates the time left of subjects, such as a view and its target, and learns from how its estimates come true.

    Call under one lock from several threads.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic, prior: tuple[float, ...] = PRIOR) -> None:
        """Begin without estimates; ``prior`` are assumed ratios of true to estimated times, ascending."""
        self._clock, self._prior = clock, prior
        self._ratios: deque[float] = deque(maxlen=KEPT)
        self._subjects: OrderedDict[Hashable, Subject] = OrderedDict()

    def estimate(self, subject: Hashable, work: float, worked: float = 0.0) -> TimeLeft:
        """The time left of a ``subject`` with so many seconds of ``work``; its earlier estimates are judged by this.

        ``worked`` counts all that has been done so far, in a unit of its own: it grows while workers are at work.
        """
        now, known = self._clock(), self._subject(subject)
        self._judge(known, Estimate(work, now, worked))
        last = known.estimates[-1].made if known.estimates else -math.inf
        if work > 0.0 and now - last >= max(APART, SHARE * work):
            known.estimates.append(Estimate(work, now, worked))
        return TimeLeft.of(work, (*self._prior, *self._ratios))

    def _subject(self, name: Hashable) -> Subject:
        """The subject of this name, marked as used now; a new one where it was not used for AWAY seconds."""
        now, known = self._clock(), self._subjects.pop(name, None)
        subject = known if known is not None and now - known.asked <= AWAY else Subject(now)
        subject.asked = now
        self._subjects[name] = subject
        if len(self._subjects) > SUBJECTS:
            self._subjects.popitem(last=False)
        return subject

    def _judge(self, subject: Subject, now: Estimate) -> None:
        """Note the time that estimates took per second of their work, of which at least JUDGED counts as done.

        Where workers were at work for as long as an estimate said, and less of it was done, it takes as long as that
        and what is estimated ``now``. Where nothing was worked, that says nothing of the time that work takes.
        """
        for each in tuple(subject.estimates):
            elapsed, done = now.made - each.made, each.work - now.work
            overdue = done > 0.0 and elapsed >= self._prior[-1] * each.work
            if elapsed > 0.0 and (done >= JUDGED * each.work or overdue):
                self._ratios.append(elapsed / max(done, JUDGED * each.work))
            elif now.worked > each.worked and elapsed >= each.work:
                self._ratios.append((elapsed + now.work) / each.work)
            else:
                continue
            subject.estimates.remove(each)


# --- cost of open requests, by measured costs


class Work(NamedTuple):
    """Work at a ``chunk``: the ``effort`` that its texels want to come to the relative error ``target``."""

    chunk: Index
    effort: Effort
    target: float


def work_seconds(work: Sequence[Work], costs: Costs) -> list[float] | None:
    """Processor seconds that each piece of ``work`` will take, by the measured ``costs`` of a bake; None if unknown.

    What is at hand comes first, what has the same target goes with it. A texel without light is assumed to need as many
    paths as others of the bake did, or will, or as many more as its own target is stricter. Those may have been lit
    elsewhere, or for another target, so the paths are bounded by what its own target allows.
    """
    total, left = costs.total, sum(each.effort.left for each in work if each.target == work[0].target)
    rates = [costs.rate(each.chunk) for each in work]
    if None in rates or (not total.texels and any(each.effort.unlit for each in work)):
        return None
    texels = max(total.texels, 1)
    usual, first = (total.paths + left) / texels, total.first / texels

    def _paths(each: Work) -> float:
        stricter = (work[0].target / each.target) ** RATE
        return each.effort.left + paths_after_first(stricter * usual, each.target) * each.effort.unlit

    return [
        rate * _paths(each) + first * each.effort.unlit
        for rate, each in zip(rates, work, strict=True)
        if rate is not None
    ]


def paths_after_first(usual: float, target: float) -> float:
    """Paths after its first light of a texel without light, where others take ``usual`` paths."""
    return min(max(usual, FEWEST), most_samples(target)) - FIRST_LEVEL


# --- cost of a whole bake, by a rehearsal


@dataclass(frozen=True)
class ChunkCost:
    """The measured cost of a chunk's ``texels``: ``seconds`` of a worker, ``processor`` seconds, and ``tasks``.

    ``seconds`` include the time in which others had the worker's core. ``maps`` are seconds that a process spends once,
    ``stored`` the bytes of the chunk's objects.
    """

    texels: int
    seconds: float
    processor: float
    tasks: float
    maps: float
    stored: int


PER_TASK = 0.008
"""Processor seconds of a worker that a task takes beside its paths."""

UNKNOWN = 0.2
"""Spread of true over estimated times that no rehearsal shows, relative (measured by ``benchmarks.prewarm``)."""


@dataclass(frozen=True)
class CostEstimate:
    """The estimated cost of a bake: ``seconds`` of all workers by the clock, and ``processor`` seconds of its paths.

    ``unsure`` is the relative standard error of these. ``maps`` are seconds that each worker spends once, and
    ``stored`` the bytes of the objects.
    """

    seconds: float = 0.0
    processor: float = 0.0
    unsure: float = 0.0
    maps: float = 0.0
    stored: int = 0

    def time_left(self, workers: int, around: float) -> TimeLeft:
        """The time of the whole bake with so many ``workers``, and of the seconds spent ``around`` it."""
        ratios = log_normal_ratios(math.hypot(self.unsure, UNKNOWN))
        return TimeLeft.of(self.seconds / workers, ratios, around + self.maps)


def extrapolated(measured: Sequence[ChunkCost], texels: int, whole: bool, per_task: float) -> CostEstimate:
    """The cost of so many ``texels`` by chunks that were ``measured``, which are the ``whole`` or a sample of it.

    Chunks were sampled in proportion to their texels, so the mean of the seconds per texel of each is that of all.
    """
    if not measured:
        return CostEstimate()
    known, each = sum(one.texels for one in measured), seconds_per_texel(measured, per_task)
    seconds = sum(one.texels * rate for one, rate in zip(measured, each, strict=True))
    total = seconds if whole else float(each.mean()) * texels
    return CostEstimate(
        seconds=total,
        processor=total / seconds * sum(one.processor for one in measured),
        unsure=0.0 if whole else relative_standard_error(each),
        maps=sum(one.maps for one in measured),
        stored=round(sum(one.stored for one in measured) / known * texels),
    )


def seconds_per_texel(measured: Sequence[ChunkCost], per_task: float = PER_TASK) -> np.ndarray:
    """Seconds of a worker for a texel of each chunk, (chunks,) float64; tasks are slowed down as much as paths are."""
    slow = sum(one.seconds for one in measured) / max(sum(one.processor for one in measured), 1e-9)
    return np.array([(one.seconds + max(slow, 1.0) * per_task * one.tasks) / one.texels for one in measured])


def relative_standard_error(values: np.ndarray) -> float:
    """The standard error of the mean of ``values`` (n,), over the mean; 1 for a single value, which shows none."""
    return float(values.std(ddof=1) / values.mean() / math.sqrt(len(values))) if len(values) > 1 else 1.0
