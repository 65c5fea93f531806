"""Error against run time: light kept in several ways, and paths from each pixel (S1, table 1 and figure 7)."""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

from isogi_core.frame.frame import Frame
from isogi_core.model.scene import Scene
from isogi_core.report import scores
from isogi_core.report.bake import ViewBake
from isogi_core.report.bench import Bench
from isogi_core.report.breakeven import evens
from isogi_core.report.metrics import Score
from isogi_core.report.reference import Reference
from isogi_core.report.sections import Column, Curve, Plot, Section, Table
from isogi_core.report.ways import as_irradiance, as_s1

KEY, TITLE = "convergence", "Error against run time"

SIZE = 32
"""Pixels of the longer side of the picture."""

RUNGS = (16, 64, 256, 1024, 4096, 16384)
"""Samples of a texel, or paths of a pixel, of the points of a curve."""

SECONDS, SHARE = 120.0, 0.1
"""Seconds that the next point of a curve may take, by what the last one took, and the share of those that are left."""

TRACED = "path tracing from each pixel"
"""The name of the curve that has no light of texels."""

ABOUT = """\
Errors against the reference, of one view, as more samples are taken. Light of texels is baked once and serves all \
cameras and, where it turns, all lights; paths from each pixel serve one picture. What a curve levels off at is what \
more samples do not mend: interpolation, harmonics and bounces that are cut off. Each point of baked light grows from \
the one before; seconds are of the processor, all threads together, without compiling. The bake pays for itself after \
so many pictures that read the texels of this one, from cameras that see the same surface or under turned lights, as \
paths from each pixel could trace to its own error in its time; frames of baked light take milliseconds, and count as \
nothing here."""

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

    def foresee(self, samples: int) -> float:
        """The seconds that so many samples are expected to take."""
        return samples * self.seconds / self.samples


def study(bench: Bench) -> Section:
    """The curves, their points as a table, and where baked light begins to pay."""
    small = bench.sized(SIZE)
    found = points_of(small)
    rows = tuple((name, p.samples, p.seconds, *scores.cells(p.score)) for name, own in found.items() for p in own)
    curves = tuple(curve(name, own) for name, own in found.items())
    size = f"{small.view.width} × {small.view.height} pixels"
    plot = Plot(f"Error against run time, {size}", Column("time", "seconds"), Column("error", "share"), curves)
    table = Table(f"Points of the curves, {size}", COLUMNS, rows)
    tables = evens(curves[:-1], curves[-1], size), table
    return Section(KEY, TITLE, " ".join([ABOUT, *ends(found)]), tables, (plot,))


def points_of(bench: Bench) -> dict[str, list[Point]]:
    """The points of all curves by name, that of path tracing last."""
    best = bench.grown(0.0)
    found = {name: baked(bench, scene, best) for name, scene in ways(bench.scene).items()}
    return {**found, TRACED: traced(bench, best)}


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


def ends(found: dict[str, list[Point]]) -> list[str]:
    """A sentence on each curve that ends before the last of RUNGS."""
    return [
        f"The curve of {name.split(':')[0]} ends at {own[-1].samples:,} samples: the next point would have taken too "
        f"long, about {own[-1].foresee(RUNGS[len(own)]):.0f} seconds."
        for name, own in found.items()
        if len(own) < len(RUNGS)
    ]


def baked(bench: Bench, scene: Scene, best: Reference) -> list[Point]:
    """The points of light that is baked by a scene's plan. Raises Cancelled."""
    bake = ViewBake(bench.renderer(scene), bench.view)

    def frame(samples: int) -> tuple[Frame, float]:
        bake.grow(samples, cancelled=bench.cancelled)
        return bake.frame(), bake.seconds

    return points(bench, best, frame)


def traced(bench: Bench, best: Reference) -> list[Point]:
    """The points of paths from each pixel, each picture traced anew; with as many bounces as may matter."""
    renderer, view = bench.renderer(bench.whole), replace(bench.view, shading="path_traced")
    renderer.render(replace(view, samples=1))

    def frame(samples: int) -> tuple[Frame, float]:
        begun = time.process_time()
        frame = renderer.render(replace(view, samples=samples), cancelled=bench.cancelled)
        return frame, time.process_time() - begun

    return points(bench, best, frame)


def points(bench: Bench, best: Reference, frame: Callable[[int], tuple[Frame, float]]) -> list[Point]:
    """The points of ``frame``, which tells its seconds too, over RUNGS, until the next would take too long.

    The first one is made in any case.
    """
    found: list[Point] = []
    for samples in RUNGS:
        if found and not fits(bench, found[-1].foresee(samples)):
            break
        picture, seconds = frame(samples)
        found.append(Point(samples, seconds, bench.score(picture.radiance, best)))
    return found


def fits(bench: Bench, seconds: float) -> bool:
    """Whether a point may take so long; the bench is told where time left forbids it."""
    if seconds > SHARE * bench.left:
        bench.hurry.set()
    return seconds <= min(SECONDS, SHARE * bench.left)
