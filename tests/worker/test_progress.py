import random
from collections.abc import Callable
from itertools import groupby

import pytest

from isogi_worker.progress import Pace, Promise, Promises, TimeEstimator, TimeLeft
from tests.worker.clock import Clock

MANY = 100
"""Outcomes after which the range shows them alone, and no earlier ones."""


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def estimator(clock: Clock) -> TimeEstimator:
    return TimeEstimator(clock)


def watch(
    estimator: TimeEstimator, clock: Clock, subject: str, work: int, truth: float
) -> TimeLeft:
    """What is first told of ``work`` that takes ``truth`` times as long as it was estimated to."""
    first = estimator.estimate(subject, float(work), clock.now)
    clock.now += truth * work
    estimator.estimate(subject, 0.0, clock.now)
    return first


def test_nothing_left_takes_no_time(estimator: TimeEstimator) -> None:
    assert estimator.estimate("view", 0.0, 5.0) == TimeLeft(0.0, 0.0, 0.0)


def test_the_range_is_wide_until_something_is_known(estimator: TimeEstimator) -> None:
    reported = estimator.estimate("view", 10.0, 0.0)
    assert reported.likely == 10.0
    assert 2.5 <= reported.low <= 5.0 and 20.0 <= reported.high <= 40.0


def test_predictions_are_corrected_by_what_came_of_earlier_ones(
    estimator: TimeEstimator, clock: Clock
) -> None:
    assert watch(estimator, clock, "view", 10, 3.0).likely == 10.0
    for turn in range(10):
        watch(estimator, clock, f"view {turn}", 10, 3.0)
    before = estimator.estimate("another", 10.0, clock.now)
    assert before.low < before.likely == pytest.approx(30.0)
    for turn in range(MANY):
        watch(estimator, clock, f"view {turn}", 10, 3.0)
    sure = estimator.estimate("another", 10.0, clock.now)
    assert (sure.low, sure.likely, sure.high) == pytest.approx((30.0, 30.0, 30.0), rel=0.05)
    for turn in range(MANY):
        watch(estimator, clock, f"view {turn}", 10, 1.0)
    again = estimator.estimate("another", 10.0, clock.now)
    assert (again.low, again.likely, again.high) == pytest.approx((10.0, 10.0, 10.0), rel=0.05)


def test_the_range_holds_four_of_five_outcomes(estimator: TimeEstimator, clock: Clock) -> None:
    for turn in range(2 * MANY):
        watch(estimator, clock, f"view {turn}", 10, 1.0 + turn % 11 / 10.0)
    reported = estimator.estimate("next", 1.0, clock.now)
    assert (reported.low, reported.likely, reported.high) == pytest.approx(
        (1.05, 1.5, 1.95), abs=0.06
    )


def test_a_view_that_was_left_is_not_judged(estimator: TimeEstimator, clock: Clock) -> None:
    before = estimator.estimate("view", 10.0, clock.now)
    clock.now += 1000.0
    estimator.estimate("view", 1.0, clock.now)
    assert estimator.estimate("view", 10.0, clock.now) == before


def test_a_view_that_nobody_works_on_teaches_nothing(
    estimator: TimeEstimator, clock: Clock
) -> None:
    before = estimator.estimate("view", 1.0, worked=7.0)
    for _ in range(200):
        clock.now += 0.5
        assert estimator.estimate("view", 1.0, worked=7.0) == before


def test_work_for_others_counts_for_views_that_take_turns(
    estimator: TimeEstimator, clock: Clock
) -> None:
    """Each second of work is for one of two: in the end twice as much was done as was estimated."""
    for turn in range(MANY):
        for worked, left in ((0.0, 1.0), (1.0, 0.5), (2.0, 0.0)):
            for subject in ("one", "other"):
                estimator.estimate(subject, left, 2.0 * turn + worked)
            clock.now += 1.0
    assert 1.4 < estimator.estimate("another", 1.0, 0.0).likely <= 2.0


def test_work_that_does_not_end_when_it_should_is_told_as_longer(
    estimator: TimeEstimator, clock: Clock
) -> None:
    """Light that needs more paths than was thought: ten seconds are left, and left again, while
    workers work.
    """
    reported = []
    for second in range(60):
        reported.append(estimator.estimate("view", 10.0, worked=float(second)))
        clock.now += 1.0
    assert reported[0].likely == 10.0
    assert reported[30].likely >= 15.0, "after three times as long it is told"
    assert reported[-1].likely == pytest.approx(20.0) and reported[-1].high >= 20.0


def test_less_work_than_was_thought_is_told_as_less(estimator: TimeEstimator, clock: Clock) -> None:
    """What is found to be less, without work, says that estimates are high, once some was
    worked.
    """
    for turn in range(MANY):
        estimator.estimate(f"view {turn}", 10.0, 5.0 * turn)
        estimator.estimate(f"view {turn}", 4.0, 5.0 * turn + 1.0)
        estimator.estimate(f"view {turn}", 0.0, 5.0 * turn + 5.0)
    assert estimator.estimate("next", 1.0, 0.0).likely == pytest.approx(0.5)


def test_each_second_takes_as_long_as_workers_lately_took(clock: Clock) -> None:
    pace = Pace(clock)
    pace.working(2)
    clock.now += 100.0
    pace.working(2)
    pace.spent(1.0)
    assert pace.value == 1.0, "workers opened what they need"
    for seconds in (3.0, 1.5):
        for _ in range(160):
            clock.now += seconds / 2
            pace.working(2)
            pace.spent(1.0)
        assert pace.value == pytest.approx(seconds, rel=0.05)
    pace.working(0)
    clock.now += 1000.0
    pace.working(2)
    assert pace.value == pytest.approx(1.5, rel=0.05), "nothing was asked for"
    assert TimeLeft(1.0, 2.0, 4.0).times(1.5) == TimeLeft(1.5, 3.0, 6.0)


