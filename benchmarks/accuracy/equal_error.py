"""Time to equal total error: isogi beside Mitsuba 3, one view and 36 views under 12 turns of the
light each.

    python -m benchmarks.accuracy equal-error [TARGET] [--size 512] [--checks 3] [--only TEXT …]

Six scenes of the shared volumes, or the scene TARGET. The isosurface is diffuse with albedo 0.7 on
both sides and reflects as often in both. Seconds are of the wall, on all cores, in one run; those
of the processor, which other work on the machine hardly touches, are told beside them. Kernels of
both are compiled before.

isogi starts from nothing: it makes its maps, bakes to an empty store what the views read, each
chunk once for all of them as ``isogi prewarm`` does, though with as many paths for each texel, and
renders every picture of the set. Its error is the total one, all causes together: relative RMSE of
the luminance against long paths from each pixel, on some pictures from all over the set ("checks").

Mitsuba path-traces scikit-image's marching-cubes mesh of the same isosurface (`llvm_ad_rgb`,
integrator `path`, which joins every hit to the probe as well, by multiple importance sampling). Its
error on each of the checks is against its own converged picture, so that mesh and length of paths
do not count. It takes as many samples per pixel as bring that error to isogi's total on the same
pixels: from a power law through measured points, drawn, and put right by that law. Seconds of the
whole set are extrapolated: those of its set-up, and its mean seconds per check times all pictures.
They are told of its default sampler and of `multijitter`, which errs least of those it has.

Both errors are of the pixels that show the outer side of the surface, and that the outline does not
run through. Where a volume ends inside the solid, as the engine's does below, the surface is open
and shows its inner side: isogi lights the outer side there, as the surface has one, and Mitsuba the
inner. So cameras are above the horizon, as a person would take them, and few such pixels are left;
there are also fewer texels to bake than for cameras all around. That both show the same light is
told by how far the converged pictures are apart: on outer sides isogi's are a few per cent
brighter, with as many bounces. Smooth normals, and paths that start a little off the surface, would
do that; it was not measured here.
"""

import statistics
from collections.abc import Iterator, Sequence
from typing import Any

import click
import numpy as np
from tqdm import tqdm

from benchmarks.accuracy.benches import wanted
from benchmarks.accuracy.errors import rms
from benchmarks.accuracy.isogi_race import Check, Costs, PictureSet, check, run, warm
from benchmarks.accuracy.mitsuba_race import VARIANT, Converged, Mitsuba, Reached
from benchmarks.common import mesh, mitsuba
from benchmarks.common.measurement import Measurement, markdown, shown
from benchmarks.common.mitsuba import SAMPLERS
from benchmarks.common.scenes import SIX, scene_of
from benchmarks.common.suite import part
from benchmarks.common.timing import Seconds
from isogi_core.model.environment import LUMINANCE_WEIGHTS
from isogi_core.plan.assembly import load_scene
from isogi_core.plan.scene import Scene

Race = dict[str, list[Reached]]
"""By the sampler, what Mitsuba took for each of the checks."""

TIMED = ("one view", "whole set")
"""What is raced: figures have these words."""

SURFACE = {"albedo": 0.7, "bounces": 4}
"""What all surfaces have in common, as Mitsuba has it."""


@part(size=512)
@click.argument("target", required=False)
@click.option("--only", multiple=True, help="Part of a scene's name.")
@click.option(
    "--views", type=click.IntRange(1), default=36, show_default=True, help="Cameras of the set."
)
@click.option(
    "--turns",
    type=click.IntRange(1),
    default=12,
    show_default=True,
    help="Turns of the light for each.",
)
@click.option(
    "--checks",
    type=click.IntRange(1),
    default=3,
    show_default=True,
    help="Pictures that are compared.",
)
@click.option(
    "--samples",
    type=click.IntRange(16),
    default=128,
    show_default=True,
    help="Paths of each texel.",
)
@click.option(
    "--paths",
    type=click.IntRange(8),
    default=128,
    show_default=True,
    help="Paths per pixel of the references.",
)
def equal_error(
    target: str | None,
    size: int,
    only: tuple[str, ...],
    views: int,
    turns: int,
    checks: int,
    samples: int,
    paths: int,
) -> Measurement:
    """Time to equal total error: isogi beside Mitsuba 3, for one view and for a set of pictures."""
    races = {}
    for name, scene in scenes(target, only):
        races[name] = raced(PictureSet(scene, size, views, turns), samples, checks, paths)
        click.echo("  ".join((f"{name}:", *row_of(races[name]))), err=True)
    title = (
        f"Time to equal total error: {size} × {size}, {views} views × {turns} turns of the light"
    )
    figures = {
        f"{name}: {key}": value for name, race in races.items() for key, value in race.items()
    }
    return Measurement(
        title, figures, markdown(HEAD, ((name, *row_of(race)) for name, race in races.items()))
    )


def scenes(target: str | None, only: Sequence[str]) -> Iterator[tuple[str, Scene]]:
    """The scene ``target``, or those of the six whose names have any part of ``only``, with their
    names.
    """
    if target is not None:
        yield target, load_scene(target, **SURFACE)
        return
    for subject in (each for each in SIX if wanted(each.name, only)):
        yield subject.name, scene_of(subject, **SURFACE)


