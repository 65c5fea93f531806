"""The three studies of a report.

The summary: what it is of, how wrong the frame is, what it took, and where it differs (S1, figure
11). The split: a frame's error, and its parts, each found by putting its exact counterpart in place
of one ingredient. Convergence: error against run time, of light kept in several ways, and of paths
from each pixel (S1, table 1 and figure 7).
"""

import math
import time
from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from isogi_core.frame.frame import Frame
from isogi_core.model.scene_plan import GLOW_KIND, Layer, ScenePlan
from isogi_core.plan.left_out import MEASURED_BANDS
from isogi_core.plan.planner import unit_of
from isogi_core.plan.scene import Scene
from isogi_core.reference import Reference
from isogi_report.bench import Bench, ViewBake, with_plan
from isogi_report.exact import (
    Lit,
    converged,
    cuts_harmonics,
    lit_by_frame,
    lit_by_paths,
    own_light,
    reference_difference,
    short_paths,
)
from isogi_report.metrics import (
    SCORE_COLUMNS,
    Score,
    Spread,
    error_map,
    map_of,
    mean_of,
    score_cells,
    spread_of,
)
from isogi_report.sections import Cell, Column, Curve, Picture, Plot, Section, Table

SUMMARY_KEY = "summary"
SUMMARY_TITLE = "Summary"

SUMMARY_TEXT = """\
One view of a scene, each of its texels baked to the target error by the scene's plan, against a \
reference: paths from each pixel to the lights themselves, with the scene's own normals and \
offset. Errors are of the luminance, over the surface pixels, relative to the reference's mean: \
the root mean square (less the reference's own noise), what 99 % of pixels stay below, the signed \
mean (bias); FLIP is of the pictures as a screen shows them. Random numbers belong to texels and \
pixels, so that light of as many samples has the same bits again; how many the reference has may \
hang on the time that there was. Seconds are of the processor, all threads together."""


def study_summary(bench: Bench) -> Section:
    """The headline, the facts, and the pictures."""
    planned = bench.planned
    best = bench.best
    frame = planned.frame()
    own = score_cells(bench.score(frame.leaving))
    columns = (*SCORE_COLUMNS, Column("estimated noise", "share"), Column("bake", "seconds"))
    headline = Table("The frame", columns, ((*own, frame.noise, planned.seconds),))
    measured = (
        Column("reference's noise", "share"),
        Column("paths per pixel", "count"),
        Column("time", "seconds"),
    )
    reference = Table("Its reference", measured, ((best.noise, best.samples, best.seconds),))
    scene = Table("The scene", (Column("what"), Column("is")), measured_facts(bench))
    pictures = (
        Picture("the frame", "radiance", frame.radiance),
        Picture(f"the reference, {best.samples} paths per pixel", "radiance", best.mean),
        Picture("the frame's error", "error", error_map(frame.leaving, best)),
    )
    return Section(
        SUMMARY_KEY, SUMMARY_TITLE, SUMMARY_TEXT, (headline, reference, scene), (), pictures
    )


def measured_facts(bench: Bench) -> tuple[tuple[Cell, ...], ...]:
    """What is measured, in words."""
    scene = bench.scene
    view = bench.view
    planned = bench.planned
    lights = " + ".join(light.name for light in scene.lighting.lights) or "no light"
    layers = " + ".join(map(layer_in_words, scene.plan.layers))
    size = " × ".join(map(str, scene.volume.size))
    texels = f"{len(planned.texels):,} texels, {planned.samples:,.0f} samples each on average"
    return (
        (
            "volume",
            f"{scene.volume.name}, {size} voxels, isovalue {scene.volume.spell(view.isovalue)}",
        ),
        ("lights", f"{lights}, {'may turn' if scene.lighting.rotating else 'stay where they are'}"),
        (
            "picture",
            f"{view.width} × {view.height}, {int(bench.best.on.sum()):,} surface pixels, {texels}",
        ),
        (
            "plan",
            f"{scene.plan.representation}: {layers}; {scene.plan.bytes_per_texel} bytes per texel",
        ),
        ("bounces", f"{scene.bounces} of the plan, {bench.whole.bounces} of the reference"),
        ("target error", f"{scene.target_error:.1%} of noise, at most, in pixels of final texels"),
    )


