"""Error against run time: light kept in several ways, and paths from each pixel (S1, table 1 and figure 7)."""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

from isogi_core.model.scene import Scene
from isogi_core.report import scores
from isogi_core.report.bake import ViewBake
from isogi_core.report.bench import Bench, longer
from isogi_core.report.metrics import Score
from isogi_core.report.sections import Column, Curve, Plot, Section, Table
from isogi_core.report.ways import as_irradiance, as_s1

SIZE = 40
"""Pixels of the longer side of the picture, at most."""

RUNGS = (16, 64, 256, 1024, 4096, 16384)
"""Samples of a texel, or paths of a pixel, of the points of a curve."""

SECONDS = 45.0
"""Seconds of the processor that the next point of a curve may take, by what the last one took."""

ABOUT = """\
Errors against the reference, of one view, as more samples are taken. Light of texels is baked once and serves all \
cameras and, where it turns, all lights; paths from each pixel serve one picture. What a curve levels off at is what \
more samples do not mend: interpolation, harmonics and bounces that are cut off. Each point of baked light grows from \
the one before; seconds are of the processor, all threads together, without compiling."""

COLUMNS = (
    Column("way"),
    Column("samples", "count"),
    Column("time", "seconds"),
    *scores.COLUMNS,
)


@dataclass(frozen=True)
class Point:
    """A picture's score after so many ``samples`` and ``seconds`` of the processor."""

    samples: int
    seconds: float
    score: Score


def study(bench: Bench) -> Section:
    """The curves, and their points as a table."""
    small = bench.smaller(SIZE)
    found = {name: list(baked(small, scene)) for name, scene in ways(bench.scene).items()}
    found["path tracing from each pixel"] = list(traced(small))
    rows = tuple((name, p.samples, p.seconds, *scores.cells(p.score)) for name, points in found.items() for p in points)
    curves = tuple(curve(name, points) for name, points in found.items())
    size = f"{small.view.width} × {small.view.height} pixels"
    plot = Plot(f"Error against run time, {size}", Column("time", "seconds"), Column("error", "share"), curves)
    table = Table(f"Points of the curves, {size}", COLUMNS, rows)
    return Section("convergence", "Error against run time", ABOUT, (table,), (plot,))


def ways(scene: Scene) -> dict[str, Scene]:
    """The ways to keep a scene's light, by name: its plan, S1's, and irradiance."""
    found = {f"the plan: {scene.plan.representation}": scene}
    s1 = as_s1(scene)
    if s1 is not None:
        found["S1: 25 harmonics in floats"] = s1
    if scene.plan.representation != "irradiance":
        found["irradiance, for a light that stays"] = as_irradiance(scene)
    return found


def curve(name: str, points: list[Point]) -> Curve:
    """The points as a curve of the plot."""
    return Curve(name, tuple(p.seconds for p in points), tuple(p.score.rmse for p in points))


def baked(bench: Bench, scene: Scene) -> Iterator[Point]:
    """The points of light that is baked by a scene's plan."""
    bake, best = ViewBake(bench.renderer(scene), bench.view), bench.grown(0.0)
    for samples in affordable(bench, lambda: bake.seconds):
        bake.grow(samples, cancelled=bench.cancelled)
        yield Point(samples, bake.seconds, bench.score(bake.frame().radiance, best))


def traced(bench: Bench) -> Iterator[Point]:
    """The points of paths from each pixel, each picture traced anew; with as many bounces as may matter."""
    renderer, spent = bench.renderer(longer(bench.scene)), 0.0
    view, best = replace(bench.view, shading="path_traced"), bench.grown(0.0)
    renderer.render(replace(view, samples=1))
    for samples in affordable(bench, lambda: spent):
        begun = time.process_time()
        frame = renderer.render(replace(view, samples=samples), cancelled=bench.cancelled)
        spent = time.process_time() - begun
        yield Point(samples, spent, bench.score(frame.radiance, best))


def affordable(bench: Bench, spent: Callable[[], float]) -> Iterator[int]:
    """RUNGS, until the next would take too long; ``spent`` tells the seconds that the curve's last point took."""
    rate = 0.0
    for samples in RUNGS:
        if rate * samples > min(SECONDS, bench.left):
            return
        yield samples
        rate = spent() / samples
