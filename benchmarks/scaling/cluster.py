"""A cluster against bare copies of the bake: the same bytes however many bake, and how much of
their speed is left.

    python -m benchmarks.scaling cluster [TARGET] [--size 128] [--tasks 32] [--rounds 3] [--workers
    1 --workers 2]

Pools and copies take turns at the same tasks. Ratios are medians over the rounds: "paths a second"
of the wall, and of the processor, which holds where others use the machine. How far it is, is told
on the way.
"""

import os
import shutil
import statistics
import tempfile
import threading
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from hashlib import sha256
from itertools import chain, pairwise, permutations
from pathlib import Path
from time import perf_counter
from typing import Any

import click
import psutil

from benchmarks.common.measurement import Measurement
from benchmarks.common.suite import part
from benchmarks.scaling.copies import LONG, Copies, Speed, processor_seconds
from isogi_core.bake.bake_spec import spec_for
from isogi_core.bake.noise import Goal
from isogi_core.model.scene_plan import MAX_SAMPLES
from isogi_core.model.view import View
from isogi_core.plan.assembly import load_scene
from isogi_core.plan.scene import Scene
from isogi_core.prepared.prepared_scene import PreparedScene
from isogi_core.storage.backend import StoreUrl
from isogi_core.storage.store import Store
from isogi_server.render.engine import RenderEngine
from isogi_worker.pool import WorkerPool, start_pool
from isogi_worker.tasks import BakeResult, BakeTask
from tests.cluster.processes import cluster as running_cluster
from tests.cluster.processes import until
from tests.server.inline import EngineWithoutWorkers

MIB = 1 << 20
Who = tuple[str, int]
"""A kind, and a number."""

SAME = 40
"""Pixels a side of the view whose bytes are compared."""

BARE = "bare copies"
HIRED = ("embedded", "joined")
"""Workers that a server starts itself, and those of a scheduler of their own."""


def view_of(scene: Scene, size: int) -> View:
    """The view whose light is baked."""
    return View(scene.isovalue, scene.camera(30.0, 20.0, 3.0, 30.0), width=size, height=size)


