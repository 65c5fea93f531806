import numpy as np
import pytest

from isogi_core.bake.effort import Effort
from isogi_core.bake.precision import FIRST_RUNG
from isogi_core.cache.costs import Cost
from isogi_core.frame.texels import Demand
from isogi_core.model.plan import MOST
from tests.worker.clock import Clock
from worker.queue import FORGET_AFTER, LOOK, BakeQueue
from worker.tasks import BakeResult
from worker.viewers import GUEST, Viewer
from worker.wants import MOST_FAILURES, STEP, Key, next_least

UNLIT = Effort(3, 0.0, 0.0)


def left(unfinished: int, worth: float, taken: float = 48.0) -> BakeResult:
    """What a task leaves of a chunk whose texels are all lit."""
    return BakeResult(unfinished, worth, Effort(0, taken, 2.0 * taken), Cost(0.1, 48, 3, 0.1))


DONE = left(0, 0.0)


@pytest.fixture
def clock() -> Clock:
    return Clock(1000.0)


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
    viewer: Viewer = GUEST,
) -> None:
    """One view that demands chunks (x, weight)."""
    offsets, seen = np.array(texels, np.int32), np.array(texels, np.float32)
    queue.want([(key(x), Demand((0, 0, x), offsets, weight, effort, seen)) for x, weight in demands], target, viewer)


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
    want(queue, (1, 10.0), (2, 20.0), (3, 10.0), effort=Effort(0, 100.0, 0.0))
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


def test_what_was_put_off_for_a_while_comes_back_then_and_others_come_first(queue: BakeQueue, clock: Clock) -> None:
    want(queue, (1, 3.0), (2, 2.0))
    assert take(queue) == 1
    queue.put_off(key(1), 0.5)
    want(queue, (1, 9.0), (2, 2.0))
    assert [take(queue), take(queue)] == [2, None]
    assert queue.counts()[0] == 2
    clock.now += 0.5
    assert [take(queue), take(queue)] == [1, None]
    end(queue, 1, DONE)
    end(queue, 2, DONE)
    assert not queue.wants


def test_what_nobody_wants_any_more_does_not_come_back(queue: BakeQueue, clock: Clock) -> None:
    want(queue, (1, 3.0), viewer=Viewer("one", single=True))
    assert take(queue) == 1
    queue.put_off(key(1), 0.5)
    queue.leave(Viewer("one", single=True))
    clock.now += 0.5
    assert take(queue) is None and not queue.wants


def test_success_forgives_failures(queue: BakeQueue) -> None:
    want(queue, (1, 1.0))
    for _ in range(3 * MOST_FAILURES):
        assert take(queue) == 1
        assert not queue.fail(key(1), "once")
        assert take(queue) == 1
        end(queue, 1, left(1, 0.9))
    assert queue.trouble() == ""


def test_what_may_have_killed_a_worker_flies_alone_and_last(queue: BakeQueue) -> None:
    want(queue, (1, 9.0), (2, 8.0), (3, 1.0))
    assert [take(queue), take(queue)] == [1, 2]
    for x in (1, 2):
        assert not queue.fail(key(x), "its worker died", suspect=True)
    assert [take(queue), take(queue)] == [3, None]
    end(queue, 3, DONE)
    assert [take(queue), take(queue)] == [1, None]
    queue.fail(key(1), "its worker died", suspect=True)
    assert [take(queue), take(queue)] == [1, None]
    assert queue.fail(key(1), "its worker died", suspect=True)
    assert [take(queue), take(queue)] == [2, None]
    end(queue, 2, left(3, 1.0))
    want(queue, (4, 9.0))
    assert [take(queue), take(queue)] == [4, 2]


def test_what_was_given_up_is_tried_afresh_after_a_while(queue: BakeQueue, clock: Clock) -> None:
    want(queue, (1, 1.0))
    for _ in range(MOST_FAILURES):
        take(queue)
        queue.fail(key(1), "no space")
    clock.now += FORGET_AFTER
    want(queue, (1, 1.0), texels=(1, 2, 3, 4))
    assert take(queue) is None
    assert queue.trouble() == "no space"
    clock.now += LOOK
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


ANNA, BERT = Viewer("Anna", single=True), Viewer("Bert", single=True)
PREWARM = Viewer("prewarm", patient=True)


def test_a_single_viewer_wants_its_newest_view_alone(queue: BakeQueue) -> None:
    want(queue, (1, 9.0), (2, 9.0), viewer=ANNA)
    want(queue, (2, 1.0), (3, 1.0), texels=(7,), viewer=ANNA)
    assert list(queue.wants) == [key(2), key(3)]
    assert queue.wants[key(2)].offsets.tolist() == [7]


