"""Runs the studies of a report one after another, and keeps each result as soon as it is there."""

import logging
import math
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Self

from tqdm import tqdm

from isogi_core.errors import Cancelled
from isogi_report.bench import Bench
from isogi_report.journal import Entry, Journal
from isogi_report.sections import Section
from isogi_report.studies import (
    CONVERGENCE_KEY,
    CONVERGENCE_TITLE,
    SPLIT_KEY,
    SPLIT_TITLE,
    SUMMARY_KEY,
    SUMMARY_TITLE,
    study_convergence,
    study_split,
    study_summary,
)
from isogi_server.clocks import ticking
from isogi_server.progress import WEIGHTED_BAR_FORMAT

log = logging.getLogger("isogi.report")

DEADLINE_GRACE_SHARE = 0.1
"""Time beyond the deadline after which a study is cancelled,
as a share of the time of all studies.
"""


@dataclass(frozen=True)
class Study:
    """One question, which ``run`` answers.

    ``weight`` is its rough share of all work; its ``key`` never changes.
    """

    key: str
    title: str
    run: Callable[[Bench], Section]
    weight: float


STUDIES = (
    Study(SUMMARY_KEY, SUMMARY_TITLE, study_summary, 0.25),
    Study(SPLIT_KEY, SPLIT_TITLE, study_split, 0.25),
    Study(CONVERGENCE_KEY, CONVERGENCE_TITLE, study_convergence, 0.5),
)
"""All studies, the most important first. Things that one study makes,
such as the reference, are on the bench for the next.
"""


@dataclass(frozen=True, eq=False)
class Measured:
    """The outcome of all studies.

    - ``done``: entries, in the order of the studies; ``found`` of them were in the journal.
    - ``late``: wanted studies without an entry, as the time was over or a person stopped the work.
    - ``unasked``: studies without an entry that were not wanted.
    - ``failed``: studies that raised an error, with its text.
    - ``hurried``: studies that are done, but measured less for lack of time.
    - ``stopped``: True if a person stopped the work before its end.
    """

    done: tuple[Entry, ...]
    late: tuple[Study, ...]
    unasked: tuple[Study, ...]
    failed: tuple[tuple[Study, str], ...]
    hurried: tuple[Study, ...]
    found: int
    stopped: bool


def measure(
    studies: Sequence[Study], wanted: Sequence[Study], bench: Bench, journal: Journal
) -> Measured:
    """Return the entries of all ``studies`` that the journal has, and run those of the ``wanted``
    ones that it lacks, until the deadline of ``bench`` or Ctrl-C.

    A new entry is kept in the journal, unless its study measured less for lack of time: it is then
    only returned, and measured again by the next report. If a study fails, its error is returned,
    and the next ones are run.
    """
    done = {study.key: entry for study in studies if (entry := journal.find(study.key)) is not None}
    found = len(done)
    stop = threading.Event()
    bar = progress_bar_of(wanted, done, bench.left)
    failed = []
    hurried = []
    with interruptible(bench, stop), limited(bench), bar.ticking():
        for study, result in run_each(
            [each for each in wanted if each.key not in done], bench, bar
        ):
            # The text of an error comes in place of an entry.
            if isinstance(result, str):
                failed.append((study, result))
                continue
            done[study.key] = result
            # Keep only sections that another run could not improve.
            if bench.hurried or bench.left <= 0.0:
                hurried.append(study)
            else:
                journal.keep(study.key, result)
    # Sort the studies that have neither an entry nor an error.
    tried = {*done, *(study.key for study, _ in failed)}
    missing = [study for study in studies if study.key not in tried]
    late = tuple(study for study in missing if study in wanted)
    unasked = tuple(study for study in missing if study not in wanted)
    ordered = tuple(done[study.key] for study in studies if study.key in done)
    # The last study may have been completed in spite of Ctrl-C: nothing was stopped then.
    stopped = stop.is_set() and bool(late)
    return Measured(ordered, late, unasked, tuple(failed), tuple(hurried), found, stopped)


