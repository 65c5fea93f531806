"""Progress of baking: counts, and the one estimator of its cost and of the time that is left."""

import math
import statistics
import threading
import time
from collections import OrderedDict, deque
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from isogi_core.bake.noise import RATE, Effort
from isogi_core.bake.texel_light import FIRST_LEVEL
from isogi_core.cache.costs import Costs
from isogi_core.model.scene_plan import MAX_SAMPLES, MIN_SAMPLES, most_samples
from isogi_core.prepared.prepared_scene import Index


@dataclass(frozen=True)
class Tally:
    """Counts of a baker's work.

    Chunks ``waiting`` and ``given_up``, and the ``age`` of the oldest request in seconds; tasks
    ``in_flight`` and ``done``, each of one or more chunks; ``chunks`` that were baked in them, and
    that ``failed``; of these, chunks whose light was there already (``duplicate``) or was damaged
    and is baked again (``healed``); the ``paths`` that were baked; the present
    ``workers``, and the ``deaths`` of workers; texels that ``kept`` the light of a whole volume
    where that is cut.
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
    kept: int = 0
    chunks: int = 0


# --- time left


LEAST_SECONDS = 1.0
"""Seconds that a time left stands for at least: people are shown no less."""


@dataclass(frozen=True)
class TimeLeft:
    """Seconds until work is done: most likely, and the range within which four of five estimates
    come true. It is ``overdue`` once the work takes longer than was said before.
    """

    low: float
    likely: float
    high: float
    overdue: bool = False

    @classmethod
    def of(cls, work: float, ratios: Sequence[float], rest: float = 0.0) -> "TimeLeft":
        """The time for so many seconds of ``work``, by ``ratios`` of true to estimated times, and a
        fixed ``rest``.
        """
        low, *_, high = statistics.quantiles(ratios, n=10, method="inclusive")
        return cls(low * work + rest, statistics.median(ratios) * work + rest, high * work + rest)

    def plus(self, other: "TimeLeft") -> "TimeLeft":
        """The time of this and then ``other`` work."""
        return TimeLeft(self.low + other.low, self.likely + other.likely, self.high + other.high)

    def times(self, pace: float) -> "TimeLeft":
        """The time of the work where each second of it takes ``pace`` seconds."""
        return replace(self, low=pace * self.low, likely=pace * self.likely, high=pace * self.high)

    def scaled_to(self, likely: float) -> "TimeLeft":
        """The time with this ``likely`` value, its range as wide as before, relative to that."""
        if self.likely > 0.0:
            return self.times(likely / self.likely)
        return replace(self, low=likely / 2.0, likely=likely, high=2.0 * likely)

    def after(self, seconds: float, span: float | None = None) -> "TimeLeft":
        """What this says so many ``seconds`` later, if nothing else is known: less by these.

        Once they are over, or a ``span`` of seconds that is given, it is overdue, and twice as
        long; and so on.
        """
        if span is None:
            span = max(self.likely, LEAST_SECONDS)
        if seconds < span:
            return self.scaled_to(min(span - seconds, self.likely))
        while seconds >= span:
            seconds -= span
            span = 2.0 * max(span, LEAST_SECONDS)
        return replace(self.scaled_to(span - seconds), overdue=True)


def log_normal_ratios(spread: float) -> tuple[float, ...]:
    """The deciles of ratios of true to estimated times whose logarithm has the standard deviation
    ``spread``.
    """
    normal = statistics.NormalDist()
    return tuple(math.exp(spread * normal.inv_cdf(p / 100)) for p in (5, *range(10, 100, 10), 95))


ASSUMED_WORK_RATIOS = (0.25, 0.5, 1.0, 2.0, 4.0)
"""Assumed ratios of true to estimated work, besides the known ones: the range is wide at first."""

MAX_KNOWN_RATIOS = 50
"""Known ratios that are kept; the oldest are dropped first."""

MIN_JUDGING_SPACING = 0.5
MIN_JUDGING_SHARE = 0.25
"""Least seconds between two estimates of one subject that are judged later, and the same as a share
of their work.
"""

FORGET_SECONDS = 60.0
"""Seconds without an estimate after which a subject is new: what happened meanwhile says nothing of
work.
"""

MAX_SUBJECTS = 16
"""Subjects whose estimates are kept; the one not used for the longest time is dropped first."""


class Estimate(NamedTuple):
    """An estimate of so many seconds of ``work`` left, when it was made, and the seconds ``worked``
    by then.
    """

    work: float
    made: float
    worked: float


@dataclass
class Subject:
    """The ``estimates`` of a subject that are yet to be judged, and the time of the last one."""

    asked: float
    estimates: list[Estimate] = field(default_factory=list)


class TimeEstimator:
    """Estimates the time left of subjects, such as a view and its target, and learns from how its
    estimates come true.

    Call under one lock from several threads.
    """

    def __init__(
        self,
        clock: Callable[[], float] = time.monotonic,
        prior: tuple[float, ...] = ASSUMED_WORK_RATIOS,
    ) -> None:
        """Begin without estimates; ``prior`` are assumed ratios of true to estimated times,
        ascending.
        """
        self._clock = clock
        self._prior = prior
        self._ratios: deque[float] = deque(maxlen=MAX_KNOWN_RATIOS)
        self._subjects: OrderedDict[Hashable, Subject] = OrderedDict()

    def estimate(self, subject: Hashable, work: float, worked: float) -> TimeLeft:
        """The time left of a ``subject`` with so many seconds of ``work``; its earlier estimates
        are judged by this.

        ``worked`` are the seconds of work that were done so far, whosesoever.
        """
        now = self._clock()
        known = self._subject(subject)
        estimate = Estimate(work, now, worked)
        self._judge(known, estimate)
        if known.estimates:
            last = known.estimates[-1].made
        else:
            last = -math.inf
        if work > 0.0 and now - last >= max(MIN_JUDGING_SPACING, MIN_JUDGING_SHARE * work):
            known.estimates.append(estimate)
        return TimeLeft.of(work, (*self._prior, *self._ratios))

    def end(self, subject: Hashable, worked: float) -> None:
        """Judge the estimates of a ``subject`` of which nothing is left, if there are any: after so
        many seconds ``worked``.
        """
        if (known := self._subjects.pop(subject, None)) is not None:
            self._judge(known, Estimate(0.0, self._clock(), worked))

    def _subject(self, name: Hashable) -> Subject:
        """The subject of this name, marked as used now; a new one where it was not used for
        FORGET_SECONDS seconds.
        """
        now = self._clock()
        known = self._subjects.pop(name, None)
        if known is not None and now - known.asked <= FORGET_SECONDS:
            subject = known
        else:
            subject = Subject(now)
        subject.asked = now
        self._subjects[name] = subject
        if len(self._subjects) > MAX_SUBJECTS:
            self._subjects.popitem(last=False)
        return subject

    def _judge(self, subject: Subject, now: Estimate) -> None:
        """Judge estimates once as much was worked as they said, or nothing is left.

        What was worked since, and what is left ``now``, over what was estimated is noted. Where
        nothing was worked, that says nothing of the time that work takes.
        """
        for each in tuple(subject.estimates):
            worked = now.worked - each.worked
            if worked > 0.0 and (worked >= each.work or not now.work):
                self._ratios.append((worked + now.work) / each.work)
                subject.estimates.remove(each)


RAISING = 2.0
"""How many times as long as a reported time an estimate is that takes its place before it is over.
"""


class Promise:
    """The time left of one work, as it is reported: it becomes less as time passes, at least.

    An estimate that is less takes its place. One that is more does so once the reported time is
    over, or at once if it is RAISING times as long: the work is overdue then. If no estimate says
    more, the reported time doubles. Call under one lock from several threads.
    """

    def __init__(
        self, clock: Callable[[], float] = time.monotonic, forget: float = math.inf
    ) -> None:
        """Report none yet. Begin again after ``forget`` seconds without an estimate."""
        self._clock = clock
        self._forget = forget
        self._told: TimeLeft | None = None
        self._estimate = 0.0
        self._at = self._asked = clock()
        self._end = math.inf

    @property
    def now(self) -> TimeLeft | None:
        """What is reported now, without a new estimate; None before the first."""
        if self._told is None:
            return None
        return self._told.after(self._clock() - self._at, self._end - self._at)

    def kept(self, left: TimeLeft) -> TimeLeft:
        """What is reported now that this much is ``left``, by a new estimate."""
        asked = self._asked
        self._asked = self._clock()
        told = self._told
        due = self.now
        if told is None or due is None or self._asked - asked > self._forget:
            return self._report(left, left.likely, math.inf)
        # the reported time is over, or far too short: the work takes longer than expected
        if self._asked >= self._end or left.likely > max(RAISING * due.likely, told.likely):
            longer = left.scaled_to(max(left.likely, due.likely))
            return self._report(replace(longer, overdue=True), left.likely, math.inf)
        # as much less than before as the estimate is; estimates that were too short see a part of
        # the work alone, and only the clock is followed then
        if not told.overdue and self._estimate > 0.0:
            likely = told.likely * left.likely / self._estimate
            if likely < due.likely:
                return self._report(left.scaled_to(likely), left.likely, self._end)
        return due

    def _report(self, left: TimeLeft, estimate: float, latest: float) -> TimeLeft:
        """Report what is ``left``; it is over in that time, and at the ``latest`` then."""
        self._told = left
        self._estimate = estimate
        self._at = self._asked
        self._end = min(self._at + max(left.likely, LEAST_SECONDS), latest)
        return left


MAX_PROMISES = 256
"""Works whose reported times are kept: those asked for last."""


class Promises:
    """The times left that were reported of several works. Any thread may use it."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """None reported yet."""
        self._clock = clock
        self._known: OrderedDict[Hashable, Promise] = OrderedDict()
        self._lock = threading.Lock()

    def kept(self, work: Hashable, left: TimeLeft) -> TimeLeft:
        """What is reported of a ``work`` of which this much is ``left``: see ``Promise``."""
        with self._lock:
            known = self._known.pop(work, None) or Promise(self._clock, FORGET_SECONDS)
            self._known[work] = known
            if len(self._known) > MAX_PROMISES:
                self._known.popitem(last=False)
            return known.kept(left)


PACE_WINDOW_SECONDS = 20.0
"""Processor seconds of tasks that the pace is measured over; what was before counts half as
much.
"""


class Pace:
    """How many seconds a worker takes for a counted processor second of its tasks, by what they
    took lately.

    Others use its core too, and tasks are handed out, read and write. Before the first is done
    workers open what they need, which says nothing of others. Call under one lock.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        """Assume one second, until more is known."""
        self._clock = clock
        self._busy = 1.0
        self._spent = 1.0
        self._begun = False
        self._working = 0
        self._since = clock()

    @property
    def value(self) -> float:
        """Seconds of a worker for a processor second."""
        return self._busy / self._spent

    def working(self, workers: int) -> None:
        """Count so many ``workers`` as busy from now on."""
        now = self._clock()
        self._busy += self._begun * self._working * (now - self._since)
        self._working = workers
        self._since = now

    def spent(self, seconds: float) -> None:
        """Count so many processor ``seconds`` of tasks that are done."""
        if self._begun:
            self._spent += seconds
        self._begun = True
        if self._spent >= 2.0 * PACE_WINDOW_SECONDS:
            self._busy = self._busy / 2.0
            self._spent = self._spent / 2.0


