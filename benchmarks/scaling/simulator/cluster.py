"""Workers that pretend: tasks take their recorded seconds, a store is far away and fails, and
workers die.
"""

import itertools
import random
from collections import deque
from dataclasses import dataclass

from benchmarks.scaling.simulator.light import Light
from benchmarks.scaling.simulator.world import World
from isogi_core.errors import StoreError
from isogi_worker.pool import TASKS_AHEAD, Done
from isogi_worker.tasks import BakeTask

OBJECTS = 4
"""Times that a task asks the store: it reads the chunk of two layers, and writes both."""

RESTART = 3.0
"""Seconds until a worker that died has another in its place, kernels loaded."""


@dataclass(frozen=True)
class Conditions:
    """How many ``workers`` there are, and what they have to put up with.

    Seconds that a call of the store takes (``latency``), the share of calls that ``fail`` and how
    often each is made at most (``tries``), how often a worker dies in an hour (``deaths``), and the
    seconds for which the scheduler is busy with one task (``dispatch``).
    """

    workers: int
    latency: float = 0.002
    fail: float = 0.0
    tries: int = 3
    deaths: float = 0.0
    dispatch: float = 0.001


@dataclass(eq=False)
class Job:
    """A task that was handed over, whom to tell, and how often a worker has begun it."""

    task: BakeTask
    done: Done
    begun: int = 0


class Cluster:
    """Has the face of a ``WorkerPool``. One scheduler passes tasks on, one after the other, first
    come first served.
    """

    def __init__(
        self, world: World, light: Light, conditions: Conditions, chance: random.Random
    ) -> None:
        """Have all workers idle. All of them may die from now on."""
        self.workers = conditions.workers
        self.deaths = self.done = self.failed = self.again = 0
        self.busy = self.lost = 0.0
        self._world = world
        self._light = light
        self._conditions = conditions
        self._chance = chance
        self._free_at = 0.0
        self._ready: deque[Job] = deque()
        self._idle = list(range(conditions.workers))[::-1]
        self._jobs: dict[int, tuple[int, Job]] = {}
        self._numbers = itertools.count()
        self.last_handed = 0.0
        if conditions.deaths:
            self._await_death()

    together = 1
    keeps_light = False
    here = False
    """Chunks are baked one by one here."""

    @property
    def room(self) -> int:
        """How many tasks may be in flight."""
        return TASKS_AHEAD * self.workers

    def submit(self, task: BakeTask, done: Done) -> None:
        """Hand a task to the scheduler, which has others to pass on first."""
        self.last_handed = self._world.now
        self._free_at = max(self._free_at, self._world.now) + self._conditions.dispatch
        job = Job(task, done)
        self._world.after(self._free_at - self._world.now, lambda: self._pass_on(job))

    def _pass_on(self, job: Job) -> None:
        self._ready.append(job)
        self._work()

    def _work(self) -> None:
        """Give tasks to workers that have none."""
        while self._ready and self._idle:
            worker = self._idle.pop()
            job = self._ready.popleft()
            job.begun += 1
            self.again += job.begun > 1
            number = next(self._numbers)
            self._jobs[worker] = number, job
            self._world.after(0.0, lambda w=worker, n=number: self._begin(w, n))  # type: ignore[misc]

    def _begin(self, worker: int, number: int) -> None:
        """A worker reads the chunk, bakes it, and writes it. What it would bake is not there before
        that.
        """
        job = self._jobs[worker][1]
        asked, calls = self._ask(OBJECTS // 2)
        if not asked:
            self._world.after(
                calls * self._conditions.latency, lambda: self._end(worker, number, None)
            )
            return
        seconds = self._seconds(job.task)
        kept, more = self._ask(OBJECTS // 2)
        taken = seconds + (calls + more) * self._conditions.latency
        self._world.after(
            taken, lambda: self._end(worker, number, seconds if kept else None, seconds)
        )

    def _ask(self, objects: int) -> tuple[bool, int]:
        """Whether the store did what was asked of it for so many objects, and the calls that this
        took.
        """
        calls = 0
        for _ in range(objects):
            tries = next((n for n in range(self._conditions.tries) if not self._fails()), None)
            if tries is None:
                calls += self._conditions.tries
            else:
                calls += tries + 1
            if tries is None:
                return False, calls
        return True, calls

    def _fails(self) -> bool:
        return self._conditions.fail > 0.0 and self._chance.random() < self._conditions.fail

    def _seconds(self, task: BakeTask) -> float:
        """What the bake of a task will take; the queue lets nobody else change its chunk
        meanwhile.
        """
        return self._light.price(task.source.name, task.index[2], task.offsets)

    def _end(self, worker: int, number: int, kept: float | None, spent: float = 0.0) -> None:
        """A task has ended, unless its worker did before; what could not be kept is lost."""
        if self._jobs.get(worker, (None,))[0] != number:
            return
        job = self._jobs.pop(worker)[1]
        self._idle.append(worker)
        self._work()
        if kept is None:
            self.failed = self.failed + 1
            self.lost = self.lost + spent
            job.done(None, StoreError("The store did not answer."))
            return
        self.done = self.done + 1
        self.busy = self.busy + kept
        job.done(self._light.bake(job.task.source.name, job.task.index[2], job.task.offsets), None)

    def _await_death(self) -> None:
        rate = self._conditions.deaths * self._conditions.workers / 3600.0
        self._world.after(self._chance.expovariate(rate), self._die)

    def _die(self) -> None:
        """One of all workers dies; the scheduler passes its task on again, before all others."""
        self._await_death()
        worker = self._chance.randrange(self._conditions.workers)
        if worker not in self._jobs and worker not in self._idle:
            return
        self.deaths = self.deaths + 1
        self.workers = self.workers - 1
        if worker in self._jobs:
            self._ready.appendleft(self._jobs.pop(worker)[1])
        else:
            self._idle.remove(worker)
        self._world.after(RESTART, lambda: self._come(worker))

    def _come(self, worker: int) -> None:
        self.workers += 1
        self._idle.append(worker)
        self._work()