def raced(pictures: PictureSet, samples: int, checks: int, paths: int) -> dict[str, Any]:
    """The figures of a race: isogi's errors and seconds, and what Mitsuba takes to the same
    errors.
    """
    warm(pictures, samples)
    frames, costs = run(pictures, samples, pictures.picks(checks))
    checked = check(pictures.scene, frames, paths)
    figures = isogi_figures(checked, costs)
    if not (mitsuba.installed() and mesh.installed() and mitsuba.usable(VARIANT)):
        return {**figures, "mitsuba": "not installed"}
    peer = Mitsuba(pictures.scene, frames[0].view)
    race, converged = compete(peer, checked)
    return (
        figures
        | mitsuba_figures(race, peer.set_up, len(pictures), costs)
        | likeness(checked, converged)
    )


HEAD = (
    *("scene", "isogi's total error, %", "of it noise, %"),
    *(
        f"{what}: {who}"
        for what in TIMED
        for who in ("isogi, s", *(f"Mitsuba {each}, times" for each in SAMPLERS))
    ),
    *("brightness, isogi / Mitsuba", "median difference, %"),
)


def row_of(figures: dict[str, Any]) -> tuple[str, ...]:
    """A row of the table: errors, seconds, how many times as long Mitsuba takes, and how alike both
    are.
    """

    def mean(name: str, scale: float) -> str:
        found = [
            value
            for key, value in figures.items()
            if key.startswith("picture") and key.endswith(name)
        ]
        if found:
            return shown(scale * statistics.fmean(found))
        return "–"

    errors = (
        figures[f"isogi: {name}"]
        for name in ("total error, all pixels", "estimated noise / total error")
    )
    cells = [f"{100.0 * value:.1f}" for value in errors]
    for what in TIMED:
        ratios = (figures.get(f"mitsuba {sampler} / isogi: {what}") for sampler in SAMPLERS)
        cells += [
            f"{figures[f'isogi: {what}, s']:.1f}",
            *("–" if each is None else f"{each:.3g}" for each in ratios),
        ]
    return (*cells, mean("brightness", 1.0), mean("likeness, difference", 100.0))


def compete(peer: Mitsuba, checked: Sequence[Check]) -> tuple[Race, list[Converged]]:
    """Have each of Mitsuba's samplers draw the checks with isogi's errors; and the converged
    pictures.
    """
    race: Race = {sampler: [] for sampler in peer.tracers}
    converged = []
    for each in tqdm(checked, desc="mitsuba", unit="picture"):
        best = peer.converge(each.lit.view, each.best.on & each.outside)
        for sampler, reached in race.items():
            reached.append(peer.reach(sampler, best, each.error(best.on)))
        converged.append(best)
    return race, converged


def isogi_figures(checked: Sequence[Check], costs: Costs) -> dict[str, Any]:
    """isogi's errors, root mean squares over the checks, and its seconds."""
    total = rms([each.error(each.best.on) for each in checked])
    noise = rms([each.lit.noise for each in checked])
    return {
        "isogi: total error, all pixels": total,
        "isogi: pixels from inside": 1.0
        - statistics.fmean(each.outside[each.best.on].mean() for each in checked),
        "isogi: estimated noise / total error": noise / total,
        "isogi: references' noise": rms([each.best.noise for each in checked]),
        **costs.first.figures("isogi: one view"),
        **costs.baking.figures("isogi: whole set, baking"),
        **costs.rendering.figures("isogi: whole set, pictures"),
        **costs.whole.figures("isogi: whole set"),
    }


def mitsuba_figures(race: Race, set_up: Seconds, pictures: int, costs: Costs) -> dict[str, Any]:
    """What Mitsuba takes with each sampler, and how many times as long that is. The first check is
    the one view.
    """
    figures: dict[str, Any] = set_up.figures("mitsuba: mesh and scene")
    for sampler, reached in race.items():
        name = f"mitsuba {sampler}"
        every = sum((each.cost for each in reached), Seconds()) * (1 / len(reached))
        one = set_up + reached[0].cost
        whole = set_up + every * pictures
        figures |= {
            f"{name}: samples per pixel": statistics.fmean(each.samples for each in reached),
            f"{name}: error / isogi's": rms([each.error / each.wanted for each in reached]),
            **one.figures(f"{name}: one view"),
            **every.figures(f"{name}: mean of {len(reached)} pictures"),
            **whole.figures(f"{name}: whole set, extrapolated"),
            **ratios(f"{name} / isogi: one view", one.over(costs.first)),
            **ratios(f"{name} / isogi: whole set", whole.over(costs.whole)),
        }
    return figures


def ratios(name: str, ratio: Seconds) -> dict[str, float]:
    """Both ratios, under a name."""
    return {name: ratio.wall, f"{name}, processor": ratio.processor}


def likeness(checked: Sequence[Check], converged: Sequence[Converged]) -> dict[str, float]:
    """How far the converged pictures of both are apart, picture by picture: brightness, and the
    median difference.
    """
    figures: dict[str, float] = {}
    for number, (each, best) in enumerate(zip(checked, converged, strict=True), 1):
        ours, theirs = (
            picture[best.on][:, :3] @ LUMINANCE_WEIGHTS
            for picture in (each.best.mean, best.picture)
        )
        apart = float(np.median(abs(ours / ours.mean() - theirs / theirs.mean())))
        figures |= {
            f"picture {number}: isogi's error, compared pixels": each.error(best.on),
            f"picture {number}: of it noise, estimated": each.noise(best.on) / each.error(best.on),
            f"picture {number}: likeness, brightness": float(ours.mean() / theirs.mean()),
            f"picture {number}: likeness, difference": apart,
            f"picture {number}: Mitsuba's converged noise": best.noise,
        }
    return figures
