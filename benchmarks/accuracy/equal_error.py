"""Time to equal total error: isogi beside Mitsuba 3, one view and 36 views under 12 turns of a probe each.

    python -m benchmarks.accuracy equal-error [VOLUME] [--size 512] [--probe FILE] [--isovalue 70] [--checks 3]

The isosurface is diffuse with albedo 0.7 on both sides and reflects as often in both. Seconds are of the wall, on all
cores, in one run; those of the processor, which other work on the machine hardly touches, are told beside them.
Kernels of both are compiled before.

isogi starts from nothing: it makes its maps, bakes to an empty store what the views read, each chunk once for all of
them as ``isogi prewarm`` does, though with as many paths for each texel, and renders every picture of the set. Its
error is the total one, all causes together: relative RMSE of the luminance against long paths from each pixel, on some
pictures from all over the set ("checks").

128 paths were chosen on two views of the engine at 256 × 256. There 64, 128, 256 and 512 left errors of 4.3, 3.4, 3.1
and 3.0 %, and 5.4, 3.9, 3.4 and 3.2 %; the second view's baking took 9.8, 14.6, 21.9 and 33.4 processor seconds.
Targets of 10 and 7 % for each texel took 104 and 176 paths on average in the first view, and left 3.9 and 3.4 %.

Mitsuba path-traces scikit-image's marching-cubes mesh of the same isosurface (`llvm_ad_rgb`, integrator `path`, which
joins every hit to the probe as well, by multiple importance sampling). Its error on each of the checks is against its
own converged picture, so that mesh and length of paths do not count. It takes as many samples per pixel as bring that
error to isogi's total on the same pixels: from a power law through measured points, drawn, and put right by that law.
Seconds of the whole set are extrapolated: those of its set-up, and its mean seconds per check times all pictures. They
are told of its default sampler and of `multijitter`, which errs least of those it has.

Both errors are of the pixels that show the outer side of the surface, and that the outline does not run through. Where
a volume ends inside the solid, as the engine's does below, the surface is open and shows its inner side: isogi lights
the outer side there, as the surface has one, and Mitsuba the inner. So cameras are above the horizon, as a person would
take them, and few such pixels are left; there are also fewer texels to bake than for cameras all around. That both
show the same light is told by how far the converged pictures are apart: on outer sides isogi's are a few per cent
brighter, with as many bounces. Smooth normals, and paths that start a little off the surface, would do that; it was
not measured here.
"""

import statistics
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click
import numpy as np
from tqdm import tqdm

from benchmarks.accuracy.errors import rms
from benchmarks.accuracy.isogi_race import Check, Costs, PictureSet, check, run, warm
from benchmarks.accuracy.mitsuba_race import VARIANT, Converged, Mitsuba, Reached
from benchmarks.common import mesh, mitsuba
from benchmarks.common.measurement import Measurement
from benchmarks.common.scenes import LIGHTS, benchmark_scene, shared_data
from benchmarks.common.suite import part
from benchmarks.common.timing import Seconds
from isogi_core.model.sky import LUMINANCE
from isogi_core.plan.scene import Scene

Race = dict[str, list[Reached]]
"""By the sampler, what Mitsuba took for each of the checks."""


