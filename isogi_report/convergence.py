"""Error against run time: light kept in several ways, and paths from each pixel (S1, table 1 and figure 7)."""

import math
import time
from bisect import bisect_left
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

from isogi_core.frame.frame import Frame
from isogi_core.model.scene_plan import GLOW_KIND, Layer
from isogi_core.plan.left_out import MEASURED_BANDS
from isogi_core.plan.planner import unit_of
from isogi_core.plan.scene import Scene
from isogi_core.reference import Reference
from isogi_report.bake import ViewBake
from isogi_report.bench import Bench, with_plan
from isogi_report.metrics import SCORE_COLUMNS, Score, score_cells
from isogi_report.sections import Cell, Column, Curve, Plot, Section, Table

CONVERGENCE_KEY, CONVERGENCE_TITLE = "convergence", "Error against run time"

CURVE_PIXELS = 32
"""Pixels of the longer side of the picture."""

CURVE_SAMPLES = (16, 64, 256, 1024, 4096, 16384)
"""Samples of a texel, or paths of a pixel, of the points of a curve."""

MAX_POINT_SECONDS, POINT_SHARE = 120.0, 0.1
"""Seconds that the next point of a curve may take, by what the last one took, and the share of those that are left."""

PATH_TRACING_CURVE = "path tracing from each pixel"
"""The name of the curve that has no light of texels."""

CONVERGENCE_TEXT = """\
Errors against the reference, of one view, as more samples are taken. Light of texels is baked once and serves all \
cameras and, where it turns, all lights; paths from each pixel serve one picture. Where a curve levels off, \
more samples do not help: interpolation, harmonics and bounces that are cut off. Each point of baked light grows from \
the one before; seconds are of the processor, all threads together, without compiling. The bake pays for itself after \
so many pictures that read the texels of this one, from cameras that see the same surface or under turned lights, as \
paths from each pixel could trace to its own error in its time; frames of baked light take milliseconds, and count as \
nothing here."""

CURVE_COLUMNS = (
    Column("way"),
    Column("samples", "count"),
    Column("time", "seconds"),
    *SCORE_COLUMNS,
)


END_ERROR_FACTOR = 1.1
"""How many times the error that a curve ends at its point may have that stands for the whole bake."""

