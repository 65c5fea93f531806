"""The baker: hands tasks to the workers in the queue's order, and reports the light that has come.

While the store is away, baking pauses; now and then one task tries whether the store is back.
"""

import logging
import threading
import time
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING
from uuid import uuid4

from isogi_core.bake.noise import Goal
from isogi_core.cache.costs import Cost, Costs
from isogi_core.cache.fresh_light import FreshLight
from isogi_core.errors import StoreAwayError
from isogi_core.files.scene_file import SceneSource
from isogi_core.frame.demand import Demand
from isogi_core.frame.texel_reading import Stage
from isogi_core.model.scene_plan import ScenePlan
from isogi_core.model.volume import Isovalue
from isogi_core.prepared.prepared_scene import Index
from isogi_core.storage.backend import StoreUrl
from isogi_worker.bake_requests import GUEST_VIEWER, BakeRequest, Key, Viewer
from isogi_worker.errors import LostWorkerError, WorkersAwayError
from isogi_worker.progress import Pace, Tally, TimeEstimator, TimeLeft, Work, work_seconds
from isogi_worker.queue import BakeQueue
from isogi_worker.tasks import Assets, BakeResult, BakeTask, Whole, open_spec
from isogi_worker.writer import CHECK_SECONDS, LightWriter

if TYPE_CHECKING:
    from isogi_worker.pool import WorkerPool

SHORTEST_PAUSE = 1.0
LONGEST_PAUSE = 8.0
"""Seconds until the first try, and the longest time between two tries;
each pause is twice as long as the last.
"""


class Pause:
    """A pause in baking for a ``reason``, which is empty if baking goes on. ``resume`` is called
    when it is time for a try.

    The caller must hold the baker's lock around all methods. ``resume`` is called from another
    thread without that lock.
    """

    def __init__(self, clock: Callable[[], float], resume: Callable[[], None]) -> None:
        """Begin without a pause."""
        self.reason = ""
        self._stumbled = False
        self._clock = clock
        self._resume = resume
        self._seconds = SHORTEST_PAUSE
        self._until = 0.0
        self._timer: threading.Timer | None = None

    @property
    def over(self) -> bool:
        """True if it is time for a try."""
        return self._clock() >= self._until

    def begin(self, reason: str) -> None:
        """Begin or prolong the pause, as the store was away for a chunk's task, for this
        ``reason``.

        The first failure is ignored, as one request to a store that works may fail by chance. The
        pause begins at the second one, unless ``end`` was called in between.
        """
        if not self._stumbled:
            self._stumbled = True
            return
        # Tasks that were in flight when the pause began fail too: they do not prolong it.
        if self.reason and not self.over:
            return
        # The task that tried the store after a pause has failed: the next pause is longer.
        if self.reason:
            self._seconds = min(2.0 * self._seconds, LONGEST_PAUSE)
        else:
            self._seconds = SHORTEST_PAUSE
        self._until = self._clock() + self._seconds
        self.reason = reason
        # A timer starts the next try, as nothing else is sure to: tasks are handed out if a view
        # asks for light or a task ends, and perhaps neither happens during the pause.
        self._timer = threading.Timer(self._seconds, self._resume)
        self._timer.daemon = True
        self._timer.start()

    def end(self) -> None:
        """End the pause, and forget a first failure, as a task has read the store, or the baker
        stops.
        """
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
"""Seconds for which a chunk is postponed that another baker has claimed,
and the most of these together, as the other baker may have been killed.
"""

Listener = Callable[[str, Index, bool], None]
"""A function that is called, from any thread, with a bake,
a chunk, and True if more of the chunk will be baked.
"""


