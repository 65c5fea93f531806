"""Adaptive against uniform samples, at equal time: the ratio of errors.

    python -m benchmarks.adaptive [SCENE.toml] [--size 64] [--samples 256] [--target 0.02] [--json]

The engine block at 70 under uffizi, the CT head at 110 under grace and the MNI brain at 90 under constant light, or
demos where the shared data are not at hand; as they are lit by their plans. One view is baked in both ways, chunk by
chunk on one thread: all of its texels to 16, 32, 64 … samples, and as the service does it, in the order and the steps
of its queue, to a target error that is asked for again whenever the work has grown by an eighth. Errors are relative
RMSE of the frame's luminance against light of 16 times the samples. Seconds are of the processor, without the frames
and without compiling. At the times of the uniform frames the error of the others is interpolated, in logarithms; the
same at equal paths.
"""

import json
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from itertools import pairwise

import click
import numpy as np
from tqdm import tqdm

from benchmarks.plan_scenes import GRACE, UFFIZI, three_scenes
from benchmarks.plans import frame_error
from isogi_core.bake.light import Light
from isogi_core.bake.precision import FIRST_RUNG
from isogi_core.bake.recipe import Index
from isogi_core.bake.refine import refine
from isogi_core.cache.costs import Cost, Costs
from isogi_core.cache.place import Place
from isogi_core.frame.frame import Frame
from isogi_core.frame.renderer import Renderer
from isogi_core.model.scene import Scene
from isogi_core.model.view import View
from isogi_core.report.bake import NEVER, ViewBake
from server.measure import make_renderer, view_of
from worker.queue import BakeQueue
from worker.tasks import BakeTask, climb, cost_of, result_of
from worker.wants import Want

MANY = 16
"""The reference takes so many times the most samples."""

GROWTH = 1.125
"""Times the work after which the service is asked for a frame again."""

HEAD = f"{'samples':>9}{'seconds':>9}{'uniform':>9}{'adaptive':>10}{'ratio':>8}{'at equal paths':>16}"
LINE = "{samples:9}{seconds:9.3f}{uniform:9.4f}{adaptive:10.4f}{at_equal_time:8.2f}{at_equal_paths:16.2f}"


@dataclass(frozen=True)
class Point:
    """A frame: the processor's ``seconds`` and the ``paths`` it took, its ``error``, and whether all of it is lit."""

    seconds: float
    paths: float
    error: float
    lit: bool


@dataclass(frozen=True)
class Row:
    """Errors of both after the ``seconds`` that so many ``samples`` of each texel take, and uniform over adaptive."""

    samples: int
    seconds: float
    uniform: float
    adaptive: float
    at_equal_time: float
    at_equal_paths: float


class ChunkBake:
    """A view's light, baked chunk by chunk on one thread; ``spent`` tells what that took."""

    def __init__(self, renderer: Renderer, view: View) -> None:
        """Begin with darkness."""
        self.bake, self.spent = ViewBake(renderer, view), Cost()
        shown = self.bake.shown
        self.rows = {index: np.arange(a, b) for index, (a, b) in zip(shown.chunks, pairwise(shown.bounds), strict=True)}

    def bake_chunk(self, index: Index, work: Callable[[Light, np.ndarray], object]) -> tuple[Light, Cost]:
        """Have ``work`` done to a chunk's light and texels; what became of it and what that took."""
        bake, rows = self.bake, self.rows[index]
        light, before = bake.light.rows(rows), bake.light.samples[rows]
        begun = time.process_time()
        work(light, bake.texels[rows])
        cost = cost_of(light.samples, before, time.process_time() - begun)
        bake.light.put(rows, light)
        self.spent = self.spent.plus(cost)
        return light, cost

    def point(self, best: Frame) -> Point:
        """The frame as it is now, beside the ``best``."""
        lit = bool((self.bake.light.samples != 0).all())
        return Point(self.spent.seconds, self.spent.paths, frame_error(self.bake.frame(), best) or 0.0, lit)


class Service(ChunkBake):
    """A view's light in the order and the steps of the service's queue."""

    def __init__(self, renderer: Renderer, view: View, target: float) -> None:
        """Begin with darkness that is to become light of this ``target``."""
        super().__init__(renderer, view)
        self.target, self.source = target, renderer.recipe.scene.source
        self.costs = Costs("unused", self.bake.look.digest)
        self.queue = BakeQueue(lambda: 0.0, rate=lambda key: self.costs.rate(key[1]))

    def ask(self) -> None:
        """Want what the view's frame lacks, as whoever waits for it does again and again."""
        self.bake.frame()
        frame = self.bake.renderer.render(self.bake.view, self.target)
        self.queue.want(((("", demand.index), demand) for demand in frame.demands), self.target)

    def work(self, until: float) -> bool:
        """Do tasks until so many seconds are spent; returns whether there is more to do."""
        while self.spent.seconds < until:
            want = self.queue.take()
            if want is None:
                return False
            self.do(want)
        return True

    def do(self, want: Want) -> None:
        """Do a task, as ``worker.tasks.bake`` does."""
        look, index = self.bake.look, want.key[1]
        what = self.source, look.plan, look.digest, Place("unused"), index, want.offsets, want.footprints
        task = BakeTask(*what, want.until, want.least or 0.0, self.target)
        light, cost = self.bake_chunk(index, partial(climb, look=look, task=task))
        self.costs.add(index, cost)
        self.queue.finish(want.key, want.offsets, self.target, result_of(light, look, task, cost))


