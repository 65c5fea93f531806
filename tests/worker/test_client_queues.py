import random

import numpy as np
import pytest

from isogi_core.bake.noise import Effort, Goal
from isogi_core.cache.costs import Cost
from isogi_core.frame.demand import Demand
from isogi_worker.bake_requests import BakeRequest, Key, Viewer
from isogi_worker.queue import BakeQueue, ClientQueues
from isogi_worker.tasks import BakeResult
from tests.worker.clock import Clock

TEXELS = np.arange(4, dtype=np.int32)
SIBLINGS = {"scene", "scene (near)"}
VIEWERS = [
    Viewer(name, single=name != "guest", patient=name == "job")
    for name in ("anna", "bert", "guest", "job")
]


def demand(x: int, weight: float) -> Demand:
    seen = np.ones(len(TEXELS), np.float32)
    return Demand((0, 0, x), TEXELS, weight + x, Effort(4, 0.0, 0.0), seen)


def request(
    queue: BakeQueue, viewer: Viewer, *chunks: int, weight: float = 1.0, bake: str = "scene"
) -> None:
    demands = [demand(x, weight) for x in chunks]
    queue.request([((bake, demand.index), demand) for demand in demands], Goal(0.1), viewer)


def shared(one: str, other: str) -> bool:
    return one == other or {one, other} == SIBLINGS


def left(unfinished: int, priority: float) -> BakeResult:
    return BakeResult(unfinished, priority, Effort(0, 64.0, 64.0), Cost(0.1, 64, 4, 0.1))


def test_a_long_drag_leaves_no_places_behind() -> None:
    """Each move ranks ten chunks of a client anew, and drops the one that has left the picture."""
    queues = ClientQueues()
    wanted = [BakeRequest(("scene", (0, 0, x))) for x in range(510)]
    most = 0
    for move in range(500):
        for x in range(move, move + 10):
            wanted[x].add_interest(demand(x, 1.0), Goal(0.1), VIEWERS[0], move, 0.0)
            queues.push(wanted[x], "anna", (False, -move, 0, -1.0, 1.0))
        wanted[move].release("anna")
        most = max(most, queues.length(False, "anna"))
    assert most < 300


def test_a_request_that_grew_for_another_client_moves_up() -> None:
    queue = BakeQueue(Clock())
    request(queue, VIEWERS[0], 1, 2, 3)
    request(queue, VIEWERS[1], 1, weight=9.0)
    assert queue.take() is queue.requests["scene", (0, 0, 1)]


def test_requests_whose_priority_sank_wait_for_others() -> None:
    queue = BakeQueue(Clock())
    request(queue, VIEWERS[0], 1, 2, 3)
    request(queue, VIEWERS[1], 1, weight=9.0)
    queue.leave(VIEWERS[1])
    assert queue.take() is queue.requests["scene", (0, 0, 3)]


def test_a_bake_with_a_shared_layer_waits_for_the_others_task() -> None:
    queue = BakeQueue(Clock(), shared)
    request(queue, VIEWERS[0], 1)
    request(queue, VIEWERS[1], 1, bake="scene (near)")
    first = queue.take()
    assert first is not None and queue.take() is None
    queue.finish(first.key, first.offsets, first.goal, left(0, 0.0))
    second = queue.take()
    assert second is not None and {first.key[0], second.key[0]} == SIBLINGS


@pytest.mark.parametrize("seed", range(6))
def test_whatever_happens_no_work_is_passed_over(seed: int) -> None:
    """Against a search of all wants: nothing is taken only where nothing can be, and then what is
    best or near it.
    """
    chance = random.Random(seed)
    clock = Clock()
    queue = BakeQueue(clock, shared)
    flown: dict[Key, tuple[np.ndarray, Goal]] = {}
    for _ in range(600):
        step(queue, chance, clock, flown)
        possible = [each for each in queue.requests.values() if free(queue, each)]
        if chance.random() < 0.5:
            taken = queue.take()
        else:
            taken = None
        if taken is not None:
            assert taken in possible
            assert worthy(queue, taken, possible)
            flown[taken.key] = taken.offsets, taken.goal
    while flown:
        land(queue, flown, 0, 0.0)
    while (taken := queue.take()) is not None:
        queue.finish(taken.key, taken.offsets, taken.goal, left(0, 0.0))
    assert not [each for each in queue.requests.values() if not each.given_up]
    assert not any(queue.is_busy(bake, (0, 0, x)) for bake in SIBLINGS for x in range(30))


def step(
    queue: BakeQueue,
    chance: random.Random,
    clock: Clock,
    flown: dict[Key, tuple[np.ndarray, Goal]],
) -> None:
    """Something happens: a view, a leaving, a task's end or its failure, time."""
    viewer = chance.choice(VIEWERS)
    deed = chance.random()
    if deed < 0.4:
        chunks = chance.sample(range(30), 5)
        request(
            queue,
            viewer,
            *chunks,
            weight=chance.uniform(1.0, 50.0),
            bake=chance.choice(sorted(SIBLINGS)),
        )
    elif deed < 0.5:
        queue.leave(viewer)
    elif deed < 0.55:
        clock.now += 20.0
    elif flown and deed < 0.6:
        key = chance.choice(list(flown))
        del flown[key]
        queue.fail(key, "no luck", suspect=chance.random() < 0.3)
    elif flown:
        land(
            queue,
            flown,
            chance.choice((0, 2)),
            chance.uniform(0.0, 1.0),
            chance.randrange(len(flown)),
        )


def land(
    queue: BakeQueue,
    flown: dict[Key, tuple[np.ndarray, Goal]],
    unfinished: int,
    priority: float,
    number: int = 0,
) -> None:
    key = list(flown)[number]
    queue.finish(key, *flown.pop(key), left(unfinished, priority))


def free(queue: BakeQueue, each: BakeRequest) -> bool:
    """Whether a want could be worked on now."""
    aloft = [other for other in queue.requests.values() if other.in_flight]
    beside = any(
        index == each.key[1] and shared(bake, each.key[0])
        for bake, index in (other.key for other in aloft)
    )
    alone = any(other.suspect for other in aloft) or (each.suspect and aloft)
    return bool(each.interests) and not each.given_up and not beside and not alone


def worthy(queue: BakeQueue, taken: BakeRequest, possible: list[BakeRequest]) -> bool:
    """Whether for some client nothing is better than what was taken, or not twice as good."""
    return any(
        all(
            not clearly_better(queue, other, taken, client)
            for other in possible
            if client in other.interests
        )
        for client in taken.interests
    )


def clearly_better(
    queue: BakeQueue, other: BakeRequest, taken: BakeRequest, client: object
) -> bool:
    (*order, priority, _), (*mine, own, _) = queue.rank(other, client), queue.rank(taken, client)
    if (
        other.interests[client].viewer.patient != taken.interests[client].viewer.patient
        or order != mine
    ):
        return (
            other.interests[client].viewer.patient == taken.interests[client].viewer.patient
            and order < mine
        )
    return priority < 2.0 * own - 1e-9
