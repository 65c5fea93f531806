"""What filtering takes out of light that converges, and whether the noise that is told then is
true.

    python -m benchmarks.accuracy filtering [--size 96] [--paths 1024] [--seed 1 …] [--only TEXT …]
    [--json]

All texels of a view have the same number of samples, or none but those that have light first. Its
picture, filtered as frames are and each texel by itself, is held against paths from each pixel, and
so are the errors that both tell of their noise. What is not noise, such as interpolation, is in the
true errors alone.
"""

import tempfile
from pathlib import Path

import click
import numpy as np

from benchmarks.accuracy.benches import bench_of
from benchmarks.accuracy.totals import scenes
from benchmarks.common.measurement import Measurement, markdown
from benchmarks.common.suite import part
from isogi_core.bake.noise import Goal
from isogi_core.bake.texel_light import FIRST_LEVEL
from isogi_core.frame.demand import first_texels
from isogi_core.frame.frame import Frame
from isogi_core.frame.renderer import Renderer
from isogi_report.bench import UNREACHED_GOAL, ViewBake
from isogi_report.metrics import Score, score

LEVELS = (16, 64, 256)
"""Samples of each texel."""

VIEWS = (
    "engine 70 under uffizi",
    "engine 70 under grace",
    "ct 110 under constant",
    "foam",
    "plates",
    "vessels",
)
"""What is measured where nothing else is asked for: parts of the names of ``totals``."""

HEAD = ("view", "samples", "each by itself, told", "true, 99 %", "filtered, told", "true, 99 %")


@part(size=96)
@click.option(
    "--paths",
    type=click.IntRange(8),
    default=1024,
    show_default=True,
    help="Paths a pixel of references.",
)
@click.option(
    "--seed",
    multiple=True,
    type=int,
    default=(1,),
    show_default=True,
    help="Of volumes; repeatable.",
)
@click.option("--only", multiple=True, default=VIEWS, help="Part of a scene's name; repeatable.")
def filtering(size: int, paths: int, seed: tuple[int, ...], only: tuple[str, ...]) -> Measurement:
    """What filtering takes out of light that converges, and what is told of it."""
    rows = []
    figures = dict[str, float]()
    with tempfile.TemporaryDirectory() as folder:
        for name, scene in scenes(Path(folder), seed, only):
            bench = bench_of(scene(), size, Path(folder) / name.replace(" ", "-"))
            bake = ViewBake(bench.renderer(bench.scene), bench.view)
            best = bench.reference(paths)
            filters = Renderer(bake.renderer.caches, bench.tiles)
            bake.grow(FIRST_LEVEL)
            few = score((picture := quarter(bake, filters)).radiance, best, 1.0)
            rows.append((name, f"{FIRST_LEVEL} in a quarter", "", "", *texts(picture, few)))
            figures[f"{name}, {FIRST_LEVEL} samples in a quarter: provisional"] = picture.coverage[
                "provisional"
            ]
            for samples in LEVELS:
                bake.grow(samples)
                pictures = pictures_of(bake, filters)
                plain, calm = (score(each.radiance, best, 1.0) for each in pictures)
                rows.append(
                    (name, str(samples), *texts(pictures[0], plain), *texts(pictures[1], calm))
                )
                figures[f"{name}, {samples} samples: filtered / alone"] = calm.rmse / plain.rmse
    if not rows:
        raise click.UsageError("No view has that in its name.")
    return Measurement("Light that converges, filtered", figures, markdown(HEAD, rows))


def pictures_of(bake: ViewBake, filters: Renderer) -> tuple[Frame, Frame]:
    """The frame with each texel's light as it is, and that of a renderer that ``filters``."""
    return bake.frame(), filters.render(bake.view, Goal.checked(UNREACHED_GOAL.error))


def quarter(bake: ViewBake, filters: Renderer) -> Frame:
    """The filtered frame of those texels alone that have light first."""
    first = first_texels(np.concatenate(bake.shown.offsets), bake.shown.lattice.bits)
    numbers = np.flatnonzero(first)
    bake.show(bake.light.rows(numbers), numbers)
    return filters.render(bake.view, Goal.checked(UNREACHED_GOAL.error))


def texts(picture: Frame, found: Score) -> tuple[str, str]:
    """The error that a picture tells, and the true one with its 99th percentile; in percent."""
    return f"{100 * picture.noise:.2f}", f"{100 * found.rmse:.2f}, {100 * found.p99:.1f}"