EQUAL_ERROR_COLUMNS = (
    Column("way"),
    Column("relative RMSE", "share"),
    Column("bake", "seconds"),
    Column("a traced picture of that error", "seconds"),
    Column("pictures until the bake pays", "count"),
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
    small = bench.sized(CURVE_PIXELS)
    found = points_of(small)
    rows = tuple((name, p.samples, p.seconds, *score_cells(p.score)) for name, own in found.items() for p in own)
    curves = tuple(curve(name, own) for name, own in found.items())
    size = f"{small.view.width} × {small.view.height} pixels"
    plot = Plot(f"Error against run time, {size}", Column("time", "seconds"), Column("error", "share"), curves)
    table = Table(f"Points of the curves, {size}", CURVE_COLUMNS, rows)
    tables = evens(curves[:-1], curves[-1], size), table
    return Section(CONVERGENCE_KEY, CONVERGENCE_TITLE, " ".join([CONVERGENCE_TEXT, *ends(found)]), tables, (plot,))


def points_of(bench: Bench) -> dict[str, list[Point]]:
    """The points of all curves by name, that of path tracing last."""
    best = bench.grown(0.0)
    found = {name: baked(bench, scene, best) for name, scene in ways(bench.scene).items()}
    return {**found, PATH_TRACING_CURVE: traced(bench, best)}


def ways(scene: Scene) -> dict[str, Scene]:
    """The ways to keep a scene's light, by name: its plan, S1's, and irradiance."""
    found = {f"the plan: {scene.plan.representation}": scene}
    s1 = as_s1(scene)
    if s1 is not None:
        found["S1: 25 harmonics in floats"] = s1
    if scene.plan.representation != "irradiance":
        found["irradiance, for a light that stays"] = as_irradiance(scene)
    return found


def as_s1(scene: Scene) -> Scene | None:
    """The scene with what S1 keeps of any; None under lamps, which harmonics do not hold."""
    if scene.lighting.lamps.any:
        return None
    whole = Layer("whole", MEASURED_BANDS, 3, half=False)
    return with_plan(
        scene, representation="transfer", layers=(whole, *of_glow(scene)), order=MEASURED_BANDS, lobes=0, survival=1.0
    )


def as_irradiance(scene: Scene) -> Scene:
    """The scene under lights that stay: a texel keeps the light that it receives."""
    channels = 1 if scene.inputs.grey and scene.inputs.grey_light else 3
    layer = Layer("irradiance", channels=channels, scale=unit_of(scene.inputs))
    return with_plan(scene, representation="irradiance", layers=(layer, *of_glow(scene)), order=1, lobes=0)


def of_glow(scene: Scene) -> tuple[Layer, ...]:
    """The layer of what glows in a scene, which is the same whatever else is kept; none where nothing does."""
    return tuple(layer for layer in scene.plan.layers if layer.kind == GLOW_KIND)


def curve(name: str, own: list[Point]) -> Curve:
    """A way's ``own`` points as a curve of the plot."""
    return Curve(name, tuple(p.seconds for p in own), tuple(p.score.rmse for p in own))


def ends(found: dict[str, list[Point]]) -> list[str]:
    """A sentence on each curve that ends before the last of CURVE_SAMPLES."""
    return [
        f"The curve of {name.split(':')[0]} ends at {own[-1].samples:,} samples: the next point would have taken too "
        f"long, about {own[-1].foresee(CURVE_SAMPLES[len(own)]):.0f} seconds."
        for name, own in found.items()
        if len(own) < len(CURVE_SAMPLES)
    ]


def baked(bench: Bench, scene: Scene, best: Reference) -> list[Point]:
    """The points of light that is baked by a scene's plan. Raises Cancelled."""
    bake = ViewBake(bench.renderer(scene), bench.view)

    def frame(samples: int) -> tuple[Frame, float]:
        bake.grow(samples)
        return bake.frame(), bake.seconds

    return points(bench, best, frame)


def traced(bench: Bench, best: Reference) -> list[Point]:
    """The points of paths from each pixel, each picture traced again; with as many bounces as may matter."""
    renderer, view = bench.renderer(bench.whole), replace(bench.view, shading="path_traced")
    renderer.render(replace(view, samples=1))

    def frame(samples: int) -> tuple[Frame, float]:
        begun = time.process_time()
        frame = renderer.render(replace(view, samples=samples))
        return frame, time.process_time() - begun

    return points(bench, best, frame)


def points(bench: Bench, best: Reference, frame: Callable[[int], tuple[Frame, float]]) -> list[Point]:
    """The points of ``frame``, which returns its seconds too, over CURVE_SAMPLES, until the next would take too long.

    The first one is made in any case.
    """
    found: list[Point] = []
    for samples in CURVE_SAMPLES:
        if found and not fits(bench, found[-1].foresee(samples)):
            break
        picture, seconds = frame(samples)
        found.append(Point(samples, seconds, bench.score(picture.leaving, best)))
    return found


def fits(bench: Bench, seconds: float) -> bool:
    """Whether a point may take so long; the bench notes where time left forbids it."""
    if seconds > POINT_SHARE * bench.left:
        bench.hurry.set()
    return seconds <= min(MAX_POINT_SECONDS, POINT_SHARE * bench.left)


def evens(baked: Iterable[Curve], traced: Curve, size: str) -> Table:
    """The break-even of each ``baked`` curve of seconds and errors against the ``traced`` one; ``size`` in words."""
    rows = tuple(even(curve, traced) for curve in baked)
    return Table(f"When baked light pays, {size}", EQUAL_ERROR_COLUMNS, rows)


def even(baked: Curve, traced: Curve) -> tuple[Cell, ...]:
    """A way's row of the table, of its cheapest point that is nearly as good as its last one."""
    seconds, error = next((x, y) for x, y in zip(baked.x, baked.y, strict=True) if y <= END_ERROR_FACTOR * baked.y[-1])
    picture = seconds_at(traced, error)
    pictures = None if picture is None else math.ceil(seconds / picture)
    return baked.name, error, seconds, picture, pictures


def seconds_at(curve: Curve, error: float) -> float | None:
    """The seconds after which a curve has come to an error, linear in their logarithms between its points.

    Beyond its first and last point the line through the nearest two goes on. None where that never meets the error:
    the curve has a single point, does not fall, or its error is 0.
    """
    if len(curve.x) < 2 or min(error, *curve.y) <= 0.0:
        return None
    i = min(max(bisect_left([-y for y in curve.y], -error), 1), len(curve.x) - 1)
    (x0, x1), (y0, y1) = ([math.log(v) for v in values[i - 1 : i + 1]] for values in (curve.x, curve.y))
    if y1 >= y0 or x1 <= x0:
        return None
    return math.exp(x0 + (math.log(error) - y0) * (x1 - x0) / (y1 - y0))