class Pieces:
    """The progress bar of work in pieces of known weight:
    ``total``, of which some was done ``before``, within ``limit`` seconds.
    """

    def __init__(self, what: str, total: float, before: float, limit: float) -> None:
        """Draw the bar."""
        self.end = time.monotonic() + limit
        self.rest = total - before
        self.done = 0.0
        self.taken = 0.0
        self.begun = time.monotonic()
        self._bar = tqdm(desc=what, total=total, initial=before, bar_format=WEIGHTED_BAR_FORMAT)

    @property
    def left(self) -> float:
        """Seconds that the rest takes at the pace so far,
        at most those to the limit; infinite if unknown.
        """
        now = time.monotonic()
        if not self.rest:
            return 0.0
        pace = self.taken / self.done if self.done else math.inf
        rest = max(self.rest * pace - (now - self.begun), 0.0)
        return min(rest, max(self.end - now, 0.0))

    def begin(self, name: str) -> None:
        """Begin a piece of the work."""
        self.begun = time.monotonic()
        self._bar.set_description_str(name)

    def finish(self, weight: float) -> None:
        """End the piece, which had this ``weight``."""
        now = time.monotonic()
        self.rest -= weight
        self.done += weight
        self.taken += now - self.begun
        self.begun = now
        self._bar.update(weight)

    def show(self) -> None:
        """Draw the bar with the time that is left now."""
        left = self.left
        if left < math.inf:
            self._bar.set_postfix_str(f"{tqdm.format_interval(left)} left")
        else:
            self._bar.set_postfix_str("")

    @contextmanager
    def ticking(self) -> Iterator[Self]:
        """Draw the bar every REDRAW_SECONDS while the block runs, and close it in the end."""
        try:
            with ticking(self.show):
                yield self
        finally:
            self.show()
            self._bar.close()


def run_each(
    studies: Iterable[Study], bench: Bench, bar: Pieces
) -> Iterator[tuple[Study, Entry | str]]:
    """Run the studies in turn; yield each with its entry or the text of its error,
    until the time is over or the bench is cancelled.
    """
    for study in studies:
        if bench.left <= 0.0 or bench.cancelled.is_set():
            return
        bar.begin(study.title)
        result = run(study, bench)
        if result is not None:
            bar.finish(study.weight)
            yield study, result


def progress_bar_of(wanted: Sequence[Study], done: Mapping[str, Entry], limit: float) -> Pieces:
    """Return the progress bar of the ``wanted`` studies, which have ``limit`` seconds."""
    total = sum(study.weight for study in wanted)
    before = sum(study.weight for study in wanted if study.key in done)
    return Pieces("report", total, before, limit)


def run(study: Study, bench: Bench) -> Entry | str | None:
    """Run a study, and return its entry;
    the text of its error if it fails, None if it is cancelled.
    """
    begun = time.process_time()
    bench.hurry.clear()
    try:
        return Entry(study.run(bench), time.process_time() - begun)
    except Cancelled:
        # Begin no other study, even if the study itself raised Cancelled.
        bench.cancelled.set()
        return None
    except Exception as error:
        what = " ".join(f"{type(error).__name__}: {error}".split())
        log.error("%s failed: %s", study.title, what)
        log.debug("%s failed", study.title, exc_info=True)
        return what


@contextmanager
def interruptible(bench: Bench, stop: threading.Event) -> Iterator[None]:
    """Let the first Ctrl-C set ``stop`` and cancel the work,
    and the second end the process immediately.
    """

    def ask(*_: object) -> None:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        stop.set()
        bench.cancelled.set()

    # Only the main thread may set handlers of signals.
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    former = signal.signal(signal.SIGINT, ask)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, former)


@contextmanager
def limited(bench: Bench) -> Iterator[None]:
    """Cancel the work if it exceeds its deadline by DEADLINE_GRACE_SHARE.
    Studies look at the deadline themselves before.
    """
    if bench.left == math.inf:
        yield
        return
    # Studies look at the deadline between points; the timer ends one that takes too long.
    timer = threading.Timer(
        max((1.0 + DEADLINE_GRACE_SHARE) * bench.left, 0.0), bench.cancelled.set
    )
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
