"""Whether frames are as wrong as they say: their true noise beside what they tell of it.

    python -m benchmarks.accuracy calibration [--size 32] [--most 512] [--scene NAME …] [--json]

Of each scene two views are baked, a whole one and a close one, their texels to 16 times ``--most``
samples. Light after 16 samples and after each fourfold count up to ``--most``, and light baked to
targets of 10 % and of 5 %, is what the same bake held on its way. Frames of it, under two rotations
where light turns, are told against the frame of the last rung: the RMSE of the luminance over
surface pixels, over its mean, and divided by the frame's own estimate. The last rung goes on from
the samples of those before it, so that what is seen to differ is short by the last one's own error:
what that tells of itself is added. All are rounded as the store rounds. ``covered`` is the share of
pixels that differ by no more than 1.96 times the standard error that the frame tells, less that
which both have. Demo volumes alone are looked at where the shared data are not at hand.
"""

import math
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import click
import numpy as np
from tqdm import tqdm

from benchmarks.accuracy.errors import relative_rmse
from benchmarks.accuracy.scenes import CALIBRATED, load_calibrated
from benchmarks.common.measurement import Measurement, markdown
from benchmarks.common.suite import part
from isogi_core.bake.bake_spec import BakeSpec
from isogi_core.bake.noise import Goal, finished
from isogi_core.bake.texel_light import FIRST_LEVEL, Light, next_level
from isogi_core.frame.frame import Frame
from isogi_core.model.environment import LUMINANCE_WEIGHTS
from isogi_core.model.view import IDENTITY, View, quaternion_from_angles
from isogi_core.plan.scene import Scene
from isogi_report.bench import ViewBake
from isogi_report.speed import make_renderer

FURTHER = 16
"""Times the samples of the frames that are judged, in the light that they are judged by."""

TARGETS = (0.1, 0.05)
"""Target errors of the light that is baked adaptively."""

VIEWS = ((40.0, 30.0, 30.0), (200.0, 10.0, 10.0))
"""Azimuth, elevation and field of view, degrees."""

TURNS = (IDENTITY, quaternion_from_angles(100.0, 35.0, -20.0))
"""Rotations of lights that turn."""

LOW = 0.7
HIGH = 1.4
"""Where the ratios of nine frames in ten should be."""

Rungs = Mapping[int, Light]
"""Light of the same texels by its samples."""


@dataclass(frozen=True)
class Told:
    """A frame: how wrong it is, how wrong it says it is, the ``ratio`` of both, and the share of
    pixels ``covered``.
    """

    scene: str
    view: int
    turn: int
    light: str
    true: float
    told: float
    ratio: float
    covered: float


@part(size=32)
@click.option(
    "--most",
    type=click.IntRange(FIRST_LEVEL),
    default=512,
    show_default=True,
    help="Samples of a texel.",
)
@click.option(
    "--scene", "names", type=click.Choice(list(CALIBRATED)), multiple=True, help="Only these."
)
def calibration(size: int, most: int, names: tuple[str, ...]) -> Measurement:
    """Whether frames are as wrong as they say: their true noise beside what they tell of it."""
    chosen = names or tuple(CALIBRATED)
    scenes = tqdm(load_calibrated(chosen), desc="scenes", unit="scene", total=len(chosen))
    frames = [told for name, scene in scenes for told in frames_of(name, scene, size, most)]
    figures = {
        f"{name}: {what}": value
        for name, group in groups(frames).items()
        for what, value in summed(group)
    }
    return Measurement(f"true noise over told noise, {size} × {size}", figures, table(frames))


def frames_of(name: str, scene: Scene, size: int, most: int) -> Iterator[Told]:
    """The frames of a scene's views, told against their last rung."""
    for number, (azimuth, elevation, fov) in enumerate(VIEWS):
        view = View(
            scene.isovalue, scene.camera(azimuth, elevation, 3.0, fov), width=size, height=size
        )
        with tempfile.TemporaryDirectory() as store:
            renderer = make_renderer(scene, store)
            turns = TURNS[: 1 if renderer.caches.spec(view.shading).order == 1 else None]
            turned = [replace(view, light=turn) for turn in turns]
            yield from judged(name, number, [ViewBake(renderer, one) for one in turned], most)