# --- cost of open requests, by measured costs


class Work(NamedTuple):
    """Work at a ``chunk``: the ``effort`` that its texels want to come to the relative error
    ``target``, or to ``enough`` samples.
    """

    chunk: Index
    effort: Effort
    target: float
    enough: int = MAX_SAMPLES


def work_seconds(work: Sequence[Work], costs: Costs) -> list[float] | None:
    """Processor seconds that each piece of ``work`` will take, by the measured ``costs`` of a bake;
    None if unknown.

    What is at hand comes first, what has the same target goes with it. A texel without light needs
    what is ``expected`` of it; where that is unknown, as many paths as others of the bake did, or
    will, or as many more as its own target is stricter. Those may have been lit elsewhere, or for
    another target, so the paths are bounded by what its own allows.
    """
    total = costs.total
    left = sum(each.effort.left for each in work if each.target == work[0].target)
    rates = [costs.rate(each.chunk) for each in work]
    if None in rates or (not total.texels and any(each.effort.unlit for each in work)):
        return None
    texels = max(total.texels, 1)
    usual = (total.paths + left) / texels
    first = total.first / texels

    def _paths(each: Work) -> float:
        unlit = each.effort.unlit
        stricter = (work[0].target / each.target) ** RATE
        if unlit and each.effort.expected:
            return each.effort.left + each.effort.expected - FIRST_LEVEL * unlit
        return each.effort.left + paths_after_first(stricter * usual, each) * unlit

    return [
        rate * _paths(each) + first * each.effort.unlit
        for rate, each in zip(rates, work, strict=True)
        if rate is not None
    ]


