import pytest

from tests.worker.clock import Clock
from worker.progress import KEPT, PRIOR, TimeEstimator, TimeLeft


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def estimator(clock: Clock) -> TimeEstimator:
    return TimeEstimator(clock)


def watch(estimator: TimeEstimator, clock: Clock, subject: str, work: int, pace: float) -> list[TimeLeft]:
    """What is told while ``work`` is done, each second of it in ``pace`` seconds."""
    reported = []
    for left in range(work, -1, -1):
        reported.append(estimator.estimate(subject, float(left)))
        clock.now += pace
    return reported


def test_nothing_left_takes_no_time(estimator: TimeEstimator) -> None:
    assert estimator.estimate("view", 0.0) == TimeLeft(0.0, 0.0, 0.0)


def test_the_range_is_wide_until_something_is_known(estimator: TimeEstimator) -> None:
    reported = estimator.estimate("view", 10.0)
    assert (reported.low, reported.likely, reported.high) == pytest.approx((3.5, 10.0, 32.0))
    assert min(PRIOR) * 10.0 < reported.low and reported.high < max(PRIOR) * 10.0


def test_predictions_are_corrected_by_what_came_of_earlier_ones(estimator: TimeEstimator, clock: Clock) -> None:
    first = watch(estimator, clock, "view", 40, 3.0)
    assert first[0].likely == 40.0
    assert first[-2].likely == pytest.approx(3.0)
    before = estimator.estimate("another", 10.0)
    assert before.low < before.likely == pytest.approx(30.0)
    for turn in range(KEPT):
        watch(estimator, clock, f"view {turn}", 40, 3.0)
    sure = estimator.estimate("another", 10.0)
    assert (sure.low, sure.likely, sure.high) == pytest.approx((30.0, 30.0, 30.0))


def test_the_range_holds_four_of_five_outcomes(estimator: TimeEstimator, clock: Clock) -> None:
    for turn in range(4 * KEPT):
        estimator.estimate(f"view {turn}", 10.0)
        clock.now += 10.0 + turn % 11
        estimator.estimate(f"view {turn}", 0.0)
    reported = estimator.estimate("next", 1.0)
    assert (reported.low, reported.likely, reported.high) == pytest.approx((1.05, 1.5, 1.95), abs=0.06)


def test_a_view_that_was_left_is_not_judged(estimator: TimeEstimator, clock: Clock) -> None:
    before = estimator.estimate("view", 10.0)
    estimator.estimate("another", 1.0)
    clock.now += 1000.0
    estimator.estimate("view", 1.0)
    assert estimator.estimate("view", 10.0) == before


def test_a_view_that_nobody_works_on_teaches_nothing(estimator: TimeEstimator, clock: Clock) -> None:
    before = estimator.estimate("view", 1.0)
    for _ in range(200):
        clock.now += 0.5
        assert estimator.estimate("view", 1.0) == before


def test_views_that_take_turns_are_each_judged(estimator: TimeEstimator, clock: Clock) -> None:
    before = estimator.estimate("another", 1.0)
    for left in range(20, -1, -1):
        clock.now += 6.0
        for subject in ("one", "other"):
            estimator.estimate(subject, float(left))
    assert estimator.estimate("another", 1.0).likely == pytest.approx(6.0)
    assert before.likely == 1.0


def test_what_is_overdue_is_judged_before_it_is_done(estimator: TimeEstimator, clock: Clock) -> None:
    before = estimator.estimate("view", 10.0)
    for _ in range(8):
        clock.now += max(PRIOR) / 2
        after = estimator.estimate("view", 10.0 * 0.99)
    assert after.likely / 0.99 > before.likely or after.high / 0.99 > before.high


def test_work_that_does_not_end_when_it_should_is_told_as_longer(estimator: TimeEstimator, clock: Clock) -> None:
    """Light that needs more paths than was thought: ten seconds are left, and left again, while workers work."""
    reported = []
    for second in range(60):
        reported.append(estimator.estimate("view", 10.0, worked=float(second)))
        clock.now += 1.0
    assert reported[0].likely == 10.0
    assert reported[30].likely >= 15.0, "after three times as long it is told"
    assert reported[-1].likely == pytest.approx(20.0) and reported[-1].high >= 20.0
