"""Progress of baking: counts of work, and estimates of its cost and of the time left."""

import math
import statistics
import threading
import time
from collections import OrderedDict, deque
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from isogi_core.bake.noise import RATE, Effort, Goal
from isogi_core.bake.texel_light import FIRST_LEVEL
from isogi_core.cache.costs import TASK_OVERHEAD_SECONDS, Costs
from isogi_core.model.scene_plan import MIN_SAMPLES
from isogi_core.prepared.prepared_scene import Index


@dataclass(frozen=True)
class Tally:
    """Counts of a baker's work.

    - ``waiting``, ``given_up``: chunks; ``age``: seconds since the oldest request.
    - ``in_flight``, ``done``: tasks, each of one or more chunks.
    - ``chunks``, ``failed``: chunks that were baked, and whose task failed, counted each time.
    - ``duplicate``, ``healed``: of the baked ones, chunks whose light was there already, and that
      were damaged.
    - ``paths``: paths traced.
    - ``workers``, ``deaths``: workers present, and lost.
    - ``kept``: texels of cuts that kept the light of the whole volume.
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
"""Shortest time left that is shown, in seconds."""


@dataclass(frozen=True)
class TimeLeft:
    """Seconds until work is done: the most ``likely`` value, and the range from ``low`` to ``high``
    that holds four of five true times.

    It is ``overdue`` once the work takes longer than was reported before.
    """

    low: float
    likely: float
    high: float
    overdue: bool = False

    @classmethod
    def of(cls, work: float, ratios: Sequence[float], rest: float = 0.0) -> "TimeLeft":
        """Return the time for ``work`` seconds of work, from ``ratios`` of true to estimated times,
        plus a fixed ``rest``.

        The range is between the first and the last decile of the ratios.
        """
        low, *_, high = statistics.quantiles(ratios, n=10, method="inclusive")
        return cls(low * work + rest, statistics.median(ratios) * work + rest, high * work + rest)

    def plus(self, other: "TimeLeft") -> "TimeLeft":
        """Return the time of this work followed by ``other`` work."""
        return TimeLeft(self.low + other.low, self.likely + other.likely, self.high + other.high)

    def times(self, pace: float) -> "TimeLeft":
        """Return the time if each second of the work takes ``pace`` seconds."""
        return replace(self, low=pace * self.low, likely=pace * self.likely, high=pace * self.high)

    def scaled_to(self, likely: float) -> "TimeLeft":
        """Return the time with this ``likely`` value; the range stays as wide in proportion."""
        if self.likely > 0.0:
            return self.times(likely / self.likely)
        return replace(self, low=likely / 2.0, likely=likely, high=2.0 * likely)

    def after(self, seconds: float, span: float | None = None) -> "TimeLeft":
        """Return the time left after ``seconds`` have passed, if nothing else is known.

        Once these exceed ``span``, by default the likely time, the work is overdue, and the span
        doubles each time that it is over.
        """
        if span is None:
            span = max(self.likely, LEAST_SECONDS)
        if seconds < span:
            return self.scaled_to(min(span - seconds, self.likely))
        # Each span that is over is followed by one twice as long, at the end of which the work is
        # expected then.
        while seconds >= span:
            seconds -= span
            span = 2.0 * max(span, LEAST_SECONDS)
        return replace(self.scaled_to(span - seconds), overdue=True)


def log_normal_ratios(spread: float) -> tuple[float, ...]:
    """Return quantiles of log-normal ratios of true to estimated
    times whose logarithm has the standard deviation ``spread``.
    """
    normal = statistics.NormalDist()
    return tuple(math.exp(spread * normal.inv_cdf(p / 100)) for p in (5, *range(10, 100, 10), 95))


ASSUMED_WORK_RATIOS = (0.25, 0.5, 1.0, 2.0, 4.0)
"""Assumed ratios of true to estimated work,
used along with measured ones, so that the range is wide at first.
"""

MAX_KNOWN_RATIOS = 50
"""Number of measured ratios that are kept; the oldest are dropped first."""

MIN_JUDGING_SPACING = 0.5
MIN_JUDGING_SHARE = 0.25
"""Least seconds between two estimates of one subject
that are compared with true times, and the same as a share of their work.
"""

FORGET_SECONDS = 60.0
"""Seconds without an estimate after which a subject counts
as new, as other work may have been done meanwhile.
"""

MAX_SUBJECTS = 16
"""Number of subjects whose estimates are kept; the longest unused is dropped first."""


class Estimate(NamedTuple):
    """An estimate of ``work`` seconds left,
    the time it was made, and the seconds ``worked`` by then.
    """

    work: float
    made: float
    worked: float


@dataclass
class Subject:
    """The ``estimates`` of a subject that are not judged yet, and the time of the last one."""

    asked: float
    estimates: list[Estimate] = field(default_factory=list)


class TimeEstimator:
    """Estimates the time left of subjects, such as a view and its target, and learns from earlier
    estimates.

    An estimate is judged when its work is done: the ratio of true to estimated work widens or
    shifts later ranges. Several threads must use it under one lock.
    """

    def __init__(
        self,
        clock: Callable[[], float] = time.monotonic,
        prior: tuple[float, ...] = ASSUMED_WORK_RATIOS,
    ) -> None:
        """Begin without estimates.

        ``clock`` returns seconds. ``prior`` are assumed ratios of true to estimated work: two or
        more, as a range needs two. They always count along with the measured ones.
        """
        self._clock = clock
        self._prior = prior
        self._ratios: deque[float] = deque(maxlen=MAX_KNOWN_RATIOS)
        self._subjects: OrderedDict[Hashable, Subject] = OrderedDict()

    def estimate(self, subject: Hashable, work: float, worked: float) -> TimeLeft:
        """Return the time left of a ``subject`` with ``work`` seconds of work, and judge its
        earlier estimates.

        ``worked`` are the seconds of all work done so far. Work for other subjects counts, too, as
        this subject waits for it.
        """
        now = self._clock()
        known = self._subject(subject)
        estimate = Estimate(work, now, worked)
        self._judge(known, estimate)
        if known.estimates:
            last = known.estimates[-1].made
        else:
            last = -math.inf
        # Estimates that follow closely are nearly the same: keep one of them, so that it is not
        # counted many times.
        if work > 0.0 and now - last >= max(MIN_JUDGING_SPACING, MIN_JUDGING_SHARE * work):
            known.estimates.append(estimate)
        return TimeLeft.of(work, (*self._prior, *self._ratios))

    def end(self, subject: Hashable, worked: float) -> None:
        """Judge the estimates of a ``subject`` that is done,
        if there are any, after ``worked`` seconds of work.
        """
        if (known := self._subjects.pop(subject, None)) is not None:
            self._judge(known, Estimate(0.0, self._clock(), worked))

    def _subject(self, name: Hashable) -> Subject:
        """Return the subject of this name, marked as used now;
        a new one if it was not used for FORGET_SECONDS.
        """
        # Take the subject out and put it in again at the end, so that the longest unused one comes
        # first.
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
        """Judge estimates whose work was done meanwhile, or of which nothing is left.

        The true work is the work done since the estimate, plus the work that is left ``now``. If
        none was done since, nothing can be learnt.
        """
        for each in tuple(subject.estimates):
            worked = now.worked - each.worked
            if worked > 0.0 and (worked >= each.work or not now.work):
                self._ratios.append((worked + now.work) / each.work)
                subject.estimates.remove(each)


RAISING = 2.0
"""An estimate replaces a reported time early if it is this many times as long as the rest of that
time.
"""


class Promise:
    """The reported time left of one work. Reports do not jump: they fall at least as fast as the
    clock runs.

    A shorter estimate replaces the reported time. A longer one does so when the reported time is
    over, or immediately if it is more than RAISING times as long as the rest of the reported time,
    and longer than that time was when it was reported; the work is then overdue. If the reported
    time is over and no estimate is longer, it doubles. Several threads must use it under one lock.
    """

    def __init__(
        self, clock: Callable[[], float] = time.monotonic, forget: float = math.inf
    ) -> None:
        """Begin without a report.

        An estimate that comes more than ``forget`` seconds after the one before is reported as if
        it were the first. ``clock`` returns seconds.
        """
        self._clock = clock
        self._forget = forget
        # The last report, the likely seconds of the estimate that it was made from, the time it was
        # made, and the time at which it is over. The last three mean nothing before a report.
        self._told: TimeLeft | None = None
        self._estimate = 0.0
        self._at = clock()
        self._end = math.inf
        # The time of the last estimate, which need not have been reported.
        self._asked = self._at

    @property
    def now(self) -> TimeLeft | None:
        """The time left that is reported now, without a new estimate; None before the first."""
        if self._told is None:
            return None
        return self._told.after(self._clock() - self._at, self._end - self._at)

    def kept(self, left: TimeLeft) -> TimeLeft:
        """Return the time to report now, given a new estimate ``left`` of the time left.

        The first report is the estimate itself, and so is one after ``forget`` seconds without an
        estimate. For all others see ``Promise``.
        """
        asked = self._asked
        self._asked = self._clock()
        reported = self._told
        due = self.now
        if reported is None or due is None or self._asked - asked > self._forget:
            return self._report(left, left.likely, math.inf)
        # The reported time is over, or far too short: the work takes longer than expected.
        if self._asked >= self._end or left.likely > max(RAISING * due.likely, reported.likely):
            longer = left.scaled_to(max(left.likely, due.likely))
            return self._report(replace(longer, overdue=True), left.likely, math.inf)
        # Shorten the reported time in proportion to the estimates, if that is less than the clock
        # leaves of it. Not if the work is overdue: estimates that were too short saw only a part of
        # it, so follow the clock.
        if not reported.overdue and self._estimate > 0.0:
            likely = reported.likely * left.likely / self._estimate
            if likely < due.likely:
                return self._report(left.scaled_to(likely), left.likely, self._end)
        return due

    def _report(self, left: TimeLeft, estimate: float, latest: float) -> TimeLeft:
        """Report ``left`` now, by an estimate of ``estimate`` likely seconds. The reported time is
        over when it has passed, or at ``latest`` by the clock if that is earlier.
        """
        self._told = left
        self._estimate = estimate
        self._at = self._asked
        self._end = min(self._at + max(left.likely, LEAST_SECONDS), latest)
        return left


MAX_PROMISES = 256
"""Number of works whose reported times are kept: those asked for last."""


class Promises:
    """The reported times left of several works, corrected by how the estimates for earlier ones
    came true by the clock.

    This makes up for work that cannot be counted, as its steps are not known beforehand. Safe to
    use from many threads.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """Begin without reports."""
        self._clock = clock
        self._estimator = TimeEstimator(clock)
        self._known: OrderedDict[Hashable, Promise] = OrderedDict()
        self._lock = threading.Lock()

    def kept(self, work: Hashable, left: TimeLeft) -> TimeLeft:
        """Return the time to report of a ``work`` by a new estimate ``left``; see ``Promise``."""
        with self._lock:
            # Correct the likely value; the range stays as wide in proportion.
            learnt = self._estimator.estimate(work, left.likely, self._clock())
            if left.likely > 0.0:
                left = left.scaled_to(learnt.likely)
            known = self._known.pop(work, None) or Promise(self._clock, FORGET_SECONDS)
            self._known[work] = known
            if len(self._known) > MAX_PROMISES:
                self._known.popitem(last=False)
            return known.kept(left)

    def now(self, work: Hashable) -> TimeLeft | None:
        """Return the time of a ``work`` to report now, without a new estimate; None before the
        first.
        """
        with self._lock:
            known = self._known.get(work)
            return known.now if known else None

    def end(self, work: Hashable) -> None:
        """Judge the estimates of a ``work`` that is done, and forget its reported time."""
        with self._lock:
            self._estimator.end(work, self._clock())
            self._known.pop(work, None)


