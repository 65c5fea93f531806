"""The three studies of a report.

- The summary: the subject, the error and the cost of its frame, and an error map (S1, figure 11).
- The split: the frame's error and its parts. Each part is found by replacing one ingredient of the
  frame by its exact counterpart.
- Convergence: error against run time, of light kept in several ways, and of paths from each pixel
  (S1, table 1 and figure 7).
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
One view of a scene, with light baked to the target error by the scene's plan, is compared with a \
reference: paths from each pixel to the lights themselves, with the scene's normals and offset. \
Errors are those of the luminance over the surface pixels, relative to the reference's mean: the \
root mean square (without the reference's own noise), the error that 99 % of the pixels stay \
below, and the signed mean (bias). FLIP compares the pictures as a screen shows them. Random \
numbers belong to texels and pixels, so light of the same number of samples always has the same \
bits; the number of paths of the reference may depend on the time available. Seconds are of the \
processor, all threads together."""


def study_summary(bench: Bench) -> Section:
    """Return the section with the headline, the facts, and the pictures."""
    planned = bench.planned
    best = bench.best
    frame = planned.frame()
    scores = score_cells(bench.score(frame.leaving))
    columns = (*SCORE_COLUMNS, Column("estimated noise", "share"), Column("bake", "seconds"))
    # The scores of the frame, its reference, and the facts of the scene, as tables.
    headline = Table("The frame", columns, ((*scores, frame.noise, planned.seconds),))
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
    """Return the facts of the measurement as names and texts."""
    scene = bench.scene
    view = bench.view
    planned = bench.planned
    # Put the scene, its picture and its plan into words.
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
    """Return a description of a layer."""
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
Each part is the change when one ingredient of the frame is replaced by its exact counterpart. \
They are replaced one after the other, so that biases add up to the total's. Known noise of \
either side is subtracted. If the parts are independent, their root sum of squares equals the \
total. Normals and offset are chosen by the scene, and so the same in the reference: their effect \
is listed separately."""


@dataclass(frozen=True, eq=False)
class Part:
    """One part of a frame's error: its ``name``, a text on ``what`` is compared, and ``wrong``
    (m,), the excess luminance of pixels.

    ``noise`` (m,) is the variance in it that belongs to no part, negative if some of the part's own
    is missing.
    """

    name: str
    what: str
    wrong: np.ndarray
    noise: np.ndarray | float = 0.0


@dataclass(frozen=True, eq=False)
class Split:
    """The ``parts`` of a frame's error and the ``whole``, relative to the luminance ``mean``.

    ``surface`` is the effect of the scene's normals and offset, and ``beyond`` the whole error with
    that.
    """

    parts: tuple[Part, ...]
    whole: Part
    surface: Part
    beyond: Part
    mean: float

    def spread(self, part: Part) -> Spread:
        """Return the size of a part."""
        return spread_of(part.wrong, part.noise, self.mean)

    @property
    def together(self) -> float:
        """Root sum of squares of the parts."""
        return math.sqrt(sum(self.spread(part).rmse ** 2 for part in self.parts))


def study_split(bench: Bench) -> Section:
    """Return the section with the frame's error and its parts, as a table and as maps."""
    split = split_error(bench)
    bias = sum(split.spread(part).bias for part in split.parts)
    reported = bench.planned.frame().noise
    # The parts, their sum, the measured total, and the effect of normals and offset, which is no
    # part.
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
    about = f"{SPLIT_TEXT} {notes_on_missing_parts(bench)}".strip()
    return Section(SPLIT_KEY, SPLIT_TITLE, about, (table,), (), pictures)


def split_error(bench: Bench) -> Split:
    """Split the error of the plan's frame."""
    best = lit_by_paths(bench.best)
    planned = lit_by_frame(bench.planned.frame())
    whole = Part(
        "total, measured", "the frame and the reference", planned.light - best.light, best.noise
    )
    # Normals and offset are in frame and reference alike: measure them by a reference without.
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
    """Return the scene with the normals of its trilinear isosurface, and rays that start on it."""
    return scene.with_settings(normals="gradient", offset=0.0)


