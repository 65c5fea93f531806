import numpy as np
import pytest

from isogi_core.bake.noise import Effort, Goal
from isogi_core.bake.texel_light import FIRST_LEVEL
from isogi_core.cache.costs import Cost
from isogi_core.frame.demand import Demand
from isogi_core.model.scene_plan import MAX_SAMPLES
from isogi_worker import bake_requests
from isogi_worker.bake_requests import GUEST_VIEWER, BakeRequest, Key, Viewer
from isogi_worker.queue import BakeQueue
from isogi_worker.tasks import BakeResult
from tests.worker.clock import Clock

GOAL = Goal(0.1)
UNLIT = Effort(3, 0.0, 0.0)

TRIES = 3
"""Tries of a chunk that fails each time (docs/faults.md)."""


def left(unfinished: int, priority: float, taken: float = 48.0) -> BakeResult:
    """What a task leaves of a chunk whose texels are all lit."""
    return BakeResult(unfinished, priority, Effort(0, taken, 2.0 * taken), Cost(0.1, 48, 3, 0.1))


DONE = left(0, 0.0)


@pytest.fixture
def clock() -> Clock:
    return Clock(1000.0)


@pytest.fixture
def queue(clock: Clock) -> BakeQueue:
    return BakeQueue(clock)


def key(x: int) -> Key:
    return "scene", (0, 0, x)


def request(
    queue: BakeQueue,
    *demands: tuple[int, float],
    texels: tuple[int, ...] = (1, 2, 3),
    goal: Goal = GOAL,
    effort: Effort = UNLIT,
    viewer: Viewer = GUEST_VIEWER,
) -> None:
    """One view that demands chunks (x, weight)."""
    offsets = np.array(texels, np.int32)
    seen = np.array(texels, np.float32)
    queue.request(
        [(key(x), Demand((0, 0, x), offsets, weight, effort, seen)) for x, weight in demands],
        goal,
        viewer,
    )


def taken_from(queue: BakeQueue) -> BakeRequest:
    """The request that is next."""
    taken = queue.take()
    assert taken is not None
    return taken


def take(queue: BakeQueue) -> int | None:
    """The x of the chunk that is next."""
    taken = queue.take()
    return None if taken is None else taken.key[1][2]


def end(queue: BakeQueue, x: int, result: BakeResult) -> None:
    """End the task of a chunk that was just taken, for all that was wanted of it."""
    taken = queue.requests[key(x)]
    queue.finish(key(x), taken.offsets, taken.goal, result)


def test_an_empty_queue_gives_nothing(queue: BakeQueue) -> None:
    assert queue.take() is None


def test_the_chunk_that_looks_most_wrong_comes_first(queue: BakeQueue) -> None:
    request(queue, (1, 5.0), (2, 50.0), (3, 20.0))
    assert [take(queue) for _ in range(4)] == [2, 3, 1, None]


def test_the_newest_view_comes_first(queue: BakeQueue) -> None:
    request(queue, (1, 500.0), (2, 400.0))
    request(queue, (3, 1.0), (4, 2.0))
    assert [take(queue) for _ in range(4)] == [4, 3, 1, 2]


def test_a_chunk_asked_for_again_belongs_to_the_newest_view(queue: BakeQueue) -> None:
    request(queue, (1, 500.0), (2, 400.0))
    request(queue, (2, 1.0))
    assert [take(queue) for _ in range(2)] == [2, 1]


def test_chunks_without_light_come_first(queue: BakeQueue) -> None:
    request(queue, (1, 500.0), (2, 1.0))
    assert take(queue) == 1
    end(queue, 1, left(3, 0.9))
    assert [take(queue) for _ in range(2)] == [2, 1]


def test_a_frame_from_before_a_task_does_not_undo_its_news(queue: BakeQueue) -> None:
    request(queue, (1, 500.0), (2, 1.0))
    assert take(queue) == 1
    end(queue, 1, left(3, 0.9))
    request(queue, (1, 500.0), (2, 1.0))  # as it was before: no light in either
    assert [take(queue) for _ in range(2)] == [2, 1]


