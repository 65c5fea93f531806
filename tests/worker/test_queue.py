from dataclasses import replace

import numpy as np
import pytest

from isogi_core.bake.effort import Effort
from isogi_core.bake.precision import FIRST_RUNG
from isogi_core.cache.costs import Cost
from isogi_core.frame.texels import Demand
from isogi_core.model.plan import MOST
from worker.queue import FORGET_AFTER, MOST_FAILURES, STEP, BakeQueue, Key
from worker.tasks import BakeResult

UNLIT = Effort(3, 0.0, 0.0)


def left(unfinished: int, worth: float, taken: float = 48.0) -> BakeResult:
    """What a task leaves of a chunk whose texels are all lit."""
    return BakeResult(unfinished, worth, Effort(0, taken, taken), Cost(0.1, 48, 3, 0.1))


DONE = left(0, 0.0)


class Clock:
    """Seconds that pass when the test says so."""

    def __init__(self) -> None:
        self.now = 1000.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def queue(clock: Clock) -> BakeQueue:
    return BakeQueue(clock)


def key(x: int) -> Key:
    return "scene", (0, 0, x)


def want(
    queue: BakeQueue,
    *demands: tuple[int, float],
    texels: tuple[int, ...] = (1, 2, 3),
    target: float = 0.1,
    effort: Effort = UNLIT,
) -> None:
    """One view that demands chunks (x, weight)."""
    offsets, seen = np.array(texels, np.int32), np.array(texels, np.float32)
    queue.want([(key(x), Demand((0, 0, x), offsets, weight, effort, seen)) for x, weight in demands], target)


def take(queue: BakeQueue) -> int | None:
    """The x of the chunk that is next."""
    taken = queue.take()
    return None if taken is None else taken.key[1][2]


def end(queue: BakeQueue, x: int, result: BakeResult) -> None:
    """End the task of a chunk that was just taken, for all that was wanted of it."""
    taken = queue.wants[key(x)]
    queue.finish(key(x), taken.offsets, taken.target, result)


def test_nothing_wanted_nothing_taken(queue: BakeQueue) -> None:
    assert queue.take() is None


def test_the_chunk_that_looks_most_wrong_comes_first(queue: BakeQueue) -> None:
    want(queue, (1, 5.0), (2, 50.0), (3, 20.0))
    assert [take(queue) for _ in range(4)] == [2, 3, 1, None]


def test_the_newest_view_comes_first(queue: BakeQueue) -> None:
    want(queue, (1, 500.0), (2, 400.0))
    want(queue, (3, 1.0), (4, 2.0))
    assert [take(queue) for _ in range(4)] == [4, 3, 1, 2]


def test_a_chunk_asked_for_again_belongs_to_the_newest_view(queue: BakeQueue) -> None:
    want(queue, (1, 500.0), (2, 400.0))
    want(queue, (2, 1.0))
    assert [take(queue) for _ in range(2)] == [2, 1]


def test_what_has_no_light_comes_first(queue: BakeQueue) -> None:
    want(queue, (1, 500.0), (2, 1.0))
    assert take(queue) == 1
    end(queue, 1, left(3, 0.9))
    assert [take(queue) for _ in range(2)] == [2, 1]


def test_a_second_is_spent_where_it_takes_most_error_off(clock: Clock) -> None:
    seconds = {key(1): 1.0, key(2): 1.0, key(3): 4.0}
    queue = BakeQueue(clock, rate=seconds.get)
    want(queue, (1, 10.0), effort=Effort(0, 100.0, 0.0))
    want(queue, (1, 10.0), (3, 10.0), effort=Effort(0, 100.0, 0.0))
    queue.wants[key(2)] = replace(queue.wants[key(1)], key=key(2), worth=0.2)
    assert [take(queue) for _ in range(3)] == [2, 1, 3]


def test_what_has_calmed_down_waits_for_what_has_not(queue: BakeQueue) -> None:
    want(queue, (1, 10.0), (2, 9.0), effort=Effort(0, 48.0, 0.0))
    assert take(queue) == 1
    end(queue, 1, left(3, 0.18))
    assert [take(queue) for _ in range(2)] == [2, 1]


def test_each_step_goes_to_paths_of_less_worth_until_the_chunk_is_final(queue: BakeQueue) -> None:
    want(queue, (1, 1.0), target=0.1)
    steps = []
    for worth in (0.8, 0.08, 0.0):
        taken = queue.take()
        assert taken is not None
        steps.append((taken.until, taken.least))
        end(queue, 1, left(2, worth))
    assert steps == [(FIRST_RUNG, None), (MOST, STEP * 0.8), (MOST, STEP * 0.08)]
    assert queue.wants[key(1)].least == 0.0
    assert take(queue) == 1
    end(queue, 1, DONE)
    assert queue.take() is None
    assert queue.open([key(1)]) == []


def test_what_flies_is_not_taken_twice(queue: BakeQueue) -> None:
    want(queue, (1, 1.0))
    assert take(queue) == 1
    want(queue, (1, 1.0))
    assert take(queue) is None
    assert len(queue.open([key(1), key(2)])) == 1


