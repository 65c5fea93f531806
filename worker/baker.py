"""The baker: gives the workers tasks in the queue's order, and reports the light that has come.

While the store is away it pauses: one task now and then tries whether the store is back.
"""

import logging
import threading
import time
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING
from uuid import uuid4

from isogi_core.cache.costs import Cost, Costs
from isogi_core.cache.fresh_light import FreshLight
from isogi_core.errors import StoreAwayError
from isogi_core.files.scene_file import SceneSource
from isogi_core.frame.demand import Demand
from isogi_core.frame.texel_reading import Stage
from isogi_core.model.scene_plan import MAX_SAMPLES, ScenePlan
from isogi_core.model.volume import Isovalue
from isogi_core.prepared.prepared_scene import Index
from isogi_core.storage.backend import StoreUrl
from worker.bake_requests import GUEST_VIEWER, BakeRequest, Key, Viewer
from worker.errors import LostWorkerError, WorkersAwayError
from worker.progress import Pace, Tally, TimeEstimator, TimeLeft, Work, work_seconds
from worker.queue import BakeQueue
from worker.tasks import Assets, BakeResult, BakeTask, Whole, open_spec
from worker.writer import LOOK_SECONDS, LightWriter

if TYPE_CHECKING:
    from worker.pool import WorkerPool

SHORTEST_PAUSE = 1.0
LONGEST_PAUSE = 8.0
"""Seconds until the first try, and the most that pass until the next; each pause is twice as long
as the last.
"""


class Pause:
    """A pause and its ``reason``, empty while there is none; ``resume`` is called when it is time
    for a try.

    The caller holds its lock around all methods. ``resume`` is called from another thread without
    that lock.
    """

    def __init__(self, clock: Callable[[], float], resume: Callable[[], None]) -> None:
        """Begin without a pause."""
        self.reason = ""
        self._stumbled = False
        self._clock = clock
        self.stir = resume
        self._seconds = SHORTEST_PAUSE
        self._until = 0.0
        self._timer: threading.Timer | None = None

    @property
    def over(self) -> bool:
        """Whether it is time for a try."""
        return self._clock() >= self._until

    def begin(self, reason: str) -> None:
        """Begin or prolong the pause: a task has failed for this ``reason``. A single failure is
        ignored.
        """
        if not self._stumbled:
            self._stumbled = True
            return
        if self.reason and not self.over:
            return
        if self.reason:
            self._seconds = min(2.0 * self._seconds, LONGEST_PAUSE)
        else:
            self._seconds = SHORTEST_PAUSE
        self._until = self._clock() + self._seconds
        self.reason = reason
        self._timer = threading.Timer(self._seconds, self.stir)
        self._timer.daemon = True
        self._timer.start()

    def end(self) -> None:
        """End the pause: a task went well, or the baker stops."""
        self.reason = ""
        self._stumbled = False
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None


log = logging.getLogger("isogi.worker")

CLEAR_CORES_SECONDS = 0.5
"""Seconds for which the workers leave cores free after a view has moved."""

POSTPONE_SECONDS = 0.25
LONGEST_REST = 5.0
"""Seconds for which a chunk is postponed that another baker has claimed, and the most of these
together: the other baker may have been killed."""

Listener = Callable[[str, Index, bool], None]
"""Is called, from any thread, with a bake, a chunk, and whether more of the chunk will be baked."""


@dataclass(frozen=True, eq=False)
class Bake:
    """A bake: the ``plan`` for the scene in ``source``, and the ``digest`` and ``store_url`` of its
    light.

    ``layers`` are the digests of the layers that it writes, ``costs`` the measured costs of its
    chunks. ``arrived`` is called with each chunk that has new light. Workers open the ``assets``,
    where there are some, in place of the scene's files. Texels lie on the isosurface that is
    ``shown``, if any. The scene may be cut from a ``whole``. Its ``light`` stays in memory while it
    converges, where the workers are of this machine.
    """

    source: SceneSource
    plan: ScenePlan
    digest: str
    layers: frozenset[str]
    store_url: StoreUrl
    arrived: Callable[[Index], None]
    costs: Costs
    assets: Assets | None = None
    shown: Isovalue | None = None
    whole: Whole | None = None
    light: FreshLight | None = None