def test_a_second_is_spent_where_it_takes_most_error_off(clock: Clock) -> None:
    seconds = {key(1): 1.0, key(2): 1.0, key(3): 4.0}
    queue = BakeQueue(clock, rate=seconds.get)
    request(queue, (1, 10.0), (2, 20.0), (3, 10.0), effort=Effort(0, 100.0, 0.0))
    assert [take(queue) for _ in range(3)] == [2, 1, 3]


def test_converged_chunks_wait_for_noisy_ones(queue: BakeQueue) -> None:
    request(queue, (1, 10.0), (2, 9.0), effort=Effort(0, 48.0, 0.0))
    assert take(queue) == 1
    end(queue, 1, left(3, 0.18))
    assert [take(queue) for _ in range(2)] == [2, 1]


def test_each_task_climbs_one_level_until_the_rest_is_short(queue: BakeQueue) -> None:
    request(queue, (1, 1.0), goal=GOAL)
    steps = []
    for samples, more in (
        (16, 1e6),
        (32, 32_768.0),
        (64, 8_192.0),
        (0, 0.0),
    ):
        taken = taken_from(queue)
        steps.append(taken.until)
        end(queue, 1, BakeResult(2, 0.5, Effort(0, 2.0 * samples, more, lit=2), Cost(0.01, 100)))
    assert steps == [FIRST_LEVEL, 2 * FIRST_LEVEL, 4 * FIRST_LEVEL, MAX_SAMPLES]
    assert take(queue) == 1
    end(queue, 1, DONE)
    assert queue.take() is None
    assert queue.open([key(1)]) == []


def test_more_samples_of_lit_texels_are_one_task(queue: BakeQueue) -> None:
    """Nothing is without light, so no task looks for what is."""
    request(queue, (1, 1.0), goal=GOAL, effort=Effort(0, 48.0, 48.0, lit=3))
    taken = taken_from(queue)
    assert taken.until == MAX_SAMPLES
    request(queue, (1, 1.0), goal=Goal(0.05), effort=Effort(0, 48.0, 480.0, lit=3))
    queue.finish(key(1), taken.offsets, GOAL, DONE)
    taken = taken_from(queue)
    assert taken.until == MAX_SAMPLES


def test_a_request_in_flight_is_not_taken_twice(queue: BakeQueue) -> None:
    request(queue, (1, 1.0))
    assert take(queue) == 1
    request(queue, (1, 1.0))
    assert take(queue) is None
    assert len(queue.open([key(1), key(2)])) == 1


def test_texels_and_goals_of_several_views_are_merged(queue: BakeQueue) -> None:
    request(queue, (1, 1.0), texels=(5, 9), goal=GOAL)
    request(queue, (1, 7.0), texels=(2, 9, 11), goal=Goal(0.3))
    request(queue, (1, 3.0), texels=(2,), goal=Goal(0.05))
    taken = taken_from(queue)
    assert taken.offsets.tolist() == [2, 5, 9, 11]
    assert taken.footprints.tolist() == [2.0, 5.0, 9.0, 11.0]
    assert (taken.goal, taken.priority) == (Goal(0.05), 3.0 / (3 * FIRST_LEVEL))


