"""The baker: keeps the workers busy with what the queue says, and tells when light has come."""

import logging
import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from isogi_core.bake.recipe import Index
from isogi_core.frame.texels import Demand
from isogi_core.model.plan import ScenePlan
from isogi_core.model.source import SceneSource
from worker.queue import BakeQueue, Key, Want
from worker.tasks import BakeResult, BakeTask

if TYPE_CHECKING:
    from worker.pool import WorkerPool

log = logging.getLogger("isogi.worker")


@dataclass(frozen=True, eq=False)
class Bake:
    """A ``plan`` for the scene in ``source``, the ``digest`` and the ``store`` of its light, and who hears of it.

    ``layers`` are the digests of the layers that it writes.
    """

    source: SceneSource
    plan: ScenePlan
    digest: str
    layers: frozenset[str]
    store: str
    arrived: Callable[[Index], None]


class Baker:
    """One queue and one pool for all scenes. Safe to use from many threads."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """Begin without workers: what is wanted waits until ``employ``."""
        self._queue = BakeQueue(clock, self._shared)
        self._bakes: dict[str, Bake] = {}
        self._pool: WorkerPool | None = None
        self._flying = 0
        self._changed = threading.Condition()

    def add(self, scene: str, bake: Bake) -> None:
        """Take on the bake of a scene."""
        self._bakes[scene] = bake

    def employ(self, pool: "WorkerPool") -> None:
        """Begin to work with ``pool``."""
        with self._changed:
            self._pool = pool
            self._feed()

    def want(self, scene: str, demands: Iterable[Demand], target: float) -> bool:
        """Ask for the light that the newest view lacks. Returns whether any of it is going to be baked."""
        wanted: list[tuple[Key, Demand]] = [((scene, demand.index), demand) for demand in demands]
        with self._changed:
            self._queue.want(wanted, target)
            self._feed()
            return self._queue.open(key for key, _ in wanted) > 0

    def wait(self, scene: str, indices: Iterable[Index], seconds: float) -> None:
        """Block until all light wanted of these chunks is baked or given up, at most ``seconds``."""
        keys: list[Key] = [(scene, index) for index in indices]
        with self._changed:
            self._changed.wait_for(lambda: not self._queue.open(keys), seconds)

    def trouble(self) -> str:
        """Why light that was asked for is not baked; empty when all of it is."""
        with self._changed:
            return self._queue.trouble()

    def stop(self) -> None:
        """Hand out no more tasks."""
        with self._changed:
            self._pool = None
            self._changed.notify_all()

    def _shared(self, one: str, other: str) -> bool:
        """Whether two bakes write to a layer that is the same."""
        return not self._bakes[one].layers.isdisjoint(self._bakes[other].layers)

    def _feed(self) -> None:
        """Hand tasks over while there is room for them; the caller holds the lock."""
        while self._pool is not None and self._flying < self._pool.room:
            want = self._queue.take()
            if want is None:
                return
            self._flying += 1
            self._submit(self._pool, want)

    def _submit(self, pool: "WorkerPool", want: Want) -> None:
        scene, index = want.key
        bake = self._bakes[scene]
        task = BakeTask(bake.source, bake.plan, bake.digest, bake.store, index, want.offsets, want.goal, want.target)
        pool.submit(task, lambda result, error: self._done(scene, task, result, error))

    def _done(self, scene: str, task: BakeTask, result: BakeResult | None, error: BaseException | None) -> None:
        key = (scene, task.index)
        if result is not None:
            self._bakes[scene].arrived(task.index)
        with self._changed:
            self._flying -= 1
            if result is not None:
                self._queue.finish(key, task.offsets, task.target, result)
            elif self._pool is not None:
                log.warning("baking chunk %s of %s failed: %s", task.index, scene, error)
                if self._queue.fail(key, f"Chunk {task.index} of {scene} cannot be baked: {error}"):
                    log.error("chunk %s of %s is given up for a while", task.index, scene)
            self._changed.notify_all()
            self._feed()