class Baker:
    """One queue and one pool for all scenes; ``paths`` counts those baked. Safe to use from many
    threads.
    """

    def __init__(
        self, clock: Callable[[], float] = time.monotonic, workers: int | None = 1
    ) -> None:
        """Begin without a pool: requests wait until ``employ``. ``workers`` is the expected number,
        None if unknown.
        """
        self._expected = workers
        self._clock = clock
        self._name = uuid4().hex
        self._queue = BakeQueue(
            clock, self._shared, lambda key: self._bakes[key[0]].costs.rate(key[1])
        )
        self._estimator = TimeEstimator(clock)
        self._pace = Pace(clock)
        self._bakes: dict[str, Bake] = {}
        self._pool: WorkerPool | None = None
        self._writer: LightWriter | None = None
        self._stopped = threading.Event()
        self._looker: threading.Thread | None = None
        self._in_flight = 0
        self._done_tasks = self._done_chunks = self._failed_tasks = 0
        self._duplicate = self._healed = self._kept = 0
        self.paths = 0
        self._seconds = 0.0
        self._way = -CLEAR_CORES_SECONDS
        self._pause = Pause(clock, self.stir)
        self._changed = threading.Condition()
        self._listeners: list[Listener] = []

    def add(self, scene: str, bake: Bake) -> None:
        """Add the bake of a scene; what a whole has that it was cut from is written for it."""
        self._bakes[scene] = bake
        if bake.whole is not None and self._writer is not None:
            self._writer.write()

    def forget(self, scene: str) -> None:
        """Drop a scene's bake; listeners learn that no more of its chunks is baked."""
        with self._changed:
            bake = self._bakes.pop(scene)
            dropped = self._queue.drop(scene)
            self._changed.notify_all()
        for _, index in dropped:
            self._notify(scene, index, False)
        bake.costs.save()

    def employ(self, pool: "WorkerPool") -> None:
        """Begin to hand out tasks to ``pool``."""
        with self._changed:
            self._pool = pool
            if pool.keeps_light:
                self._writer = LightWriter(pool, self._met, self.stir)
                self._looker = threading.Thread(target=self._look, name="writing", daemon=True)
                self._looker.start()
            self._feed()

    def prepare(self, scene: str | None = None) -> None:
        """Have every worker open what a bake of a scene needs, by default the first one, before a
        view asks for it.
        """
        pool = self._pool
        bake = self._bakes.get(scene or next(iter(self._bakes), ""))
        if pool is not None and bake is not None:
            pool.prepare(
                partial(open_spec, bake.source, bake.plan, bake.digest, bake.store_url, bake.assets)
            )

    def stir(self) -> None:
        """Hand out the tasks that there is room for: workers have come, can be reached again, or a
        pause is over.
        """
        with self._changed:
            self._feed()

    def listen(self, listener: Listener) -> None:
        """Call ``listener`` for every chunk that has new light, or whose task failed."""
        self._listeners.append(listener)

    def request(
        self,
        scene: str,
        demands: Iterable[Demand],
        target: float,
        viewer: Viewer = GUEST_VIEWER,
        enough: int = MAX_SAMPLES,
    ) -> frozenset[Index]:
        """Request the light that a viewer's newest view lacks. Returns the chunks that will be
        baked, or have been since the view was drawn.

        There are none where the scene was dropped.
        """
        wanted: list[tuple[Key, Demand]] = [((scene, demand.index), demand) for demand in demands]
        with self._changed:
            if scene not in self._bakes:
                return frozenset()
            stale = self._queue.request(wanted, target, viewer, enough)
            self._feed()
            coming = self._queue.open(key for key, _ in wanted)
            return frozenset(index for _, index in (*stale, *(each.key for each in coming)))

    def make_way(self) -> None:
        """Leave cores to frames and a browser while a view moves: for CLEAR_CORES_SECONDS half the
        workers rest.

        The others get one task each, at lower priority. Workers on other machines go on.
        """
        pool = self._pool
        if pool is not None and pool.step_back(CLEAR_CORES_SECONDS):
            self._way = self._clock()

    def leave(self, viewer: Viewer) -> None:
        """Drop the requests of a viewer that has gone."""
        with self._changed:
            self._queue.leave(viewer)

    def wait(self, scene: str, indices: Iterable[Index], seconds: float) -> None:
        """Block until all requests of these chunks are done or given up, at most ``seconds``."""
        keys: list[Key] = [(scene, index) for index in indices]
        with self._changed:
            self._changed.wait_for(lambda: not self._queue.open(keys), seconds)

    def open(self, scene: str, indices: Iterable[Index], viewer: Viewer = GUEST_VIEWER) -> int:
        """Count the chunks with open requests, neither done nor given up, and renew the viewer's
        interest in them.
        """
        keys: list[Key] = [(scene, index) for index in indices]
        with self._changed:
            self._queue.renew(keys, viewer)
            return len(self._queue.open(keys))

    def failures(self, scene: str, indices: Iterable[Index]) -> dict[Index, str]:
        """The reasons for which chunks were given up."""
        with self._changed:
            found = self._queue.failures((scene, index) for index in indices)
            return {index: trouble for (_, index), trouble in found.items()}

    def spent(self, scene: str, indices: Iterable[Index]) -> Cost:
        """The cost of these chunks' tasks so far; none where the scene was dropped."""
        bake = self._bakes.get(scene)
        if bake is None:
            return Cost()
        return bake.costs.of(indices)

    @property
    def manned(self) -> bool:
        """Whether there is a pool of workers."""
        return self._pool is not None

    @property
    def workers(self) -> int:
        """Number of workers, present or expected; 1 where that is unknown."""
        pool = self._pool
        if pool is not None:
            return pool.workers
        return self._expected or 1

    def time_left(
        self, scene: str, subject: Hashable, indices: Iterable[Index], later: Iterable[Stage] = ()
    ) -> TimeLeft | None:
        """Estimate the time until all requests of these chunks, and ``later`` stages of the same
        picture, are done.

        None where their cost is unknown.
        """
        with self._changed:
            if scene not in self._bakes:
                return None
            open_now = self._queue.open((scene, index) for index in indices)
            work = [Work(each.key[1], each.effort, each.target, each.enough) for each in open_now]
            work += [
                Work(each.index, each.effort, stage.target, stage.enough)
                for stage in later
                for each in stage.demands
            ]
            seconds = work_seconds(work, self._bakes[scene].costs)
            if self._pool is None:
                workers = self._expected
            else:
                workers = self._pool.workers
            if seconds is None or workers is None:
                return None
            left = max(sum(seconds) / workers, *seconds, 0.0)
            return self._estimator.estimate(subject, left, self._seconds / workers).times(
                self._pace.value
            )

    def trouble(self) -> str:
        """Why requested light is not baked; empty where all is well."""
        with self._changed:
            return self._queue.trouble()

    def paused(self) -> str:
        """Why baking is paused: the store is away; empty where it is not."""
        return self._pause.reason or (self._writer.reason if self._writer else "")

    def tally(self) -> Tally:
        """Counts of waiting, done and failed work so far."""
        with self._changed:
            pool = self._pool
            counts = self._queue.counts()
            tasks = (
                self._in_flight,
                self._done_tasks,
                self._failed_tasks,
                self._duplicate,
                self._healed,
            )
            if pool is None:
                people = (0, 0)
            else:
                people = (pool.workers, pool.deaths)
            return Tally(*counts, *tasks, self.paths, *people, self._kept, self._done_chunks)

    def stop(self) -> None:
        """Hand out no more tasks, write the light that is in memory, and save the measured
        costs.
        """
        with self._changed:
            self._pool = None
            self._pause.end()
            self._changed.notify_all()
        self._stopped.set()
        if self._looker is not None:
            self._looker.join()
        if self._writer is not None:
            self._writer.finish()
        for bake in list(self._bakes.values()):
            bake.costs.save()

    def write(self) -> None:
        """Write the light that is in memory, and return when it is written."""
        if self._writer is not None:
            self._writer.finish()

    @property
    def unwritten(self) -> int:
        """How many chunks have light that is in memory alone."""
        if self._writer is None:
            return 0
        return self._writer.unwritten

    def _look(self) -> None:
        """Have light written when that is due, until the baker stops."""
        while self._writer is not None and not self._stopped.wait(LOOK_SECONDS):
            self._writer.look(self._wanted)
            with self._changed:
                self._writer.sweep(self._queue.is_busy)

    def _wanted(self, name: str) -> set[Index]:
        """The chunks of a bake that are still to be baked."""
        with self._changed:
            return self._queue.wanted(name)

    def _met(self, name: str, index: Index) -> None:
        """Have light read again that another writer has added to."""
        bake = self._bakes.get(name)
        if bake is not None:
            bake.arrived(index)
            self._notify(name, index, False)

    def _shared(self, one: str, other: str) -> bool:
        """Whether two bakes write to the same layer; False for a bake that was dropped."""
        if one == other or one not in self._bakes or other not in self._bakes:
            return one == other
        return not self._bakes[one].layers.isdisjoint(self._bakes[other].layers)

    def _feed(self) -> None:
        """Hand tasks over while there is room for them; the caller holds the lock."""
        while self._pool is not None and self._in_flight < self._room(self._pool):
            request = self._queue.take()
            if request is None:
                return
            self._fly(1)
            self._submit(
                self._pool, self._queue.take_along(request, self._pool.together, self._pool.room)
            )

    def _fly(self, more: int) -> None:
        """Count so many ``more`` tasks as in flight; the caller holds the lock."""
        self._in_flight += more
        self._pace.working(min(self._in_flight, self.workers))

    def _room(self, pool: "WorkerPool") -> int:
        """How many tasks may be in flight now: none, or one trial, in a pause; fewer while a view
        moves.
        """
        if self._writer is not None and self._writer.reason:
            return 0
        if self._pause.reason:
            return min(int(self._pause.over), pool.room)
        return min(
            max(pool.workers // 2, 1)
            if self._clock() - self._way < CLEAR_CORES_SECONDS
            else pool.room,
            pool.room,
        )

    def _submit(self, pool: "WorkerPool", requests: Sequence[BakeRequest]) -> None:
        """Hand over the tasks of requests of one bake, to be done together."""
        scene = requests[0].key[0]
        bake = self._bakes[scene]
        keeps = self._writer is not None and bake.light is not None
        tasks = [self._task(bake, request, keeps) for request in requests]
        if len(tasks) == 1:
            pool.submit(
                tasks[0], lambda result, error: self._done(scene, bake, tasks, [result or error])
            )
        else:
            pool.submit_all(tasks, lambda outcomes: self._done(scene, bake, tasks, outcomes))

    def _task(self, bake: Bake, request: BakeRequest, keeps: bool) -> BakeTask:
        index = request.key[1]
        place = (bake.source, bake.plan, bake.digest, bake.store_url, index)
        what = (*request.next, request.until, request.target)
        insists = request.waited >= LONGEST_REST
        light = None
        if keeps and bake.light is not None:
            light = bake.light.some(index, request.next[0])
        return BakeTask(
            *place,
            *what,
            bake.assets,
            self._name,
            insists,
            bake.shown,
            bake.whole,
            request.enough,
            keeps,
            light,
        )

    def _done(
        self,
        scene: str,
        bake: Bake,
        tasks: Sequence[BakeTask],
        outcomes: Sequence[BakeResult | BaseException | None],
    ) -> None:
        """Take over what became of tasks that were done together."""
        for task, outcome in zip(tasks, outcomes, strict=True):
            if isinstance(outcome, BakeResult) and not outcome.elsewhere:
                bake.costs.add(task.index, outcome.cost)
                if self._writer is not None and bake.light is not None:
                    self._writer.take(scene, bake.light, task, outcome)
                bake.arrived(task.index)
        with self._changed:
            self._fly(-1)
            self._done_tasks += any(
                isinstance(each, BakeResult) and not each.elsewhere for each in outcomes
            )
            for task, outcome in zip(tasks, outcomes, strict=True):
                self._settle(scene, task, outcome)
            self._changed.notify_all()
            self._feed()
            open_still = [bool(self._queue.open([(scene, task.index)])) for task in tasks]
        for task, outcome, more in zip(tasks, outcomes, open_still, strict=True):
            if not (isinstance(outcome, BakeResult) and outcome.elsewhere):
                self._notify(scene, task.index, more)
        bake.costs.save(at_once=self._pool is None)

    def _settle(
        self, scene: str, task: BakeTask, outcome: BakeResult | BaseException | None
    ) -> None:
        """Note in the queue what became of a task; the caller holds the lock."""
        key = scene, task.index
        if isinstance(outcome, BakeResult) and outcome.elsewhere:
            self._postpone(key)
        elif isinstance(outcome, BakeResult):
            self.paths += outcome.cost.paths
            self._seconds += outcome.cost.seconds
            self._pace.spent(outcome.cost.seconds)
            self._done_chunks += 1
            if task.light is None:  # it has read the store
                self._pause.end()
            self._duplicate += outcome.duplicate
            self._healed += outcome.healed
            self._kept += outcome.kept
            self._queue.finish(key, task.offsets, task.target, outcome, task.enough)
        elif isinstance(outcome, WorkersAwayError):
            self._queue.put_off(key)
        elif isinstance(outcome, StoreAwayError):
            self._put_off(key, outcome)
        elif self._pool is not None:
            self._fail(key, outcome)

    def _put_off(self, key: Key, error: StoreAwayError) -> None:
        """Postpone a task that could not reach the store, and pause baking until the store is there
        again.
        """
        waited = self._pause.reason
        self._queue.put_off(key)
        if self._pool is not None:
            self._pause.begin(str(error))
        if self._pause.reason and not waited:
            log.error("baking waits for the store: %s", error)

    def _postpone(self, key: Key) -> None:
        """Postpone a chunk that another baker has claimed; other chunks come first."""
        self._queue.put_off(key, POSTPONE_SECONDS)
        after(POSTPONE_SECONDS, self.stir)

    def _notify(self, scene: str, index: Index, more: bool) -> None:
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
    """Call a function from another thread, in so many seconds."""
    timer = threading.Timer(seconds, call)
    timer.daemon = True
    timer.start()
