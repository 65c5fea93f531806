"""Bare copies of the bake: processes without store, queue and scheduler, which a pool of workers is
held against.
"""

import multiprocessing
import time
from collections.abc import Sequence
from multiprocessing.connection import Connection
from typing import Any, NamedTuple

import psutil

from isogi_core.cache.chunk_record import Chunk
from isogi_worker.niceness import stand_behind, worker_niceness
from isogi_worker.tasks import BakeTask, cost_of, open_spec, sample_texels

LONG = 600.0
"""Seconds after which something is taken to hang."""


class Speed(NamedTuple):
    """Paths a second of the wall, and a second of the processor: the latter holds where others use
    the machine.
    """

    wall: float
    processor: float

    def over(self, other: "Speed") -> "Speed":
        """How many times as fast as the ``other``."""
        return Speed(self.wall / other.wall, self.processor / other.processor)


def climb(task: BakeTask) -> int:
    """What a task is without store, queue and scheduler; the paths that it took."""
    spec, _ = open_spec(task.source, task.plan, task.digest, task.store_url)
    light = Chunk.empty(task.index, spec.plan).with_texels(task.offsets).light
    before = light.samples.copy()
    sample_texels(light, spec.prepared.lattice.positions(task.index, task.offsets), spec, task)
    return cost_of(light.samples, before, 0.0).paths


def copy(tasks: Sequence[BakeTask], line: Connection) -> None:
    """The life of one copy, as nice as a worker: bake those of the tasks that are named, until none
    are.
    """
    stand_behind(worker_niceness())
    line.send(climb(tasks[0]))
    while share := line.recv():
        begun = time.perf_counter()
        paths = sum(climb(tasks[number]) for number in share)
        line.send((paths, time.perf_counter() - begun))


class Copies:
    """So many processes that bake ``tasks``, ready when this is made, until it is closed; and their
    ``pids``.
    """

    def __init__(self, tasks: Sequence[BakeTask], most: int) -> None:
        """Start them, and wait until each has baked a task."""
        context = multiprocessing.get_context("spawn")
        self._tasks = len(tasks)
        self._lines: list[Connection] = []
        self.pids: list[int] = []
        for _ in range(most):
            ours, theirs = context.Pipe()
            self._lines.append(ours)
            process = context.Process(target=copy, args=(tasks, theirs), daemon=True)
            process.start()
            self.pids.append(process.pid or 0)
        for line in self._lines:
            told(line)

    def bake(self, copies: int) -> Speed:
        """All tasks in as many shares, at the same time: the sum of what each copy does while it
        works.
        """
        before = processor_seconds()
        for number, line in enumerate(self._lines[:copies]):
            line.send(range(number, self._tasks, copies))
        found = [told(line) for line in self._lines[:copies]]
        spent = processor_seconds() - before
        return Speed(
            sum(paths / seconds for paths, seconds in found),
            sum(paths for paths, _ in found) / spent,
        )

    def close(self) -> None:
        """Have them end."""
        for line in self._lines:
            line.send(())
            line.close()


def told(line: Connection) -> Any:
    """What a copy says; TimeoutError where it says nothing for long."""
    if not line.poll(LONG):
        raise TimeoutError("A copy of the bake says nothing.")
    return line.recv()


def processor_seconds() -> float:
    """Seconds of the processor that this process and all that it has started, and that live, have
    taken.
    """
    own = psutil.Process()
    return sum(sum(each.cpu_times()[:2]) for each in (own, *own.children(recursive=True)))
