"""The tally of baking."""

import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from isogi_core.bake.noise import Effort
from isogi_core.cache.costs import Cost, Costs
from isogi_core.files.scene_file import SceneSource
from isogi_core.frame.view_texels import Demand
from isogi_core.model.scene_plan import Layer, ScenePlan
from isogi_core.storage.backend import StoreUrl
from tests.worker.clock import Clock
from worker.baker import Bake, Baker
from worker.pool import Done, WorkerPool
from worker.progress import Tally
from worker.tasks import BakeResult, BakeTask

PLAN = ScenePlan("transfer", (Layer("direct", 5),), 5, 4, 1.0, 4096)
DONE = BakeResult(0, 0.0, Effort(0, 100.0, 0.0), Cost(2.0, 100, 2, 0.64))


class FakePool:
    """Takes one task at a time and ends it when the test says so."""

    room, together, workers, deaths = 1, 1, 2, 3

    def __init__(self) -> None:
        self.end: Callable[[BakeResult | None, BaseException | None], None] = lambda *_: None

    def submit(self, task: BakeTask, done: Done) -> None:
        self.end = done


@pytest.fixture
def clock() -> Clock:
    return Clock(100.0)


@pytest.fixture
def baker(clock: Clock) -> Baker:
    baker, source = Baker(clock), SceneSource("scene", {"volume": "demo:orbital"}, Path())
    costs = Costs("memory://costs", "digest")
    baker.add("scene", Bake(source, PLAN, "digest", frozenset({"direct"}), StoreUrl("store"), lambda _: None, costs))
    return baker


def request(baker: Baker, *chunks: int) -> None:
    texels, seen = np.array([1, 2], np.int32), np.array([1.0, 0.5], np.float32)
    baker.request("scene", [Demand((0, 0, x), texels, 1.0, Effort(2, 0.0, 0.0), seen) for x in chunks], 0.1)


def test_counts_of_waiting_requests_and_their_age(baker: Baker, clock: Clock) -> None:
    assert baker.tally() == Tally(0, 0, 0.0, 0, 0, 0, 0, 0, 0, 0, 0)
    request(baker, 1)
    clock.now += 5.0
    request(baker, 1, 2)
    clock.now += 2.0
    assert baker.tally() == Tally(2, 0, 7.0, 0, 0, 0, 0, 0, 0, 0, 0)


def test_counts_of_done_failed_and_given_up_tasks(baker: Baker) -> None:
    pool = FakePool()
    baker.employ(pool)  # type: ignore[arg-type]
    request(baker, 1, 2)
    pool.end(replace(DONE, healed=True), None)
    assert baker.tally() == Tally(1, 0, 0.0, 1, 1, 0, 0, 1, 100, 2, 3)
    for _ in range(3):
        pool.end(None, OSError("no"))
    assert baker.tally() == Tally(0, 1, 0.0, 0, 1, 3, 0, 1, 100, 2, 3)


def test_a_worker_that_is_replaced_has_died(monkeypatch: pytest.MonkeyPatch) -> None:
    there, moves = [["a", "b"]], []

    class FakeClient:
        status = "running"

        def __init__(self, *_: Any, **__: Any) -> None:
            pass

        def scheduler_info(self, **_: Any) -> dict[str, Any]:
            return {"id": "Scheduler", "n_workers": len(there[-1]), "workers": dict.fromkeys(there[-1])}

        def register_plugin(self, _: Any) -> None:
            pass

        def subscribe_topic(self, topic: str, handler: Callable[[Any], None]) -> None:
            assert topic == "all"
            moves.append(handler)

        def unsubscribe_topic(self, topic: str) -> None:
            assert topic == "all"

        def close(self) -> None:
            pass

    monkeypatch.setattr("worker.pool.OwnClient", FakeClient)
    pool, stirred = WorkerPool(2, "tcp://elsewhere"), threading.Semaphore(0)
    pool.attend(stirred.release)
    assert (pool.workers, pool.deaths) == (2, 0)
    for addresses, counts in ((["a", "c"], (2, 1)), (["c"], (1, 2)), (["c", "d", "e"], (3, 2)), ([], (1, 5))):
        there.append(addresses)
        moves[0]((0.0, {"action": "remove-worker"}))
        while (pool.workers, pool.deaths) != counts:
            assert stirred.acquire(timeout=60)
    assert "No worker has joined" in pool.trouble
    pool.close()