def parts_of(bench: Bench, planned: Lit, best: Lit) -> Iterator[Part]:
    """Yield the parts of the error, each the change from one ingredient to its exact counterpart.

    They go in a chain from the frame to the reference, so that biases add up to the total.
    """
    # From the frame's texels to converged ones, and from rounded to exact coefficients.
    pair = converged(bench)
    plan = bench.scene.plan
    kept = lit_by_frame(pair.kept)
    exact = lit_by_frame(pair.exact)
    what = f"texels as they are, and after {pair.samples:,.0f} samples each on average"
    yield Part("Monte Carlo noise", what, planned.light - kept.light, -kept.noise)
    if plan.precision != "single":
        yield Part("quantization", f"{plan.precision} and single floats", kept.light - exact.light)
    # From texels around a pixel to the pixel's own point.
    own = own_light(bench)
    short = short_paths(bench)
    noise = exact.noise + own.noise
    yield Part(
        "interpolation",
        "texels around a pixel, and light at its own point",
        exact.light - own.light,
        noise,
    )
    # From harmonics to the lights themselves.
    if cuts_harmonics(bench.scene):
        what = f"{harmonics_in_words(plan)}, and the lights themselves"
        lights = lit_by_paths(short)
        yield Part("harmonics cut off", what, own.light - lights.light, own.noise + lights.noise)
    # From the plan's bounces to all that matter.
    if bench.scene.bounces:
        cut = reference_difference(short, bench.best)
        what = f"{bench.scene.bounces} bounces, and {bench.whole.bounces}"
        yield Part("bounces cut off", what, cut.light, cut.noise)


def harmonics_in_words(plan: ScenePlan) -> str:
    """Return a description of the harmonics of the plan, and of its lobes."""
    lobes = {0: "", 1: " and a lobe"}.get(plan.lobes, f" and {plan.lobes} lobes")
    return f"harmonics of order {plan.order}{lobes}"


def notes_on_missing_parts(bench: Bench) -> str:
    """Return sentences on the parts that this plan does not have."""
    plan = bench.scene.plan
    reasons = []
    if plan.precision == "single":
        reasons.append("Light is kept in single floats: nothing is rounded.")
    if not cuts_harmonics(bench.scene):
        reasons.append("Texels keep no harmonics that could be cut off.")
    if not bench.scene.bounces:
        reasons.append("The scene has only direct light: no bounces are missing.")
    return " ".join(reasons)


def row_of(part: Part, split: Split) -> tuple[str, float, float, str]:
    """Return a part's row of the table."""
    spread = split.spread(part)
    return part.name, spread.rmse, spread.bias, part.what


CONVERGENCE_KEY = "convergence"
CONVERGENCE_TITLE = "Error against run time"

CURVE_PIXELS = 32
"""Pixels of the longer side of the picture."""

CURVE_SAMPLES = (16, 64, 256, 1024, 4096, 16384)
"""Samples of a texel, or paths of a pixel, at the points of a curve."""

MAX_POINT_SECONDS = 120.0
POINT_SHARE = 0.1
"""Most seconds that the next point of a curve may take,
predicted from the last one, and the same as a share of the time left.
"""

PATH_TRACING_CURVE = "path tracing from each pixel"
"""Name of the curve without light of texels."""

CONVERGENCE_TEXT = """\
Errors of one view against the reference, as more samples are taken. Light of texels is baked \
once and serves all cameras and, if the light rotates, all rotations; paths from each pixel serve \
one picture. Where a curve becomes flat, more samples do not help: the rest of the error is that \
of interpolation, and of harmonics and bounces that are cut off. Each point of baked light \
continues the one before. Seconds are of the processor, all threads together, without compiling. \
Baking pays once as many pictures read the same texels, from other cameras or under rotated \
light, as the table says: it has then taken less time than tracing each of them to the same \
error. The time for frames of baked light, some milliseconds, is not counted."""

CURVE_COLUMNS = (
    Column("way"),
    Column("samples", "count"),
    Column("time", "seconds"),
    *SCORE_COLUMNS,
)