def test_the_goal_is_known_without_merging_texels(
    queue: BakeQueue, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every frame asks for the time left of hundreds of chunks, each of which many views may
    want.
    """
    for goal in (Goal(0.1), Goal(0.05, 64), Goal(0.2)):
        request(queue, (1, 1.0), goal=goal, viewer=Viewer(goal, 1))
    monkeypatch.setattr(bake_requests, "merged", lambda _: pytest.fail("texels were merged"))
    assert queue.requests[key(1)].goal == Goal(0.05)


def test_new_texels_start_from_the_first_level(queue: BakeQueue) -> None:
    request(queue, (1, 1.0), texels=(1, 2))
    take(queue)
    end(queue, 1, left(1, 0.6))
    request(queue, (1, 1.0), texels=(1,))
    assert queue.requests[key(1)].until > FIRST_LEVEL
    request(queue, (1, 1.0), texels=(1, 3))
    assert queue.requests[key(1)].until == FIRST_LEVEL


def test_a_stricter_goal_starts_from_the_first_level(queue: BakeQueue) -> None:
    request(queue, (1, 1.0), goal=GOAL)
    take(queue)
    end(queue, 1, left(1, 0.6))
    request(queue, (1, 1.0), goal=Goal(0.01))
    assert queue.requests[key(1)].until == FIRST_LEVEL


@pytest.mark.parametrize(
    ("texels", "goal"),
    [
        ((1, 2, 3, 4), GOAL),
        ((7,), GOAL),
        ((1, 2, 3), Goal(0.01)),
    ],
)
def test_a_request_that_grew_in_flight_stays(
    queue: BakeQueue, texels: tuple[int, ...], goal: Goal
) -> None:
    request(queue, (1, 1.0))
    flown = taken_from(queue)
    offsets = flown.offsets
    former = flown.goal
    request(queue, (1, 50.0), (2, 20.0), texels=texels, goal=goal)
    queue.finish(key(1), offsets, former, DONE)
    again = taken_from(queue)
    assert again.key == key(1)
    assert set(again.offsets.tolist()) == {1, 2, 3, *texels}
    assert again.goal == Goal.strictest([GOAL, goal])
    assert again.until == FIRST_LEVEL


def test_a_request_that_did_not_grow_in_flight_is_done(queue: BakeQueue) -> None:
    request(queue, (1, 1.0))
    take(queue)
    request(queue, (1, 1.0), texels=(2,), goal=Goal(0.5))
    queue.finish(key(1), np.array([1, 2, 3], np.int32), GOAL, DONE)
    assert queue.open([key(1)]) == []


def test_failures_are_tried_again_and_then_given_up(queue: BakeQueue) -> None:
    request(queue, (1, 9.0), (2, 1.0))
    for failure in range(1, TRIES + 1):
        assert take(queue) == 1
        assert len(queue.open([key(1)])) == 1
        assert queue.fail(key(1), f"failure {failure}") == (failure == TRIES)
    assert queue.open([key(1)]) == []
    assert queue.trouble() == "failure 3"
    assert [take(queue) for _ in range(2)] == [2, None]


def test_postponed_requests_come_back_after_others(queue: BakeQueue, clock: Clock) -> None:
    request(queue, (1, 3.0), (2, 2.0))
    assert take(queue) == 1
    queue.put_off(key(1), 0.5)
    request(queue, (1, 9.0), (2, 2.0))
    assert [take(queue), take(queue)] == [2, None]
    assert queue.counts()[0] == 2
    clock.now += 0.5
    assert [take(queue), take(queue)] == [1, None]
    end(queue, 1, DONE)
    end(queue, 2, DONE)
    assert not queue.requests


def test_postponed_requests_without_clients_do_not_return(queue: BakeQueue, clock: Clock) -> None:
    request(queue, (1, 3.0), viewer=Viewer("one", single=True))
    assert take(queue) == 1
    queue.put_off(key(1), 0.5)
    queue.leave(Viewer("one", single=True))
    clock.now += 0.5
    assert take(queue) is None and not queue.requests


def test_success_forgives_failures(queue: BakeQueue) -> None:
    request(queue, (1, 1.0))
    for _ in range(3 * TRIES):
        assert take(queue) == 1
        assert not queue.fail(key(1), "once")
        assert take(queue) == 1
        end(queue, 1, left(1, 0.9))
    assert queue.trouble() == ""


def test_a_suspect_request_runs_alone_and_last(queue: BakeQueue) -> None:
    request(queue, (1, 9.0), (2, 8.0), (3, 1.0))
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
    request(queue, (4, 9.0))
    assert [take(queue), take(queue)] == [4, 2]


def test_a_given_up_chunk_is_retried_after_a_while(queue: BakeQueue, clock: Clock) -> None:
    """It is tried again a minute later (docs/faults.md)."""
    request(queue, (1, 1.0))
    for _ in range(TRIES):
        take(queue)
        queue.fail(key(1), "no space")
    clock.now += 50.0
    request(queue, (1, 1.0), texels=(1, 2, 3, 4))
    assert take(queue) is None
    assert queue.trouble() == "no space"
    clock.now += 20.0
    assert queue.trouble() == ""
    request(queue, (1, 1.0))
    assert take(queue) == 1


def test_light_that_nobody_asks_for_any_more_is_forgotten(queue: BakeQueue, clock: Clock) -> None:
    """It is baked for a minute (docs/http-streams.md)."""
    request(queue, (1, 1.0), (2, 1.0))
    clock.now += 30.0
    request(queue, (2, 1.0))
    clock.now += 25.0
    assert len(queue.open([key(1), key(2)])) == 2
    clock.now += 10.0
    assert [take(queue) for _ in range(2)] == [2, None]
    assert queue.open([key(1)]) == []


def test_light_is_not_forgotten_while_somebody_waits_for_it(queue: BakeQueue, clock: Clock) -> None:
    request(queue, (1, 1.0), (2, 1.0))
    clock.now += 50.0
    queue.renew([key(2), key(3)])
    clock.now += 20.0
    assert [take(queue) for _ in range(2)] == [2, None]


def test_a_request_in_flight_does_not_expire(queue: BakeQueue, clock: Clock) -> None:
    request(queue, (1, 1.0))
    assert take(queue) == 1
    clock.now += 600.0
    assert take(queue) is None
    end(queue, 1, left(1, 0.9))
    assert take(queue) is None
    assert queue.open([key(1)]) == []


ANNA = Viewer("Anna", single=True)
BERT = Viewer("Bert", single=True)
PREWARM = Viewer("prewarm", patient=True)


def test_a_single_viewer_keeps_its_newest_view_alone(queue: BakeQueue) -> None:
    request(queue, (1, 9.0), (2, 9.0), viewer=ANNA)
    request(queue, (2, 1.0), (3, 1.0), texels=(7,), viewer=ANNA)
    assert list(queue.requests) == [key(2), key(3)]
    assert queue.requests[key(2)].offsets.tolist() == [7]


def test_a_client_that_leaves_drops_its_requests_alone(queue: BakeQueue) -> None:
    request(queue, (1, 9.0), (2, 9.0), texels=(1, 5), viewer=ANNA)
    request(queue, (2, 1.0), texels=(5, 8), goal=Goal(0.2), viewer=BERT)
    shared = queue.requests[key(2)]
    assert (shared.offsets.tolist(), shared.goal) == ([1, 5, 8], GOAL)
    queue.leave(ANNA)
    assert list(queue.requests) == [key(2)]
    assert (shared.offsets.tolist(), shared.goal) == ([5, 8], Goal(0.2))
    queue.leave(BERT)
    assert queue.requests == {}


def test_a_request_in_flight_ends_with_its_task_after_a_leave(queue: BakeQueue) -> None:
    request(queue, (1, 9.0), viewer=ANNA)
    assert take(queue) == 1
    queue.leave(ANNA)
    assert queue.counts() == (0, 0, 0.0)
    assert list(queue.requests) == [key(1)]
    end(queue, 1, left(3, 0.9))
    assert queue.requests == {}


def test_an_early_end_of_a_visit_keeps_older_requests(queue: BakeQueue) -> None:
    first = Viewer("home", 1)
    second = Viewer("home", 2)
    request(queue, (1, 1.0), (2, 1.0), viewer=first)
    request(queue, (2, 1.0), (3, 1.0), viewer=second)
    queue.leave(second)
    assert list(queue.requests) == [key(1)]


def test_viewers_take_turns_by_the_seconds_that_they_were_served(queue: BakeQueue) -> None:
    request(queue, *((x, 1.0) for x in range(10, 40)), viewer=ANNA)
    request(queue, *((x, 1000.0) for x in range(50, 99)), viewer=BERT)
    served = {"Anna": 0.0, "Bert": 0.0}
    for _ in range(30):
        taken = taken_from(queue)
        (client,) = taken.interests
        cost = 0.3 if client == "Bert" else 0.1
        served[str(client)] += cost
        queue.finish(
            taken.key,
            taken.offsets,
            taken.goal,
            BakeResult(0, 0.0, UNLIT, Cost(cost, 48, 3, 0.1)),
        )
    assert served["Anna"] == pytest.approx(served["Bert"], abs=0.4)


def test_a_late_client_starts_level_with_the_others(queue: BakeQueue) -> None:
    request(queue, *((x, 1.0) for x in range(10, 60)), viewer=ANNA)
    for _ in range(20):
        end(queue, take(queue) or 0, DONE)
    request(queue, *((x, 1.0) for x in range(60, 99)), viewer=BERT)
    turns = []
    for _ in range(10):
        x = take(queue) or 0
        turns.append("Anna" if x < 60 else "Bert")
        end(queue, x, DONE)
    assert abs(turns.count("Anna") - turns.count("Bert")) <= 2
    assert "Bert" in turns[:2]


def test_a_chunk_that_two_see_counts_for_both(queue: BakeQueue) -> None:
    request(queue, (1, 10.0), (2, 8.0), viewer=ANNA)
    request(queue, (2, 8.0), viewer=BERT)
    assert [take(queue) for _ in range(2)] == [2, 1]
    assert queue.shares.accounts["Anna"].spent > queue.shares.accounts["Bert"].spent


def test_of_equals_the_nearest_to_final_comes_first(queue: BakeQueue) -> None:
    far, near = Effort(0, 48.0, 900.0), Effort(0, 48.0, 100.0)
    texels = np.array([1, 2, 3], np.int32)
    seen = np.ones(3, np.float32)
    both = [
        (key(x), Demand((0, 0, x), texels, 1.0, effort, seen))
        for x, effort in ((1, far), (2, near))
    ]
    queue.request(both, GOAL)
    assert [take(queue) for _ in range(2)] == [2, 1]


CHUNK = np.arange(512, dtype=np.int32)
"""Offsets of all texels of a chunk of 8³."""


def whole_chunks(queue: BakeQueue, viewer: Viewer, unlit: int = len(CHUNK)) -> None:
    """A view that demands two whole chunks, the first of which looks more wrong."""
    seen = np.ones(len(CHUNK), np.float32)
    effort = Effort(unlit, 0.0, 0.0)
    demands = [(key(x), Demand((0, 0, x), CHUNK, 9.0 / x, effort, seen, bits=3)) for x in (1, 2)]
    queue.request(demands, GOAL, viewer)


def test_a_quarter_of_the_texels_has_light_first(queue: BakeQueue) -> None:
    """Of all chunks, before any has the rest; who is patient has all at once, and so has what had
    some light.
    """
    whole_chunks(queue, ANNA)
    for texels in (128, 512):
        taken = [taken_from(queue), taken_from(queue)]
        assert [each.key for each in taken] == [key(1), key(2)]
        for each in taken:
            offsets, footprints = each.next
            assert each.until == FIRST_LEVEL and len(offsets) == len(footprints) == texels
            queue.finish(each.key, offsets, GOAL, left(texels, 1.0))
    assert all(request.until == MAX_SAMPLES for request in queue.requests.values())


@pytest.mark.parametrize(("viewer", "unlit"), [(PREWARM, 512), (ANNA, 511)])
def test_all_texels_have_light_at_once(queue: BakeQueue, viewer: Viewer, unlit: int) -> None:
    whole_chunks(queue, viewer, unlit)
    request = taken_from(queue)
    assert len(request.next[0]) == 512


def test_patient_clients_yield_to_others(queue: BakeQueue) -> None:
    request(queue, (1, 1000.0), (2, 1000.0), viewer=PREWARM)
    request(queue, (3, 1.0), viewer=ANNA)
    request(queue, (2, 1.0), viewer=BERT)
    assert sorted(take(queue) or 0 for _ in range(2)) == [2, 3]
    assert take(queue) == 1


def test_given_up_chunks_are_not_retried_by_short_visits(queue: BakeQueue) -> None:
    for visit in range(TRIES):
        request(queue, (1, 1.0), viewer=ANNA)
        assert take(queue) == 1
        queue.fail(key(1), f"failure {visit}")
    queue.leave(ANNA)
    request(queue, (1, 1.0), viewer=BERT)
    assert take(queue) is None
    assert queue.trouble() == "failure 2"


def test_what_goes_with_a_request_is_alike_and_not_too_much(clock: Clock) -> None:
    queue = BakeQueue(clock, rate=lambda _: 0.06 / 48.0)
    request(queue, (4, 1.0), goal=Goal(0.2))
    request(queue, *((x, 1.0) for x in range(4)))
    first = taken_from(queue)
    assert len(queue.take_along(first, 7)) == 2  # texels: three each
    first = taken_from(queue)
    assert len(queue.take_along(first, 100)) == 2  # the next has another goal
    request(queue, *((x, 1.0) for x in range(10, 40)))
    first = taken_from(queue)
    assert 0.125 <= 0.06 * len(queue.take_along(first, 100)) <= 0.5  # seconds of a worker


def test_later_tasks_are_joined_by_what_they_will_take(clock: Clock) -> None:
    """Not by all that their texels will ever take: where that is long, a task climbs one level."""
    effort = Effort(0, 48.0, 1e6, lit=3)
    queue = BakeQueue(clock, rate=lambda _: 0.02 / 48.0)
    lit = BakeResult(3, 1.0, effort, Cost(9.0, 48))
    request(queue, *((x, 1.0) for x in range(40)))
    assert sum(take(queue) is not None for _ in range(40)) == 40
    for x in range(40):
        end(queue, x, lit)
    first = taken_from(queue)
    assert first.until == 2 * FIRST_LEVEL
    assert 0.125 <= 0.02 * len(queue.take_along(first, 200)) <= 0.5


def test_the_rest_of_a_rung_is_shared_by_all_workers(clock: Clock) -> None:
    """Each of four tasks takes a fourth of what is left."""
    queue = BakeQueue(clock, rate=lambda _: 0.025 / 48.0)
    request(queue, *((x, 1.0) for x in range(16)))
    sizes = []
    while (first := queue.take()) is not None:
        sizes.append(len(queue.take_along(first, 1000, 4)))
    assert sum(sizes) == 16
    assert sizes[0] == 4 and sizes == sorted(sizes, reverse=True) and sizes[-1] == 1


def test_no_task_is_so_short_that_it_is_not_worth_its_way(clock: Clock) -> None:
    """Ten workers share a fifth of a second, in fewer tasks than ten."""
    queue = BakeQueue(clock, rate=lambda _: 0.002 / 48.0)
    request(queue, *((x, 1.0) for x in range(100)))
    assert 0.025 <= 0.002 * len(queue.take_along(taken_from(queue), 1000, 10)) <= 0.1


def test_rungs_of_one_picture_are_taken_together(clock: Clock) -> None:
    """What is long by itself goes with what is short where both end at the picture's rung."""
    queue = BakeQueue(clock, rate=lambda _: 1e-9)
    request(queue, (1, 1.0), (2, 1.0), goal=Goal(0.1, 4 * FIRST_LEVEL))
    assert take(queue) is not None and take(queue) is not None
    for x, left in ((1, 48.0), (2, 1e6)):
        end(queue, x, BakeResult(3, 1.0, Effort(0, 6.0 * FIRST_LEVEL, left, lit=3), Cost(9.0, 48)))
    first = taken_from(queue)
    assert first.until == 4 * FIRST_LEVEL
    assert len(queue.take_along(first, 100)) == 2


def test_a_view_drawn_before_its_light_came_opens_nothing(queue: BakeQueue, clock: Clock) -> None:
    """One that wants more than was finished does, and one that still lacks it some time later."""
    request(queue, (1, 1.0))
    assert take(queue) == 1
    end(queue, 1, DONE)
    clock.now += 1.0
    request(queue, (1, 1.0))
    request(queue, (1, 1.0), texels=(1, 2))
    assert not queue.open([key(1)]) and take(queue) is None
    request(queue, (1, 1.0), texels=(1, 2, 3, 4))
    assert take(queue) == 1
    end(queue, 1, DONE)
    request(queue, (1, 1.0), goal=Goal(0.05))
    assert take(queue) == 1
    end(queue, 1, DONE)
    clock.now += 4.0
    request(queue, (1, 1.0))
    assert take(queue) == 1


def test_what_may_have_killed_a_worker_is_taken_alone(queue: BakeQueue) -> None:
    request(queue, (1, 1.0), (2, 1.0))
    assert take(queue) is not None and take(queue) is not None
    for x in (1, 2):
        queue.fail(key(x), "It died.", suspect=True)
    first = taken_from(queue)
    assert queue.take_along(first, 100) == [first]
