"""The baker: keeps the workers busy with what the queue says, and tells when light has come."""

import logging
import threading
import time
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING
from uuid import uuid4

from isogi_core.bake.precision import FIRST_RUNG
from isogi_core.bake.recipe import Index
from isogi_core.cache.costs import Cost, Costs
from isogi_core.cache.parcels import Parcels
from isogi_core.cache.place import Place
from isogi_core.errors import StoreAwayError
from isogi_core.frame.texels import Demand
from isogi_core.model.plan import FEWEST, ScenePlan, most_samples
from isogi_core.model.source import SceneSource
from worker.errors import LostWorkerError, WorkersAwayError
from worker.outlook import Outlook, TimeLeft
from worker.pause import Pause
from worker.queue import BakeQueue
from worker.tally import Tally
from worker.tasks import BakeResult, BakeTask
from worker.viewers import GUEST, Viewer
from worker.wants import Key, Want

if TYPE_CHECKING:
    from worker.pool import WorkerPool

log = logging.getLogger("isogi.worker")

WAY = 0.5
"""Seconds for which the workers make way for a view that moves, once it has moved."""

REST, LONGEST_REST = 0.25, 5.0
"""Seconds after which a chunk is looked at again that somebody else was at, and the most in a row: whoever that was
may have been killed."""

Listener = Callable[[str, Index, bool], None]
"""Is told, from any thread, of a chunk of a bake, and whether more of it is going to be baked."""


@dataclass(frozen=True, eq=False)
class Bake:
    """A ``plan`` for the scene in ``source``, the ``digest`` and the ``store`` of its light, and who hears of it.

    ``layers`` are the digests of the layers that it writes; ``costs`` tell what its chunks take. ``parcels`` are what
    workers that lack the scene's files read in their place. Texels lie on the isosurface that is ``shown``, if any.
    """

    source: SceneSource
    plan: ScenePlan
    digest: str
    layers: frozenset[str]
    store: Place
    arrived: Callable[[Index], None]
    costs: Costs
    parcels: Parcels | None = None
    shown: float | None = None