END_ERROR_FACTOR = 1.1
"""The cheapest point whose error is at most this many times
that at the end of its curve stands for the whole bake.
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
    """The score of a picture after ``samples`` samples and ``seconds`` of the processor."""

    samples: int
    seconds: float
    score: Score

    def foresee(self, samples: int) -> float:
        """Return the seconds that ``samples`` samples are expected to take."""
        return samples * self.seconds / self.samples


def study_convergence(bench: Bench) -> Section:
    """Return the section with the curves, their points
    as a table, and the break-even of baked light.
    """
    # Measure the curves on a small picture, as some points take many samples.
    small = bench.sized(CURVE_PIXELS)
    found = points_of(small)
    rows = tuple(
        (name, p.samples, p.seconds, *score_cells(p.score))
        for name, points in found.items()
        for p in points
    )
    curves = tuple(curve_of(name, points) for name, points in found.items())
    size = f"{small.view.width} × {small.view.height} pixels"
    plot = Plot(
        f"Error against run time, {size}",
        Column("time", "seconds"),
        Column("error", "share"),
        curves,
    )
    table = Table(f"Points of the curves, {size}", CURVE_COLUMNS, rows)
    tables = break_even_table(curves[:-1], curves[-1], size), table
    return Section(
        CONVERGENCE_KEY,
        CONVERGENCE_TITLE,
        " ".join([CONVERGENCE_TEXT, *notes_on_early_ends(found)]),
        tables,
        (plot,),
    )


def points_of(bench: Bench) -> dict[str, list[Point]]:
    """Return the points of all curves by name, that of path tracing last."""
    best = bench.grown(0.0)
    found = {
        name: points_of_bake(bench, scene, best)
        for name, scene in ways_to_keep_light(bench.scene).items()
    }
    return {**found, PATH_TRACING_CURVE: points_of_paths(bench, best)}


def ways_to_keep_light(scene: Scene) -> dict[str, Scene]:
    """Return scenes that keep the light in several ways, by name:
    by the plan, as S1 does, and as irradiance.
    """
    found = {f"the plan: {scene.plan.representation}": scene}
    s1 = as_s1(scene)
    if s1 is not None:
        found["S1: 25 harmonics in floats"] = s1
    if scene.plan.representation != "irradiance":
        found["irradiance, for a light that stays"] = as_irradiance(scene)
    return found


def as_s1(scene: Scene) -> Scene | None:
    """Return the scene with the coefficients that S1 keeps of any scene;
    None under lamps, which harmonics do not hold.
    """
    if scene.lighting.lamps.any:
        return None
    # S1 keeps direct and reflected light together, in single floats, and takes no lobes out.
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
    """Return the scene under lights that do not rotate:
    a texel keeps the irradiance that it receives.
    """
    if scene.inputs.grey and scene.inputs.grey_light:
        channels = 1
    else:
        channels = 3
    layer = Layer("irradiance", channels=channels, scale=unit_of(scene.inputs))
    return with_plan(
        scene, representation="irradiance", layers=(layer, *of_glow(scene)), order=1, lobes=0
    )


def of_glow(scene: Scene) -> tuple[Layer, ...]:
    """Return the layer of glowing parts of a scene, which all ways share; none if nothing glows."""
    return tuple(layer for layer in scene.plan.layers if layer.kind == GLOW_KIND)


def curve_of(name: str, points: list[Point]) -> Curve:
    """Return the points of a way as a curve of the plot."""
    return Curve(name, tuple(p.seconds for p in points), tuple(p.score.rmse for p in points))


def notes_on_early_ends(found: dict[str, list[Point]]) -> list[str]:
    """Return a sentence on each curve that ends before the last of CURVE_SAMPLES."""
    return [
        f"The curve of {name.split(':')[0]} ends at {points[-1].samples:,} samples: the next point "
        "would have taken too long, about "
        f"{points[-1].foresee(CURVE_SAMPLES[len(points)]):.0f} seconds."
        for name, points in found.items()
        if len(points) < len(CURVE_SAMPLES)
    ]


def points_of_bake(bench: Bench, scene: Scene, best: Reference) -> list[Point]:
    """Return the points of light that is baked by a scene's plan. Raises Cancelled."""
    bake = ViewBake(bench.renderer(scene), bench.view)

    def frame(samples: int) -> tuple[Frame, float]:
        bake.grow(samples)
        return bake.frame(), bake.seconds

    return measure_points(bench, best, frame)


