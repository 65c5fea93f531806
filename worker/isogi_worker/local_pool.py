"""The worker processes of this machine,
forked from the fork server, with tasks and results over pipes.
"""

import logging
import multiprocessing
import os
import pickle
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Collection, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, NamedTuple

from isogi_core.kernels._compilation import without_main
from isogi_core.model.scene_plan import ScenePlan
from isogi_worker.errors import LostWorkerError, WorkersAwayError, WorkersError
from isogi_worker.fork_server import START_METHOD, start_fork_server
from isogi_worker.local_worker import LAST_SECONDS, Answer, Job, Start, run_worker
from isogi_worker.niceness import worker_niceness
from isogi_worker.pool import (
    MAX_TASK_TEXELS,
    TASKS_AHEAD,
    WORKERS_COMPILE,
    AllDone,
    Done,
    WriteDone,
    all_ended,
)
from isogi_worker.tasks import (
    PLAIN_LAYER_KINDS,
    BakeTask,
    WriteTask,
    attempt,
    bake,
    bake_all,
    kernels_missing,
    write_all,
)

START_SECONDS = 120.0
"""Seconds that the start of the pool waits for each worker in turn.
The first one is late, as the fork server imports code and loads kernels before it forks.
"""

WELCOME_SECONDS = 0.1
"""Seconds after which a start looks again if it was stopped."""

RETRY_SECONDS = 1.0
"""Seconds until a process is started again that ended before it took jobs."""

CLOSING_SECONDS = LAST_SECONDS + 2.0
"""Seconds within which workers end by themselves when the pool is closed."""

WORKERS_LOST = "The worker processes are gone: others are being started."

log = logging.getLogger("isogi.worker")


class Sent(NamedTuple):
    """A job, ``packed`` for a pipe, and the function that is called when it is ``done``."""

    packed: bytes
    done: Callable[[Any, BaseException | None], None]


@dataclass(eq=False)
class LocalWorker:
    """A worker ``process``, the server's ends of its two pipes, and the jobs it was sent, the one
    at work first.

    It is ``here`` once its first answer has come, and is sent waiting jobs from then on.
    """

    process: BaseProcess
    jobs: Connection
    answers: Connection
    here: bool = False
    sent: deque[Sent] = field(default_factory=deque)

    @property
    def pid(self) -> int:
        """The id of the process."""
        return self.process.pid or 0

    def close(self) -> None:
        """Close the pipes, which ends the process."""
        self.jobs.close()
        self.answers.close()


