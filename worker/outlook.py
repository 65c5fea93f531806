"""The outlook: how long it takes until a view's light is final, told from what became of earlier predictions."""

import statistics
import time
from collections import deque
from collections.abc import Callable, Hashable
from dataclasses import dataclass

PRIOR = (0.25, 0.5, 1.0, 2.0, 4.0)
"""Times taken over times predicted that are assumed before any is known: the range is wide at first."""

KEPT = 50
"""Outcomes that a range is told from; the oldest are forgotten first."""

APART = 0.5
"""Seconds between two predictions of one subject that are judged later."""

JUDGED = 0.25
"""Share of the predicted work that is done when a prediction is judged; it is too once it is long overdue."""


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


class Outlook:
    """Predictions of one subject at a time, a view and its target; call under one lock from several threads."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """Know of no prediction yet."""
        self._clock = clock
        self._outcomes: deque[float] = deque(PRIOR, KEPT)
        self._subject: Hashable = None
        self._open: deque[Prediction] = deque(maxlen=4 * KEPT)

    def tell(self, subject: Hashable, work: float) -> TimeLeft:
        """The time left of a ``subject`` with so many seconds of ``work``; earlier predictions are judged by it."""
        now = self._clock()
        if subject != self._subject:
            self._subject = subject
            self._open.clear()
        self._judge(work, now)
        if work > 0.0 and (not self._open or now - self._open[-1].made >= APART):
            self._open.append(Prediction(work, now))
        low, *_, high = statistics.quantiles(self._outcomes, n=10, method="inclusive")
        return TimeLeft(low * work, statistics.median(self._outcomes) * work, high * work)

    def _judge(self, work: float, now: float) -> None:
        """Note how long predictions took per second of their work, of which JUDGED is taken to be done at least."""
        for each in tuple(self._open):
            elapsed, done = now - each.made, each.work - work
            if elapsed > 0.0 and (done >= JUDGED * each.work or elapsed >= PRIOR[-1] * each.work):
                self._outcomes.append(elapsed / max(done, JUDGED * each.work))
                self._open.remove(each)
