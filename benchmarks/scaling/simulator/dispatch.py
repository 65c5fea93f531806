"""What Dask takes to pass a task on: measured on a cluster of this machine with tasks that do
nothing.
"""

import threading
import time
from typing import Any

import numpy as np
from distributed import Client, LocalCluster

PAYLOAD = np.arange(400, dtype=np.int32)
"""About as much as a task carries: offsets and footprints of its texels."""


def nothing(payload: np.ndarray) -> int:
    """A task that does nothing."""
    return len(payload)


def measure(tasks: int, workers: int = 2, flying: int = 64) -> dict[str, float]:
    """Seconds a task, where so many fly at once: of the wall, and of the processor in the process
    that has them.

    That holds the scheduler and its client; the workers are not counted.
    """
    with (
        LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            silence_logs=50,
        ) as cluster,
        Client(cluster, set_as_default=False) as client,
    ):
        hand_over(client, flying, flying)
        wall = time.perf_counter()
        processor = time.process_time()
        hand_over(client, tasks, flying)
        return {
            "wall": (time.perf_counter() - wall) / tasks,
            "processor": (time.process_time() - processor) / tasks,
        }


def hand_over(client: Client, tasks: int, flying: int) -> None:
    """Have tasks done as a pool has: the end of one makes room for the next."""
    room = threading.Semaphore(flying)
    done = threading.Semaphore(0)

    def ended(future: Any) -> None:
        future.result()
        room.release()
        done.release()

    for _ in range(tasks):
        room.acquire()
        client.submit(nothing, PAYLOAD, pure=False).add_done_callback(ended)
    for _ in range(tasks):
        done.acquire()