@dataclass(frozen=True, eq=False)
class Bake:
    """The bake of a scene by a ``plan``: everything that its tasks have in common.

    - ``source``: the scene. Workers open its ``assets``, if there are any, in place of its files.
    - ``digest``, ``store_url``: the name and the place of its light.
    - ``layers``: digests of the layers that it writes.
    - ``arrived``: called with each chunk that has new light.
    - ``costs``: measured costs of its chunks.
    - ``shown``: if given, texels are projected onto that isosurface.
    - ``whole``: the scene that this one was cut from, if it was.
    - ``light``: light in memory while it converges, if the workers are of this machine.
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
    """Bakes light for all scenes, with one queue and one pool of workers. Safe to use from many
    threads.

    ``paths`` counts the paths baked.
    """

    def __init__(
        self, clock: Callable[[], float] = time.monotonic, workers: int | None = 1
    ) -> None:
        """Begin without a pool: requests wait until ``use_pool`` is called.

        ``workers`` is the expected number of workers, None if unknown.
        """
        self._expected = workers
        self._clock = clock
        # The name of this baker in claims: no other process has had it.
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
        self._writing: threading.Thread | None = None
        self._in_flight = 0
        self._done_tasks = self._done_chunks = self._failed_chunks = 0
        self._duplicate = self._healed = self._kept = 0
        self.paths = 0
        # Seconds of all workers together, each shared by as many as there were when it was done.
        self._worked = 0.0
        # Time at which workers last began to leave cores free for a view that moves.
        self._way = -CLEAR_CORES_SECONDS
        self._pause = Pause(clock, self.dispatch)
        self._changed = threading.Condition()
        self._listeners: list[Listener] = []

    def add(self, scene: str, bake: Bake) -> None:
        """Add the ``bake`` of a ``scene``."""
        self._bakes[scene] = bake
        # A cut may keep light of the whole, which workers read from the store: write all of it that
        # is in memory.
        if bake.whole is not None and self._writer is not None:
            self._writer.write_all()

    def forget(self, scene: str) -> None:
        """Drop the bake of a scene, and tell listeners that no more of its chunks is baked."""
        with self._changed:
            bake = self._bakes.pop(scene)
            dropped = self._queue.drop(scene)
            self._changed.notify_all()
        for _, index in dropped:
            self._notify(scene, index, False)
        bake.costs.save()

    def use_pool(self, pool: "WorkerPool") -> None:
        """Begin to hand out tasks to ``pool``."""
        with self._changed:
            self._pool = pool
            if pool.keeps_light:
                self._writer = LightWriter(pool, self._reread, self.dispatch)
                self._writing = threading.Thread(
                    target=self._write_due, name="writing", daemon=True
                )
                self._writing.start()
            self._feed()

    def prepare(self, scene: str | None = None) -> None:
        """Have every worker open a ``scene``, by default the first one, before a view asks for its
        light. Does not wait for that.

        Nothing is done without a pool, or if there is no such scene. A worker that fails to open it
        reports no error: it opens the scene again with its first task.
        """
        pool = self._pool
        # Without a name take the bake that was added first.
        bake = self._bakes.get(scene or next(iter(self._bakes), ""))
        # Open it by the arguments of its tasks: these find it open then.
        if pool is not None and bake is not None:
            place = (bake.source, bake.plan, bake.digest, bake.store_url)
            pool.prepare(partial(open_spec, *place, bake.assets, bake.shown))

    def dispatch(self) -> None:
        """Hand out tasks if there is room. Call this if workers have come or can be reached again,
        or if a pause is over.
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
        goal: Goal,
        viewer: Viewer = GUEST_VIEWER,
    ) -> frozenset[Index]:
        """Request the light that the newest view of a ``viewer`` lacks for the ``goal`` of its
        picture, by its ``demands``.

        Return the chunks that will be baked, or were baked since the view was drawn; none if the
        scene was dropped.
        """
        wanted: list[tuple[Key, Demand]] = [((scene, demand.index), demand) for demand in demands]
        with self._changed:
            if scene not in self._bakes:
                return frozenset()
            stale = self._queue.request(wanted, goal, viewer)
            self._feed()
            coming = self._queue.open(key for key, _ in wanted)
            return frozenset(index for _, index in (*stale, *(each.key for each in coming)))

    def make_way(self) -> None:
        """Leave cores to frames and a browser while a view moves: half of the workers rest for
        CLEAR_CORES_SECONDS.

        The other half get one task each. Workers on other machines go on.
        """
        pool = self._pool
        if pool is not None and pool.here:
            self._way = self._clock()

    def leave(self, viewer: Viewer) -> None:
        """Drop the requests of a viewer that has gone."""
        with self._changed:
            self._queue.leave(viewer)

    def wait(self, scene: str, indices: Iterable[Index], seconds: float) -> None:
        """Block until all requests of these chunks are done or given up,
        at most for ``seconds``.
        """
        keys: list[Key] = [(scene, index) for index in indices]
        with self._changed:
            self._changed.wait_for(lambda: not self._queue.open(keys), seconds)

    def open(self, scene: str, indices: Iterable[Index], viewer: Viewer = GUEST_VIEWER) -> int:
        """Return the number of these chunks with requests that are neither done nor given up,
        and renew the viewer's interest in them.
        """
        keys: list[Key] = [(scene, index) for index in indices]
        with self._changed:
            self._queue.renew(keys, viewer)
            return len(self._queue.open(keys))

    def failures(self, scene: str, indices: Iterable[Index]) -> dict[Index, str]:
        """Return the reasons for which chunks were given up."""
        with self._changed:
            found = self._queue.failures((scene, index) for index in indices)
            return {index: trouble for (_, index), trouble in found.items()}

    def spent(self, scene: str, indices: Iterable[Index]) -> Cost:
        """Return the cost of these chunks' tasks so far; zero if the scene was dropped."""
        bake = self._bakes.get(scene)
        if bake is None:
            return Cost()
        return bake.costs.of(indices)

    @property
    def manned(self) -> bool:
        """True if there is a pool of workers."""
        return self._pool is not None

    @property
    def workers(self) -> int:
        """Number of workers, present or expected; 1 if that is unknown."""
        pool = self._pool
        if pool is not None:
            return pool.workers
        return self._expected or 1

    def time_left(
        self,
        scene: str,
        subject: Hashable,
        indices: Iterable[Index],
        later: Iterable[Stage] = (),
        like: str = "",
    ) -> TimeLeft | None:
        """Estimate the time until all requests of these chunks, and ``later`` stages of the same
        picture, are done.

        ``subject`` names the picture, so that its earlier estimates can be compared with this one.
        Until a task of this bake is done, its costs are taken to be those of the bake ``like``.
        Return None if the cost of the work is unknown.
        """
        with self._changed:
            if scene not in self._bakes:
                return None
            open_now = self._queue.open((scene, index) for index in indices)
            # Sum up the processor seconds of open requests and of later stages.
            work = [Work(each.key[1], each.effort, each.goal) for each in open_now]
            work += [
                Work(each.index, each.effort, stage.goal)
                for stage in later
                for each in stage.demands
            ]
            seconds = work_seconds(work, self._bakes[scene].costs)
            if seconds is None and like in self._bakes:
                seconds = work_seconds(work, self._bakes[like].costs)
            if self._pool is None:
                workers = self._expected
            else:
                workers = self._pool.workers
            if seconds is None or workers is None:
                return None
            # Workers share the work, but a chunk is not divided among them.
            left = max(sum(seconds) / workers, *seconds, 0.0)
            return self._estimator.estimate(subject, left, self._worked).times(self._pace.value)

    def trouble(self) -> str:
        """Return the reason if requested light cannot be baked, else an empty string."""
        with self._changed:
            return self._queue.trouble()

    def paused(self) -> str:
        """Return the reason if baking is paused because the store is away, else an empty string."""
        return self._pause.reason or (self._writer.reason if self._writer else "")

    def tally(self) -> Tally:
        """Return counts of the work that waits and that was done so far, as of one moment; only the
        numbers of workers change without the lock. Both are 0 without a pool.
        """
        with self._changed:
            pool = self._pool
            waiting, given_up, age = self._queue.counts()
            return Tally(
                waiting=waiting,
                given_up=given_up,
                age=age,
                in_flight=self._in_flight,
                done=self._done_tasks,
                failed=self._failed_chunks,
                duplicate=self._duplicate,
                healed=self._healed,
                paths=self.paths,
                workers=0 if pool is None else pool.workers,
                deaths=0 if pool is None else pool.deaths,
                kept=self._kept,
                chunks=self._done_chunks,
            )

    def stop(self) -> None:
        """Hand out no more tasks, write the light that is in memory, and save measured costs."""
        # Without a pool no task is handed out, and nobody waits any longer for light.
        with self._changed:
            self._pool = None
            self._pause.end()
            self._changed.notify_all()
        # End the thread that writes due light before the rest is written.
        self._stopped.set()
        if self._writing is not None:
            self._writing.join()
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
        """Number of chunks with light that is in memory only."""
        if self._writer is None:
            return 0
        return self._writer.unwritten

    def _write_due(self) -> None:
        """Have due light written, and written light forgotten, until the baker stops.

        Runs in a thread.
        """
        while self._writer is not None and not self._stopped.wait(CHECK_SECONDS):
            self._writer.write_due(self._wanted)
            with self._changed:
                self._writer.sweep(self._queue.is_busy)

    def _wanted(self, name: str) -> set[Index]:
        """Return the chunks of the bake ``name`` that have open requests."""
        with self._changed:
            return self._queue.wanted(name)

    def _reread(self, name: str, index: Index) -> None:
        """Have views read the chunk ``index`` of the bake ``name`` again, as the writer has found
        that another process has added light to it.

        Listeners are told that more of it will come if it has open requests.
        """
        bake = self._bakes.get(name)
        if bake is None:
            return
        bake.arrived(index)
        with self._changed:
            more = bool(self._queue.open([(name, index)]))
        self._notify(name, index, more)

    def _shared(self, one: str, other: str) -> bool:
        """Return True if two bakes write to the same layer,
        or are the same; False for a bake that was dropped.
        """
        if one == other or one not in self._bakes or other not in self._bakes:
            return one == other
        return not self._bakes[one].layers.isdisjoint(self._bakes[other].layers)

    def _feed(self) -> None:
        """Hand out tasks while there is room and the queue has requests that can start. The caller
        must hold the lock.
        """
        while self._pool is not None and self._in_flight < self._room(self._pool):
            request = self._queue.take()
            if request is None:
                return
            self._fly(1)
            # Join requests up to the texels that the pool takes in one task. If little work waits,
            # share it among all tasks that the pool can have in flight.
            most_texels = self._pool.together
            tasks = self._pool.room
            self._submit(self._pool, self._queue.take_along(request, most_texels, tasks))

    def _fly(self, more: int) -> None:
        """Add ``more`` to the number of tasks in flight. The caller must hold the lock."""
        self._in_flight += more
        self._pace.working(min(self._in_flight, self.workers))

    def _room(self, pool: "WorkerPool") -> int:
        """Return the number of tasks that may be in flight now.

        It is at most ``pool.room``, which is 0 while the workers cannot be reached.
        """
        # While the store takes no light, more of it would only fill memory.
        if self._writer is not None and self._writer.reason:
            return 0
        # In a pause nothing is handed out; when it is over, a single task tries the store.
        if self._pause.reason:
            return min(int(self._pause.over), pool.room)
        # While a view moves, half of the workers have one task each.
        if self._clock() - self._way < CLEAR_CORES_SECONDS:
            return min(max(pool.workers // 2, 1), pool.room)
        return pool.room

    def _submit(self, pool: "WorkerPool", requests: Sequence[BakeRequest]) -> None:
        """Hand over a BakeTask for each of the ``requests``, all to be done together: they count as
        one task in flight. The caller must hold the lock.

        There is at least one request, and all are of the same bake and goal. The pool calls
        ``_done`` with their outcomes from another thread.
        """
        scene = requests[0].key[0]
        bake = self._bakes[scene]
        keeps = self._writer is not None and bake.light is not None
        tasks = [self._task(bake, request, keeps) for request in requests]
        if len(tasks) == 1:

            def ended(result: BakeResult | None, error: BaseException | None) -> None:
                """Take over the outcome of the only task."""
                outcome = error if result is None else result
                self._done(scene, bake, tasks, [outcome])

            pool.submit(tasks[0], ended)
        else:
            pool.submit_all(tasks, lambda outcomes: self._done(scene, bake, tasks, outcomes))

    def _task(self, bake: Bake, request: BakeRequest, keeps: bool) -> BakeTask:
        """Return the task of a request."""
        index = request.key[1]
        place = (bake.source, bake.plan, bake.digest, bake.store_url, index)
        what = (*request.next, request.until, request.goal)
        # The other baker may have been killed: after LONGEST_REST its claim counts no more.
        insists = request.waited >= LONGEST_REST
        # A worker needs no read of the store if the light of its texels is in memory.
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
        """Take over the outcomes of tasks that were done together, from a thread of the pool."""
        # Keep new light first, so that a view that is notified of it finds it.
        for task, outcome in zip(tasks, outcomes, strict=True):
            if isinstance(outcome, BakeResult) and not outcome.elsewhere:
                bake.costs.add(task.index, outcome.cost)
                if self._writer is not None and bake.light is not None:
                    self._writer.take(scene, bake.light, task, outcome)
                bake.arrived(task.index)
        # Then tell the queue, and hand out the next tasks.
        with self._changed:
            self._fly(-1)
            self._done_tasks += any(
                isinstance(each, BakeResult) and not each.elsewhere for each in outcomes
            )
            for task, outcome in zip(tasks, outcomes, strict=True):
                self._settle(scene, task, outcome)
            # Tasks that were done together failed together: one failure of the store counts once.
            for error in {id(each): each for each in outcomes}.values():
                if isinstance(error, StoreAwayError):
                    self._pause_for(error)
            self._changed.notify_all()
            self._feed()
            open_still = [bool(self._queue.open([(scene, task.index)])) for task in tasks]
        # Call listeners last, without the lock, as they may call the baker.
        for task, outcome, more in zip(tasks, outcomes, open_still, strict=True):
            if not (isinstance(outcome, BakeResult) and outcome.elsewhere):
                self._notify(scene, task.index, more)
        bake.costs.save(at_once=self._pool is None)

    def _settle(
        self, scene: str, task: BakeTask, outcome: BakeResult | BaseException | None
    ) -> None:
        """Tell the queue the outcome of a task. The caller must hold the lock."""
        key = scene, task.index
        if isinstance(outcome, BakeResult) and outcome.elsewhere:
            self._postpone(key)
        elif isinstance(outcome, BakeResult):
            self.paths += outcome.cost.paths
            self._worked += outcome.cost.seconds / self.workers
            self._pace.spent(outcome.cost.seconds)
            self._done_chunks += 1
            # A task that was sent no light has read the store, so the store is there. One that was
            # sent light has not, and shows nothing.
            if task.light is None:
                self._pause.end()
            self._duplicate += outcome.duplicate
            self._healed += outcome.healed
            self._kept += outcome.kept
            self._queue.finish(key, task.offsets, task.goal, outcome)
        elif isinstance(outcome, WorkersAwayError):
            # The workers are gone, which is no fault of the chunk: try it again when others come.
            self._queue.put_off(key)
        elif isinstance(outcome, StoreAwayError):
            # The chunk is not to blame: the task does not count as a failure of it.
            self._queue.put_off(key)
        elif self._pool is not None:
            # Tasks that end after the baker has stopped do not count as failures.
            self._fail(key, outcome)

    def _pause_for(self, error: StoreAwayError) -> None:
        """Note that a task could not reach the store. From the second such task on, baking pauses
        until the store is back: see ``Pause.begin``. The caller must hold the lock.
        """
        former_reason = self._pause.reason
        # A baker that has stopped has no pool, and needs no pause.
        if self._pool is not None:
            self._pause.begin(str(error))
        # Log the beginning of a pause only, and not each try that fails during it.
        if self._pause.reason and not former_reason:
            log.error("baking waits for the store: %s", error)

    def _postpone(self, key: Key) -> None:
        """Postpone a chunk that another baker has claimed, in favour of other chunks."""
        self._queue.put_off(key, POSTPONE_SECONDS)
        after(POSTPONE_SECONDS, self.dispatch)

    def _notify(self, scene: str, index: Index, more: bool) -> None:
        """Call all listeners."""
        for listener in self._listeners:
            listener(scene, index, more)

    def _fail(self, key: Key, error: BaseException | None) -> None:
        """Log that the task of a chunk has failed with an ``error``, and have the queue try it
        again. After several failures the queue gives the chunk up until its request expires: see
        ``bake_requests.MOST_FAILURES``. The caller must hold the lock.
        """
        scene, index = key
        self._failed_chunks += 1
        log.warning("baking chunk %s of %s failed: %s", index, scene, error)
        # If a worker died with the task, the queue hands the chunk out alone the next time, as its
        # task may kill workers.
        lost = isinstance(error, LostWorkerError)
        if self._queue.fail(key, f"Chunk {index} of {scene} cannot be baked: {error}", lost):
            log.error("chunk %s of %s is given up for a while", index, scene)


def after(seconds: float, call: Callable[[], None]) -> None:
    """Call a function from another thread after ``seconds``."""
    timer = threading.Timer(seconds, call)
    timer.daemon = True
    timer.start()
