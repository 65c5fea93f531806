"""Sweeps: runs of the simulation that differ in one thing, and the figures of each."""

from collections.abc import Callable, Iterable
from dataclasses import asdict, replace
from typing import Any

from benchmarks.scaling.simulator import decisions, dispatch
from benchmarks.scaling.simulator.cluster import Conditions
from benchmarks.scaling.simulator.recording import Recording
from benchmarks.scaling.simulator.run import batch, visit
from benchmarks.scaling.simulator.visitors import Habits

Rows = list[dict[str, Any]]
Tell = Callable[[str, dict[str, Any]], None]

WORKERS = (2, 8, 32, 64, 128, 256, 512)
VISITORS = (1, 10, 30, 100, 300, 1000)
LATENCIES = (0.0002, 0.002, 0.01, 0.05)
FAILURES = (0.0, 0.005, 0.02, 0.05)
DEATHS = (0.0, 10.0, 60.0)
"""Deaths of a worker in an hour."""

CROWDS = (100, 1000, 10_000, 100_000)
USUAL = 64
PEOPLE = 10
"""Workers and visitors where these are not what differs."""

VARIED = (
    "workers",
    "dispatch",
    "visitors",
    "latency",
    "fail",
    "tries",
    "deaths",
    "chunks",
    "clients",
    "together",
)
"""What differs from one row of a sweep to the next; all else in a row was measured."""

SCENE_EACH = 32
"""Workers for each scene of a batch: so all have enough to do, however many there are."""


def workers(recording: Recording, quick: bool, tell: Tell) -> Rows:
    """A batch over the number of workers, for two speeds of the scheduler."""
    rows = []
    for count in few(WORKERS, quick):
        for each in (0.001, 0.0002):
            done = batch(recording, Conditions(count, dispatch=each), max(count // SCENE_EACH, 1))
            rows.append({"dispatch": each, **asdict(done)})
            tell("workers", rows[-1])
    return rows


def visitors(recording: Recording, quick: bool, tell: Tell) -> Rows:
    """Visitors over their number."""
    return visits(
        recording, [({"visitors": n}, Conditions(USUAL), n) for n in few(VISITORS, quick)], tell
    )


def latencies(recording: Recording, quick: bool, tell: Tell) -> Rows:
    """Visitors over how far the store is away."""
    base = Conditions(USUAL)
    runs = [
        ({"latency": each}, replace(base, latency=each), PEOPLE) for each in few(LATENCIES, quick)
    ]
    return visits(recording, runs, tell)


def failures(recording: Recording, quick: bool, tell: Tell) -> Rows:
    """Visitors over how often a call of the store fails."""
    base = Conditions(USUAL)
    both = [(each, tries) for tries in (1, 3) for each in few(FAILURES, quick)]
    runs = [({"fail": f, "tries": n}, replace(base, fail=f, tries=n), PEOPLE) for f, n in both]
    return visits(recording, runs, tell)


def deaths(recording: Recording, quick: bool, tell: Tell) -> Rows:
    """Visitors over how often workers die."""
    base = Conditions(USUAL)
    return visits(
        recording,
        [({"deaths": each}, replace(base, deaths=each), PEOPLE) for each in few(DEATHS, quick)],
        tell,
    )


def visits(
    recording: Recording, runs: Iterable[tuple[dict[str, Any], Conditions, int]], tell: Tell
) -> Rows:
    """What became of runs, each with the name of what differs."""
    rows = []
    for named, conditions, people in runs:
        found, _ = visit(recording, conditions, people, Habits())
        rows.append({**named, **found.figures()})
        tell("visits", rows[-1])
    return rows


def queue(_: Recording, quick: bool, tell: Tell) -> Rows:
    """Processor time of a decision over the chunks that wait, for one client and for many, alone
    and together.
    """
    rows = []
    for chunks in few(CROWDS, quick):
        for clients, together in ((1, False), (100, False), (1000, False), (100, True)):
            if together and chunks * clients > 100_000:
                continue  # a hundred clients do not look at ten thousand chunks each
            found = decisions.measure(chunks, clients, min(1024, chunks // 2), together)
            rows.append(
                {"chunks": chunks, "clients": clients, "together": together, **found._asdict()}
            )
            tell("queue", rows[-1])
    return rows


def scheduler(_: Recording, quick: bool, tell: Tell) -> Rows:
    """What Dask takes of a task."""
    rows = [dict(dispatch.measure(200 if quick else 1000))]
    tell("scheduler", rows[-1])
    return rows


SWEEPS: dict[str, Callable[[Recording, bool, Tell], Rows]] = {
    "scheduler": scheduler,
    "queue": queue,
    "workers": workers,
    "visitors": visitors,
    "latency": latencies,
    "failures": failures,
    "deaths": deaths,
}


def few(values: tuple[Any, ...], quick: bool) -> tuple[Any, ...]:
    """The first two values where it is to be quick, else all."""
    return values[:2] if quick else values
