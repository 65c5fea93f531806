"""A film beside single pictures of its frames, and beside Mitsuba's path tracer to the same error.

    python -m benchmarks.speed film [SCENE.toml] [--size 128] [--frames 240] [--degrees 360] [--singles 6]
        [--error 0.03]

Runs `isogi film` for a turn of the camera on an empty store, and `isogi render` for some of its frames, evenly spread:
each with a store of its own, and one after the other with one store. Where Mitsuba is installed, it draws the same
frames to the same relative error against its own converged pictures. What was not drawn is extrapolated from the mean
of what was.
"""

import json
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click
import numpy as np

from benchmarks.accuracy.mitsuba_race import VARIANT, Mitsuba
from benchmarks.common import mesh, mitsuba
from benchmarks.common.measurement import Measurement
from benchmarks.common.scenes import scene_file
from benchmarks.common.suite import part
from benchmarks.common.timing import Seconds
from isogi_core.plan.assembly import load_scene
from server.cli.options import settings_from
from server.parameters import FrameParams, read, view_of

FPS, FIRST = 24, 30.0
"""Frames of a second, and the azimuth of the first."""


def isogi(*words: object) -> tuple[float, dict[str, Any]]:
    """Wall seconds of a command, from its start to its end, and the facts that it prints."""
    begun = time.perf_counter()
    command = [sys.executable, "-m", "server", *map(str, words), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise click.ClickException(done.stderr.strip().splitlines()[-1])
    return time.perf_counter() - begun, json.loads(done.stdout)


def options(size: int, error: float, workers: int) -> list[object]:
    """What film and pictures have in common."""
    return ["--width", size, "--height", size, "--target-error", error, "--workers", workers]


def filmed(scene: str, folder: Path, frames: int, degrees: float, common: Sequence[object]) -> dict[str, Any]:
    """The film, and how good it became."""
    length = ("--length", frames / FPS, "--fps", FPS, "--azimuth", f"{FIRST}:{FIRST + degrees}")
    seconds, facts = isogi("film", scene, "-o", folder / "film", "--store", folder / "film-light", *length, *common)
    told = {"final frames": facts["final"], **{f"{what} error": value for what, value in facts["error"].items()}}
    return {"film, s": seconds, "film: s a frame": seconds / frames, **{f"film: {name}": x for name, x in told.items()}}


def single(
    scene: str, folder: Path, azimuths: Sequence[float], frames: int, common: Sequence[object]
) -> dict[str, Any]:
    """Single pictures, extrapolated to all frames: each with light of its own, and all with one store."""
    figures: dict[str, Any] = {}
    for what, store in (("a store of its own", "{}"), ("one store", "shared")):
        seconds = []
        for number, azimuth in enumerate(azimuths):
            place = folder / store.format(number)
            spent, _ = isogi("render", scene, "-o", folder / "a.png", "--azimuth", azimuth, "--store", place, *common)
            seconds.append(spent)
        mean = statistics.fmean(seconds)
        figures |= {f"single pictures, {what}: s each": mean, f"single pictures, {what}: all frames, s": frames * mean}
    return figures


def peer(scene: str, azimuths: Sequence[float], size: int, frames: int, error: float) -> dict[str, Any]:
    """Mitsuba's seconds to the same error, extrapolated to all frames."""
    if not (mitsuba.installed() and mesh.installed() and mitsuba.usable(VARIANT)):
        return {"mitsuba": "not installed"}
    loaded, settings = load_scene(scene), settings_from()
    sides = {"width": size, "height": size}
    views = [view_of(loaded, read(FrameParams, {"azimuth": each, **sides}.items()), settings) for each in azimuths]
    tracers, costs = Mitsuba(loaded, views[0]), {name: Seconds() for name in mitsuba.SAMPLERS}
    for view in views:
        best = tracers.converge(view, np.ones((size, size), bool))
        costs = {name: cost + tracers.reach(name, best, error).cost for name, cost in costs.items()}
    means = {name: cost * (1 / len(views)) for name, cost in costs.items()}
    every = {name: tracers.set_up + mean * frames for name, mean in means.items()}
    each = {f"mitsuba {name}: s a frame": mean.wall for name, mean in means.items()}
    return each | {f"mitsuba {name}: all frames, s": cost.wall for name, cost in every.items()}


@part(size=128)
@click.argument("target", required=False)
@click.option("--frames", default=240, show_default=True, help="Frames of the film.")
@click.option("--degrees", default=360.0, show_default=True, help="That the camera turns.")
@click.option("--singles", default=6, show_default=True, help="Frames that are drawn singly.")
@click.option("--error", default=0.03, show_default=True, help="Relative error of each frame.")
@click.option("--workers", default=2, show_default=True, help="Worker processes.")
def film(
    target: str | None, size: int, frames: int, degrees: float, singles: int, error: float, workers: int
) -> Measurement:
    """A film of a turn, beside single pictures of its frames, and Mitsuba's."""
    with tempfile.TemporaryDirectory() as name:
        folder, azimuths = Path(name), [FIRST + degrees * n / singles for n in range(singles)]
        scene, common = target or scene_file(Path(name)), options(size, error, workers)
        figures = filmed(scene, folder, frames, degrees, common) | single(scene, folder, azimuths, frames, common)
        figures |= peer(scene, azimuths, size, frames, error)
    for other in [each for each in figures if each.endswith("all frames, s")]:
        figures[f"{other.removesuffix(': all frames, s')} / film"] = float(figures[other]) / float(figures["film, s"])
    return Measurement(f"A film of {frames} frames of {Path(scene).stem}, {size} × {size}, {workers} workers", figures)