def test_texels_and_targets_of_several_views_are_merged(queue: BakeQueue) -> None:
    want(queue, (1, 1.0), texels=(5, 9), target=0.1)
    want(queue, (1, 7.0), texels=(2, 9, 11), target=0.3)
    want(queue, (1, 3.0), texels=(2,), target=0.05)
    taken = queue.take()
    assert taken is not None
    assert taken.offsets.tolist() == [2, 5, 9, 11]
    assert taken.footprints.tolist() == [2.0, 5.0, 9.0, 11.0]
    assert (taken.target, taken.worth) == (0.05, 3.0 / (3 * FIRST_RUNG))


def test_new_texels_start_from_the_first_rung(queue: BakeQueue) -> None:
    want(queue, (1, 1.0), texels=(1, 2))
    take(queue)
    end(queue, 1, left(1, 0.6))
    want(queue, (1, 1.0), texels=(1,))
    assert queue.wants[key(1)].least == STEP * 0.6
    want(queue, (1, 1.0), texels=(1, 3))
    assert queue.wants[key(1)].least is None


def test_a_stricter_target_starts_from_the_first_rung(queue: BakeQueue) -> None:
    want(queue, (1, 1.0), target=0.1)
    take(queue)
    end(queue, 1, left(1, 0.6))
    want(queue, (1, 1.0), target=0.01)
    assert queue.wants[key(1)].least is None


@pytest.mark.parametrize(("texels", "target"), [((1, 2, 3, 4), 0.1), ((7,), 0.1), ((1, 2, 3), 0.01)])
def test_what_grew_while_flying_stays_wanted(queue: BakeQueue, texels: tuple[int, ...], target: float) -> None:
    want(queue, (1, 1.0))
    flown = queue.take()
    assert flown is not None
    offsets, former = flown.offsets, flown.target
    want(queue, (1, 50.0), (2, 20.0), texels=texels, target=target)
    queue.finish(key(1), offsets, former, DONE)
    again = queue.take()
    assert again is not None and again.key == key(1)
    assert set(again.offsets.tolist()) == {1, 2, 3, *texels}
    assert again.target == min(0.1, target)
    assert again.least is None


def test_what_did_not_grow_while_flying_is_done(queue: BakeQueue) -> None:
    want(queue, (1, 1.0))
    take(queue)
    want(queue, (1, 1.0), texels=(2,), target=0.5)
    queue.finish(key(1), np.array([1, 2, 3], np.int32), 0.1, DONE)
    assert queue.open([key(1)]) == []


def test_failures_are_tried_again_and_then_given_up(queue: BakeQueue) -> None:
    want(queue, (1, 9.0), (2, 1.0))
    for failure in range(1, MOST_FAILURES + 1):
        assert take(queue) == 1
        assert len(queue.open([key(1)])) == 1
        assert queue.fail(key(1), f"failure {failure}") == (failure == MOST_FAILURES)
    assert MOST_FAILURES == 3
    assert queue.open([key(1)]) == []
    assert queue.trouble() == "failure 3"
    assert [take(queue) for _ in range(2)] == [2, None]


def test_success_forgives_failures(queue: BakeQueue) -> None:
    want(queue, (1, 1.0))
    for _ in range(3 * MOST_FAILURES):
        assert take(queue) == 1
        assert not queue.fail(key(1), "once")
        assert take(queue) == 1
        end(queue, 1, left(1, 0.9))
    assert queue.trouble() == ""


def test_what_was_given_up_is_tried_afresh_after_a_while(queue: BakeQueue, clock: Clock) -> None:
    want(queue, (1, 1.0))
    for _ in range(MOST_FAILURES):
        take(queue)
        queue.fail(key(1), "no space")
    clock.now += FORGET_AFTER
    want(queue, (1, 1.0), texels=(1, 2, 3, 4))
    assert take(queue) is None
    assert queue.trouble() == "no space"
    clock.now += 0.1
    assert queue.trouble() == ""
    want(queue, (1, 1.0))
    assert take(queue) == 1


def test_light_that_nobody_asks_for_any_more_is_forgotten(queue: BakeQueue, clock: Clock) -> None:
    want(queue, (1, 1.0), (2, 1.0))
    clock.now += FORGET_AFTER / 2
    want(queue, (2, 1.0))
    clock.now += FORGET_AFTER / 2
    assert len(queue.open([key(1), key(2)])) == 2
    clock.now += 0.1
    assert [take(queue) for _ in range(2)] == [2, None]
    assert queue.open([key(1)]) == []


def test_light_is_not_forgotten_while_somebody_waits_for_it(queue: BakeQueue, clock: Clock) -> None:
    want(queue, (1, 1.0), (2, 1.0))
    clock.now += FORGET_AFTER
    queue.renew([key(2), key(3)])
    clock.now += 0.1
    assert [take(queue) for _ in range(2)] == [2, None]


def test_what_flies_is_not_forgotten(queue: BakeQueue, clock: Clock) -> None:
    want(queue, (1, 1.0))
    assert take(queue) == 1
    clock.now += 10 * FORGET_AFTER
    assert take(queue) is None
    end(queue, 1, left(1, 0.9))
    assert take(queue) is None
    assert queue.open([key(1)]) == []