def test_who_leaves_wants_nothing_more_and_the_others_what_they_did(queue: BakeQueue) -> None:
    want(queue, (1, 9.0), (2, 9.0), texels=(1, 5), viewer=ANNA)
    want(queue, (2, 1.0), texels=(5, 8), target=0.2, viewer=BERT)
    shared = queue.wants[key(2)]
    assert (shared.offsets.tolist(), shared.target) == ([1, 5, 8], 0.1)
    queue.leave(ANNA)
    assert list(queue.wants) == [key(2)]
    assert (shared.offsets.tolist(), shared.target) == ([5, 8], 0.2)
    queue.leave(BERT)
    assert queue.wants == {}


def test_what_flies_for_who_left_ends_with_its_task(queue: BakeQueue) -> None:
    want(queue, (1, 9.0), viewer=ANNA)
    assert take(queue) == 1
    queue.leave(ANNA)
    assert queue.counts() == (0, 0, 0.0)
    assert list(queue.wants) == [key(1)]
    end(queue, 1, left(3, 0.9))
    assert queue.wants == {}


def test_a_visit_that_ends_early_leaves_what_its_client_asked_for_before(queue: BakeQueue) -> None:
    first, second = Viewer("home", 1), Viewer("home", 2)
    want(queue, (1, 1.0), (2, 1.0), viewer=first)
    want(queue, (2, 1.0), (3, 1.0), viewer=second)
    queue.leave(second)
    assert list(queue.wants) == [key(1)]


def test_viewers_take_turns_by_the_seconds_that_they_were_served(queue: BakeQueue) -> None:
    want(queue, *((x, 1.0) for x in range(10, 40)), viewer=ANNA)
    want(queue, *((x, 1000.0) for x in range(50, 99)), viewer=BERT)
    served = {"Anna": 0.0, "Bert": 0.0}
    for _ in range(30):
        taken = queue.take()
        assert taken is not None
        (client,) = taken.claims
        cost = 0.3 if client == "Bert" else 0.1
        served[str(client)] += cost
        queue.finish(taken.key, taken.offsets, taken.target, BakeResult(0, 0.0, UNLIT, Cost(cost, 48, 3, 0.1)))
    assert served["Anna"] == pytest.approx(served["Bert"], abs=0.4)


def test_who_comes_late_neither_waits_for_the_past_nor_is_paid_for_it(queue: BakeQueue) -> None:
    want(queue, *((x, 1.0) for x in range(10, 60)), viewer=ANNA)
    for _ in range(20):
        end(queue, take(queue) or 0, DONE)
    want(queue, *((x, 1.0) for x in range(60, 99)), viewer=BERT)
    turns = []
    for _ in range(10):
        x = take(queue) or 0
        turns.append("Anna" if x < 60 else "Bert")
        end(queue, x, DONE)
    assert abs(turns.count("Anna") - turns.count("Bert")) <= 2
    assert "Bert" in turns[:2]


def test_a_chunk_that_two_see_counts_for_both(queue: BakeQueue) -> None:
    want(queue, (1, 10.0), (2, 8.0), viewer=ANNA)
    want(queue, (2, 8.0), viewer=BERT)
    assert [take(queue) for _ in range(2)] == [2, 1]
    assert queue.shares.served["Anna"] > queue.shares.served["Bert"]


def test_of_equals_the_nearest_to_final_comes_first(queue: BakeQueue) -> None:
    far, near = Effort(0, 48.0, 900.0), Effort(0, 48.0, 100.0)
    texels, seen = np.array([1, 2, 3], np.int32), np.ones(3, np.float32)
    both = [(key(x), Demand((0, 0, x), texels, 1.0, effort, seen)) for x, effort in ((1, far), (2, near))]
    queue.want(both, 0.1)
    assert [take(queue) for _ in range(2)] == [2, 1]


def test_who_is_patient_yields_to_people(queue: BakeQueue) -> None:
    want(queue, (1, 1000.0), (2, 1000.0), viewer=PREWARM)
    want(queue, (3, 1.0), viewer=ANNA)
    want(queue, (2, 1.0), viewer=BERT)
    assert sorted(take(queue) or 0 for _ in range(2)) == [2, 3]
    assert take(queue) == 1


def test_what_was_given_up_is_not_tried_afresh_by_who_comes_and_goes(queue: BakeQueue) -> None:
    for visit in range(MOST_FAILURES):
        want(queue, (1, 1.0), viewer=ANNA)
        assert take(queue) == 1
        queue.fail(key(1), f"failure {visit}")
    queue.leave(ANNA)
    want(queue, (1, 1.0), viewer=BERT)
    assert take(queue) is None
    assert queue.trouble() == "failure 2"


@pytest.mark.parametrize(("left", "people", "patient"), [(900.0, 0.0, 0.0), (4e3, 0.25, 0.0), (6e3, 0.25, 0.25)])
def test_the_rest_of_a_chunk_is_one_task_where_that_is_short_and_shorter_for_people(
    left: float, people: float, patient: float
) -> None:
    result = BakeResult(3, 2.0, Effort(0, 64.0, left), Cost(0.01, 100, 0, 0.0))
    assert (next_least(result, False), next_least(result, True)) == (people, patient)
