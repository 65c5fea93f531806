"""Several servers and a prewarm over one store, all at the same views at the same time: how much is
done twice.

    python -m benchmarks.scaling together [SCENE.toml] [--servers 2] [--workers 1] [--views 6]
    [--no-prewarm]

What was done is counted by the paths that each tells; what was needed are those that the light in
the store is of. Afterwards the same is baked by one after the other, and all bytes are compared.
"""

import json
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import click

from benchmarks.common.measurement import Figures, Measurement
from benchmarks.common.serving import Served, serving
from benchmarks.common.suite import part
from benchmarks.scaling.visiting import Visitor, small_scene, view
from benchmarks.scaling.watching import Watcher, light_in
from isogi_core.cache.upkeep import census_of
from isogi_core.storage.store import Store


def warmed(scene: str, store: str) -> dict[str, Any]:
    """What ``isogi prewarm`` tells of views at the isovalue of the first view."""
    command = [
        sys.executable,
        "-m",
        "isogi_server",
        "prewarm",
        scene,
        "--store",
        store,
        "--json",
        "--workers",
        "1",
    ]
    looks = [
        "--isovalue",
        str(view(0)["isovalue"]),
        "--views",
        "4",
        "--width",
        "48",
        "--height",
        "48",
    ]
    done = subprocess.run(
        [*command, *looks], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, check=True
    )
    facts: dict[str, Any] = json.loads(done.stdout)
    return facts


def visited(server: Served, views: int) -> list[str]:
    """The final pictures of all views."""
    visitor = Visitor(f"{server.url}{server.path}")
    return [visitor.see(number) for number in range(views)]


def needed(store: str) -> int:
    """The paths that the light in a store is of: its layers are of the same."""
    counts = census_of(Store(store, make=False)).counts.values()
    return max((count.paths for count in counts), default=0)


def baked_together(
    scene: str, store: str, servers: int, workers: int, views: int, prewarm: bool
) -> tuple[Figures, Any]:
    """All at once; the figures, and the pictures that each server has shown."""
    with ExitStack() as stack, ThreadPoolExecutor(servers + 1) as pool:
        watcher = stack.enter_context(Watcher(store))
        served = [stack.enter_context(serving(scene, store, workers)) for _ in range(servers)]
        begun = time.perf_counter()
        if prewarm:
            warming = pool.submit(warmed, scene, store)
        else:
            warming = None
        visits = [pool.submit(visited, server, views) for server in served]
        pictures = [visit.result() for visit in visits]
        told = [server.metric("isogi_paths_total") for server in served]
        if warming:
            told += [warming.result()["paths"]]
        seconds = time.perf_counter() - begun
        twice = sum(s.metric("isogi_tasks_duplicate_total") for s in served)
        tasks = sum(server.metric("isogi_tasks_done_total") for server in served)
    return {
        "bakers": len(told),
        "seconds": seconds,
        "paths baked": int(sum(told)),
        "paths needed": needed(store),
        "done twice, %": 100.0 * (sum(told) / needed(store) - 1.0),
        "tasks of servers": int(tasks),
        "of these found all there": int(twice),
        "torn": sum(watcher.torn.values()),
        "lost, or with less light than before": sum(watcher.lost.values()),
    }, pictures


def alone(scene: str, store: str, workers: int, views: int, prewarm: bool) -> list[str]:
    """One after the other; the pictures."""
    if prewarm:
        warmed(scene, store)
    with serving(scene, store, workers) as server:
        return visited(server, views)


@part()
@click.argument("target", required=False)
@click.option("--servers", default=2, show_default=True, help="Servers over the store.")
@click.option("--workers", default=1, show_default=True, help="Workers of each.")
@click.option("--views", default=6, show_default=True, help="Views that all of them show.")
@click.option("--prewarm/--no-prewarm", default=True, help="Have a prewarm beside them.")
def together(
    target: str | None, servers: int, workers: int, views: int, prewarm: bool
) -> Measurement:
    """Several servers and a prewarm over one store: how much is done twice."""
    with tempfile.TemporaryDirectory() as folder:
        scene = target or small_scene(Path(folder))
        found, pictures = baked_together(scene, f"{folder}/light", servers, workers, views, prewarm)
        expected = alone(scene, f"{folder}/alone", workers, views, prewarm)
        light = light_in(f"{folder}/light")
        whole = light_in(f"{folder}/alone")
        found = {
            **found,
            "objects with other bytes than of one": sum(
                light.get(key) != value for key, value in whole.items()
            ),
            "objects": len(light),
            "pictures that differ": sum(
                one != own for shown in pictures for one, own in zip(shown, expected, strict=True)
            ),
        }
    return Measurement(f"{Path(scene).stem}, {servers} servers over one store", found)