def race(scene: Scene, size: int, most: int, target: float) -> tuple[list[Point], list[Point]]:
    """The points of both ways, uniform samples first."""
    with tempfile.TemporaryDirectory() as store:
        renderer, view = make_renderer(scene, store), view_of(scene, size)
        best = ViewBake(renderer, view)
        best.grow(MANY * most)
        frame = best.frame()
        uniform = list(uniform_points(ChunkBake(renderer, view), most, frame))
        return uniform, list(adaptive_points(Service(renderer, view, target), uniform[-1].seconds, frame))


def uniform_points(bake: ChunkBake, most: int, best: Frame) -> Iterator[Point]:
    """A point after each rung up to the ``most`` samples."""
    for samples in tqdm(rungs(most), desc="uniform", leave=False):
        for index in bake.rows:
            bake.bake_chunk(index, partial(refine, look=bake.bake.look, until=samples, target=NEVER))
        yield bake.point(best)


def adaptive_points(bake: Service, seconds: float, best: Frame) -> Iterator[Point]:
    """A point each time that the work has grown by GROWTH, until it took more than ``seconds``."""
    until, more = seconds / 1000.0, True
    while more and bake.spent.seconds < seconds:
        bake.ask()
        more = bake.work(until)
        until = GROWTH * max(until, bake.spent.seconds)
        yield bake.point(best)


def rungs(most: int) -> list[int]:
    """Samples of the uniform frames."""
    return [FIRST_RUNG << k for k in range((most // FIRST_RUNG).bit_length())]


def rows(uniform: Sequence[Point], adaptive: Sequence[Point]) -> list[Row]:
    """Errors of both at the uniform frames' times; those alone at which the other frame was lit, and not yet done."""
    by_time, by_paths = (error_at(adaptive, of) for of in (lambda p: p.seconds, lambda p: p.paths))
    return [
        Row(FIRST_RUNG << k, point.seconds, point.error, other, point.error / other, point.error / same)
        for k, point in enumerate(uniform)
        if (other := by_time(point)) and (same := by_paths(point))
    ]


def error_at(points: Sequence[Point], cost: Callable[[Point], float]) -> Callable[[Point], float | None]:
    """The error that lit ``points`` had at what another costs, interpolated in logarithms; None beyond them."""
    lit = [point for point in points if point.lit]
    costs, errors = np.log([cost(point) for point in lit]), np.log([point.error for point in lit])

    def found(other: Point) -> float | None:
        at = np.log(cost(other))
        inside = len(lit) > 0 and costs[0] <= at <= costs[-1]
        return float(np.exp(np.interp(at, costs, errors))) if inside else None

    return found


def first_lit(points: Sequence[Point]) -> float | None:
    """Seconds until the first frame that was lit everywhere."""
    return next((point.seconds for point in points if point.lit), None)


@click.command()
@click.argument("scene", required=False)
@click.option("--size", type=click.IntRange(8), default=64, show_default=True, help="Pixels a side of the view.")
@click.option("--samples", type=click.IntRange(FIRST_RUNG), default=256, show_default=True, help="The most, uniform.")
@click.option("--target", type=click.FloatRange(0.0, min_open=True), default=0.02, show_default=True, help="Its error.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def main(scene: str | None, size: int, samples: int, target: float, as_json: bool) -> None:
    """Bake in both ways and print the ratios of their errors."""
    for each in three_scenes(scene, UFFIZI, GRACE):
        uniform, adaptive = race(each, size, samples, target)
        show(f"{each.name} at {each.isovalue:g}, {each.environment.name}", uniform, adaptive, as_json)


def show(title: str, uniform: Sequence[Point], adaptive: Sequence[Point], as_json: bool) -> None:
    """Print the ratios: as JSON on one line, or as a table."""
    found, lit = rows(uniform, adaptive), {"uniform": first_lit(uniform), "adaptive": first_lit(adaptive)}
    if as_json:
        facts = {"what": title, "lit": lit, "rows": [asdict(row) for row in found]}
        click.echo(json.dumps(facts, allow_nan=False))
        return
    click.echo(f"\n{title}: lit everywhere after {lit['uniform']:.3g} s and {lit['adaptive'] or np.nan:.3g} s\n{HEAD}")
    for row in found:
        click.echo(LINE.format(**asdict(row)))


if __name__ == "__main__":
    main()