def layer_in_words(layer: Layer) -> str:
    """A layer in words."""
    if layer.kind != "irradiance":
        order = f" of order {layer.order}"
    else:
        order = ""
    return f"{layer.kind} light{order}, {layer.channels} × {layer.order**2} in {layer.precision}"


SPLIT_KEY = "split"
SPLIT_TITLE = "Where the error comes from"

SPLIT_COLUMNS = (
    Column("part"),
    Column("relative RMSE", "share"),
    Column("bias", "share"),
    Column("what is compared"),
)

SPLIT_TEXT = """\
Each part is the difference that remains when one ingredient of the frame gives way to its exact \
counterpart, one after the other, so that biases add up to the total's. Noise that is known of \
either side is taken off. The parts' root sum of squares equals the total where they are \
independent. Normals and offset are the scene's own choice, and so the reference's too: what they \
change is listed apart."""


@dataclass(frozen=True, eq=False)
class Part:
    """One part of a frame's error: its ``name``, ``what`` was compared, and ``wrong`` (m,), the
    pixels' luminance too much; ``noise`` (m,) is the variance of it that belongs to no part,
    negative where some of the part is missing.
    """

    name: str
    what: str
    wrong: np.ndarray
    noise: np.ndarray | float = 0.0


@dataclass(frozen=True, eq=False)
class Split:
    """The ``parts`` of a frame's error, and the ``whole`` of it; ``mean`` is the luminance that
    they are relative to.

    ``surface`` is what the scene's normals and offset make of it, and ``beyond`` the whole with
    that.
    """

    parts: tuple[Part, ...]
    whole: Part
    surface: Part
    beyond: Part
    mean: float

    def spread(self, part: Part) -> Spread:
        """The size of a part."""
        return spread_of(part.wrong, part.noise, self.mean)

    @property
    def together(self) -> float:
        """Root sum of squares of the parts."""
        return math.sqrt(sum(self.spread(part).rmse ** 2 for part in self.parts))


def study_split(bench: Bench) -> Section:
    """The frame's error and its parts, as a table and as maps."""
    split = split_error(bench)
    bias = sum(split.spread(part).bias for part in split.parts)
    reported = bench.planned.frame().noise
    rows = (
        *(row_of(part, split) for part in split.parts),
        ("parts together", split.together, bias, "root sum of squares, sum of biases"),
        row_of(split.whole, split),
        (
            "the frame's own estimate",
            reported,
            None,
            "Monte Carlo noise alone, estimated by the texels",
        ),
        row_of(split.surface, split),
        row_of(split.beyond, split),
    )
    shown = (*split.parts, split.whole, split.surface)
    pictures = tuple(
        Picture(part.name, "error", map_of(part.wrong, bench.best.on, split.mean)) for part in shown
    )
    table = Table("Error of the plan's frame and its parts", SPLIT_COLUMNS, rows)
    return Section(
        SPLIT_KEY, SPLIT_TITLE, f"{SPLIT_TEXT} {missing(bench)}".strip(), (table,), (), pictures
    )


def split_error(bench: Bench) -> Split:
    """Split the error of the plan's frame."""
    best = lit_by_paths(bench.best)
    planned = lit_by_frame(bench.planned.frame())
    whole = Part(
        "total, measured", "the frame and the reference", planned.light - best.light, best.noise
    )
    bare = bench.reference(bench.best.samples, true_surface(bench.scene))
    true = lit_by_paths(bare)
    change = reference_difference(bench.best, bare)
    what = "the scene's normals and offset, and plain gradients with rays from the surface itself"
    surface = Part("normals and offset", what, change.light, change.noise)
    beyond = Part(
        "total with these", "the frame and such a reference", planned.light - true.light, true.noise
    )
    return Split(tuple(parts_of(bench, planned, best)), whole, surface, beyond, mean_of(best.light))


def true_surface(scene: Scene) -> Scene:
    """The scene with the normals that its trilinear isosurface has, and rays that start on it."""
    return scene.with_settings(normals="gradient", offset=0.0)