def tasks_of(scene: Scene, size: int, most: int, store: str) -> list[BakeTask]:
    """A task for each of ``most`` chunks all over a view, that brings it to final light at once;
    large ones first.
    """
    spec = spec_for(PreparedScene(scene), "gi")
    with (
        tempfile.TemporaryDirectory() as empty,
        closing(EngineWithoutWorkers([scene], empty)) as engine,
    ):
        engine.start()
        goal = Goal.checked(scene.target_error)
        demands = engine.survey(scene.id, view_of(scene, size), goal).demands
    some = sorted(
        demands[:: max(len(demands) // most, 1)][:most], key=lambda demand: -len(demand.offsets)
    )
    what = scene.source, spec.plan, spec.digest, StoreUrl(store)
    return [
        BakeTask(*what, d.index, d.offsets, d.footprints, MAX_SAMPLES, Goal(goal.error))
        for d in some
    ]


def pooled(pool: WorkerPool, tasks: Sequence[BakeTask]) -> Speed:
    """What a pool does in a store without light, with as many tasks in flight as the baker has."""
    room = threading.Semaphore(pool.room)
    ended = threading.Semaphore(0)
    paths = [0]
    failures: list[BaseException | None] = []

    def done(result: BakeResult | None, error: BaseException | None) -> None:
        if result is not None:
            paths[0] += result.cost.paths
        failures.extend([] if result is not None else [error])
        room.release()
        ended.release()

    for light in tasks[0].store_url.folder.glob("*/c"):
        shutil.rmtree(light)
    begun = perf_counter()
    before = processor_seconds()
    for task in tasks:
        room.acquire(timeout=LONG)
        pool.submit(task, done)
    for _ in tasks:
        ended.acquire(timeout=LONG)
    seconds = perf_counter() - begun
    spent = processor_seconds() - before
    assert not failures, failures[0]
    return Speed(paths[0] / seconds, paths[0] / spent)


@contextmanager
def hired(kind: str, workers: int) -> Iterator[WorkerPool]:
    """A pool of so many workers of a kind."""
    with ExitStack() as stack:
        if kind == "embedded":
            yield stack.enter_context(closing(start_pool(workers)))
            return
        address = stack.enter_context(running_cluster(workers)).address
        pool = stack.enter_context(closing(start_pool(1, address)))
        until(lambda: len(pool.pids()) == workers)
        yield pool


class Contest:
    """All who bake ``tasks``, by kind and number: pools, and as many bare copies as there are
    ``workers`` of each.
    """

    def __init__(self, tasks: Sequence[BakeTask], workers: Sequence[int], stack: ExitStack) -> None:
        """Start all, and have each bake a little; they end with the ``stack``."""
        self._tasks = tasks
        self._copies = stack.enter_context(closing(Copies(tasks, max(workers))))
        self._pools = {
            (kind, n): stack.enter_context(hired(kind, n)) for n in workers for kind in HIRED
        }
        self.found: dict[Who, list[Speed]] = {
            (kind, n): [] for n in workers for kind in (BARE, *HIRED)
        }
        for pool in self._pools.values():
            pooled(pool, tasks[: 2 * pool.room])

    def turn(self) -> None:
        """Have each bake all tasks, one after the other."""
        for who, speeds in self.found.items():
            pool = self._pools.get(who)
            speeds.append(self._copies.bake(who[1]) if pool is None else pooled(pool, self._tasks))
            tell(f"{named(*who)}: {speeds[-1].wall:,.0f} paths a second")

    def ratios(self) -> dict[str, float]:
        """What each pool's speed is of that of as many copies, and how much more many do than few;
        medians.
        """
        figures = {
            f"{named(*who)}: paths a second": usual(each.wall for each in s)
            for who, s in self.found.items()
        }
        for who in self._pools:
            ratios = self._over(who, (BARE, who[1]))
            figures[f"{named(*who)} / bare copies"] = usual(ratio.wall for ratio in ratios)
            figures[f"{named(*who)} / bare copies, by processor seconds"] = usual(
                ratio.processor for ratio in ratios
            )
        for (kind, few), (_, many) in (
            (a, b) for a, b in permutations(self.found, 2) if a[0] == b[0] and a[1] < b[1]
        ):
            more = self._over((kind, many), (kind, few))
            figures[f"{named(kind, many)} / {few}"] = usual(ratio.wall for ratio in more)
        return figures

    def _over(self, who: Who, other: Who) -> list[Speed]:
        """How many times as fast as another one is, round by round."""
        return [
            own.over(their) for own, their in zip(self.found[who], self.found[other], strict=True)
        ]

    def memory(self) -> dict[str, float]:
        """The most that a process of each kind took."""
        workers = {named(*who): pool.pids() for who, pool in self._pools.items()}
        known = {*chain.from_iterable(workers.values()), *self._copies.pids}
        others = [
            child.pid
            for child in psutil.Process().children(recursive=True)
            if child.pid not in known
        ]
        of = {
            **{f"a worker of {name}": pids for name, pids in workers.items()},
            "a bare copy": self._copies.pids,
        }
        of |= {"a scheduler or nanny": others, "this process": [os.getpid()]}
        return {f"most memory of {name}, MiB": max(map(peak, pids)) for name, pids in of.items()}


def usual(values: Iterable[float]) -> float:
    """The median."""
    return statistics.median(values)


def named(kind: str, number: int) -> str:
    """Who bakes, in words."""
    return f"{kind} {number}"


def tell(text: str) -> None:
    """Say how far it is."""
    click.echo(text, err=True)


def speeds(
    scene: Scene, size: int, most: int, workers: Sequence[int], rounds: int
) -> dict[str, Any]:
    """How fast pools and copies are, taking turns, and the memory that they take."""
    with ExitStack() as stack:
        store = stack.enter_context(tempfile.TemporaryDirectory())
        Store(store).check_writable()
        tasks = tasks_of(scene, size, most, store)
        contest = Contest(tasks, workers, stack)
        for number in range(rounds):
            tell(f"round {number + 1} of {rounds}, {len(tasks)} tasks each")
            contest.turn()
        return {"tasks": len(tasks), **contest.ratios(), **contest.memory()}


def peak(pid: int) -> float:
    """The most memory that a process had so far, MiB."""
    for line in Path(f"/proc/{pid}/status").read_text(encoding="ascii").splitlines():
        if line.startswith("VmHWM"):
            return int(line.split()[1]) / 1024
    return psutil.Process(pid).memory_info().rss / MIB


def digest(scene: Scene, workers: int, address: str | None) -> str:
    """The SHA-256 of all chunks that a view leaves in an empty store."""
    with tempfile.TemporaryDirectory() as store:
        with closing(RenderEngine([scene], store, workers, address)) as engine:
            engine.start()
            while engine.frame(scene.id, view_of(scene, SAME), wait=LONG).provisional:
                assert not engine.trouble(), engine.trouble()
        total = sha256()
        for path in sorted(each for each in Path(store).glob("*/c/**/*") if each.is_file()):
            total.update(str(path.relative_to(store)).encode() + path.read_bytes())
        return total.hexdigest()


def digests(numbers: Sequence[int]) -> Iterator[tuple[str, str]]:
    """What workers of each kind and number leave. A cluster grows from one number to the next."""
    scene = load_scene("demo:orbital", order=2, lattice=0.4, bounces=1, target_error=0.5)
    for number in numbers:
        yield named("embedded", number), digest(scene, number, None)
    with running_cluster(0) as running:
        for before, number in pairwise((0, *sorted(numbers))):
            for _ in range(number - before):
                running.worker()
            with closing(start_pool(1, running.address)) as pool:
                until(lambda n=number, p=pool: len(p.pids()) == n)  # type: ignore[misc]
            yield named("joined", number), digest(scene, number, running.address)


@part()
@click.argument("target", default="demo:casting")
@click.option("--size", default=128, show_default=True, help="Pixels a side of the view for speed.")
@click.option("--tasks", default=32, show_default=True, help="Chunks of it that are baked.")
@click.option("--rounds", default=3, show_default=True, help="Turns of pools and copies.")
@click.option(
    "--workers",
    multiple=True,
    type=int,
    default=(1, 2),
    show_default=True,
    help="Numbers for speed.",
)
@click.option(
    "--same",
    multiple=True,
    type=int,
    default=(1, 2, 4),
    show_default=True,
    help="Numbers for sameness.",
)
def cluster(
    target: str, size: int, tasks: int, rounds: int, workers: tuple[int, ...], same: tuple[int, ...]
) -> Measurement:
    """Workers beside bare copies of the bake: speed kept, and the same bytes. Fails where bytes
    differ.
    """
    figures: dict[str, Any] = {}
    for name, found in digests(same):
        tell(f"{name}: SHA-256 of all chunks {found[:12]}…")
        figures[f"SHA-256 of all chunks, {name}"] = found
    if len(set(figures.values())) > 1:
        wrong = "The bytes differ from one number of workers to another."
    else:
        wrong = ""
    figures |= speeds(load_scene(target), size, tasks, workers, rounds)
    return Measurement(
        f"{Path(target).stem}: a cluster against bare copies of the bake", figures, wrong=wrong
    )
