"""What it costs to measure a picture's total error, and to reach the target, beside the bake of its
light.

    python -m benchmarks.accuracy checking [TARGET] [--size 512] [--only TEXT …]

Six scenes of the shared volumes, or the scene TARGET, by their default plans. Seconds are of the
processor, all threads together. The first step traces control pixels; where these say that light is
good enough, it is the only one. Further steps trace more of them, or give pixels light of their
own.
"""

import tempfile
from pathlib import Path
from statistics import median

import click

from benchmarks.accuracy.benches import benches
from benchmarks.common.measurement import Measurement, markdown
from benchmarks.common.scenes import SIX
from benchmarks.common.suite import part
from benchmarks.common.timing import Seconds
from isogi_core.bake.noise import Goal
from isogi_report.bench import Bench

HEAD = (
    "scene",
    "told at first, %",
    "told, %",
    "own light",
    "bake, s",
    "first step, s",
    "all steps, s",
    "KiB",
)


@part(size=512)
@click.argument("target", required=False)
@click.option("--only", multiple=True, help="Part of a scene's name; repeatable.")
def checking(target: str | None, size: int, only: tuple[str, ...]) -> Measurement:
    """What it takes to measure total errors, and to reach the target, beside the bake."""
    figures: dict[str, float] = {}
    rows: list[tuple[str, ...]] = []
    with tempfile.TemporaryDirectory() as folder:
        for name, bench in benches(target, SIX, lambda _: {}, Path(folder), size, only):
            found = measure(bench)
            figures |= {f"{name}: {key}": value for key, value in found.items()}
            rows.append(row_of(name, found))
            click.echo(" | ".join(rows[-1]), err=True)
    if not rows:
        raise click.UsageError("No scene has that in its name.")
    first = median(value for key, value in figures.items() if key.endswith("first step / bake"))
    return Measurement(
        "Checks beside bakes", {**figures, "first step / bake, median": first}, markdown(HEAD, rows)
    )


def measure(bench: Bench) -> dict[str, float]:
    """The figures of a view that is baked, and checked to its end."""
    bench.planned.frame()
    renderer = bench.renderer(bench.scene)
    goal = Goal.checked(bench.scene.target_error)
    renderer.render(bench.view, goal)
    bytes_before = renderer.nbytes
    first = Seconds()
    every = Seconds()
    with first.counting():
        more = renderer.refine(bench.view, goal)
    told = renderer.render(bench.view, goal).total
    with every.counting():
        while more and renderer.refine(bench.view, goal):
            pass
    every = every + first
    last = renderer.render(bench.view, goal)
    bake = bench.planned.seconds
    return {
        "told at first": told.likely,
        "told": last.total.likely,
        "final": float(last.final),
        "own light": last.traced_pixels / max(last.surface, 1),
        "bake, s": bake,
        "first step, s": first.processor,
        "first step / bake": first.processor / bake,
        "all steps, s": every.processor,
        "all steps / bake": every.processor / bake,
        "bytes": renderer.nbytes - bytes_before,
    }


def row_of(name: str, found: dict[str, float]) -> tuple[str, ...]:
    """A line of the table."""
    return (
        name,
        f"{100 * found['told at first']:.2f}",
        f"{100 * found['told']:.2f}{'' if found['final'] else ' (not final)'}",
        f"{found['own light']:.1%}",
        f"{found['bake, s']:.1f}",
        f"{found['first step, s']:.2f} ({found['first step / bake']:.1%})",
        f"{found['all steps, s']:.1f} ({found['all steps / bake']:.0%})",
        f"{found['bytes'] / 1024:.0f}",
    )
