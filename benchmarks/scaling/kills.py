"""Killing workers, servers, schedulers or prewarms while they bake: nothing kept is lost or torn,
or other light.

    python -m benchmarks.scaling kills [SCENE.toml] [--victim worker|server|scheduler|prewarm]
    [--cycles 100] [--seed 0]

A visitor looks at one view after the other while a process is killed at a random time, again and
again; somebody else reads every object of the store all the time. A server that is killed loses the
light of its last seconds, which it had not written; so the visitor then looks at each view once
more until it is final, in peace. At last the same views are baked undisturbed, in another store,
and all bytes are compared. That is done in rounds of at most ROUND kills, each with an
empty store, so that there is always light to bake. A prewarm that was killed is gone on with by the
next; where one came to its end, the next is of another isovalue. A scheduler is started again at
its address, and so are its workers, which end when it is gone.
"""

import os
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, ExitStack, suppress
from pathlib import Path
from uuid import uuid4

import click
import psutil

from benchmarks.common.measurement import Figures, Measurement
from benchmarks.common.serving import Served, serving
from benchmarks.common.suite import part
from benchmarks.scaling.visiting import Visitor, small_scene, view
from benchmarks.scaling.watching import Watcher, altered, light_in, texels_of
from tests.cluster.processes import OWN, Cluster, Started, named

WORKERS = 2
SOON = 5.0
"""Seconds after which nothing may be left of what was killed."""

LATEST = {"worker": 0.5, "server": 2.0, "scheduler": 1.0, "prewarm": 1.0}
"""Seconds after which the next is killed at the latest, once light has come."""

PATIENCE = 120.0
"""Seconds within which light comes, or a worker."""

ROUND = 10
"""Kills of a round: the small scene has light for 48 views, and two are baked from one kill of a
server to the next.
"""

RESTART = "restart to an old frame, longest, s"
MARK = "BENCHMARK_MARK"
GO_ON = ("--continue",)

Repeat = Callable[[str], Figures]
"""Bakes the same in another store, undisturbed, and tells what is not as it was."""


class Killer:
    """Kills, and counts what is wrong afterwards. ``seed`` decides when, and whom."""

    def __init__(self, scene: str, store: str, seed: int) -> None:
        """Kill nobody yet."""
        self.scene = scene
        self.store = store
        self.orphans = self.kills = self.orders = 0
        self.restarts: list[float] = []
        self._chance = random.Random(seed)
        self._mark = uuid4().hex

    def serving(self, *options: str) -> AbstractContextManager[Served]:
        """The server, whose processes can be told by a mark in their environment."""
        return serving(self.scene, self.store, WORKERS, *options, environment={MARK: self._mark})

    def workers(self, server: Served, watcher: Watcher, cycles: int) -> None:
        """Kill one worker after the other."""
        for _ in range(cycles):
            self._wait(watcher, "worker", lambda: False)
            self._kill(self._chance.choice(workers_of(server)))

    def servers(
        self, stack: ExitStack, server: Served, visitor: Visitor, watcher: Watcher, cycles: int
    ) -> None:
        """Kill one server after the other, and start it again."""
        for _ in range(cycles):
            self._wait(watcher, "server", lambda: False)
            self._kill(psutil.Process(server.process.pid))
            self.orphans += len(marked(self._mark))
            server = stack.enter_context(self.serving())
            visitor.url = f"{server.url}{server.path}"
            begun = time.perf_counter()
            server.client.get(f"{server.path}/frame", params=view(0)).raise_for_status()
            self.restarts.append(server.ready_after + time.perf_counter() - begun)

    def schedulers(self, joined: "Joined", watcher: Watcher, cycles: int) -> None:
        """Kill one scheduler after the other, and start it again, and its workers once they have
        ended.
        """
        for _ in range(cycles):
            self._wait(watcher, "scheduler", lambda: False)
            self._kill(psutil.Process(joined.first.pid))
            gone = [psutil.Process(each.pid) for each in joined.workers]
            self.orphans += len(psutil.wait_procs(gone, timeout=SOON)[1])
            joined.begin()

    def prewarms(self, watcher: Watcher, cycles: int) -> None:
        """Kill one prewarm after the other, and have the next go on; the last comes to its end."""
        going = False
        while self.kills < cycles:
            what = GO_ON if going else self._order()
            process = prewarming(self.scene, self.store, what, self._mark)
            self._wait(watcher, "prewarm", lambda: process.poll() is not None)  # noqa: B023 (called at once)
            going = process.poll() is None
            if going:
                self._kill(psutil.Process(process.pid))
                process.wait()
                self.orphans += len(marked(self._mark))
            elif what is not GO_ON and process.returncode:
                raise RuntimeError("A prewarm failed by itself.")
        if going:
            prewarming(self.scene, self.store, GO_ON).wait()

    def _order(self) -> tuple[str, ...]:
        """What the next prewarm is to bake."""
        self.orders += 1
        return order(self.orders - 1)

    def _wait(self, watcher: Watcher, victim: str, over: Callable[[], bool]) -> None:
        """Until light has come since the last kill, or the victim is ``over`` by itself, and some
        time more.
        """
        before = watcher.progress
        deadline = time.monotonic() + PATIENCE
        while watcher.progress == before and not over():
            if time.monotonic() > deadline:
                raise click.ClickException(
                    f"No light came for {PATIENCE:g} s: take a scene that has more to bake."
                )
            time.sleep(0.01)
        time.sleep(self._chance.uniform(0.0, LATEST[victim]))

    def _kill(self, process: psutil.Process) -> None:
        """Kill a process; what it had started must end too."""
        family = [process, *process.children(recursive=True)]
        process.kill()
        self.kills += 1
        self.orphans += len(psutil.wait_procs(family, timeout=SOON)[1])


