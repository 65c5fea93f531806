"""Failpoints: places in the life of a chunk at which a worker fails when a test says so.

The workers of a test run ``run_failing_worker``. To arm one, a file is put into the folder
``$ISOGI_TEST_FAILPOINTS``: its name is a point, a fault and anything, such as ``mid_write.kill.1``;
who takes the file away does the fault, once. A file whose name ends with ``.always`` stays, and one
with ``@1_2_3`` after its fault is for that chunk alone.
"""

import errno
import os
import signal
import time
from collections.abc import Callable
from functools import wraps
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from isogi_core.cache.layer import LayerStore
from isogi_worker import tasks
from isogi_worker.local_worker import Start, run_worker

POINTS = ("before_bake", "before_write", "mid_write", "after_write", "after_bake")
"""Before a task reads its chunk; before a layer's object is written, when it is but has not its
name yet, and when it has; and after the task has written, which nobody hears of then."""

ERRORS = ("EIO", "ENOSPC", "EACCES")
FAULTS = ("kill", *ERRORS, "sleep")
FOLDER = "ISOGI_TEST_FAILPOINTS"
SLEEP = 0.5


def run_failing_worker(jobs: Connection, answers: Connection, start: Start) -> None:
    """Run a worker with the failpoints in it."""
    set_up()
    run_worker(jobs, answers, start)


def set_up() -> None:
    """Put the failpoints around what a worker does."""
    tasks.Work.begin = staticmethod(  # type: ignore[method-assign, assignment]
        around(tasks.Work.begin, lambda task, _: task.index, before="before_bake")
    )
    tasks.Work.end = around(tasks.Work.end, lambda work, *_: work.chunk.index, after="after_bake")  # type: ignore[method-assign]
    LayerStore.save = around(  # type: ignore[method-assign]
        LayerStore.save, lambda _, index, *__: index, before="before_write", after="after_write"
    )
    os.replace = replacing(os.replace)


def around(
    function: Callable[..., Any],
    chunk_of: Callable[..., tuple[int, ...]],
    before: str = "",
    after: str = "",
) -> Callable[..., Any]:
    """A function with a point before it and one after, where these have names."""

    @wraps(function)
    def wrapped(*args: Any, **kwargs: Any) -> Any:
        if before:
            reach(before, tuple(chunk_of(*args)))
        result = function(*args, **kwargs)
        if after:
            reach(after, tuple(chunk_of(*args)))
        return result

    return wrapped


def replacing(replace: Callable[..., None]) -> Callable[..., None]:
    """``os.replace`` with a point before a chunk's object gets its name."""

    @wraps(replace)
    def wrapped(source: Any, to: Any, **kwargs: Any) -> None:
        parts = Path(os.fspath(to)).parts
        if len(parts) > 5 and parts[-5] == "c":
            reach("mid_write", tuple(map(int, parts[-4:-1])))
        replace(source, to, **kwargs)

    return wrapped


def reach(point: str, chunk: tuple[int, ...]) -> None:
    """Do the fault that is armed for a point, if one is."""
    for path in sorted(Path(os.environ[FOLDER]).glob(f"{point}.*")):
        fault, _, only = path.name.split(".")[1].partition("@")
        if only in ("", "_".join(map(str, chunk))) and (path.suffix == ".always" or taken(path)):
            do(fault)


def taken(path: Path) -> bool:
    """Whether this process is the one that took a file away."""
    try:
        path.unlink()
    except FileNotFoundError:
        return False
    return True


def do(fault: str) -> None:
    """Die, raise or wait."""
    if fault == "kill":
        os.kill(os.getpid(), signal.SIGKILL)
    if fault == "sleep":
        time.sleep(SLEEP)
        return
    raise OSError(getattr(errno, fault), os.strerror(getattr(errno, fault)))
