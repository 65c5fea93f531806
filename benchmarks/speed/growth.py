"""How frame time grows with the volume, the picture and the threads, and what a second thread is
worth.

    python -m benchmarks.speed growth [TARGET] [--largest 512] [--size 512] [--repeats 7] [--json]

Volumes: one shape, resampled to 64³, 128³, … voxels, seen from the same place; light is baked at
one texel per voxel. Pictures: 256², 512², … pixels of TARGET. Threads: frames and diffuse rays on
one thread and on two, and on two processes of one thread each that start at the same time and know
nothing of each other; "two threads / two processes" compares their rates. `gi` and `lambert` cast
their primary rays anew in every frame.
"""

import multiprocessing
import tempfile
from collections.abc import Iterable
from contextlib import ExitStack, closing
from dataclasses import replace
from functools import partial
from multiprocessing.connection import Connection
from typing import Any

import click
import numpy as np

from benchmarks.common.measurement import Measurement
from benchmarks.common.scenes import benchmark_scene
from benchmarks.common.suite import part
from benchmarks.common.timing import milliseconds
from isogi_core.frame.renderer import Renderer
from isogi_core.model.scene_plan import MIN_SAMPLES
from isogi_core.model.volume import Volume, make_volume
from isogi_core.plan.scene import Scene
from isogi_report.speed import (
    Candidate,
    bake_view,
    bounce,
    cast,
    make_renderer,
    medians,
    new_camera,
    primary_rays,
    timed,
    view_of,
)

SHADINGS = ("gi", "lambert")
KINDS = (*SHADINGS, "rays")
SMALLEST = 64
TURNS = 4
"""Times that work is done in a row. The first finds caches full of other work, and the last of two
processes may be alone: those between count, of threads and of processes alike."""

PIECE = 8192
"""Rays that a thread casts before it takes the next."""


def resample(volume: Volume, side: int) -> Volume:
    """The volume at ``side``³ voxels between the same outermost voxels, by trilinear
    interpolation.
    """
    voxels = volume.voxels
    for axis, n in enumerate(volume.shape):
        place = np.linspace(0.0, n - 1.0, side)
        low = np.minimum(place.astype(int), n - 2)
        part = np.expand_dims(np.float32(place - low), tuple({0, 1, 2} - {axis}))
        voxels = voxels.take(low, axis) * (1 - part) + voxels.take(low + 1, axis) * part
    x, y, z = (length / (side - 1) for length in volume.extent)
    return make_volume(
        voxels * np.float32(volume.scale) + np.float32(volume.offset), (x, y, z), volume.solid
    )


def baked(scene: Scene, store: str, sizes: Iterable[int], threads: int | None = None) -> Renderer:
    """A renderer with the light of the view at all ``sizes`` baked."""
    renderer = make_renderer(scene, store, threads)
    for size in sizes:
        bake_view(renderer, view_of(scene, size), MIN_SAMPLES)
    return renderer


def by_volume(scene: Scene, sides: list[int], size: int, repeats: int) -> dict[str, float]:
    """Frame times of the same shape at different resolutions."""
    works: dict[str, Candidate] = {}
    with ExitStack() as stack:
        for side in sides:
            store = stack.enter_context(tempfile.TemporaryDirectory())
            renderer = baked(replace(scene, volume=resample(scene.volume, side)), store, [size])
            view = view_of(scene, size)
            works |= {
                f"{side}³: {s}": new_camera(renderer, replace(view, shading=s)) for s in SHADINGS
            }
        taken = medians(works, repeats)
    ratios = {f"{sides[-1]}³ / {sides[0]}³: {s}": grown(taken, sides, "³", s) for s in SHADINGS}
    return {**milliseconds(taken), **ratios}


def by_picture(renderer: Renderer, sizes: list[int], repeats: int) -> dict[str, float]:
    """Frame times of one scene at different picture sizes."""
    scene = renderer.prepared.scene
    works = {
        f"{size}²: {s}": new_camera(renderer, view_of(scene, size, shading=s))
        for size in sizes
        for s in SHADINGS
    }
    taken = medians(works, repeats)
    ratios = {f"{sizes[-1]}² / {sizes[0]}²: {s}": grown(taken, sizes, "²", s) for s in SHADINGS}
    return {**milliseconds(taken), **ratios}


def grown(taken: dict[str, float], steps: list[int], sign: str, shading: str) -> float:
    """How many times longer the last step takes than the first."""
    return taken[f"{steps[-1]}{sign}: {shading}"] / taken[f"{steps[0]}{sign}: {shading}"]


