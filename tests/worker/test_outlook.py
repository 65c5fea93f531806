import pytest

from tests.worker.clock import Clock
from worker.outlook import KEPT, PRIOR, Outlook, TimeLeft


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def outlook(clock: Clock) -> Outlook:
    return Outlook(clock)


def watch(outlook: Outlook, clock: Clock, subject: str, work: int, pace: float) -> list[TimeLeft]:
    """What is told while ``work`` is done, each second of it in ``pace`` seconds."""
    told = []
    for left in range(work, -1, -1):
        told.append(outlook.tell(subject, float(left)))
        clock.now += pace
    return told


def test_nothing_left_takes_no_time(outlook: Outlook) -> None:
    assert outlook.tell("view", 0.0) == TimeLeft(0.0, 0.0, 0.0)


def test_the_range_is_wide_until_something_is_known(outlook: Outlook) -> None:
    told = outlook.tell("view", 10.0)
    assert (told.low, told.likely, told.high) == pytest.approx((3.5, 10.0, 32.0))
    assert min(PRIOR) * 10.0 < told.low and told.high < max(PRIOR) * 10.0


def test_predictions_are_corrected_by_what_came_of_earlier_ones(outlook: Outlook, clock: Clock) -> None:
    first = watch(outlook, clock, "view", 40, 3.0)
    assert first[0].likely == 40.0
    assert first[-2].likely == pytest.approx(3.0)
    before = outlook.tell("another", 10.0)
    assert before.low < before.likely == pytest.approx(30.0)
    for turn in range(KEPT):
        watch(outlook, clock, f"view {turn}", 40, 3.0)
    sure = outlook.tell("another", 10.0)
    assert (sure.low, sure.likely, sure.high) == pytest.approx((30.0, 30.0, 30.0))


def test_the_range_holds_four_of_five_outcomes(outlook: Outlook, clock: Clock) -> None:
    for turn in range(4 * KEPT):
        outlook.tell(f"view {turn}", 10.0)
        clock.now += 10.0 + turn % 11
        outlook.tell(f"view {turn}", 0.0)
    told = outlook.tell("next", 1.0)
    assert (told.low, told.likely, told.high) == pytest.approx((1.05, 1.5, 1.95), abs=0.06)


def test_a_view_that_was_left_is_not_judged(outlook: Outlook, clock: Clock) -> None:
    before = outlook.tell("view", 10.0)
    outlook.tell("another", 1.0)
    clock.now += 1000.0
    outlook.tell("view", 1.0)
    assert outlook.tell("view", 10.0) == before


def test_a_view_that_nobody_works_on_teaches_nothing(outlook: Outlook, clock: Clock) -> None:
    before = outlook.tell("view", 1.0)
    for _ in range(200):
        clock.now += 0.5
        assert outlook.tell("view", 1.0) == before


def test_views_that_take_turns_are_each_judged(outlook: Outlook, clock: Clock) -> None:
    before = outlook.tell("another", 1.0)
    for left in range(20, -1, -1):
        clock.now += 6.0
        for subject in ("one", "other"):
            outlook.tell(subject, float(left))
    assert outlook.tell("another", 1.0).likely == pytest.approx(6.0)
    assert before.likely == 1.0


def test_what_is_overdue_is_judged_before_it_is_done(outlook: Outlook, clock: Clock) -> None:
    before = outlook.tell("view", 10.0)
    for _ in range(8):
        clock.now += max(PRIOR) / 2
        after = outlook.tell("view", 10.0 * 0.99)
    assert after.likely / 0.99 > before.likely or after.high / 0.99 > before.high
