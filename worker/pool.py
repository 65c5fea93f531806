"""What the baker asks of worker processes: those of this machine, or those of a Dask scheduler."""

import threading
from collections.abc import Callable, Collection, Sequence
from typing import Protocol

from worker.tasks import PLAIN_LAYER_KINDS, BakeResult, BakeTask, WriteTask, Written

MAX_TASK_TEXELS = 1 << 14
"""Most texels of a task: at 1024 and more their paths fill whole waves; the sums of so many take
some 20 MB.
"""

TASKS_AHEAD = 2
"""Tasks in flight per worker: few, as a task in flight can be neither re-ordered nor stopped."""

WORKERS_COMPILE = "The workers compile their kernels."

Done = Callable[[BakeResult | None, BaseException | None], None]
WriteDone = Callable[[Sequence[Written] | None, BaseException | None], None]
AllDone = Callable[[Sequence[BakeResult | BaseException]], None]


class WorkerPool(Protocol):
    """Worker processes that bake, wherever they are. Safe to use from many threads."""

    @property
    def workers(self) -> int:
        """Number of workers, at least 1, as tasks may wait for the first one."""

    @property
    def deaths(self) -> int:
        """Number of workers that were lost; one that is started in its place counts as new."""

    @property
    def room(self) -> int:
        """Most tasks in flight; none while the workers cannot be reached."""

    @property
    def together(self) -> int:
        """Most texels of a task, of as many chunks as that takes."""

    @property
    def connected(self) -> bool:
        """Whether the workers, or their scheduler, can be reached."""

    @property
    def trouble(self) -> str:
        """Why nothing is baked at the moment; empty when all is well."""

    @property
    def preparing(self) -> str:
        """Say what the workers do before they can bake: they compile kernels; else empty."""

    def attend(self, stir: Callable[[], None]) -> None:
        """Call ``stir``, from another thread, whenever workers have come or gone."""

    def submit(self, task: BakeTask, done: Done) -> None:
        """Hand a task over; ``done`` is called from another thread with its result or its error."""

    def submit_all(self, tasks: Sequence[BakeTask], done: AllDone) -> None:
        """Hand tasks of one bake over, to be done together; ``done`` is called with the result or
        error of each.
        """

    @property
    def keeps_light(self) -> bool:
        """Whether the server keeps light that converges: its workers hand it back, and ``write`` it
        when they are told.
        """

    def write(self, task: WriteTask, done: WriteDone) -> None:
        """Have light written; ``done`` is called as for ``submit``."""

    def prepare(self, work: Callable[[], object]) -> None:
        """Have each worker of this machine do some ``work`` ahead of its tasks; if it fails, it
        fails again with these.
        """

    def step_back(self, seconds: float) -> bool:
        """Lower the priority of the workers of this machine for some seconds; False if they are
        not this server's.
        """

    def pids(self) -> list[int]:
        """Process ids of the workers."""

    def close(self) -> None:
        """Stop the workers that were started here, and leave those that were joined."""


def start_pool(
    workers: int,
    scheduler: str | None = None,
    kinds: Collection[str] = PLAIN_LAYER_KINDS,
    stopped: threading.Event | None = None,
) -> WorkerPool:
    """Start ``workers`` processes of one thread each, or join a ``scheduler``.

    Workers started here load or compile the kernels that bake layers of these ``kinds`` at once.
    Raises WorkersError, also if it is ``stopped`` before they have come, and WorkersAwayError if
    the scheduler is not there.
    """
    if scheduler is not None:
        from worker.dask_pool import DaskPool  # noqa: PLC0415 (loads Dask)

        return DaskPool(scheduler)
    from worker.local_pool import LocalPool  # noqa: PLC0415 (it imports this)

    return LocalPool(workers, kinds, stopped)


def all_ended(tasks: Sequence[BakeTask], done: AllDone) -> Callable[..., None]:
    """Take the outcomes of ``tasks`` that were done together, or one error for all of them."""

    def ended(
        outcomes: Sequence[BakeResult | BaseException] | None, error: BaseException | None
    ) -> None:
        if outcomes is None:
            done([error or RuntimeError("Nothing came of the task.")] * len(tasks))
        else:
            done(outcomes)

    return ended
