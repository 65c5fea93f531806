"""Lattices of one density and adaptive ones: errors, texels and bakes, as docs/accuracy-lattice.md tells them.

``python -m benchmarks.lattices [--size 80] [--wide 512] [--only 'engine under grace'] [-o FOLDER]``; references are
kept in FOLDER. Errors are of interpolation alone, of texels that have hardly any noise; texels and bakes are those of
the same view in a wider picture, at the target error. Needs the shared data.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from benchmarks.interpolation import ENGINES, PROBES, benches
from isogi_core.report.bench import Bench
from isogi_core.report.converged import converged
from isogi_core.report.metrics import Spread, mean_of, spread_of
from isogi_core.report.points import lit_by_frame, own_light

SUBJECTS = (ENGINES[0], *PROBES)

WAYS: Mapping[str, Mapping[str, Any]] = {
    "1 texel per voxel": {},
    "adaptive": {"adaptive": True},
    "0.5": {"lattice": 0.5},
    "2, adaptive": {"lattice": 2.0, "adaptive": True},
}
"""What scenes say."""

HEAD = "| {} | RMSE, % | 99th percentile, % | texels | with moved ones | bake, s of the processor |"


@click.command()
@click.option("-o", "--output", type=click.Path(path_type=Path, file_okay=False), help="Where references are kept.")
@click.option("--size", type=click.IntRange(8, 1024), default=80, show_default=True, help="Pixels, for errors.")
@click.option("--wide", type=click.IntRange(8, 1024), default=512, show_default=True, help="Pixels, for texels.")
@click.option("--only", multiple=True, help="Part of a subject's name, such as 'engine under grace'; repeatable.")
@click.option("--way", "ways", multiple=True, type=click.Choice(list(WAYS)), help="Lattices; all of them by default.")
def main(output: Path | None, size: int, wide: int, only: tuple[str, ...], ways: tuple[str, ...]) -> None:
    """Print a table in Markdown for each subject; its texels are moved (``sharpen = true``)."""
    for subject, bench in benches(SUBJECTS, lambda _: {"sharpen": True}, output, size, only):
        click.echo(HEAD.format(subject.name) + "\n| --- |" + " ---: |" * 5)
        for way in ways or WAYS:
            click.echo(row_of(way, replace(bench, scene=replace(bench.scene, **WAYS[way]), _made={}), wide))


def row_of(way: str, bench: Bench, wide: int) -> str:
    """A lattice's row of the table."""
    error, bake = interpolation_error(bench), bench.sized(wide).planned
    own = int((bake.light.samples[: len(bake.shown.places)] != 0).sum())
    figures = f"{100.0 * error.rmse:.2f} | {100.0 * error.p99:.1f} | {own:,} | {bake.lights:,} | {bake.seconds:.1f}"
    return f"| {way} | {figures} |"


def interpolation_error(bench: Bench) -> Spread:
    """What remains beside light at the pixels' own points."""
    exact, own = lit_by_frame(converged(bench).exact), own_light(bench)
    return spread_of(exact.light - own.light, exact.noise + own.noise, mean_of(own.light))


if __name__ == "__main__":
    main()
