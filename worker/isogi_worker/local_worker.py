"""A worker process of this machine: it takes jobs from one pipe, and answers each on another."""

import os
import pickle
import queue
import signal
import threading
import time
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from functools import partial
from multiprocessing.connection import Connection
from typing import Any, NamedTuple

from isogi_worker.errors import WorkersError
from isogi_worker.niceness import stand_behind
from isogi_worker.tasks import attempt, load_kernels


class Job(NamedTuple):
    """A call of ``work`` with the arguments ``what``. Both can be pickled."""

    work: Callable[..., Any]
    what: tuple[Any, ...] = ()


class Answer(NamedTuple):
    """The ``result`` of a job, or the ``error`` that it raised."""

    result: Any
    error: BaseException | None = None


class Start(NamedTuple):
    """The arguments of a worker: its ``environment`` and ``niceness``,
    and the ``kinds`` of layers whose kernels it loads.
    """

    environment: Mapping[str, str]
    niceness: int
    kinds: Collection[str]


LAST_SECONDS = 1.0
"""Seconds that the job at work may take once the server has closed the pipe, or has ended."""


TERM_SECONDS = 5.0
"""Seconds that a worker lives on after SIGTERM. A signal to the whole process group
reaches the server, too, which has its workers write light before it closes their pipes.
"""


def run_worker(jobs: Connection, answers: Connection, start: Start) -> None:
    """Do one job after the other until the server closes the pipe or ends.

    The first answer belongs to no job: it says that the process runs and reads jobs. After it, and
    before the first job, the process loads its kernels.
    """
    # Leave Ctrl-C to the server, which also gets it, and outlive a signal to end for a while.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, end_later)
    os.environ.clear()
    os.environ.update(start.environment)
    stand_behind(start.niceness)
    # A thread reads the pipe, so that the server never waits for this process to finish a job.
    waiting: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
    closed = threading.Event()
    reader = threading.Thread(target=read_jobs, args=(jobs, waiting, closed), daemon=True)
    reader.start()
    with suppress(OSError):  # the server is gone
        answers.send_bytes(pickle.dumps(Answer(os.getpid())))
        attempt(partial(load_kernels, tuple(start.kinds)))
        # After the end of the pipe the queue may hold more jobs: nobody waits for them.
        while (sent := waiting.get()) is not None and not closed.is_set():
            answers.send_bytes(answer_to(sent))


def end_later(*_: object) -> None:
    """End the process after TERM_SECONDS."""
    timer = threading.Timer(TERM_SECONDS, os._exit, [0])
    timer.daemon = True
    timer.start()


def read_jobs(
    jobs: Connection, waiting: "queue.SimpleQueue[bytes | None]", closed: threading.Event
) -> None:
    """Read jobs from the pipe into a queue, so that the server never waits. At the pipe's end, end
    the process.

    A job at work may be interrupted by that, as each object is written whole or not at all.
    """
    with suppress(EOFError, OSError):
        while True:
            waiting.put(jobs.recv_bytes())
    closed.set()
    waiting.put(None)
    time.sleep(LAST_SECONDS)
    os._exit(0)


def answer_to(sent: bytes) -> bytes:
    """Do a job that was sent, and return the pickled answer."""
    try:
        job: Job = pickle.loads(sent)
        return pickle.dumps(Answer(job.work(*job.what)))
    except Exception as error:
        return packed_error(error)


def packed_error(error: Exception) -> bytes:
    """Return an error as a pickled answer; only its text if it cannot be pickled and read again."""
    try:
        packed = pickle.dumps(Answer(None, error))
        # Some errors can be pickled but not read again.
        pickle.loads(packed)
    except Exception:
        packed = pickle.dumps(Answer(None, WorkersError(f"A worker failed: {error!r}")))
    return packed
