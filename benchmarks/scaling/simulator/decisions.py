"""What the queue itself takes: processor seconds of a decision, measured on the real one."""

import time
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from isogi_core.bake.noise import Effort, Goal
from isogi_core.cache.costs import Cost
from isogi_core.frame.demand import Demand
from isogi_worker.bake_requests import Key, Viewer
from isogi_worker.queue import BakeQueue
from isogi_worker.tasks import BakeResult

ROUNDS = 24
"""Decisions that are timed; the median of their seconds is told."""

VIEW = 100
"""Chunks of a view, for the time that a new one takes."""

TEXELS = np.arange(0, 800, 10, dtype=np.int32)
SEEN = np.ones(len(TEXELS), np.float32)
GOAL = Goal(0.1)
RESULT = BakeResult(40, 0.01, Effort(0, 4000.0, 9000.0), Cost(0.1, 1280, 80, 0.1))


class Decision(NamedTuple):
    """Median processor seconds to choose a task, to end it, and to take a viewer's next view in."""

    take: float
    finish: float
    view: float


def measure(chunks: int, clients: int, flying: int, together: bool = False) -> Decision:
    """A decision where ``clients`` want so many ``chunks`` in all, each its own or all ``together``
    the same.
    """
    queue = crowded(chunks, clients, together)
    flown = [queue.take() for _ in range(flying)]
    takes = []
    finishes = []
    views = []
    for want in flown[:ROUNDS]:
        assert want is not None
        texels = want.offsets
        goal = want.goal
        finishes.append(seconds(partial(queue.finish, want.key, texels, goal, RESULT)))
        takes.append(seconds(queue.take))
    for number in range(ROUNDS):
        shift = number + 1
        keys = [key((shift + place) % chunks) for place in range(min(VIEW, chunks))]
        viewer = Viewer(0, single=True)
        views.append(seconds(partial(queue.request, demands(keys), GOAL, viewer)))
    return Decision(*(float(np.median(each)) for each in (takes, finishes, views)))


def crowded(chunks: int, clients: int, together: bool) -> BakeQueue:
    """A queue in which all of these wait; its clock stands still."""
    queue = BakeQueue(lambda: 0.0, rate=lambda _: 1e-5)
    for client in range(clients):
        if together:
            own = range(chunks)
        else:
            own = range(client, chunks, clients)
        queue.request(demands([key(chunk) for chunk in own]), GOAL, Viewer(client, single=True))
    return queue


def demands(keys: list[Key]) -> list[tuple[Key, Demand]]:
    """What a view wants of these chunks: no two are worth the same."""
    return [
        (each, Demand(each[1], TEXELS, 1.0 + each[1][2] % 97, Effort(80, 0.0, 0.0), SEEN))
        for each in keys
    ]


def key(chunk: int) -> Key:
    """A chunk by its number."""
    return "scene", (0, 0, chunk)


def seconds(work: Callable[[], object]) -> float:
    """Processor seconds that some work takes."""
    begun = time.process_time()
    work()
    return time.process_time() - begun
