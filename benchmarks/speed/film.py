"""A film beside single pictures of its frames, and beside Mitsuba's path tracer to the same error.

    python -m benchmarks.speed film [SCENE.toml] [--size 128] [--frames 240] [--degrees 360]
    [--singles 12]
        [--alone 2] [--peers 3] [--error 0.03] [--folder DIR] [--seconds S]

Runs `isogi film` for a turn of the camera on an empty store, and `isogi render` for some of its
frames, evenly spread: one after the other with one store, and a few each with a store of its own.
Where Mitsuba is installed, it draws some frames to the same relative error against its own
converged pictures. What was not drawn is extrapolated from the mean of what was. With `--folder`,
what is done is kept there, and the same command goes on with the rest; `--seconds` are those after
which the film is stopped, to go on later: its times add up.
"""

import json
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
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
from isogi_server.cli.setting_options import settings_from
from isogi_server.parameters import FrameParams, read
from isogi_server.views import view_of

FPS = 24
FIRST = 30.0
"""Frames of a second, and the azimuth of the first."""

ALONE = "a store of its own"
SHARED = "one store"
"""Where single pictures keep their light."""


def isogi(*words: object, most: float | None = None) -> tuple[float, dict[str, Any]]:
    """Wall seconds of a command, and the facts that it prints; none where it is stopped after
    ``most`` seconds.
    """
    begun = time.perf_counter()
    command = [sys.executable, "-m", "isogi_server", *map(str, words), "--json"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        output, complaint = process.communicate(timeout=most)
    except subprocess.TimeoutExpired:
        process.terminate()
        process.communicate()
        return time.perf_counter() - begun, {}
    if process.returncode:
        raise click.ClickException(complaint.strip().splitlines()[-1])
    return time.perf_counter() - begun, json.loads(output)


def options(size: int, error: float, workers: int) -> list[object]:
    """What film and pictures have in common."""
    return ["--width", size, "--height", size, "--target-error", error, "--workers", workers]


def filmed(
    scene: str,
    folder: Path,
    frames: int,
    degrees: float,
    common: Sequence[object],
    most: float | None = None,
) -> dict[str, Any]:
    """The film, and how good it became; it is stopped after ``most`` seconds, and went on where it
    had been stopped.
    """
    length = ("--length", frames / FPS, "--fps", FPS, "--azimuth", f"{FIRST}:{FIRST + degrees}")
    places = ("-o", folder / "film", "--store", folder / "film-light")
    seconds, facts = isogi("film", scene, *places, *length, *common, most=most)
    before = folder / "film-seconds.txt"
    if before.exists():
        seconds += float(before.read_text())
    if not facts:
        before.write_text(f"{seconds}")
        drawn = sum(1 for _ in (folder / "film").glob("*.png"))
        raise click.ClickException(
            f"The film has {drawn} of {frames} frames: run the same command again to go on."
        )
    told = {
        "final frames": facts["final"],
        **{f"{what} error": value for what, value in facts["error"].items()},
    }
    return {
        "film, s": seconds,
        "film: s a frame": seconds / frames,
        **{f"film: {name}": x for name, x in told.items()},
    }


def single(
    scene: str,
    folder: Path,
    azimuths: Sequence[float],
    frames: int,
    common: Sequence[object],
    what: str,
) -> dict[str, Any]:
    """Single pictures, extrapolated to all frames: ``what`` says whether each has a store of its
    own, or all one.
    """
    seconds = []
    for number, azimuth in enumerate(azimuths):
        place = folder / (str(number) if what == ALONE else "shared")
        spent, _ = isogi(
            "render", scene, "-o", folder / "a.png", "--azimuth", azimuth, "--store", place, *common
        )
        seconds.append(spent)
    mean = statistics.fmean(seconds)
    name = f"single pictures, {what}"
    drawn = {
        f"{name}: pictures drawn": len(seconds),
        f"{name}: s each": mean,
        f"{name}: first, s": seconds[0],
    }
    return drawn | {f"{name}: all frames, s": frames * mean}


def peer(
    scene: str, azimuths: Sequence[float], size: int, frames: int, error: float
) -> dict[str, Any]:
    """Mitsuba's seconds to the same error, extrapolated to all frames."""
    if not (mitsuba.installed() and mesh.installed() and mitsuba.usable(VARIANT)):
        return {"mitsuba": "not installed"}
    loaded = load_scene(scene)
    settings = settings_from()
    sides = {"width": size, "height": size}
    views = [
        view_of(loaded, read(FrameParams, {"azimuth": each, **sides}.items()), settings)
        for each in azimuths
    ]
    tracers = Mitsuba(loaded, views[0])
    costs = {name: Seconds() for name in mitsuba.SAMPLERS}
    for view in views:
        best = tracers.converge(view, np.ones((size, size), bool))
        costs = {name: cost + tracers.reach(name, best, error).cost for name, cost in costs.items()}
    means = {name: cost * (1 / len(views)) for name, cost in costs.items()}
    every = {name: tracers.set_up + mean * frames for name, mean in means.items()}
    each = {f"mitsuba {name}: s a frame": mean.wall for name, mean in means.items()}
    each["mitsuba: frames drawn"] = len(views)
    return each | {f"mitsuba {name}: all frames, s": cost.wall for name, cost in every.items()}


def measured(
    scene: str, folder: Path, most: float | None, numbers: dict[str, Any]
) -> dict[str, Any]:
    """All figures, by the options of the command; those that ``folder`` keeps are not measured
    again.
    """
    frames, degrees, error, size = (
        numbers[name] for name in ("frames", "degrees", "error", "size")
    )
    common = options(size, error, numbers["workers"])
    book = folder / "figures.json"

    def turns(count: int) -> list[float]:
        return [FIRST + degrees * n / count for n in range(count)]

    steps: dict[str, Callable[[], dict[str, Any]]] = {
        "film": lambda: filmed(scene, folder, frames, degrees, common, most),
        SHARED: lambda: single(scene, folder, turns(numbers["singles"]), frames, common, SHARED),
        ALONE: lambda: single(scene, folder, turns(numbers["alone"]), frames, common, ALONE),
        "mitsuba": lambda: peer(scene, turns(numbers["peers"]), size, frames, error),
    }
    known: dict[str, dict[str, Any]] = json.loads(book.read_text()) if book.exists() else {}
    for name, measure in steps.items():
        if name not in known:
            known[name] = measure()
            book.write_text(json.dumps(known))
    return {name: figure for step in steps for name, figure in known[step].items()}


@part(size=128)
@click.argument("target", required=False)
@click.option("--frames", default=240, show_default=True, help="Frames of the film.")
@click.option("--degrees", default=360.0, show_default=True, help="That the camera turns.")
@click.option(
    "--singles", default=12, show_default=True, help="Frames that are drawn singly, with one store."
)
@click.option(
    "--alone", default=2, show_default=True, help="Those that are drawn with a store of their own."
)
@click.option("--peers", default=3, show_default=True, help="Those that Mitsuba draws.")
@click.option("--error", default=0.03, show_default=True, help="Relative error of each frame.")
@click.option("--workers", default=2, show_default=True, help="Worker processes.")
@click.option(
    "--folder",
    type=click.Path(path_type=Path, file_okay=False),
    help="Keeps what is done, to go on.",
)
@click.option(
    "--seconds", type=click.FloatRange(1.0), help="After which the film is stopped, to go on later."
)
def film(
    target: str | None, folder: Path | None, seconds: float | None, **numbers: Any
) -> Measurement:
    """A film of a turn, beside single pictures of its frames, and Mitsuba's."""
    frames, size, workers = (numbers[name] for name in ("frames", "size", "workers"))
    with tempfile.TemporaryDirectory() as name:
        kept = folder or Path(name)
        kept.mkdir(parents=True, exist_ok=True)
        scene = target or scene_file(kept)
        figures = measured(scene, kept, seconds, numbers)
    for other in [each for each in figures if each.endswith("all frames, s")]:
        figures[f"{other.removesuffix(': all frames, s')} / film"] = float(figures[other]) / float(
            figures["film, s"]
        )
    shown = load_scene(scene).volume.name
    return Measurement(
        f"A film of {frames} frames of {shown}, {size} × {size}, {workers} workers", figures
    )