class Baker:
    """One queue and one pool for all scenes. Safe to use from many threads."""

    def __init__(self, clock: Callable[[], float] = time.monotonic, workers: int | None = 1) -> None:
        """Begin without workers: what is wanted waits until ``employ``. So many are to come, None for nobody knows."""
        self._expected = workers
        self._clock = clock
        self._name = uuid4().hex
        self._queue = BakeQueue(clock, self._shared, lambda key: self._bakes[key[0]].costs.rate(key[1]))
        self._outlook = Outlook(clock)
        self._bakes: dict[str, Bake] = {}
        self._pool: WorkerPool | None = None
        self._flying = 0
        self._done_tasks = self._failed_tasks = 0
        self._duplicate = self._healed = 0
        self._paths = 0
        self._way = -WAY
        self._pause = Pause(clock, self._resume)
        self._changed = threading.Condition()
        self._listeners: list[Listener] = []

    def add(self, scene: str, bake: Bake) -> None:
        """Take on the bake of a scene."""
        self._bakes[scene] = bake

    def forget(self, scene: str) -> None:
        """Bake no more of a scene; who waits for its light is told that none is coming."""
        with self._changed:
            bake = self._bakes.pop(scene)
            dropped = self._queue.drop(scene)
            self._changed.notify_all()
        for _, index in dropped:
            self._tell(scene, index, False)
        bake.costs.save()

    def employ(self, pool: "WorkerPool") -> None:
        """Begin to work with ``pool``."""
        with self._changed:
            self._pool = pool
            self._feed()

    def stir(self) -> None:
        """Workers have come, or can be reached again: hand out what there is room for now."""
        with self._changed:
            self._feed()

    def listen(self, listener: Listener) -> None:
        """Tell ``listener`` of every chunk that has new light, or whose task failed."""
        self._listeners.append(listener)

    def want(self, scene: str, demands: Iterable[Demand], target: float, viewer: Viewer = GUEST) -> frozenset[Index]:
        """Ask for the light that a viewer's newest view lacks. Returns the chunks that are going to be baked.

        There are none of a scene that was forgotten.
        """
        wanted: list[tuple[Key, Demand]] = [((scene, demand.index), demand) for demand in demands]
        with self._changed:
            if scene not in self._bakes:
                return frozenset()
            self._queue.want(wanted, target, viewer)
            self._feed()
            return frozenset(want.key[1] for want in self._queue.open(key for key, _ in wanted))

    def make_way(self) -> None:
        """Somebody moves a view: for WAY seconds half the workers rest, and the others stand back.

        One task apiece flies for these. Frames and a browser have the cores to themselves then. Workers on other
        machines are in nobody's way, and go on.
        """
        pool = self._pool
        if pool is not None and pool.step_back(WAY):
            self._way = self._clock()

    def leave(self, viewer: Viewer) -> None:
        """Bake no more for a viewer that has gone."""
        with self._changed:
            self._queue.leave(viewer)

    def wait(self, scene: str, indices: Iterable[Index], seconds: float) -> None:
        """Block until all light wanted of these chunks is baked or given up, at most ``seconds``."""
        keys: list[Key] = [(scene, index) for index in indices]
        with self._changed:
            self._changed.wait_for(lambda: not self._queue.open(keys), seconds)

    def open(self, scene: str, indices: Iterable[Index], viewer: Viewer = GUEST) -> int:
        """How many of the chunks are waited for, and neither baked nor given up; the viewer's are not forgotten yet."""
        keys: list[Key] = [(scene, index) for index in indices]
        with self._changed:
            self._queue.renew(keys, viewer)
            return len(self._queue.open(keys))

    def failures(self, scene: str, indices: Iterable[Index]) -> dict[Index, str]:
        """Why those of the chunks that were given up were."""
        with self._changed:
            found = self._queue.failures((scene, index) for index in indices)
            return {index: trouble for (_, index), trouble in found.items()}

    def spent(self, scene: str, indices: Iterable[Index]) -> Cost:
        """What tasks at these chunks took so far; nothing where the scene was forgotten."""
        bake = self._bakes.get(scene)
        return Cost() if bake is None else bake.costs.of(indices)

    @property
    def manned(self) -> bool:
        """Whether there is a pool of workers."""
        return self._pool is not None

    @property
    def workers(self) -> int:
        """How many workers there are, or are to come; 1 where nobody knows."""
        pool = self._pool
        return pool.workers if pool is not None else self._expected or 1

    def time_left(self, scene: str, subject: Hashable, indices: Iterable[Index]) -> TimeLeft | None:
        """Seconds until all light that a ``subject`` wants of these chunks is baked; None where that is unknown."""
        with self._changed:
            if scene not in self._bakes:
                return None
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

    def paused(self) -> str:
        """Why nothing is baked for the moment, though it will be: the store is away; empty when all goes well."""
        return self._pause.reason

    def tally(self) -> Tally:
        """What waits, was done, and was lost so far."""
        with self._changed:
            pool, counts = self._pool, self._queue.counts()
            tasks = (self._flying, self._done_tasks, self._failed_tasks, self._duplicate, self._healed)
            people = (0, 0) if pool is None else (pool.workers, pool.deaths)
            return Tally(*counts, *tasks, self._paths, *people)

    def stop(self) -> None:
        """Hand out no more tasks, and have what was learnt of costs kept."""
        with self._changed:
            self._pool = None
            self._pause.end()
            self._changed.notify_all()
        for bake in list(self._bakes.values()):
            bake.costs.save()

    def _shared(self, one: str, other: str) -> bool:
        """Whether two bakes write to a layer that is the same; of one that was forgotten nobody knows."""
        if one == other or one not in self._bakes or other not in self._bakes:
            return one == other
        return not self._bakes[one].layers.isdisjoint(self._bakes[other].layers)

    def _seconds(self, scene: str, wants: Sequence[Want]) -> list[float] | None:
        """Processor seconds that each of the wants will take; None where nothing is known.

        A texel without light is taken to need as many paths as others of the bake did, or will; these may have been
        lit elsewhere, or for another target, so that it is held to what the want's own target is worth.
        """
        costs = self._bakes[scene].costs
        total, left = costs.total, sum(want.effort.left for want in wants)
        rates = [costs.rate(want.key[1]) for want in wants]
        if None in rates or (not total.texels and any(want.effort.unlit for want in wants)):
            return None
        texels = max(total.texels, 1)
        usual, first = (total.paths + left) / texels, total.first / texels
        return [
            rate * (want.effort.left + paths_after_first(usual, want) * want.effort.unlit) + first * want.effort.unlit
            for rate, want in zip(rates, wants, strict=True)
            if rate is not None
        ]

    def _feed(self) -> None:
        """Hand tasks over while there is room for them; the caller holds the lock."""
        while self._pool is not None and self._flying < self._room(self._pool):
            want = self._queue.take()
            if want is None:
                return
            self._flying += 1
            self._submit(self._pool, want)

    def _room(self, pool: "WorkerPool") -> int:
        """How many tasks may be in flight now; none in a pause, or where ``stir`` tells when there is room again."""
        if self._pause.reason:
            return min(int(self._pause.over), pool.room)
        return min(max(pool.workers // 2, 1) if self._clock() - self._way < WAY else pool.room, pool.room)

    def _submit(self, pool: "WorkerPool", want: Want) -> None:
        scene, index = want.key
        bake = self._bakes[scene]
        place = (bake.source, bake.plan, bake.digest, bake.store, index)
        what = (want.offsets, want.footprints, want.until, want.least or 0.0, want.target)
        task = BakeTask(*place, *what, bake.parcels, self._name, want.waited >= LONGEST_REST, bake.shown)
        pool.submit(task, lambda result, error: self._done(scene, bake, task, result, error))

    def _done(
        self, scene: str, bake: Bake, task: BakeTask, result: BakeResult | None, error: BaseException | None
    ) -> None:
        if result is not None and result.elsewhere:
            self._step_aside((scene, task.index))
            return
        if result is not None:
            bake.costs.add(task.index, result.cost)
            bake.arrived(task.index)
        with self._changed:
            self._flying -= 1
            if result is not None:
                self._paths += result.cost.paths
                self._done_tasks += 1
                self._pause.end()
                self._duplicate += result.duplicate
                self._healed += result.healed
                self._queue.finish((scene, task.index), task.offsets, task.target, result)
            elif isinstance(error, WorkersAwayError):
                self._queue.put_off((scene, task.index))
            elif isinstance(error, StoreAwayError):
                self._put_off((scene, task.index), error)
            elif self._pool is not None:
                self._fail((scene, task.index), error)
            self._changed.notify_all()
            self._feed()
            open_still = bool(self._queue.open([(scene, task.index)]))
        self._tell(scene, task.index, open_still)
        bake.costs.save(at_once=self._pool is None)

    def _put_off(self, key: Key, error: StoreAwayError) -> None:
        """A task could not be done for want of the store: nothing is, until it is there again."""
        waited = self._pause.reason
        self._queue.put_off(key)
        if self._pool is not None:
            self._pause.begin(str(error))
        if self._pause.reason and not waited:
            log.error("baking waits for the store: %s", error)

    def _step_aside(self, key: Key) -> None:
        """Somebody else is at a chunk: other chunks come first, and it comes back after a while."""
        with self._changed:
            self._flying -= 1
            self._queue.put_off(key, REST)
            self._feed()
        after(REST, self._resume)

    def _resume(self) -> None:
        """Hand out what can be done again, after a while in which it could not."""
        with self._changed:
            self._feed()

    def _tell(self, scene: str, index: Index, more: bool) -> None:
        for listener in self._listeners:
            listener(scene, index, more)

    def _fail(self, key: Key, error: BaseException | None) -> None:
        scene, index = key
        self._failed_tasks += 1
        log.warning("baking chunk %s of %s failed: %s", index, scene, error)
        lost = isinstance(error, LostWorkerError)
        if self._queue.fail(key, f"Chunk {index} of {scene} cannot be baked: {error}", lost):
            log.error("chunk %s of %s is given up for a while", index, scene)


def after(seconds: float, call: Callable[[], None]) -> None:
    """Have something called from another thread, in so many seconds."""
    timer = threading.Timer(seconds, call)
    timer.daemon = True
    timer.start()


def paths_after_first(usual: float, want: Want) -> float:
    """Paths after its first light of a texel that has none yet, where others take so many as is ``usual``."""
    return min(max(usual, FEWEST), most_samples(want.target)) - FIRST_RUNG