# --- times as they are reported


def test_a_time_passes_and_then_doubles() -> None:
    left = TimeLeft(5.0, 10.0, 20.0)
    assert left.after(4.0) == TimeLeft(3.0, 6.0, 12.0)
    assert left.after(10.0) == TimeLeft(10.0, 20.0, 40.0, overdue=True)
    assert left.after(25.0) == TimeLeft(2.5, 5.0, 10.0, overdue=True)
    assert left.after(30.0) == TimeLeft(20.0, 40.0, 80.0, overdue=True)
    nothing = TimeLeft(0.0, 0.0, 0.0)
    assert nothing.after(0.4) == nothing, "it is as good as done"
    late = nothing.after(2.5)
    assert late.overdue and late.likely > 0.0


def test_what_is_promised_follows_progress_and_the_clock(clock: Clock) -> None:
    promise = Promise(clock)
    assert promise.now is None
    assert promise.kept(TimeLeft(5.0, 10.0, 20.0)).likely == 10.0
    clock.now += 2.0
    assert promise.kept(TimeLeft(5.0, 10.0, 20.0)).likely == 8.0, "time has passed"
    assert promise.kept(TimeLeft(2.0, 4.0, 8.0)).likely == 4.0, "less is left"
    assert promise.kept(TimeLeft(3.0, 6.0, 12.0)) == TimeLeft(2.0, 4.0, 8.0), "no need to say more"
    longer = promise.kept(TimeLeft(20.0, 40.0, 80.0))
    assert longer == TimeLeft(20.0, 40.0, 80.0, overdue=True), "far more: said at once"


def test_a_promise_that_nobody_asked_for_is_made_again(clock: Clock) -> None:
    told = Promises(clock)
    told.kept("one", TimeLeft(1.0, 2.0, 4.0))
    clock.now += 100.0
    assert told.kept("one", TimeLeft(1.0, 2.0, 4.0)) == TimeLeft(1.0, 2.0, 4.0)
    for number in range(100):
        told.kept(number, TimeLeft(1.0, 2.0, 4.0))
    assert told.kept("one", TimeLeft(5.0, 9.0, 40.0)).overdue, "it is known among a hundred"
    for number in range(600):
        told.kept(number, TimeLeft(1.0, 2.0, 4.0))
    assert told.kept("one", TimeLeft(5.0, 9.0, 40.0)) == TimeLeft(5.0, 9.0, 40.0)


def test_promises_are_corrected_by_works_that_took_longer(clock: Clock) -> None:
    told = Promises(clock)
    for work in range(10):
        told.kept(work, TimeLeft(5.0, 10.0, 20.0))
        clock.now += 30.0
        told.end(work)
    assert told.kept("next", TimeLeft(5.0, 10.0, 20.0)) == TimeLeft(15.0, 30.0, 60.0)


def test_a_promise_counts_on_while_nothing_is_foreseen(clock: Clock) -> None:
    """By the clock; once it is over, it is overdue and doubles."""
    told = Promises(clock)
    assert told.now("one") is None
    told.kept("one", TimeLeft(5.0, 10.0, 20.0))
    clock.now += 4.0
    left = told.now("one")
    assert left is not None and left.likely == 6.0 and not left.overdue
    clock.now += 8.0
    left = told.now("one")
    assert left is not None and left.likely == 18.0 and left.overdue
    told.end("one")
    assert told.now("one") is None


def test_a_work_that_is_done_is_promised_again(clock: Clock) -> None:
    told = Promises(clock)
    told.kept("one", TimeLeft(1.0, 2.0, 4.0))
    told.end("one")
    assert told.kept("one", TimeLeft(5.0, 9.0, 40.0)) == TimeLeft(5.0, 9.0, 40.0)


def stuck(left: float, at: float) -> float:
    """An estimate that never changes."""
    return 2.0


def blind(left: float, at: float) -> float:
    """One that sees a tenth of the work, with noise."""
    return 0.1 * left * (1.0 + 0.3 * random.Random(at).random())


def in_phases(left: float, at: float) -> float:
    """One that sees no further than the present quarter of a minute of work."""
    return left % 15.0


@pytest.mark.parametrize("estimate", [stuck, blind, in_phases])
@pytest.mark.parametrize("whole", [7.0, 60.0, 400.0])
@pytest.mark.parametrize("asking", [0.3, 1.0, 7.0])
def test_no_number_stands_longer_than_itself(
    clock: Clock, estimate: Callable[[float, float], float], whole: float, asking: float
) -> None:
    """Once a reported time is over and the work is not, more is said, and that it is overdue."""
    promise = Promise(clock)
    told: list[tuple[float, TimeLeft]] = []
    while clock.now < whole:
        likely = estimate(whole - clock.now, clock.now)
        told.append((clock.now, promise.kept(TimeLeft(likely / 2, likely, 2 * likely))))
        clock.now += asking
    for number, (at, left) in enumerate(told):
        later = [each for then, each in told[number + 1 :] if then >= at + max(left.likely, 1.0)]
        assert all(each.overdue for each in later)
    for likely, run in groupby(told, key=lambda each: each[1].likely):
        moments = [at for at, _ in run]
        assert moments[-1] - moments[0] <= max(likely, 1.0) + asking
    wrong = [left.likely < (whole - at) / 2.0 for at, left in told]
    assert sum(wrong) <= 0.8 * len(told) + 3, "doubling comes near the truth"
