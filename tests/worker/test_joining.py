"""What a pool knows of deaths in a cluster that it joined."""

import threading
from collections.abc import Callable
from typing import Any

import pytest

from isogi_worker.dask_pool import DaskPool


def test_a_worker_that_is_replaced_has_died(monkeypatch: pytest.MonkeyPatch) -> None:
    there = [["a", "b"]]
    moves = []

    class FakeClient:
        status = "running"

        def __init__(self, *_: Any, **__: Any) -> None:
            pass

        def scheduler_info(self, **_: Any) -> dict[str, Any]:
            return {
                "id": "Scheduler",
                "n_workers": len(there[-1]),
                "workers": dict.fromkeys(there[-1]),
            }

        def register_plugin(self, _: Any) -> None:
            pass

        def subscribe_topic(self, topic: str, handler: Callable[[Any], None]) -> None:
            assert topic == "all"
            moves.append(handler)

        def unsubscribe_topic(self, topic: str) -> None:
            assert topic == "all"

        def close(self) -> None:
            pass

    monkeypatch.setattr("isogi_worker.dask_pool.OwnClient", FakeClient)
    pool = DaskPool("tcp://elsewhere")
    stirred = threading.Semaphore(0)
    pool.on_workers_changed(stirred.release)
    assert (pool.workers, pool.deaths) == (2, 0)
    for addresses, counts in (
        (["a", "c"], (2, 1)),
        (["c"], (1, 2)),
        (["c", "d", "e"], (3, 2)),
        ([], (1, 5)),
    ):
        there.append(addresses)
        moves[0]((0.0, {"action": "remove-worker"}))
        while (pool.workers, pool.deaths) != counts:
            assert stirred.acquire(timeout=60)
    assert "No worker has joined" in pool.trouble
    pool.close()