def judged(name: str, number: int, bakes: Sequence[ViewBake], most: int) -> Iterator[Told]:
    """The frames of one view, under each turn of its light; the first of ``bakes`` is grown."""
    rungs = climb(bakes[0], FURTHER * most)
    best = [bake.frame(rungs[max(rungs)]) for bake in bakes]
    for label, light in lights_of(rungs, bakes[0].spec, most):
        for turn, (bake, reference) in enumerate(zip(bakes, best, strict=True)):
            yield compared(name, number, turn, label, bake.frame(light), reference)


def climb(bake: ViewBake, until: int) -> Rungs:
    """The light of a view's texels at each rung up to ``until`` samples."""
    rungs = {}
    samples = 0
    while samples < until:
        samples = next_level(samples)
        bake.grow(samples)
        rungs[samples] = bake.light.rows(np.arange(len(bake.light)))
    return rungs


def lights_of(rungs: Rungs, spec: BakeSpec, most: int) -> Iterator[tuple[str, Light]]:
    """The lights that are judged, and their names: every other rung, and those that reach the
    targets.
    """
    for samples in list(rungs)[::2]:
        if samples <= most:
            yield f"{samples} samples", rungs[samples]
    for target in TARGETS:
        yield f"target {target:.0%}", adaptive(rungs, spec, Goal(target))


def adaptive(rungs: Rungs, spec: BakeSpec, goal: Goal) -> Light:
    """The light as a bake to a ``goal`` leaves it: each texel on the first rung that is
    enough.
    """
    light = Light.dark(spec.plan, len(next(iter(rungs.values()))))
    waiting = np.ones(len(light), np.bool_)
    for rung in rungs.values():
        done = np.flatnonzero(waiting)
        light.put(done, rung.rows(done))
        waiting &= ~finished(rung, spec, goal)
    return light


def compared(name: str, number: int, turn: int, light: str, frame: Frame, best: Frame) -> Told:
    """What a frame tells of its error beside what is seen of it against the ``best``."""
    on = best.state > 0
    apart = relative_rmse(frame.radiance, best.radiance, on)
    told = frame.noise
    seen, exact = (one.radiance[on].astype(np.float64) @ LUMINANCE_WEIGHTS for one in (frame, best))
    error = frame.error[on] * seen
    shared = best.error[on] * exact
    covered = np.abs(seen - exact) <= 1.96 * np.sqrt(np.maximum(error**2 - shared**2, 0.0))
    true = math.hypot(apart, best.noise)
    return Told(
        name, number, turn, light, true, told, true / max(told, 1e-30), float(covered.mean())
    )


def groups(frames: Sequence[Told]) -> dict[str, list[Told]]:
    """The frames of each scene, of each light, and all of them."""
    found = {
        name: [told for told in frames if told.scene == name]
        for name in dict.fromkeys(t.scene for t in frames)
    }
    for light in dict.fromkeys(told.light for told in frames):
        found[f"all, {light}"] = [told for told in frames if told.light == light]
    return {**found, "all": list(frames)}


def summed(frames: Sequence[Told]) -> Iterator[tuple[str, float]]:
    """The figures of some frames: what errs over what is told of it, and how many pixels are within
    their intervals.
    """
    ratios = np.array([told.ratio for told in frames])
    yield "frames", len(frames)
    yield "median", float(np.median(ratios))
    yield f"within {LOW} to {HIGH}, %", 100.0 * float(np.mean((ratios >= LOW) & (ratios <= HIGH)))
    yield "least", float(ratios.min())
    yield "most", float(ratios.max())
    yield "pixels covered, %", 100.0 * float(np.mean([told.covered for told in frames]))


def table(frames: Sequence[Told]) -> str:
    """A line for each scene and each light, and one for all, in Markdown."""
    head = (
        "scene",
        "frames",
        "true / told, median",
        f"in {LOW} … {HIGH}",
        "least … most",
        "pixels covered",
    )
    return markdown(head, (cells(name, group) for name, group in groups(frames).items()))


def cells(name: str, frames: Sequence[Told]) -> list[str]:
    """The text of a line's cells."""
    count, median, within, least, most, covered = (value for _, value in summed(frames))
    spread = f"{least:.2f} … {most:.2f}"
    return [name, f"{count:g}", f"{median:.2f}", f"{within:.0f}%", spread, f"{covered:.1f}%"]
