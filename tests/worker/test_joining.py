"""What a pool knows of clusters: keys of its own one, and deaths in one that it joined."""

import threading
from collections.abc import Callable
from typing import Any

import pytest
from distributed import Security

from worker.pool import WorkerPool, temporary_security


def test_each_cluster_has_a_key_of_its_own() -> None:
    one, other = temporary_security(), temporary_security()
    assert one.require_encryption
    assert one.tls_worker_key == one.tls_client_key != other.tls_client_key
    assert isinstance(one, Security) and "PRIVATE" not in repr(one)


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

    monkeypatch.setattr("worker.pool.OwnClient", FakeClient)
    pool = WorkerPool(2, "tcp://elsewhere")
    stirred = threading.Semaphore(0)
    pool.attend(stirred.release)
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