class Joined(Cluster):
    """A scheduler, ``first``, and workers that join it."""

    first: Started
    workers: list[Started]

    def begin(self) -> None:
        """Start them all."""
        self.first, self.workers = self.scheduler(), [self.worker() for _ in range(WORKERS)]

    @property
    def options(self) -> tuple[str, ...]:
        """Those of a server that joins the scheduler too."""
        return "--scheduler", self.address, *named(OWN, self.certificates)


def workers_of(server: Served) -> list[psutil.Process]:
    """The processes that bake, once there is any."""
    deadline = time.monotonic() + PATIENCE
    while not (found := server.workers) and time.monotonic() < deadline:
        time.sleep(0.05)
    return found


def marked(mark: str) -> list[psutil.Process]:
    """The processes with a mark in their environment."""
    found = []
    for process in psutil.process_iter():
        with suppress(psutil.Error):
            if process.environ().get(MARK) == mark:
                found.append(process)
    return found


def order(number: int) -> tuple[str, ...]:
    """What one prewarm after the other bakes: several views at the isovalue of a visitor's view."""
    return (
        "--isovalue",
        str(view(number)["isovalue"]),
        "--views",
        "6",
        "--width",
        "48",
        "--height",
        "48",
    )


def prewarming(
    scene: str, store: str, what: tuple[str, ...], mark: str = ""
) -> subprocess.Popen[bytes]:
    """A prewarm that begins, whose processes can be told by a mark in their environment."""
    command = [
        sys.executable,
        "-m",
        "isogi_server",
        "prewarm",
        scene,
        "--store",
        store,
        "--workers",
        str(WORKERS),
        *what,
    ]
    return subprocess.Popen(
        command,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env={**os.environ, MARK: mark},
    )


def disturbed(
    scene: str, store: str, victim: str, cycles: int, seed: int
) -> tuple[Figures, Repeat]:
    """Bake while processes are killed."""
    killer = Killer(scene, store, seed)
    begun = time.perf_counter()
    with Watcher(store) as watcher:
        if victim == "prewarm":
            more, repeat = prewarmed(killer, watcher, cycles)
        else:
            more, repeat = visited(killer, watcher, victim, cycles)
        watcher.spec()
    if killer.restarts:
        restarts = {RESTART: max(killer.restarts)}
    else:
        restarts = {}
    return {
        f"{victim}s killed": killer.kills,
        "seconds": time.perf_counter() - begun,
        **more,
        "objects": watcher.objects,
        "objects read meanwhile": watcher.reads,
        "torn": sum(watcher.torn.values()),
        "lost, or with less light than before": sum(watcher.lost.values()),
        f"processes left after {SOON:g} s": killer.orphans,
        "half-written files left": len(list(Path(store).rglob("*.partial"))),
        **restarts,
    }, repeat


