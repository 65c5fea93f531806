"""Measuring the studies of a report one after another, each kept as soon as it is done."""

import signal
import threading
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

from isogi_core.errors import Cancelled
from isogi_core.report.bench import Bench
from isogi_core.report.studies import Study
from server.report.journal import Entry, Journal
from server.report.progress import Progress, ticking

GRACE = 0.1
"""What a study may take beyond its deadline, of the time that all of them had, before it is cancelled."""


@dataclass(frozen=True, eq=False)
class Measured:
    """What became of the studies: entries that are ``done``, in order, and studies that are not.

    ``late`` are those for which there was no time, ``unasked`` those that nobody wants now; ``found`` of those
    that are done were in the journal; ``stopped`` is whether a person stopped the work.
    """

    done: tuple[Entry, ...]
    late: tuple[Study, ...]
    unasked: tuple[Study, ...]
    found: int
    stopped: bool


def measure(studies: Sequence[Study], wanted: Sequence[Study], bench: Bench, journal: Journal) -> Measured:
    """Run the ``wanted`` of all ``studies`` that the journal lacks, until the deadline of ``bench`` or a Ctrl-C.

    A study that ends after the deadline is shown, but not kept: it may have left something out.
    """
    done = {study.key: entry for study in studies if (entry := journal.find(study.key)) is not None}
    found, stop, bar = len(done), threading.Event(), progress_of(wanted, done, bench.left)
    with interruptible(bench, stop), limited(bench), ticking(bar):
        for study, entry in worked([each for each in wanted if each.key not in done], bench, bar):
            done[study.key] = entry
            if bench.left > 0.0:
                journal.keep(study.key, entry)
    missing = [study for study in studies if study.key not in done]
    late, unasked = (tuple(each for each in missing if (each in wanted) is asked) for asked in (True, False))
    ordered = tuple(done[study.key] for study in studies if study.key in done)
    return Measured(ordered, late, unasked, found, stop.is_set())


def worked(studies: Iterable[Study], bench: Bench, bar: Progress) -> Iterator[tuple[Study, Entry]]:
    """The studies one after another, with what they found, until there is no time left or they are cancelled."""
    for study in studies:
        if bench.left <= 0.0 or bench.cancelled.is_set():
            return
        bar.begin(study.title)
        entry = run(study, bench)
        if entry is not None:
            bar.finish(study.weight)
            yield study, entry


def progress_of(wanted: Sequence[Study], done: Mapping[str, Entry], limit: float) -> Progress:
    """The bar of the ``wanted`` studies; ``limit`` is the seconds that they have."""
    total, before = (sum(each.weight for each in wanted if each.key in done or some) for some in (True, False))
    return Progress(total, before, limit)


def run(study: Study, bench: Bench) -> Entry | None:
    """The study's section and what it took; None where it was cancelled."""
    begun = time.process_time()
    try:
        return Entry(study.run(bench), time.process_time() - begun)
    except (Cancelled, KeyboardInterrupt):
        bench.cancelled.set()
        return None


@contextmanager
def interruptible(bench: Bench, stop: threading.Event) -> Iterator[None]:
    """Have the first Ctrl-C set ``stop`` and cancel the work, and the second one end it at once."""

    def ask(*_: object) -> None:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        stop.set()
        bench.cancelled.set()

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
    """Cancel the work when its deadline has passed by GRACE; studies themselves look at the deadline before."""
    if bench.left == float("inf"):
        yield
        return
    timer = threading.Timer(max((1.0 + GRACE) * bench.left, 0.0), bench.cancelled.set)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
