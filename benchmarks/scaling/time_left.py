"""Whether the time left was told rightly while views were baked.

    python -m benchmarks.scaling time-left [SCENE.toml] [--size 128] [--views 3] [--error 0.03]
    [--json]

Tasks are done one after the other in this process, and time is its processor seconds: what else the
machine does changes nothing. Views follow each other over one store.
"""

import tempfile
import time
from contextlib import closing
from dataclasses import replace

import click
import numpy as np

from benchmarks.common.measurement import Measurement
from benchmarks.common.scenes import benchmark_scene
from benchmarks.common.suite import part
from isogi_core.bake.noise import Goal
from isogi_core.frame.frame import Frame
from isogi_core.model.view import View
from isogi_report.speed import view_of
from isogi_server.render.engine import RenderEngine
from isogi_worker.baker import Baker
from isogi_worker.pool import Done
from isogi_worker.progress import TimeLeft
from isogi_worker.tasks import PLAIN_LAYER_KINDS, BakeTask, bake, load_kernels

Told = tuple[float, Frame, TimeLeft | None]
"""When, of which frame, and what."""

TURN = 100.0
"""Degrees between two views."""


class OneByOne:
    """A pool of one worker, which works when it is told to. ``seconds`` are the processor's, spent
    on tasks.
    """

    room = 2
    together = 1
    keeps_light = False
    workers = 1
    trouble = ""

    def __init__(self) -> None:
        self.tasks: list[tuple[BakeTask, Done]] = []
        self.seconds = 0.0

    def submit(self, task: BakeTask, done: Done) -> None:
        """Take a task."""
        self.tasks.append((task, done))

    def work(self, seconds: float) -> None:
        """Do tasks for at least so long, or until there are none."""
        until = self.seconds + seconds
        while self.tasks and self.seconds < until:
            task, done = self.tasks.pop(0)
            begun = time.thread_time()
            result = bake(task)
            self.seconds += time.thread_time() - begun
            done(result, None)

    def close(self) -> None:
        """Nothing is to be closed."""


@part(size=128)
@click.argument("target", required=False)
@click.option("--views", default=3, show_default=True, help="Views, one after the other.")
@click.option("--error", default=0.03, show_default=True, help="Target error of each pixel.")
@click.option(
    "--every", default=0.5, show_default=True, help="Processor seconds between two predictions."
)
def time_left(target: str | None, size: int, views: int, error: float, every: float) -> Measurement:
    """Whether the time left was told rightly while views were baked."""
    load_kernels(PLAIN_LAYER_KINDS)
    scene = benchmark_scene(target)
    pool = OneByOne()
    figures = dict[str, float]()
    baker = Baker(lambda: pool.seconds)
    with (
        tempfile.TemporaryDirectory() as folder,
        closing(RenderEngine([scene], folder, baker=baker)) as engine,
    ):
        engine.start(with_workers=False)
        baker.use_pool(pool)  # type: ignore[arg-type]
        for number in range(views):
            camera = scene.camera(40.0 + TURN * number, 30.0, 3.0, 30.0)
            told = watch(engine, pool, replace(view_of(scene, size), camera=camera), error, every)
            figures |= {f"view {number + 1}, {name}": value for name, value in judged(told).items()}
    return Measurement(f"{scene.name}, {size} × {size}, to {error:g}", figures)


def watch(
    engine: RenderEngine, pool: OneByOne, view: View, error: float, every: float
) -> list[Told]:
    """What was told of a view, and when, until it was final."""
    (scene,) = engine.scenes
    told = []
    goal = Goal.checked(error)
    while True:
        frame = engine.frame(scene, view, goal=goal)
        told.append((pool.seconds, frame, engine.time_left(scene, frame, goal)))
        if not frame.provisional:
            return told
        pool.work(every)


def judged(told: list[Told]) -> dict[str, float]:
    """Seconds that a view took, and how what was told compares: taken over told, and the share
    within the range.
    """
    end = told[-1][0]
    lefts = [(end - at, left) for at, _, left in told if left is not None and left.likely > 0.0]
    ratios = [actual / left.likely for actual, left in lefts]
    within = [left.low <= actual <= left.high for actual, left in lefts]
    return {
        "seconds": end - told[0][0],
        "estimated error": told[-1][1].noise,
        "predictions": len(lefts),
        "first, taken over told": ratios[0] if ratios else 0.0,
        "median, taken over told": float(np.median(ratios)) if ratios else 0.0,
        "within the range": float(np.mean(within)) if within else 0.0,
        "range, high over low": float(np.median([left.high / left.low for _, left in lefts]))
        if lefts
        else 0.0,
    }
