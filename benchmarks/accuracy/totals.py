"""What pictures tell of their total error beside the truth, and what it takes to bring it to the
target.

    python -m benchmarks.accuracy totals [--size 96] [--paths 1024] [--views 1] [--seed 1 …]
    [--only TEXT …] [--part 1/4] [--kept FILE]

Views of all real volumes, and of volumes by formula (see ``formulas``), are baked by their scenes'
plans to 2 %, in lights of all kinds, as they stand and turned; their pictures are then checked as
the server checks pictures at rest. Later views of a row are seen STEP degrees further around the
volume, by the same renderer: they take over light of the views before. References are path-traced
from each pixel, with as many bounces as may matter, until their noise is within NOISE.
"""

import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import islice
from pathlib import Path
from statistics import median
from typing import Any

import click
import numpy as np

from benchmarks.accuracy.benches import bench_of, report_view, wanted
from benchmarks.accuracy.formulas import KINDS, made
from benchmarks.accuracy.kept import Kept
from benchmarks.common.measurement import Measurement, markdown
from benchmarks.common.scenes import CONSTANT, LIGHTS, shared_data
from benchmarks.common.suite import part
from isogi_core.bake.noise import Goal
from isogi_core.files.radiance import write_hdr
from isogi_core.frame.frame import Frame
from isogi_core.frame.rays.control_pixels import TotalError
from isogi_core.frame.rays.own_light import PATHS_RATE, PixelLight, all_points
from isogi_core.frame.rays.tail_error import TailError
from isogi_core.frame.renderer import Renderer
from isogi_core.model.view import View, quaternion_from_angles
from isogi_core.plan.assembly import load_scene
from isogi_core.plan.scene import Scene
from isogi_core.reference import Reference
from isogi_report.bench import Bench, ViewBake, dark
from isogi_report.metrics import score

PLACES = (
    *(
        ("engine_256x256x128_uint8", 70),
        ("engine_256x256x128_uint8", 170),
        ("ct_head_208x256x225_uint8", 110),
    ),
    *(
        ("mni152_t1_197x233x189_uint8", 90),
        ("carp_256x512x256_uint8", 110),
        ("brain_t1_124x160x140_uint8", 50),
    ),
    *(
        ("bonsai_256x256x256_uint8", 40),
        ("heptane_302x302x302_uint8", 100),
        ("fuel_crop_64x33x32_uint8", 100),
    ),
    *(
        ("avm_337x319x154_uint8", 120),
        ("boston_teapot_256x256x178_uint8", 35),
        ("tooth_103x94x161_uint16", 700),
    ),
    *(("nucleon_41x41x41_uint8", 140), ("bucky_32x32x32_uint8", 90), ("neghip_66x66x66_uint8", 90)),
    *(("hydrogen3d_64x64x64_float32", 0.02), ("isabel_t30_wind_125x125x25_float32", 35)),
    ("lidc_chest_256x256x133_uint8", 60),
)
"""All shared volumes by their files, at isovalues of the middle of what their notes name."""

TURNS = {"": None, " turned": (110.0, 25.0, 0.0)}
"""Angles (z, y, x), in degrees, that lights are turned by; those that stand as their files have
them, and others.
"""

FORESEEN = 0.05
"""Relative error that is assumed of texels that are never baked."""

STEP = 10.0
"""Degrees of azimuth between a view and the next."""

LATER = ", view "
"""What stands before the number of a later view of a row, in its name."""

NOISE = 0.005
MOST = 64
"""The relative noise that references may have, and times ``--paths`` that they may take for
that.
"""

HEAD = (
    *("view", "told before", "noise", "true", "first told (95 %)", "told / true"),
    *("told at the end", "true at the end, 99 %", "99 % told (95 %)", "99 % told / true"),
    *("pixels' own light", "samples", "bake, s", "check, s"),
)


@dataclass(frozen=True)
class Found:
    """A view: what was ``predicted``, and first told, of a picture whose true error is ``lit``; and
    of that at the end.

    ``p99`` is what 99 % of the pixels truly err by at most then, and ``tail`` what the picture says
    of it; None where it is not measured. ``own`` is the share of pixels with light of their own;
    texels have so many ``samples`` then, in the mean; seconds are of the processor.
    """

    name: str
    noise: float
    predicted: float
    first: TotalError
    lit: float
    last: TotalError
    final: bool
    true: float
    p99: float
    own: float
    bake: float
    samples: float
    seconds: float
    tail: TailError | None = None

    @classmethod
    def of(cls, given: Mapping[str, Any]) -> "Found":
        """One that was written as JSON."""
        if given.get("tail"):
            tail = TailError(**given["tail"])
        else:
            tail = None
        totals = {name: TotalError(**given[name]) for name in ("first", "last")}
        return cls(**{**given, **totals, "tail": tail})

    @property
    def row(self) -> tuple[str, ...]:
        """What stands below CHECKED in a table."""
        return (
            self.name,
            f"{100 * self.lit:.2f}",
            f"{100 * self.last.likely:.2f}{'' if self.final else ' (not final)'}",
            f"{100 * self.true:.2f}, {100 * self.p99:.1f}",
            f"{self.own:.0%}",
            f"{self.bake:.1f}",
        )


