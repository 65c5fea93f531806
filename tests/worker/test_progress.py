import pytest

from tests.worker.clock import Clock
from worker.progress import (
    ASSUMED_WORK_RATIOS,
    MAX_KNOWN_RATIOS,
    PACE_WINDOW_SECONDS,
    Pace,
    TimeEstimator,
    TimeLeft,
)


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
    assert (reported.low, reported.likely, reported.high) == pytest.approx((3.5, 10.0, 32.0))
    assert (
        min(ASSUMED_WORK_RATIOS) * 10.0 < reported.low
        and reported.high < max(ASSUMED_WORK_RATIOS) * 10.0
    )


def test_predictions_are_corrected_by_what_came_of_earlier_ones(
    estimator: TimeEstimator, clock: Clock
) -> None:
    assert watch(estimator, clock, "view", 10, 3.0).likely == 10.0
    for turn in range(len(ASSUMED_WORK_RATIOS)):
        watch(estimator, clock, f"view {turn}", 10, 3.0)
    before = estimator.estimate("another", 10.0, clock.now)
    assert before.low < before.likely == pytest.approx(30.0)
    for turn in range(MAX_KNOWN_RATIOS):
        watch(estimator, clock, f"view {turn}", 10, 3.0)
    sure = estimator.estimate("another", 10.0, clock.now)
    assert (sure.low, sure.likely, sure.high) == pytest.approx((30.0, 30.0, 30.0), rel=0.05)


def test_the_range_holds_four_of_five_outcomes(estimator: TimeEstimator, clock: Clock) -> None:
    for turn in range(4 * MAX_KNOWN_RATIOS):
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
    for turn in range(MAX_KNOWN_RATIOS):
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
    for turn in range(MAX_KNOWN_RATIOS):
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
        for _ in range(int(8 * PACE_WINDOW_SECONDS)):
            clock.now += seconds / 2
            pace.working(2)
            pace.spent(1.0)
        assert pace.value == pytest.approx(seconds, rel=0.05)
    pace.working(0)
    clock.now += 1000.0
    pace.working(2)
    assert pace.value == pytest.approx(1.5, rel=0.05), "nothing was asked for"
    assert TimeLeft(1.0, 2.0, 4.0).times(1.5) == TimeLeft(1.5, 3.0, 6.0)