def works_of(renderer: Renderer, size: int) -> dict[str, Candidate]:
    """A frame of each shading, and diffuse rays in pieces of PIECE, in the middle of a row of
    them.
    """
    prepared = renderer.prepared
    rays = bounce(prepared, primary_rays(prepared, size), np.random.default_rng(1))
    parts = [rays.part(slice(first, first + PIECE)) for first in range(0, len(rays), PIECE)]

    def piece(a: int, b: int) -> None:
        for those in parts[a:b]:
            cast(prepared, those)

    works = {s: new_camera(renderer, view_of(prepared.scene, size, shading=s)) for s in SHADINGS}
    works["rays"] = timed(partial(renderer.tiles.run, piece, len(parts), 1))
    return {kind: in_a_row(work) for kind, work in works.items()}


def in_a_row(work: Candidate) -> Candidate:
    """The same work TURNS times: seconds of one of them."""
    return lambda _: float(np.mean([work(turn) for turn in range(TURNS)][1:-1]))


def serve(pipe: Connection, target: str | None, store: str, size: int) -> None:
    """What an independent process does: the work that is named, and the seconds that took."""
    works = works_of(make_renderer(benchmark_scene(target), store, 1), size)
    pipe.send("ready")
    while name := pipe.recv():
        pipe.send(works[name](0))


class Pair:
    """Two processes that do the same thing at the same time."""

    def __init__(self, target: str | None, store: str, size: int) -> None:
        """Start them, and wait until both are ready."""
        context = multiprocessing.get_context("spawn")
        pipes = [context.Pipe() for _ in range(2)]
        self.pipes = [mine for mine, _ in pipes]
        self.processes = [
            context.Process(target=serve, args=(its, target, store, size)) for _, its in pipes
        ]
        for process in self.processes:
            process.start()
        assert all(pipe.recv() == "ready" for pipe in self.pipes)

    def candidate(self, name: str) -> Candidate:
        """Seconds for one piece of work a process, while both are busy."""

        def work(_: int) -> float:
            for pipe in self.pipes:
                pipe.send(name)
            return float(np.mean([pipe.recv() for pipe in self.pipes]))

        return work

    def close(self) -> None:
        """End them."""
        for pipe, process in zip(self.pipes, self.processes, strict=True):
            pipe.send("")
            process.join()


def by_threads(target: str | None, store: str, size: int, repeats: int) -> dict[str, float]:
    """One thread, two threads and two processes, over the light that is in ``store``."""
    scene = benchmark_scene(target)
    one, two = (works_of(make_renderer(scene, store, threads), size) for threads in (1, 2))
    with closing(Pair(target, store, size)) as pair:
        works: dict[str, Candidate] = {}
        for kind in KINDS:
            works[f"one thread: {kind}"] = one[kind]
            works[f"two threads: {kind}"] = two[kind]
            works[f"two processes: {kind}"] = pair.candidate(kind)
        taken = medians(works, repeats)
    figures = milliseconds(taken)
    for kind in KINDS:
        single, threads, processes = (
            taken[f"{n}: {kind}"] for n in ("one thread", "two threads", "two processes")
        )
        figures[f"two threads / one: {kind}"] = single / threads
        figures[f"two processes / one: {kind}"] = 2.0 * single / processes
        figures[f"two threads / two processes: {kind}"] = processes / (2.0 * threads)
    return figures


def doubling(first: int, last: int) -> list[int]:
    """Powers of two times ``first``, up to ``last``."""
    steps = [first]
    while 2 * steps[-1] <= last:
        steps.append(2 * steps[-1])
    return steps


@part(size=512, repeats=7)
@click.argument("target", required=False)
@click.option(
    "--largest",
    type=click.IntRange(2),
    default=512,
    show_default=True,
    help="Voxels a side of the largest.",
)
def growth(target: str | None, largest: int, size: int, repeats: int) -> Measurement:
    """How frame time grows with the volume, the picture (--size the middle one) and the threads."""
    shape = benchmark_scene("demo:casting", lights=[{"type": "sky"}])
    figures: dict[str, Any] = by_volume(
        shape, doubling(min(SMALLEST, largest), largest), size, repeats
    )
    scene = benchmark_scene(target)
    with tempfile.TemporaryDirectory() as store:
        sizes = [max(size // 2, 1), size, 2 * size]
        figures |= by_picture(baked(scene, store, sizes), sizes, repeats)
        figures |= by_threads(target, store, size, repeats)
    return Measurement(f"the casting resampled, and {scene.name} at {scene.isovalue:g}", figures)