CHECKED = (
    "view",
    "texels' light, %",
    "told at the end, %",
    "true at the end, 99 %, %",
    "own light",
    "bake, s",
)
"""Heads of the columns of ``Found.row``."""


def measurement_of(
    title: str, found: Sequence[Found], head: Sequence[str], rows: Sequence[Sequence[str]]
) -> Measurement:
    """What views were found to be like, as figures and a table; UsageError where there is none."""
    if not found:
        raise click.UsageError("No view has that in its name.")
    figures = {
        "views": len(found),
        "within 3 % and 99th percentile 10 %": sum(
            each.true <= 0.03 and each.p99 <= 0.1 for each in found
        ),
        "final": sum(each.final for each in found),
        "worst, %": 100 * max(each.true for each in found),
    }
    return Measurement(title, figures, markdown(head, rows))


@part(size=96)
@click.option(
    "--paths",
    type=click.IntRange(8),
    default=1024,
    show_default=True,
    help="Paths a pixel of references.",
)
@click.option(
    "--views",
    type=click.IntRange(1, 36),
    default=1,
    show_default=True,
    help="Cameras of a row, each drawn after the others.",
)
@click.option(
    "--seed",
    multiple=True,
    type=int,
    default=(1,),
    show_default=True,
    help="Of volumes; repeatable.",
)
@click.option("--only", multiple=True, help="Part of a scene's name; repeatable.")
@click.option(
    "--part",
    "share",
    default="1/1",
    show_default=True,
    help="Every so many-th scene, from which on.",
)
@click.option(
    "--by-paths", is_flag=True, help="Light pictures by paths alone, as if their texels cost more."
)
@click.option(
    "--kept", type=Path, help="A file of views measured before, and where others are added."
)
def totals(
    size: int,
    paths: int,
    views: int,
    seed: tuple[int, ...],
    only: tuple[str, ...],
    share: str,
    by_paths: bool,
    kept: Path | None,
) -> Measurement:
    """What pictures tell of their total error, beside the truth, and what reaching the target
    takes.
    """
    found = []
    (first, step) = map(int, share.split("/"))
    known = Kept(kept, Found.of)
    with tempfile.TemporaryDirectory() as folder:
        for name, scene in islice(scenes(Path(folder), seed, only), first - 1, None, step):
            bench = cache(partial(made_bench, scene, size, Path(folder) / name.replace(" ", "-")))
            for turn, angles in TURNS.items():
                names = [name + turn + later(number) for number in range(views)]
                # A row is measured as a whole, as each of its views depends on those before.
                row = [view for each in names if (view := known.get(each)) is not None]
                if len(row) < views:
                    measured = measure(names, bench(), angles, paths, by_paths)
                    row = [known.put(each) for each in measured]
                found += row
                for each in row:
                    click.echo(" | ".join(row_of(each)), err=True)
    if not found:
        raise click.UsageError("No view has that in its name.")
    return Measurement(
        "Total errors, told and true", figures(found), markdown(HEAD, map(row_of, found))
    )


def made_bench(scene: Callable[[], Scene], size: int, folder: Path) -> Bench:
    """The bench of a scene that is still to be made."""
    return bench_of(scene(), size, folder)


def scenes(
    folder: Path, seeds: Sequence[int], only: Sequence[str]
) -> Iterator[tuple[str, Callable[[], Scene]]]:
    """All scenes by name, and what makes them."""
    write_hdr(folder / "lamps.hdr", street())
    street_lights = {"a street at night": {"type": "probe", "file": str(folder / "lamps.hdr")}}
    data = shared_data()
    lights = {**(LIGHTS if data is not None else {"constant light": CONSTANT}), **street_lights}
    for light, entry in lights.items():
        lit = of_file(dict(entry), data)
        for volume, make in volumes(seeds):
            if wanted(name := f"{volume} under {light}", only):
                yield name, partial(make, lit)


def volumes(seeds: Sequence[int]) -> Iterator[tuple[str, Callable[..., Scene]]]:
    """All volumes by name, and what makes a scene of each: of a light, and an albedo."""
    data = shared_data()
    for file, isovalue in PLACES if data is not None else ():
        yield (
            f"{file.split('_')[0]} {isovalue:g}",
            partial(file_scene, f"{data}/{file}.nhdr", isovalue),
        )
    for kind in KINDS:
        for seed in seeds:
            yield f"{kind} {seed}", partial(formula_scene, kind, seed)


