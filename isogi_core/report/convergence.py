"""Error against run time: light kept in several ways, and paths from each pixel (S1, table 1 and figure 7)."""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

from isogi_core.frame.frame import Frame
from isogi_core.model.scene import Scene
from isogi_core.report import scores
from isogi_core.report.bake import ViewBake
from isogi_core.report.bench import Bench, longer
from isogi_core.report.metrics import Score
from isogi_core.report.reference import Reference
from isogi_core.report.sections import Column, Curve, Plot, Section, Table
from isogi_core.report.ways import as_irradiance, as_s1

SIZE = 32
"""Pixels of the longer side of the picture."""

RUNGS = (16, 64, 256, 1024, 4096, 16384)
"""Samples of a texel, or paths of a pixel, of the points of a curve."""

SECONDS = 25.0
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
    small = bench.sized(SIZE)
    found = {name: list(baked(small, scene)) for name, scene in ways(bench.scene).items()}
    found["path tracing from each pixel"] = list(traced(small))
    rows = tuple((name, p.samples, p.seconds, *scores.cells(p.score)) for name, own in found.items() for p in own)
    curves = tuple(curve(name, own) for name, own in found.items())
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


def curve(name: str, own: list[Point]) -> Curve:
    """A way's ``own`` points as a curve of the plot."""
    return Curve(name, tuple(p.seconds for p in own), tuple(p.score.rmse for p in own))


def baked(bench: Bench, scene: Scene) -> Iterator[Point]:
    """The points of light that is baked by a scene's plan."""
    bake, best = ViewBake(bench.renderer(scene), bench.view), bench.grown(0.0)

    def frame(samples: int) -> tuple[Frame, float]:
        bake.grow(samples, cancelled=bench.cancelled)
        return bake.frame(), bake.seconds

    return points(bench, best, frame)


def traced(bench: Bench) -> Iterator[Point]:
    """The points of paths from each pixel, each picture traced anew; with as many bounces as may matter."""
    renderer, best = bench.renderer(longer(bench.scene)), bench.grown(0.0)
    view = replace(bench.view, shading="path_traced")
    renderer.render(replace(view, samples=1))

    def frame(samples: int) -> tuple[Frame, float]:
        begun = time.process_time()
        frame = renderer.render(replace(view, samples=samples), cancelled=bench.cancelled)
        return frame, time.process_time() - begun

    return points(bench, best, frame)


def points(bench: Bench, best: Reference, frame: Callable[[int], tuple[Frame, float]]) -> Iterator[Point]:
    """The points of ``frame``, which tells its seconds too, over RUNGS, until the next would take too long."""
    rate = 0.0
    for samples in RUNGS:
        if rate * samples > min(SECONDS, bench.left):
            return
        picture, seconds = frame(samples)
        rate = seconds / samples
        yield Point(samples, seconds, bench.score(picture.radiance, best))
