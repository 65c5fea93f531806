"""How far pictures jump as the isovalue slides and as the light turns, beside how far the truth
does.

    python -m benchmarks.accuracy sequences [SCENE.toml] [--from 50] [--to 110] [--step 4] [--turns
    5] [--projected]

What an eye sees that follows a slider (S1, figures 4 and 12): how much pixels that show the surface
in one frame and in the next change, and how much that differs from the change of references by the
same random numbers. Errors that stay where they are jump nowhere. Figures are root mean squares
over pixels, percent of the mean luminance, less the noise of the references.
"""

import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import click
import numpy as np

from benchmarks.common.measurement import Measurement
from benchmarks.common.scenes import benchmark_scene
from benchmarks.common.suite import part
from isogi_core.bake.noise import Goal
from isogi_core.frame.rays.pixel_rays import variance_of_mean
from isogi_core.model.view import View, quaternion_from_angles
from isogi_core.reference import Reference, trace_reference
from isogi_report.bench import Bench, ViewBake
from isogi_report.exact import replicas
from isogi_report.metrics import luminance_of, mean_of, spread_of


@dataclass(frozen=True, eq=False)
class Shot:
    """One frame of a sequence: its ``luminance`` (h, w) float64, and its ``truth``."""

    luminance: np.ndarray
    truth: Reference


@dataclass(frozen=True)
class Jump:
    """From one frame to the next, over pixels that show the surface in both, relative to their mean
    luminance.

    ``own`` is the root mean square of what the truth changes by, ``beyond`` that of what the frames
    change by more or less than it; 99 % of the pixels differ by less than ``p99``, noise and all.
    """

    own: float
    beyond: float
    p99: float


@part(size=64)
@click.argument("target", required=False)
@click.option(
    "--light", type=click.Choice(["constant", "probe"]), default="constant", show_default=True
)
@click.option("--from", "first", default=50.0, show_default=True, help="The first isovalue.")
@click.option(
    "--to",
    "last",
    default=110.0,
    show_default=True,
    help="The last isovalue; none before the first.",
)
@click.option("--step", default=4.0, show_default=True, help="From one isovalue to the next.")
@click.option("--degrees", default=5.0, show_default=True, help="From one light to the next.")
@click.option("--turns", default=0, show_default=True, help="Steps that the light turns.")
@click.option(
    "--paths", default=512, show_default=True, help="Paths from each pixel of the references."
)
@click.option("--error", default=0.02, show_default=True, help="Target error of the light.")
@click.option("--projected", is_flag=True, help="Project texels whatever the plan says.")
def sequences(
    target: str | None,
    light: str,
    first: float,
    last: float,
    step: float,
    degrees: float,
    turns: int,
    paths: int,
    size: int,
    error: float,
    projected: bool,
) -> Measurement:
    """How far pictures jump as the isovalue slides and the light turns, beyond the truth's own
    jumps.
    """
    scene = benchmark_scene(target, light, target_error=error)
    scene = scene.with_settings(projected=projected or scene.settings.projected)
    view = View(scene.isovalue, scene.camera(30.0, 20.0, 2.5, 30.0), width=size, height=size)
    found: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(scene, view, Path(folder))
        if last > first:
            sliding = slide(view, np.arange(first, last + step / 2.0, step) - view.isovalue)
            found |= figures_of("isovalue", list(jumps(shots(bench, sliding, paths))))
        if turns:
            turning = turn(view, [degrees * number for number in range(turns + 1)])
            found |= figures_of("light", list(jumps(shots(bench, turning, paths))))
    return Measurement(f"jumps of {scene.name}, {size} × {size} pixels, percent", found)


def figures_of(name: str, found: list[Jump]) -> dict[str, float]:
    """What a sequence comes to, in percent of the mean luminance."""
    worst = int(np.argmax([each.beyond for each in found]))
    return {
        f"{name}: steps": len(found),
        f"{name}: the truth's jump, root mean square, mean": 100.0
        * float(np.mean([each.own for each in found])),
        f"{name}: beyond it, mean": 100.0 * float(np.mean([each.beyond for each in found])),
        f"{name}: beyond it, largest": 100.0 * found[worst].beyond,
        f"{name}: the truth's there": 100.0 * found[worst].own,
        f"{name}: beyond it, 99th percentile of pixels, largest": 100.0
        * max(each.p99 for each in found),
    }


def slide(view: View, by: Iterable[float]) -> list[View]:
    """The view at other isovalues."""
    return [replace(view, isovalue=view.isovalue + each) for each in by]


def turn(view: View, degrees: Iterable[float]) -> list[View]:
    """The view under the light turned about z, by so many ``degrees`` in all."""
    return [replace(view, light=quaternion_from_angles(each, 0.0, 0.0)) for each in degrees]


def shots(bench: Bench, views: Iterable[View], paths: int) -> Iterator[Shot]:
    """The frames of views, each with its own light baked to the scene's target, and their
    references.

    Raises Cancelled.
    """
    renderer = bench.renderer(bench.scene)
    goal = Goal(bench.scene.target_error)
    for view in views:
        bake = ViewBake(renderer, view)
        bake.grow(goal.most_samples, goal)
        truth = trace_reference(bench.renderer(bench.whole), view, paths)
        yield Shot(luminance_of(bake.frame().radiance), truth)


def jumps(taken: Iterable[Shot]) -> Iterator[Jump]:
    """From each shot to the next; those that have no pixel of the surface in common are left
    out.
    """
    for before, after in pairwise(taken):
        common = before.truth.on & after.truth.on
        if common.any():
            yield jump(before, after, common)


def jump(before: Shot, after: Shot, common: np.ndarray) -> Jump:
    """From one shot to the next in ``common`` pixels (h, w) bool.

    References of the same random numbers have most of their noise in common: what is left of it is
    told from the changes of their replicas.
    """
    changes = replicas_at(after.truth, common) - replicas_at(before.truth, common)
    truth = luminance_of(changes.mean(axis=1))
    noise = variance_of_mean(changes).astype(np.float64)
    mean = mean_of(
        luminance_of(np.concatenate([before.truth.mean[common], after.truth.mean[common]]))
    )
    beyond = spread_of((after.luminance - before.luminance)[common] - truth, noise, mean)
    return Jump(spread_of(truth, noise, mean).rmse, beyond.rmse, beyond.p99)


def replicas_at(truth: Reference, where: np.ndarray) -> np.ndarray:
    """The replicas (m, replicas, 3) of a reference at some of its surface pixels, ``where`` (h, w)
    bool.
    """
    return replicas(truth)[where[truth.on]]
