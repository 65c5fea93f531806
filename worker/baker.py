"""The baker: keeps the workers busy with what the queue says, and tells when light has come."""

import logging
import threading
import time
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from isogi_core.bake.precision import FIRST_RUNG
from isogi_core.bake.recipe import Index
from isogi_core.cache.costs import Costs
from isogi_core.frame.texels import Demand
from isogi_core.model.plan import ScenePlan
from isogi_core.model.source import SceneSource
from worker.outlook import Outlook, TimeLeft
from worker.queue import BakeQueue, Key, Want
from worker.tasks import BakeResult, BakeTask

if TYPE_CHECKING:
    from worker.pool import WorkerPool

log = logging.getLogger("isogi.worker")


@dataclass(frozen=True, eq=False)
class Bake:
    """A ``plan`` for the scene in ``source``, the ``digest`` and the ``store`` of its light, and who hears of it.

    ``layers`` are the digests of the layers that it writes; ``costs`` tell what its chunks take.
    """

    source: SceneSource
    plan: ScenePlan
    digest: str
    layers: frozenset[str]
    store: str
    arrived: Callable[[Index], None]
    costs: Costs


class Baker:
    """One queue and one pool for all scenes. Safe to use from many threads."""

    def __init__(self, clock: Callable[[], float] = time.monotonic, workers: int | None = 1) -> None:
        """Begin without workers: what is wanted waits until ``employ``. So many are to come, None for nobody knows."""
        self._expected = workers
        self._queue = BakeQueue(clock, self._shared, lambda key: self._bakes[key[0]].costs.rate(key[1]))
        self._outlook = Outlook(clock)
        self._bakes: dict[str, Bake] = {}
        self._pool: WorkerPool | None = None
        self._flying = 0
        self._paths = 0
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
            return bool(self._queue.open(key for key, _ in wanted))

    def wait(self, scene: str, indices: Iterable[Index], seconds: float) -> None:
        """Block until all light wanted of these chunks is baked or given up, at most ``seconds``."""
        keys: list[Key] = [(scene, index) for index in indices]
        with self._changed:
            self._changed.wait_for(lambda: not self._queue.open(keys), seconds)

    def open(self, scene: str, indices: Iterable[Index]) -> int:
        """How many of the chunks are still waited for, and neither baked nor given up; they are not forgotten yet."""
        keys: list[Key] = [(scene, index) for index in indices]
        with self._changed:
            self._queue.renew(keys)
            return len(self._queue.open(keys))

    def time_left(self, scene: str, subject: Hashable, indices: Iterable[Index]) -> TimeLeft | None:
        """Seconds until all light that a ``subject`` wants of these chunks is baked; None where that is unknown."""
        with self._changed:
            wants = self._queue.open((scene, index) for index in indices)
            seconds = self._seconds(scene, wants)
            workers = self._expected if self._pool is None else self._pool.workers
            if seconds is None or workers is None:
                return None
            return self._outlook.tell(subject, max(sum(seconds) / workers, *seconds, 0.0))

    @property
    def paths(self) -> int:
        """Paths that were baked, of all scenes."""
        return self._paths

    def trouble(self) -> str:
        """Why light that was asked for is not baked; empty when all of it is."""
        with self._changed:
            return self._queue.trouble()

    def stop(self) -> None:
        """Hand out no more tasks, and have what was learnt of costs kept."""
        with self._changed:
            self._pool = None
            self._changed.notify_all()
        for bake in self._bakes.values():
            bake.costs.save()

    def _shared(self, one: str, other: str) -> bool:
        """Whether two bakes write to a layer that is the same."""
        return not self._bakes[one].layers.isdisjoint(self._bakes[other].layers)

    def _seconds(self, scene: str, wants: Sequence[Want]) -> list[float] | None:
        """Processor seconds that each of the wants will take; None where nothing is known.

        A texel without light is taken to need as many paths as others of the bake did, or will.
        """
        costs = self._bakes[scene].costs
        total, left = costs.total, sum(want.effort.left for want in wants)
        rates = [costs.rate(want.key[1]) for want in wants]
        if None in rates or (not total.texels and any(want.effort.unlit for want in wants)):
            return None
        texels = max(total.texels, 1)
        more, first = (total.paths + left) / texels - FIRST_RUNG, total.first / texels
        return [
            rate * (want.effort.left + more * want.effort.unlit) + first * want.effort.unlit
            for rate, want in zip(rates, wants, strict=True)
            if rate is not None
        ]

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
        place = (bake.source, bake.plan, bake.digest, bake.store, index)
        task = BakeTask(*place, want.offsets, want.footprints, want.until, want.least or 0.0, want.target)
        pool.submit(task, lambda result, error: self._done(scene, task, result, error))

    def _done(self, scene: str, task: BakeTask, result: BakeResult | None, error: BaseException | None) -> None:
        bake = self._bakes[scene]
        if result is not None:
            bake.costs.add(task.index, result.cost)
            bake.arrived(task.index)
        with self._changed:
            self._flying -= 1
            if result is not None:
                self._paths += result.cost.paths
                self._queue.finish((scene, task.index), task.offsets, task.target, result)
            elif self._pool is not None:
                self._fail((scene, task.index), error)
            self._changed.notify_all()
            self._feed()
        bake.costs.save(at_once=self._pool is None)

    def _fail(self, key: Key, error: BaseException | None) -> None:
        scene, index = key
        log.warning("baking chunk %s of %s failed: %s", index, scene, error)
        if self._queue.fail(key, f"Chunk {index} of {scene} cannot be baked: {error}"):
            log.error("chunk %s of %s is given up for a while", index, scene)