@part(size=512)
@click.argument("volume", required=False)
@click.option("--probe", type=click.Path(exists=True, dir_okay=False), help="The light; uffizi by default.")
@click.option("--isovalue", type=float, help="The scene's own by default.")
@click.option("--views", type=click.IntRange(1), default=36, show_default=True, help="Cameras of the set.")
@click.option("--turns", type=click.IntRange(1), default=12, show_default=True, help="Turns of the light for each.")
@click.option("--checks", type=click.IntRange(1), default=3, show_default=True, help="Pictures that are compared.")
@click.option("--samples", type=click.IntRange(16), default=128, show_default=True, help="Paths of each texel.")
@click.option(
    "--paths", type=click.IntRange(8), default=128, show_default=True, help="Paths per pixel of the references."
)
def equal_error(
    volume: str | None,
    size: int,
    probe: str | None,
    isovalue: float | None,
    views: int,
    turns: int,
    checks: int,
    samples: int,
    paths: int,
) -> Measurement:
    """Time to equal total error: isogi beside Mitsuba 3, for one view and for a set of pictures."""
    scene = probe_scene(volume, probe, isovalue)
    pictures = PictureSet(scene, size, views, turns)
    warm(pictures, samples)
    frames, costs = run(pictures, samples, pictures.picks(checks))
    checked = check(scene, frames, paths)
    figures = isogi_figures(checked, costs)
    if mitsuba.installed() and mesh.installed() and mitsuba.usable(VARIANT):
        peer = Mitsuba(scene, frames[0].view)
        race, converged = compete(peer, checked)
        figures |= mitsuba_figures(race, peer.set_up, len(pictures), costs) | likeness(checked, converged)
    else:
        figures["mitsuba"] = "not installed"
    title = f"{scene.name} at {scene.isovalue:g}, {size} × {size}, {views} views × {turns} turns"
    return Measurement(title, figures)


def probe_scene(volume: str | None, probe: str | None, isovalue: float | None) -> Scene:
    """The ``volume``, or the benchmarks' own, under the ``probe`` or uffizi; under a sky where there are no data."""
    data = shared_data()
    file = Path(probe) if probe else data / LIGHTS["uffizi"]["file"] if data else None
    light: dict[str, Any] = {"type": "probe", "file": str(file.resolve())} if file else {"type": "sky"}
    at: dict[str, Any] = {} if isovalue is None else {"isovalue": isovalue}
    return benchmark_scene(volume, albedo=0.7, bounces=4, lights=[light], rotating=True, **at)


def compete(peer: Mitsuba, checked: Sequence[Check]) -> tuple[Race, list[Converged]]:
    """Have each of Mitsuba's samplers draw the checks with isogi's errors; and the converged pictures."""
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
        "isogi: pixels from inside": 1.0 - statistics.fmean(each.outside[each.best.on].mean() for each in checked),
        "isogi: estimated noise / total error": noise / total,
        "isogi: references' noise": rms([each.best.noise for each in checked]),
        **costs.first.figures("isogi: one view"),
        **costs.baking.figures("isogi: whole set, baking"),
        **costs.rendering.figures("isogi: whole set, pictures"),
        **costs.whole.figures("isogi: whole set"),
    }


def mitsuba_figures(race: Race, set_up: Seconds, pictures: int, costs: Costs) -> dict[str, Any]:
    """What Mitsuba takes with each sampler, and how many times as long that is. The first check is the one view."""
    figures: dict[str, Any] = set_up.figures("mitsuba: mesh and scene")
    for sampler, reached in race.items():
        name, every = f"mitsuba {sampler}", sum((each.cost for each in reached), Seconds()) * (1 / len(reached))
        one, whole = set_up + reached[0].cost, set_up + every * pictures
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
    """How far the converged pictures of both are apart, picture by picture: brightness, and the median difference."""
    figures: dict[str, float] = {}
    for number, (each, best) in enumerate(zip(checked, converged, strict=True), 1):
        ours, theirs = (picture[best.on][:, :3] @ LUMINANCE for picture in (each.best.mean, best.picture))
        apart = float(np.median(abs(ours / ours.mean() - theirs / theirs.mean())))
        figures |= {
            f"picture {number}: isogi's error, compared pixels": each.error(best.on),
            f"picture {number}: of it noise, estimated": each.noise(best.on) / each.error(best.on),
            f"picture {number}: likeness, brightness": float(ours.mean() / theirs.mean()),
            f"picture {number}: likeness, difference": apart,
            f"picture {number}: Mitsuba's converged noise": best.noise,
        }
    return figures