PACE_WINDOW_SECONDS = 20.0
"""Processor seconds of tasks over which the pace is measured; tasks before these count half."""


class Pace:
    """The ratio of worker seconds by the clock to processor seconds of tasks, as measured lately.

    It exceeds 1 as other processes use the core, and as tasks are handed out, read and written. The
    time until the first task is done is left out, as workers then open scenes. Several threads must
    use it under one lock.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        """Begin with a ratio of 1."""
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
        """Count ``workers`` as busy from now on."""
        now = self._clock()
        self._busy += self._begun * self._working * (now - self._since)
        self._working = workers
        self._since = now

    def spent(self, seconds: float) -> None:
        """Count processor ``seconds`` of tasks that are done."""
        if self._begun:
            self._spent += seconds
        self._begun = True
        # Halve both sums, so that older tasks count less and less.
        if self._spent >= 2.0 * PACE_WINDOW_SECONDS:
            self._busy = self._busy / 2.0
            self._spent = self._spent / 2.0


# --- cost of open requests, by measured costs


class Work(NamedTuple):
    """The work at a ``chunk``: the ``effort`` of its texels to reach a ``goal``."""

    chunk: Index
    effort: Effort
    goal: Goal


def work_seconds(work: Sequence[Work], costs: Costs) -> list[float] | None:
    """Return the processor seconds that each piece of ``work`` will take, by the measured ``costs``
    of a bake; None if unknown.

    The pieces of the present stage come first in ``work``; those of later stages follow, with goals
    of their own. A texel without light is taken to need its ``expected`` samples (see ``Effort``),
    a path each. If these are unknown, it is taken to need as many paths as other texels of the bake
    took or will take: more if its goal is stricter than that of the first piece, but no more than
    its goal allows.
    """
    total = costs.total
    # Of the paths left, take only those to the error of the first piece, as ``mean_paths`` is the
    # mean for that error.
    left = sum(each.effort.left for each in work if each.goal.error == work[0].goal.error)
    rates = [costs.rate(each.chunk) for each in work]
    if None in rates or (not total.texels and any(each.effort.unlit for each in work)):
        return None
    # Means of a texel of the bake: its paths, those taken and those left together, and the seconds
    # of its first light.
    texels = max(total.texels, 1)
    mean_paths = (total.paths + left) / texels
    first_seconds = total.first / texels

    def _paths(each: Work) -> float:
        """Return the paths that a piece of work will take, except those of first light, whose
        seconds are in ``first_seconds``.

        They are the ``left`` paths of texels that have light, and those that texels without light
        take after their first light.
        """
        unlit = each.effort.unlit
        # Paths grow with 1 / error^RATE, so a later stage of half the error takes 2^RATE times as
        # many.
        stricter = (work[0].goal.error / each.goal.error) ** RATE
        # Expected samples are the sum over all unlit texels of the chunk. They include first light,
        # FIRST_LEVEL paths a texel, which must not count here.
        if unlit and each.effort.expected:
            return each.effort.left + each.effort.expected - FIRST_LEVEL * unlit
        return each.effort.left + paths_after_first(stricter * mean_paths, each) * unlit

    return [
        rate * _paths(each) + first_seconds * each.effort.unlit
        for rate, each in zip(rates, work, strict=True)
        if rate is not None  # none is None here: this tells the type checker
    ]


def paths_after_first(usual: float, work: Work) -> float:
    """Return the paths that a texel without light will take after first light,
    if other texels take ``usual`` paths in all.

    It takes no fewer than the least number of samples, and no more than its goal allows.
    """
    return min(max(usual, MIN_SAMPLES), work.goal.most_samples) - FIRST_LEVEL


# --- cost of a whole bake, by a rehearsal


@dataclass(frozen=True)
class ChunkCost:
    """The measured cost of a chunk's ``texels``.

    - ``seconds``: of a worker by the clock, including time in which other processes had its core.
    - ``processor``: processor seconds.
    - ``tasks``: number of tasks.
    - ``maps``: seconds that each process spends once, on maps of active cells.
    - ``stored``: bytes of the chunk's objects.
    """

    texels: int
    seconds: float
    processor: float
    tasks: float
    maps: float
    stored: int


UNREHEARSED_SPREAD = math.log(2.0)
"""Relative spread of true over estimated times that a rehearsal does not show:
pictures end a sample level sooner or later.
"""


@dataclass(frozen=True)
class CostEstimate:
    """The estimated cost of a bake.

    - ``seconds``: of all workers together, by the clock.
    - ``processor``: processor seconds of its paths.
    - ``unsure``: relative standard error of both.
    - ``maps``: seconds that each worker spends once.
    - ``stored``: bytes of the objects.
    """

    seconds: float = 0.0
    processor: float = 0.0
    unsure: float = 0.0
    maps: float = 0.0
    stored: int = 0

    def times(self, factor: float) -> "CostEstimate":
        """Return the cost of ``factor`` times as many texels. Maps are still made once for each
        worker, and the relative error stays.
        """
        seconds = factor * self.seconds
        processor = factor * self.processor
        stored = round(factor * self.stored)
        return replace(self, seconds=seconds, processor=processor, stored=stored)

    def time_left(self, workers: int, around: float) -> TimeLeft:
        """Return the time of the whole bake with ``workers`` workers,
        plus the seconds ``around`` it.
        """
        ratios = log_normal_ratios(math.hypot(self.unsure, UNREHEARSED_SPREAD))
        return TimeLeft.of(self.seconds / workers, ratios, around + self.maps)


def extrapolated(
    measured: Sequence[ChunkCost], texels: int, whole: bool, per_task: float
) -> CostEstimate:
    """Return the cost of baking ``texels`` texels, from ``measured`` chunks, which are the
    ``whole`` or a sample of it.

    Chunks must be sampled in proportion to their texels: then the mean over chunks of seconds per
    texel is unbiased.
    """
    if not measured:
        return CostEstimate()
    known = sum(one.texels for one in measured)
    # Mean seconds per texel of the measured chunks, and from it the total.
    each = seconds_per_texel(measured, per_task)
    seconds = sum(one.texels * rate for one, rate in zip(measured, each, strict=True))
    if whole:
        total = seconds
    else:
        total = float(each.mean()) * texels
    # If all chunks were measured, nothing is unsure. A process keeps the maps of active cells, so
    # each measured chunk shows only those that the chunks before it did not need: add these up.
    return CostEstimate(
        seconds=total,
        processor=total / seconds * sum(one.processor for one in measured),
        unsure=0.0 if whole else relative_standard_error(each),
        maps=sum(one.maps for one in measured),
        stored=round(sum(one.stored for one in measured) / known * texels),
    )


def seconds_per_texel(
    measured: Sequence[ChunkCost], per_task: float = TASK_OVERHEAD_SECONDS
) -> np.ndarray:
    """Return the seconds of a worker per texel of each chunk, (chunks,) float64.

    Work per task is slowed down like paths.
    """
    slow = sum(one.seconds for one in measured) / max(sum(one.processor for one in measured), 1e-9)
    return np.array(
        [(one.seconds + max(slow, 1.0) * per_task * one.tasks) / one.texels for one in measured]
    )


def relative_standard_error(values: np.ndarray) -> float:
    """Return the standard error of the mean of ``values`` (n,),
    relative to the mean; 1 for a single value, which shows none.
    """
    if len(values) > 1:
        return float(values.std(ddof=1) / values.mean() / math.sqrt(len(values)))
    return 1.0