def prewarmed(killer: Killer, watcher: Watcher, cycles: int) -> tuple[Figures, Repeat]:
    """Kill prewarms."""
    killer.prewarms(watcher, cycles)

    def repeat(store: str) -> Figures:
        codes = [
            prewarming(killer.scene, store, order(number)).wait() for number in range(killer.orders)
        ]
        return {"prewarms that fail undisturbed": sum(code != 0 for code in codes)}

    return {"prewarms begun": killer.orders}, repeat


def visited(killer: Killer, watcher: Watcher, victim: str, cycles: int) -> tuple[Figures, Repeat]:
    """Kill servers, or the workers or schedulers of one, while somebody looks."""
    with ExitStack() as stack:
        joined = stack.enter_context(Joined())
        if victim == "scheduler":
            joined.begin()
        server = stack.enter_context(
            killer.serving(*joined.options) if victim == "scheduler" else killer.serving()
        )
        visitor = stack.enter_context(Visitor(f"{server.url}{server.path}"))
        if victim == "scheduler":
            killer.schedulers(joined, watcher, cycles)
        elif victim == "worker":
            killer.workers(server, watcher, cycles)
        else:
            killer.servers(stack, server, visitor, watcher, cycles)
        visitor.stop()
        # Bake again the light that was lost before it was written: the same bytes must come back.
        again = [visitor.see(number) for number in range(len(visitor.finals))]
        changed = sum(a != b for a, b in zip(visitor.finals, again, strict=True))

    def repeat(store: str) -> Figures:
        with serving(killer.scene, store, WORKERS) as again:
            other = Visitor(f"{again.url}{again.path}")
            finals = [other.see(number) for number in range(len(visitor.finals))]
        return {
            "final pictures that differ": sum(
                a != b for a, b in zip(visitor.finals, finals, strict=True)
            )
        }

    found = {
        "views that became final": len(visitor.finals),
        "final pictures that changed since": changed,
        "answers 5xx": visitor.errors,
    }
    return found, repeat


def compared(folder: str, repeat: Repeat) -> Figures:
    """Bake the same undisturbed, and compare."""
    differ = repeat(f"{folder}/undisturbed")
    light = light_in(f"{folder}/light")
    expected = light_in(f"{folder}/undisturbed")
    return {
        "objects with other bytes than undisturbed": sum(
            light.get(key) != value for key, value in expected.items()
        ),
        "objects that undisturbed are none": len(light.keys() - expected.keys()),
        "texels lost, or of other light by as many samples": altered(
            texels_of(f"{folder}/undisturbed"), texels_of(f"{folder}/light")
        ),
        **differ,
    }


def in_a_round(target: str | None, victim: str, cycles: int, seed: int) -> Figures:
    """The figures of so many kills over a store of their own."""
    with tempfile.TemporaryDirectory() as folder:
        scene = target or small_scene(Path(folder))
        found, repeat = disturbed(scene, f"{folder}/light", victim, cycles, seed)
        return {**found, **compared(folder, repeat)}


def summed(rounds: Sequence[Figures]) -> Figures:
    """The figures of all rounds together: the longest of restarts, the sums of the others."""
    return {
        name: (max if name == RESTART else sum)(found[name] for found in rounds)
        for name in rounds[0]
    }


@part()
@click.argument("target", required=False)
@click.option("--victim", type=click.Choice(list(LATEST)), default="worker", show_default=True)
@click.option("--cycles", type=click.IntRange(1), default=100, show_default=True, help="Kills.")
@click.option("--seed", default=0, show_default=True, help="Decides when, and whom.")
def kills(target: str | None, victim: str, cycles: int, seed: int) -> Measurement:
    """Workers, servers, schedulers or prewarms killed while they bake: what is lost, torn, other
    than undisturbed.
    """
    counts = [min(ROUND, cycles - done) for done in range(0, cycles, ROUND)]
    found = summed(
        [in_a_round(target, victim, count, seed + number) for number, count in enumerate(counts)]
    )
    return Measurement(
        f"{Path(target or 'small').stem}, {cycles} kills of a {victim}", found, variant=victim
    )