class LocalPool:
    """Worker processes of this machine, each with one thread. If one dies, another is started in
    its place.

    A thread of the pool sends all jobs and reads all answers. A worker answers its jobs in order.
    So if it dies, the first job it was sent is lost, and the others go to another worker.
    """

    connected = True
    together = MAX_TASK_TEXELS
    keeps_light = True
    here = True

    def __init__(
        self,
        workers: int,
        kinds: Collection[str] = PLAIN_LAYER_KINDS,
        stopped: threading.Event | None = None,
    ) -> None:
        """Start ``workers`` processes, and return once all of them run. They then load or compile
        the kernels of layers of these ``kinds``.

        They inherit the environment variables of now. Raises WorkersError if they cannot be
        started, or if ``stopped`` is set before all of them run; those that were started are ended.
        """
        self._start = Start(dict(os.environ), worker_niceness(), tuple(kinds))
        self._number = workers
        self._kinds = set(kinds)
        self._baked = set[str]()
        self._deaths = 0
        self._workers_changed: Callable[[], None] = lambda: None
        self._waiting: deque[Sent] = deque()
        self._ahead: deque[tuple[LocalWorker, Sent]] = deque()
        self._workers: list[LocalWorker] = []
        self._lock = threading.Lock()
        self._closed = False
        self._retry = 0.0
        # A pipe by which other threads wake the pool's thread.
        self._woken, self._waker = multiprocessing.Pipe(duplex=False)
        try:
            start_fork_server()
            # Start all processes before waiting for the first, so that they start at the same time.
            for _ in range(workers):
                self._workers.append(self._begin())
            for worker in self._workers:
                self._welcome(worker, stopped or threading.Event())
        except Exception as error:
            self._end(0.0)
            raise WorkersError(f"Cannot start the workers: {error}") from error
        self._thread = threading.Thread(target=self._run, name="workers", daemon=True)
        self._thread.start()

    @property
    def workers(self) -> int:
        """Number of workers that take jobs, at least 1."""
        return max(len(self.pids()), 1)

    @property
    def deaths(self) -> int:
        """Number of workers that were lost."""
        return self._deaths

    @property
    def room(self) -> int:
        """Most tasks in flight."""
        return TASKS_AHEAD * self.workers

    @property
    def trouble(self) -> str:
        """The reason if nothing can be baked at the moment, else empty."""
        if self.pids():
            return ""
        return WORKERS_LOST

    @property
    def preparing(self) -> str:
        """A sentence for users if the workers compile kernels
        that this machine lacks, else empty.
        """
        lacking = self._kinds - self._baked
        if not self.trouble and kernels_missing(lacking):
            return WORKERS_COMPILE
        return ""

    def on_workers_changed(self, callback: Callable[[], None]) -> None:
        """Call ``callback``, from another thread, whenever workers have come or gone."""
        self._workers_changed = callback

    def submit(self, task: BakeTask, done: Done) -> None:
        """Hand a task over; ``done`` is called from another thread with its result or its error."""
        self._bake(Job(bake, (task,)), task.plan, done)

    def submit_all(self, tasks: Sequence[BakeTask], done: AllDone) -> None:
        """Hand over tasks of one bake, to be done together."""
        self._bake(Job(bake_all, (tasks,)), tasks[0].plan, all_ended(tasks, done))

    def write(self, task: WriteTask, done: WriteDone) -> None:
        """Hand over a task that writes light."""
        self._bake(Job(write_all, (task,)), task.plan, done)

    def prepare(self, work: Callable[[], object]) -> None:
        """Have each worker do some ``work`` before its next task."""
        job = Sent(pickle.dumps(Job(attempt, (work,))), lambda *_: None)
        self.tell([(worker, job) for worker in self._workers])

    def pids(self) -> list[int]:
        """Return the process ids of the workers that take jobs."""
        with self._lock:
            return [worker.pid for worker in self._workers if worker.here]

    def close(self) -> None:
        """Stop the workers. Each ends the job at work if that takes less than LAST_SECONDS."""
        with self._lock:
            self._closed = True
        self._wake()
        self._thread.join()
        left = [*self._waiting, *(sent for worker in self._workers for sent in worker.sent)]
        self._end()
        for sent in left:
            report(sent, None, WorkersAwayError("The workers were stopped."))

    def tell(self, jobs: Iterable[tuple[LocalWorker, Sent]]) -> None:
        """Send jobs to given workers, before jobs that wait for any worker."""
        self._ahead.extend(jobs)
        self._wake()

    def _bake(
        self, job: Job, plan: ScenePlan, done: Callable[[Any, BaseException | None], None]
    ) -> None:
        """Have a worker do a job of a ``plan``."""
        kinds = {layer.kind for layer in plan.layers}
        self._kinds |= kinds

        def end_job(result: Any, error: BaseException | None) -> None:
            """Note that kernels are compiled, and report the end of the job."""
            # A finished task shows that the kernels of its layers are compiled.
            if error is None:
                self._baked.update(kinds)
            done(result, error)

        # Pickle the job here, so that the pool's thread only has to send it.
        sent = Sent(pickle.dumps(job), end_job)
        with self._lock:
            closed = self._closed
            if not closed:
                self._waiting.append(sent)
        # After the pool was closed a job fails at once, from another thread as always.
        if closed:
            away = WorkersAwayError("The workers were stopped.")
            threading.Thread(target=done, args=(None, away), daemon=True).start()
        else:
            self._wake()

    def _wake(self) -> None:
        """Wake the pool's thread, which then looks for work."""
        with suppress(OSError):
            self._waker.send_bytes(b"")

    def _run(self) -> None:
        """Send jobs, read answers, and start workers in place of those that died, until the pool is
        closed. Runs in a thread.
        """
        while not self._closed:
            self._hand_out()
            answers = {worker.answers: worker for worker in self._workers}
            # Wait until a worker answers, a process ends (its pipe is then at its end), or another
            # thread has work. After RETRY_SECONDS a process that could not be started is tried
            # again.
            for ready in wait([self._woken, *answers], RETRY_SECONDS):
                if ready is self._woken:
                    self._woken.recv_bytes()
                elif isinstance(ready, Connection):
                    self._read(answers[ready])
            self._replace()

    def _hand_out(self) -> None:
        """Send jobs to the workers: those that are meant for one of them, and waiting ones to the
        workers with the fewest, until each has TASKS_AHEAD.
        """
        while self._ahead:
            self._send(*self._ahead.popleft())
        # A worker whose first answer has not come may die before it begins: it gets no waiting job.
        while self._waiting:
            here = [worker for worker in self._workers if worker.here]
            free = min(here, key=lambda worker: len(worker.sent), default=None)
            if free is None or len(free.sent) >= TASKS_AHEAD:
                return
            self._send(free, self._waiting.popleft())

    def _send(self, worker: LocalWorker, sent: Sent) -> None:
        """Send a job to a worker.

        Only the thread of the pool does so, as it may have to wait for the pipe.
        """
        worker.sent.append(sent)
        with suppress(OSError):  # its end is noticed when its answers are read
            worker.jobs.send_bytes(sent.packed)

    def _read(self, worker: LocalWorker) -> None:
        """Take an answer of a worker, or note that the worker has died."""
        try:
            packed = worker.answers.recv_bytes()
        except (EOFError, OSError):
            self._bury(worker)
            return
        # The first answer belongs to no job: it says that the process runs and reads jobs.
        if not worker.here:
            worker.here = True
            self._workers_changed()
            return
        sent = worker.sent.popleft()
        try:
            answer: Answer = pickle.loads(packed)
        except Exception as error:
            answer = Answer(None, WorkersError(f"What a worker answered cannot be read: {error}"))
        report(sent, *answer)

    def _bury(self, worker: LocalWorker) -> None:
        """Remove a worker that has died: the job at work is lost, and others take the rest."""
        with self._lock:
            self._workers.remove(worker)
        at_work = worker.sent.popleft() if worker.sent else None
        # Put the jobs that it had not begun back at the head of the queue, in order.
        self._waiting.extendleft(reversed(worker.sent))
        worker.close()
        self._deaths += 1
        # It died while it started, and so may the next one: wait before that is started.
        if not worker.here:
            self._retry = time.monotonic() + RETRY_SECONDS
        log.warning("the worker process %d has died", worker.pid)
        if at_work is not None:
            report(at_work, None, LostWorkerError("the process that was to bake it died."))
        self._workers_changed()

    def _replace(self) -> None:
        """Start processes in place of those that died."""
        while len(self._workers) < self._number and time.monotonic() >= self._retry:
            try:
                started = self._begin()
            except Exception as error:
                log.error("cannot start a worker process: %s", error)
                self._retry = time.monotonic() + RETRY_SECONDS
                return
            with self._lock:
                self._workers.append(started)

    def _begin(self) -> LocalWorker:
        """Start a process, and return it before its first answer has come.

        Raises OSError, or EOFError if the fork server ends meanwhile.
        """
        context: Any = multiprocessing.get_context(START_METHOD)
        # The process reads jobs and writes answers; this process keeps the other two ends.
        job_reader, job_writer = context.Pipe(duplex=False)
        answer_reader, answer_writer = context.Pipe(duplex=False)
        process = context.Process(
            target=run_worker, args=(job_reader, answer_writer, self._start), daemon=True
        )
        # Close the ends of the process here once it has them: each end is then open in one process
        # only, so that either side notices when the other is gone.
        with job_reader, answer_writer, without_main():
            process.start()
        return LocalWorker(process, job_writer, answer_reader)

    def _welcome(self, worker: LocalWorker, stopped: threading.Event) -> None:
        """Wait for the first answer of a process, which it sends before it loads kernels.

        Raises EOFError if it ends before, TimeoutError after START_SECONDS, and WorkersAwayError
        once ``stopped`` is set.
        """
        deadline = time.monotonic() + START_SECONDS
        while not worker.answers.poll(WELCOME_SECONDS):
            if stopped.is_set():
                raise WorkersAwayError("they were stopped before they came.")
            if time.monotonic() > deadline:
                raise TimeoutError(f"none has come within {START_SECONDS:g} seconds.")
        worker.answers.recv_bytes()
        worker.here = True

    def _end(self, seconds: float = CLOSING_SECONDS) -> None:
        """End all processes, and return when they have ended.

        Processes that have not ended by themselves after ``seconds``, counted once for all of them,
        are killed.
        """
        # The end of its pipe of jobs tells a worker to end. Close all of these first, so that the
        # workers end side by side.
        for worker in self._workers:
            worker.jobs.close()
        deadline = time.monotonic() + seconds
        for worker in self._workers:
            if not ended(worker.answers, deadline):
                with suppress(OSError):
                    os.kill(worker.pid, signal.SIGKILL)
            worker.answers.close()
            worker.process.join(CLOSING_SECONDS)
        self._workers.clear()
        self._woken.close()
        self._waker.close()


def ended(answers: Connection, deadline: float) -> bool:
    """Wait until a worker process has ended, which closes its end of the pipe of ``answers``.
    Return True if it ends before the ``deadline``, in seconds of the monotonic clock.

    Answers that still come are dropped.
    """
    try:
        while answers.poll(max(deadline - time.monotonic(), 0.0)):
            answers.recv_bytes()
    except (EOFError, OSError):
        return True
    return False


def report(sent: Sent, result: Any, error: BaseException | None) -> None:
    """Call ``done`` of a job. An error in it is logged, and harms no other job."""
    try:
        sent.done(result, error)
    except Exception:
        log.exception("A result of a worker could not be taken over.")
