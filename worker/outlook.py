"""The outlook: how long it takes until a view's light is final, told from what became of earlier predictions."""

import math
import statistics
import time
from collections import OrderedDict, deque
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field

PRIOR = (0.25, 0.5, 1.0, 2.0, 4.0)
"""Times taken over times predicted that are assumed besides those known: the range is wide at first."""

KEPT = 50
"""Outcomes that a range is told from; the oldest are forgotten first."""

APART, SHARE = 0.5, 0.25
"""Seconds between two predictions of one subject that are judged later, and that as a share of their work."""

JUDGED = 0.25
"""Share of the predicted work that is done when a prediction is judged; it is too once it is long overdue."""

AWAY = 60.0
"""Seconds after which a subject that nobody asked for is new: what became of it meanwhile says nothing of work."""

SUBJECTS = 16
"""Subjects whose predictions are kept; the longest unasked are forgotten first."""


@dataclass(frozen=True)
class TimeLeft:
    """Seconds until a view is final: most likely, and the range within which four of five predictions came true."""

    low: float
    likely: float
    high: float


@dataclass(frozen=True)
class Prediction:
    """That so many seconds of ``work`` were left at a time."""

    work: float
    made: float


@dataclass
class Open:
    """The ``predictions`` of a subject that are still to be judged, and when it was last ``asked`` for."""

    asked: float
    predictions: list[Prediction] = field(default_factory=list)


class Outlook:
    """Predictions of subjects, each a view and its target; call under one lock from several threads."""

    def __init__(self, clock: Callable[[], float] = time.monotonic, prior: tuple[float, ...] = PRIOR) -> None:
        """Know of no prediction yet, and assume the times of the ``prior``, ascending."""
        self._clock, self._prior = clock, prior
        self._outcomes: deque[float] = deque(maxlen=KEPT)
        self._open: OrderedDict[Hashable, Open] = OrderedDict()

    def tell(self, subject: Hashable, work: float) -> TimeLeft:
        """The time left of a ``subject`` with so many seconds of ``work``; earlier predictions are judged by it."""
        now, own = self._clock(), self._of(subject)
        self._judge(own, work, now)
        last = own.predictions[-1].made if own.predictions else -math.inf
        if work > 0.0 and now - last >= max(APART, SHARE * work):
            own.predictions.append(Prediction(work, now))
        outcomes = (*self._prior, *self._outcomes)
        low, *_, high = statistics.quantiles(outcomes, n=10, method="inclusive")
        return TimeLeft(low * work, statistics.median(outcomes) * work, high * work)

    def _of(self, subject: Hashable) -> Open:
        """What is open of a subject, which is asked for now; nothing where it was not for a while."""
        now, known = self._clock(), self._open.pop(subject, None)
        own = known if known is not None and now - known.asked <= AWAY else Open(now)
        own.asked = now
        self._open[subject] = own
        if len(self._open) > SUBJECTS:
            self._open.popitem(last=False)
        return own

    def _judge(self, own: Open, work: float, now: float) -> None:
        """Note how long predictions took per second of their work, of which JUDGED is taken to be done at least.

        Where nothing was done nobody worked on it, which says nothing of how long work takes.
        """
        for each in tuple(own.predictions):
            elapsed, done = now - each.made, each.work - work
            overdue = done > 0.0 and elapsed >= self._prior[-1] * each.work
            if elapsed > 0.0 and (done >= JUDGED * each.work or overdue):
                self._outcomes.append(elapsed / max(done, JUDGED * each.work))
                own.predictions.remove(each)
