"""Whether a dry run tells what a prewarm then takes, and what that comes to.

    python -m benchmarks.scaling prewarm [--size 128] [--views 4] [--error 0.05] [--only engine]
    [--json]

Each scene has a store of its own, empty at first, and each command is a process of its own, as a
person's is: a dry run, then the prewarm. "took over told" compares the seconds of all of it by the
clock; "processor, …" those that the workers spent, which what else the machine does changes less.
"cores it had" tells how much of the machine that was: on a busy one, less than there are workers.
"""

import json
import resource
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click

from benchmarks.common.measurement import Measurement
from benchmarks.common.scenes import GRACE, VOLUMES, shared_data
from benchmarks.common.suite import part

LIT = '[[lights]]\ntype = "probe"\nfile = "{probe}"\n'


def scenes(folder: Path) -> Iterator[tuple[str, str, str]]:
    """Names, targets and isovalues of the scenes that can be had here."""
    yield "casting", "demo:casting", "128"
    data = shared_data()
    if data is not None:
        for name, file, isovalue in (
            ("engine", VOLUMES["engine"], "70"),
            ("brain", VOLUMES["MNI brain"], "90"),
        ):
            scene = folder / f"{name}.toml"
            told = f'volume = "{data / file}"\nisovalue = {isovalue}\nalbedo = 0.7\nbounces = 4\n'
            scene.write_text(told + LIT.format(probe=data / GRACE), encoding="utf-8")
            yield name, str(scene), isovalue


def prewarmed(target: str, store: Path, *more: str) -> dict[str, Any]:
    """The summary that ``isogi prewarm`` prints, and the processor seconds of all its processes
    (``cpu``).
    """
    command = [
        sys.executable,
        "-m",
        "isogi_server",
        "prewarm",
        target,
        "--store",
        str(store),
        "--json",
        *more,
    ]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return {**json.loads(done.stdout), "cpu": spent}


def measured(target: str, options: list[str]) -> dict[str, float]:
    """What was told of a prewarm, and what it took."""
    with tempfile.TemporaryDirectory() as store:
        told = prewarmed(target, Path(store), *options, "--dry-run")
        came = prewarmed(target, Path(store), *options)
    left = told["time_left"]
    return {
        "texels": came["texels"],
        "chunks": came["chunks"],
        "told, s": left["likely"],
        "took, s": came["seconds"],
        "took over told": came["seconds"] / left["likely"],
        "cores it had": came["cpu"] / came["seconds"],
        "within the range": float(left["low"] <= came["seconds"] <= left["high"]),
        "processor, told s": told["processor_seconds"],
        "processor, took s": came["processor_seconds"],
        "processor, took over told": came["processor_seconds"] / told["processor_seconds"],
        "bytes stored over told": came["stored_bytes"] / told["stored_bytes"],
        "final": came["final"],
        "worst error": came["error"],
    }


@part(size=128)
@click.option("--views", default=4, show_default=True, help="Directions.")
@click.option("--error", default=0.05, show_default=True, help="Target error.")
@click.option("--workers", default=2, show_default=True, help="Baking processes.")
@click.option("--only", multiple=True, help="These scenes alone.")
def prewarm(
    size: int, views: int, error: float, workers: int, only: tuple[str, ...]
) -> Measurement:
    """What a dry run tells of a prewarm, beside what that then takes."""
    figures: dict[str, float] = {}
    side = [f"--{name}={size}" for name in ("width", "height")]
    with tempfile.TemporaryDirectory() as folder:
        for name, target, isovalue in scenes(Path(folder)):
            if not only or name in only:
                options = [
                    *side,
                    f"--views={views}",
                    f"--target-error={error}",
                    f"--workers={workers}",
                ]
                found = measured(target, [*options, f"--isovalue={isovalue}"])
                figures |= {f"{name}: {fact}": value for fact, value in found.items()}
    return Measurement(f"prewarms of {views} views, {size} × {size}, to {error:g}", figures)