def points_of_paths(bench: Bench, best: Reference) -> list[Point]:
    """Return the points of paths from each pixel, with as many bounces as the reference ``best``
    has. Each picture is traced from the start.
    """
    renderer = bench.renderer(bench.whole)
    view = replace(bench.view, shading="path_traced")
    # Compile the kernels before time is taken.
    renderer.render(replace(view, samples=1))

    def frame(samples: int) -> tuple[Frame, float]:
        begun = time.process_time()
        frame = renderer.render(replace(view, samples=samples))
        return frame, time.process_time() - begun

    return measure_points(bench, best, frame)


def measure_points(
    bench: Bench, best: Reference, frame: Callable[[int], tuple[Frame, float]]
) -> list[Point]:
    """Return the points of ``frame``, a function that returns a frame and its seconds, over
    CURVE_SAMPLES.

    They end when the next point would take too long; the first is made in any case.
    """
    found: list[Point] = []
    for samples in CURVE_SAMPLES:
        # Time grows in proportion to samples, so the last point foretells the next.
        if found and not is_affordable(bench, found[-1].foresee(samples)):
            break
        picture, seconds = frame(samples)
        found.append(Point(samples, seconds, bench.score(picture.leaving, best)))
    return found


def is_affordable(bench: Bench, seconds: float) -> bool:
    """Return True if a point may take this many seconds.

    If the time left forbids it, the bench notes that.
    """
    if seconds > POINT_SHARE * bench.left:
        bench.hurry.set()
    return seconds <= min(MAX_POINT_SECONDS, POINT_SHARE * bench.left)


def break_even_table(baked: Iterable[Curve], traced: Curve, size: str) -> Table:
    """Return the table of break-evens of each ``baked`` curve against the ``traced`` one;
    ``size`` is in words.
    """
    rows = tuple(break_even_row(curve, traced) for curve in baked)
    return Table(f"When baked light pays, {size}", EQUAL_ERROR_COLUMNS, rows)


def break_even_row(baked: Curve, traced: Curve) -> tuple[Cell, ...]:
    """Return the row under EQUAL_ERROR_COLUMNS of one way to keep baked light: its bake against
    pictures of the same error by paths from each pixel, the ``traced`` curve.

    Drawing a picture of baked light counts as free. The last two cells are None if the traced curve
    never has that error.
    """
    # End the bake at the first point with at most END_ERROR_FACTOR times the error of the last: if
    # the curve is flat there, more samples hardly help.
    seconds, error = next(
        (x, y) for x, y in zip(baked.x, baked.y, strict=True) if y <= END_ERROR_FACTOR * baked.y[-1]
    )
    traced_seconds = seconds_at(traced, error)
    pictures = None if traced_seconds is None else math.ceil(seconds / traced_seconds)
    return baked.name, error, seconds, traced_seconds, pictures


def seconds_at(curve: Curve, error: float) -> float | None:
    """Return the seconds after which a curve reaches an error, by linear interpolation of
    logarithms between its points.

    Beyond the first and the last point the line through the nearest two is extended. Return None if
    it never meets the error: the curve has a single point or does not fall, or the error is 0.
    """
    if len(curve.x) < 2 or min(error, *curve.y) <= 0.0:
        return None
    # Find the two points that bracket the error, or the nearest two.
    i = min(max(bisect_left([-y for y in curve.y], -error), 1), len(curve.x) - 1)
    (x0, x1), (y0, y1) = (
        [math.log(v) for v in values[i - 1 : i + 1]] for values in (curve.x, curve.y)
    )
    if y1 >= y0 or x1 <= x0:
        return None
    return math.exp(x0 + (math.log(error) - y0) * (x1 - x0) / (y1 - y0))