def file_scene(file: str, isovalue: float, light: dict[str, str], albedo: float = 0.7) -> Scene:
    """The scene of a volume of a file."""
    return load_scene(file, isovalue=isovalue, albedo=albedo, lights=[light])


def of_file(light: dict[str, str], data: Path | None) -> dict[str, str]:
    """A light whose file, if it has one, is named from anywhere."""
    if data and "file" in light:
        return {**light, "file": str(data / light["file"])}
    return light


def formula_scene(kind: str, seed: int, light: dict[str, str], albedo: float = 0.7) -> Scene:
    """The scene of a volume by formula."""
    volume, isovalue = made(kind, seed)
    scene = load_scene("demo:orbital", lights=[light], albedo=albedo)
    return replace(scene, volume=volume, isovalue=isovalue, isovalues=volume.value_range)


def street() -> np.ndarray:
    """A night sky with sixty small lamps of all strengths, (64, 128, 3) float32."""
    rng = np.random.default_rng(7)
    image = np.full((64, 128, 3), 0.02, np.float32)
    for _ in range(60):
        row, column = int(rng.integers(20, 44)), int(rng.integers(0, 128))
        image[row, column] = 10.0 ** rng.uniform(0.5, 2.5) * rng.uniform(0.6, 1.0, 3)
    return image


def later(number: int) -> str:
    """What is added to a scene's name for the view of this ``number`` in a row, from 0 on."""
    if number:
        return f"{LATER}{number + 1}"
    return ""


def measure(
    names: Sequence[str],
    bench: Bench,
    angles: tuple[float, float, float] | None,
    paths: int,
    by_paths: bool = False,
) -> Iterator[Found]:
    """Yield what is found of each view of a row, with the light turned by ``angles``: bring its
    picture to its target, and hold it against the truth.

    Texels are baked anew for each view, in unturned light. One renderer draws the row, so that
    later views take over light that was traced for earlier ones. If ``by_paths``, paths alone light
    the pictures.
    """
    kept = bench.renderer(bench.scene)
    renderer = Renderer(kept.caches, bench.tiles)
    for number, name in enumerate(names):
        baked = report_view(bench.scene, bench.view.width, STEP * number)
        if angles:
            turned = replace(baked, light=quaternion_from_angles(*angles))
        else:
            turned = baked
        folder = bench.folder / f"{'turned' if angles else 'still'}-{number}"
        best = quiet_reference(replace(bench, view=turned, folder=folder, _made={}), paths)
        if by_paths:
            go_by_paths(renderer, turned)
        yield measure_view(name, ViewBake(kept, baked), renderer, turned, best)


def measure_view(
    name: str, bake: ViewBake, renderer: Renderer, turned: View, best: Reference
) -> Found:
    """Bring the picture of a ``turned`` view, whose texels a ``bake`` lights, to its target, and
    hold it against the ``best`` known.
    """
    goal = Goal.checked(renderer.prepared.scene.target_error)
    spent = [0.0]
    bake.show(dark(bake.layers, len(bake.texels)), np.arange(len(bake.shown.places)))
    frames = [lit := lit_frame(bake, renderer, turned, goal)]
    while refined(renderer, turned, goal, spent):
        frames.append(lit_frame(bake, renderer, turned, goal))
    first = frames[min(1, len(frames) - 1)]
    last = frames[-1]
    before, after = (score(frame.radiance, best, 1.0) for frame in (lit, last))
    return Found(
        name=name,
        noise=lit.noise,
        predicted=lit.total.likely,
        first=first.total,
        lit=before.rmse,
        last=last.total,
        final=last.final,
        true=after.rmse,
        p99=after.p99,
        own=last.traced_pixels / max(last.surface, 1),
        bake=bake.seconds,
        samples=bake.samples,
        seconds=sum(spent),
        tail=last.tail,
    )


def go_by_paths(renderer: Renderer, view: View) -> None:
    """Have paths alone light the picture of a ``view``, as if its texels cost more."""
    goal = Goal.checked(renderer.prepared.scene.target_error)
    gbuffer = renderer.gbuffer(view)
    check = renderer.surface.checks.of(renderer.surface.shot(view, gbuffer, goal, renderer.tiles))
    scouted = check.scout(gbuffer, renderer.tiles)
    effort = scouted.effort(PATHS_RATE)
    choice = all_points(len(gbuffer.pixels), FORESEEN, goal.error, scouted.mean, effort)
    check.light_by_paths(choice, PixelLight.none())
    # The first step lights all pixels.
    renderer.refine(view, goal)