def parts_of(bench: Bench, planned: Lit, best: Lit) -> Iterator[Part]:
    """The parts, from the frame to the reference."""
    pair = converged(bench)
    plan = bench.scene.plan
    kept = lit_by_frame(pair.kept)
    exact = lit_by_frame(pair.exact)
    what = f"texels as they are, and after {pair.samples:,.0f} samples each on average"
    yield Part("Monte Carlo noise", what, planned.light - kept.light, -kept.noise)
    if plan.precision != "single":
        yield Part("quantization", f"{plan.precision} and single floats", kept.light - exact.light)
    own = own_light(bench)
    short = short_paths(bench)
    noise = exact.noise + own.noise
    yield Part(
        "interpolation",
        "texels around a pixel, and light at its own point",
        exact.light - own.light,
        noise,
    )
    if cuts_harmonics(bench.scene):
        what = f"{harmonics(plan)}, and the lights themselves"
        lights = lit_by_paths(short)
        yield Part("harmonics cut off", what, own.light - lights.light, own.noise + lights.noise)
    if bench.scene.bounces:
        cut = reference_difference(short, bench.best)
        what = f"{bench.scene.bounces} bounces, and {bench.whole.bounces}"
        yield Part("bounces cut off", what, cut.light, cut.noise)


def harmonics(plan: ScenePlan) -> str:
    """What texels keep of a light, and what pixels see of it themselves."""
    lobes = {0: "", 1: ", a lobe beside"}.get(plan.lobes, f", {plan.lobes} lobes beside")
    return f"harmonics of order {plan.order}{lobes}"


def missing(bench: Bench) -> str:
    """Why some parts are not there."""
    plan = bench.scene.plan
    reasons = []
    if plan.precision == "single":
        reasons.append("Light is kept in single floats: nothing is rounded.")
    if not cuts_harmonics(bench.scene):
        reasons.append("Texels keep no harmonics that could be cut off.")
    if not bench.scene.bounces:
        reasons.append("The scene has direct light alone: no bounces are missing.")
    return " ".join(reasons)


def row_of(part: Part, split: Split) -> tuple[str, float, float, str]:
    """A part's row of the table."""
    spread = split.spread(part)
    return part.name, spread.rmse, spread.bias, part.what


CONVERGENCE_KEY = "convergence"
CONVERGENCE_TITLE = "Error against run time"

CURVE_PIXELS = 32
"""Pixels of the longer side of the picture."""

CURVE_SAMPLES = (16, 64, 256, 1024, 4096, 16384)
"""Samples of a texel, or paths of a pixel, of the points of a curve."""

MAX_POINT_SECONDS = 120.0
POINT_SHARE = 0.1
"""Seconds that the next point of a curve may take, by what the last one took, and the share of
those that are left.
"""

PATH_TRACING_CURVE = "path tracing from each pixel"
"""The name of the curve that has no light of texels."""

CONVERGENCE_TEXT = """\
Errors against the reference, of one view, as more samples are taken. Light of texels is baked \
once and serves all cameras and, where it turns, all lights; paths from each pixel serve one \
picture. Where a curve levels off, more samples do not help: interpolation, harmonics and bounces \
that are cut off. Each point of baked light grows from the one before; seconds are of the \
processor, all threads together, without compiling. The bake pays for itself after so many \
pictures that read the texels of this one, from cameras that see the same surface or under turned \
lights, as paths from each pixel could trace to its own error in its time; frames of baked light \
take milliseconds, and count as nothing here."""

CURVE_COLUMNS = (
    Column("way"),
    Column("samples", "count"),
    Column("time", "seconds"),
    *SCORE_COLUMNS,
)


END_ERROR_FACTOR = 1.1
"""How many times the error that a curve ends at its point may have that stands for the whole
bake.
"""

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