def paths_after_first(usual: float, work: Work) -> float:
    """Paths after its first light of a texel without light, where others take ``usual`` paths."""
    return min(max(usual, MIN_SAMPLES), most_samples(work.target), work.enough) - FIRST_LEVEL


# --- cost of a whole bake, by a rehearsal


@dataclass(frozen=True)
class ChunkCost:
    """The measured cost of a chunk's ``texels``: ``seconds`` of a worker, ``processor`` seconds,
    and ``tasks``.

    ``seconds`` include the time in which others had the worker's core. ``maps`` are seconds that a
    process spends once, ``stored`` the bytes of the chunk's objects.
    """

    texels: int
    seconds: float
    processor: float
    tasks: float
    maps: float
    stored: int


PER_TASK = 0.008
"""Processor seconds of a worker that a task takes beside its paths."""

UNREHEARSED_SPREAD = math.log(2.0)
"""Spread of true over estimated times that no rehearsal shows, relative: pictures end a rung sooner
or later.
"""


@dataclass(frozen=True)
class CostEstimate:
    """The estimated cost of a bake: ``seconds`` of all workers by the clock, and ``processor``
    seconds of its paths.

    ``unsure`` is the relative standard error of these. ``maps`` are seconds that each worker spends
    once, and ``stored`` the bytes of the objects.
    """

    seconds: float = 0.0
    processor: float = 0.0
    unsure: float = 0.0
    maps: float = 0.0
    stored: int = 0

    def times(self, more: float) -> "CostEstimate":
        """The cost of so many times as many texels."""
        seconds = more * self.seconds
        processor = more * self.processor
        stored = round(more * self.stored)
        return replace(self, seconds=seconds, processor=processor, stored=stored)

    def time_left(self, workers: int, around: float) -> TimeLeft:
        """The time of the whole bake with so many ``workers``, and of the seconds spent ``around``
        it.
        """
        ratios = log_normal_ratios(math.hypot(self.unsure, UNREHEARSED_SPREAD))
        return TimeLeft.of(self.seconds / workers, ratios, around + self.maps)


