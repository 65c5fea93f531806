"""The interface of the baker to worker processes:
those of this machine, or those of a Dask scheduler.
"""

import threading
from collections.abc import Callable, Collection, Sequence
from typing import Protocol

from isogi_worker.tasks import PLAIN_LAYER_KINDS, BakeResult, BakeTask, WriteTask, Written

MAX_TASK_TEXELS = 1 << 14
"""Most texels of a task. With 1024 and more their paths fill whole waves;
the sums of this many take about 20 MB.
"""

TASKS_AHEAD = 2
"""Tasks in flight per worker: few, as a task in flight can be neither re-ordered nor stopped."""

WORKERS_COMPILE = "The workers compile their kernels."

Done = Callable[[BakeResult | None, BaseException | None], None]
WriteDone = Callable[[Sequence[Written] | None, BaseException | None], None]
AllDone = Callable[[Sequence[BakeResult | BaseException]], None]


class WorkerPool(Protocol):
    """Worker processes that bake, on this machine or others. Safe to use from many threads."""

    @property
    def workers(self) -> int:
        """Number of workers, at least 1, as tasks may wait for the first one."""

    @property
    def deaths(self) -> int:
        """Number of workers that were lost.

        One that is started in the place of another counts as new.
        """

    @property
    def room(self) -> int:
        """Most tasks in flight; none while the workers cannot be reached."""

    @property
    def together(self) -> int:
        """Most texels of a task, which may be of several chunks."""

    @property
    def connected(self) -> bool:
        """True if the workers, or their scheduler, can be reached."""

    @property
    def trouble(self) -> str:
        """The reason if nothing can be baked at the moment, else empty."""

    @property
    def preparing(self) -> str:
        """A sentence for users if the workers compile kernels before they can bake, else empty."""

    def on_workers_changed(self, callback: Callable[[], None]) -> None:
        """Call ``callback``, from another thread, whenever workers have come or gone."""

    def submit(self, task: BakeTask, done: Done) -> None:
        """Hand a task over; ``done`` is called from another thread with its result or its error."""

    def submit_all(self, tasks: Sequence[BakeTask], done: AllDone) -> None:
        """Hand over tasks of one bake, to be done together;
        ``done`` is called with the result or error of each.
        """

    @property
    def keeps_light(self) -> bool:
        """True if the server keeps light while it converges:
        workers hand it back, and write it when asked to.
        """

    def write(self, task: WriteTask, done: WriteDone) -> None:
        """Hand over a task that writes light; ``done`` is called as for ``submit``."""

    def prepare(self, work: Callable[[], object]) -> None:
        """Have each worker of this machine do some ``work`` before its next task.

        Failure is ignored, as that task fails, too.
        """

    @property
    def here(self) -> bool:
        """True if the workers share this machine with the server, and serve no other."""

    def pids(self) -> list[int]:
        """Return the process ids of the workers."""

    def close(self) -> None:
        """Stop the workers that were started here, and leave those that were joined."""


def start_pool(
    workers: int,
    scheduler: str | None = None,
    kinds: Collection[str] = PLAIN_LAYER_KINDS,
    stopped: threading.Event | None = None,
) -> WorkerPool:
    """Start ``workers`` processes of one thread each, or join a ``scheduler`` by its address.

    Workers started here immediately load or compile the kernels that bake layers of these
    ``kinds``. Raises WorkersError, also if ``stopped`` is set before they have come, and
    WorkersAwayError if the scheduler cannot be reached.
    """
    if scheduler is not None:
        from isogi_worker.dask_pool import DaskPool  # noqa: PLC0415 (loads Dask)

        return DaskPool(scheduler)
    from isogi_worker.local_pool import LocalPool  # noqa: PLC0415 (it imports this)

    return LocalPool(workers, kinds, stopped)


def all_ended(tasks: Sequence[BakeTask], done: AllDone) -> Callable[..., None]:
    """Return a function that calls ``done`` with the outcomes of ``tasks``
    that were done together, or with one error for each of them.
    """

    def ended(
        outcomes: Sequence[BakeResult | BaseException] | None, error: BaseException | None
    ) -> None:
        """Pass on the outcomes, or the error once for each task."""
        if outcomes is None:
            done([error or RuntimeError("Nothing came of the task.")] * len(tasks))
        else:
            done(outcomes)

    return ended