def study_convergence(bench: Bench) -> Section:
    """The curves, their points as a table, and where baked light begins to pay."""
    small = bench.sized(CURVE_PIXELS)
    found = points_of(small)
    rows = tuple(
        (name, p.samples, p.seconds, *score_cells(p.score))
        for name, own in found.items()
        for p in own
    )
    curves = tuple(curve(name, own) for name, own in found.items())
    size = f"{small.view.width} × {small.view.height} pixels"
    plot = Plot(
        f"Error against run time, {size}",
        Column("time", "seconds"),
        Column("error", "share"),
        curves,
    )
    table = Table(f"Points of the curves, {size}", CURVE_COLUMNS, rows)
    tables = evens(curves[:-1], curves[-1], size), table
    return Section(
        CONVERGENCE_KEY,
        CONVERGENCE_TITLE,
        " ".join([CONVERGENCE_TEXT, *ends(found)]),
        tables,
        (plot,),
    )


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
        scene,
        representation="transfer",
        layers=(whole, *of_glow(scene)),
        order=MEASURED_BANDS,
        lobes=0,
        survival=1.0,
    )


def as_irradiance(scene: Scene) -> Scene:
    """The scene under lights that stay: a texel keeps the light that it receives."""
    if scene.inputs.grey and scene.inputs.grey_light:
        channels = 1
    else:
        channels = 3
    layer = Layer("irradiance", channels=channels, scale=unit_of(scene.inputs))
    return with_plan(
        scene, representation="irradiance", layers=(layer, *of_glow(scene)), order=1, lobes=0
    )


def of_glow(scene: Scene) -> tuple[Layer, ...]:
    """The layer of what glows in a scene, which is the same whatever else is kept; none where
    nothing does.
    """
    return tuple(layer for layer in scene.plan.layers if layer.kind == GLOW_KIND)


def curve(name: str, own: list[Point]) -> Curve:
    """A way's ``own`` points as a curve of the plot."""
    return Curve(name, tuple(p.seconds for p in own), tuple(p.score.rmse for p in own))


def ends(found: dict[str, list[Point]]) -> list[str]:
    """A sentence on each curve that ends before the last of CURVE_SAMPLES."""
    return [
        f"The curve of {name.split(':')[0]} ends at {own[-1].samples:,} samples: the next "
        "point would have taken too "
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
    """The points of paths from each pixel, each picture traced again; with as many bounces as may
    matter.
    """
    renderer = bench.renderer(bench.whole)
    view = replace(bench.view, shading="path_traced")
    renderer.render(replace(view, samples=1))

    def frame(samples: int) -> tuple[Frame, float]:
        begun = time.process_time()
        frame = renderer.render(replace(view, samples=samples))
        return frame, time.process_time() - begun

    return points(bench, best, frame)


def points(
    bench: Bench, best: Reference, frame: Callable[[int], tuple[Frame, float]]
) -> list[Point]:
    """The points of ``frame``, which returns its seconds too, over CURVE_SAMPLES, until the next
    would take too long.

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
    """The break-even of each ``baked`` curve of seconds and errors against the ``traced`` one;
    ``size`` in words.
    """
    rows = tuple(even(curve, traced) for curve in baked)
    return Table(f"When baked light pays, {size}", EQUAL_ERROR_COLUMNS, rows)


def even(baked: Curve, traced: Curve) -> tuple[Cell, ...]:
    """A way's row of the table, of its cheapest point that is nearly as good as its last one."""
    seconds, error = next(
        (x, y) for x, y in zip(baked.x, baked.y, strict=True) if y <= END_ERROR_FACTOR * baked.y[-1]
    )
    picture = seconds_at(traced, error)
    if picture is None:
        pictures = None
    else:
        pictures = math.ceil(seconds / picture)
    return baked.name, error, seconds, picture, pictures


def seconds_at(curve: Curve, error: float) -> float | None:
    """The seconds after which a curve has come to an error, linear in their logarithms between its
    points.

    Beyond its first and last point the line through the nearest two goes on. None where that never
    meets the error: the curve has a single point, does not fall, or its error is 0.
    """
    if len(curve.x) < 2 or min(error, *curve.y) <= 0.0:
        return None
    i = min(max(bisect_left([-y for y in curve.y], -error), 1), len(curve.x) - 1)
    (x0, x1), (y0, y1) = (
        [math.log(v) for v in values[i - 1 : i + 1]] for values in (curve.x, curve.y)
    )
    if y1 >= y0 or x1 <= x0:
        return None
    return math.exp(x0 + (math.log(error) - y0) * (x1 - x0) / (y1 - y0))