def extrapolated(
    measured: Sequence[ChunkCost], texels: int, whole: bool, per_task: float
) -> CostEstimate:
    """The cost of so many ``texels`` by chunks that were ``measured``, which are the ``whole`` or a
    sample of it.

    Chunks were sampled in proportion to their texels, so the mean of the seconds per texel of each
    is that of all.
    """
    if not measured:
        return CostEstimate()
    known = sum(one.texels for one in measured)
    each = seconds_per_texel(measured, per_task)
    seconds = sum(one.texels * rate for one, rate in zip(measured, each, strict=True))
    if whole:
        total = seconds
    else:
        total = float(each.mean()) * texels
    return CostEstimate(
        seconds=total,
        processor=total / seconds * sum(one.processor for one in measured),
        unsure=0.0 if whole else relative_standard_error(each),
        maps=sum(one.maps for one in measured),
        stored=round(sum(one.stored for one in measured) / known * texels),
    )


def seconds_per_texel(measured: Sequence[ChunkCost], per_task: float = PER_TASK) -> np.ndarray:
    """Seconds of a worker for a texel of each chunk, (chunks,) float64; tasks are slowed down as
    much as paths are.
    """
    slow = sum(one.seconds for one in measured) / max(sum(one.processor for one in measured), 1e-9)
    return np.array(
        [(one.seconds + max(slow, 1.0) * per_task * one.tasks) / one.texels for one in measured]
    )


def relative_standard_error(values: np.ndarray) -> float:
    """The standard error of the mean of ``values`` (n,), over the mean; 1 for a single value, which
    shows none.
    """
    if len(values) > 1:
        return float(values.std(ddof=1) / values.mean() / math.sqrt(len(values)))
    return 1.0