def lit_frame(bake: ViewBake, renderer: Renderer, view: View, goal: Goal) -> Frame:
    """The frame of a view once its texels have as many samples as are enough for its check."""
    while (frame := renderer.render(view, goal)).provisional:
        bake.grow(frame.quality.samples, Goal(goal.error))
        bake.frame()
    return frame


def refined(renderer: Renderer, view: View, goal: Goal, spent: list[float]) -> bool:
    """Take a step of a view's check, whose processor seconds are noted; whether there was one."""
    begun = time.process_time()
    try:
        return renderer.refine(view, goal)
    finally:
        spent.append(time.process_time() - begun)


def quiet_reference(bench: Bench, paths: int) -> Reference:
    """The reference of a view after so many ``paths`` a pixel, or more where small lamps leave it
    noisy.
    """
    best = bench.reference(paths)
    while best.noise > NOISE and best.samples < MOST * paths:
        best = bench.reference(2 * best.samples)
    return best


def row_of(found: Found) -> tuple[str, ...]:
    """A line of the table, in percent and seconds."""
    first, last = found.first, found.last
    return (
        found.name,
        f"{100 * found.predicted:.2f}",
        f"{100 * found.noise:.2f}",
        f"{100 * found.lit:.2f}",
        f"{100 * first.likely:.2f} ({100 * first.low:.2f} to {100 * first.high:.2f})",
        f"{first.likely / max(found.lit, 1e-6):.2f}",
        f"{100 * last.likely:.2f}{'' if found.final else ' (not final)'}",
        f"{100 * found.true:.2f}, {100 * found.p99:.1f}",
        *tail_cells(found),
        f"{found.own:.0%}",
        f"{found.samples:.0f}",
        f"{found.bake:.1f}",
        f"{found.seconds:.2f}",
    )


def tail_cells(found: Found) -> tuple[str, str]:
    """What a picture tells of its 99th percentile at the end, in percent, and that over the
    truth.
    """
    tail = found.tail
    if tail is None:
        return "", ""
    told = f"{100 * tail.likely:.1f} ({100 * tail.low:.1f} to {100 * tail.high:.1f})"
    return told, f"{tail.likely / max(found.p99, 1e-6):.2f}"


def figures_of_tails(found: Sequence[Found]) -> dict[str, float]:
    """How well the 99th percentile is told."""
    tails = [(each.tail, each.p99) for each in found if each.tail is not None]
    ratios = sorted(tail.likely / max(true, 1e-6) for tail, true in tails)
    if not ratios:
        return {}
    return {
        "99 % told / true, least": ratios[0],
        "99 % told / true, median": median(ratios),
        "99 % told / true, most": ratios[-1],
        "99 % told / true within 0.7 and 1.4": sum(0.7 <= ratio <= 1.4 for ratio in ratios)
        / len(ratios),
        "99 % intervals that hold the truth": sum(
            tail.low <= true <= tail.high for tail, true in tails
        )
        / len(tails),
        "99 % intervals with an upper end": sum(tail.high < 1.0 for tail, _ in tails) / len(tails),
        "worst true 99 % of a final picture": max(
            (each.p99 for each in found if each.final), default=0.0
        ),
    }


def figures_of_later_views(found: Sequence[Found]) -> dict[str, float]:
    """How well errors of the later views of rows are told; nothing if there is none."""
    ends = [each.last.likely / max(each.true, 1e-6) for each in found if LATER in each.name]
    if not ends:
        return {}
    return {
        "later views: told / true at the end, median": median(ends),
        "later views: told / true at the end, least": min(ends),
        "later views: told / true at the end, most": max(ends),
    }


def figures(found: Sequence[Found]) -> dict[str, float]:
    """How well errors are told, and how far pictures are from the truth at the end."""
    ratios = sorted(each.first.likely / max(each.lit, 1e-6) for each in found)
    held = [each.first.low <= each.lit <= each.first.high for each in found]
    met = [each.true <= 0.03 and each.p99 <= 0.1 for each in found]
    ends = sorted(each.last.likely / max(each.true, 1e-6) for each in found)
    return {
        "views": len(found),
        "told / true, median": median(ratios),
        "told / true within 0.67 and 1.5": sum(0.67 <= ratio <= 1.5 for ratio in ratios)
        / len(found),
        "intervals that hold the truth": sum(held) / len(found),
        "final": sum(each.final for each in found) / len(found),
        "within 3 % and 99th percentile 10 %": sum(met) / len(found),
        "worst true error told as final": max(
            (each.true for each in found if each.final), default=0.0
        ),
        "told / true at the end, median": median(ends),
        "told / true at the end, least": ends[0],
        "told / true at the end, most": ends[-1],
        "samples of texels, median": median(each.samples for each in found),
        **figures_of_later_views(found),
        **figures_of_tails(found),
    }
