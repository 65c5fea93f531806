"""How light is carried from texels to pixels: the ways of ``carrying`` (S1, figure 6) and of
``projection``.

    python -m benchmarks.accuracy interpolation [SCENE] [--size 80] [--only "engine under grace"]
    [-o FOLDER]

Errors are of interpolation alone: the same texels, with hardly any noise, beside light at the
pixels' own points. The RMSE is less the noise of both sides. References are kept in FOLDER, and
grown from there. Without a SCENE the shared data are needed.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path

import click

from benchmarks.accuracy.benches import benches
from benchmarks.accuracy.carrying import errors_of_ways
from benchmarks.accuracy.projection import errors_of_moves
from benchmarks.common.measurement import Measurement, markdown
from benchmarks.common.scenes import Subject
from benchmarks.common.suite import part
from isogi_report.metrics import Spread

SUBJECTS = (
    *(Subject("engine", isovalue, "constant light") for isovalue in (70, 170, 180)),
    *(Subject(*each, "constant light") for each in (("CT head", 110), ("MNI brain", 90))),
    *(Subject("engine", isovalue, light) for isovalue, light in ((70, "grace"), (170, "uffizi"))),
    Subject("CT head", 110, "uffizi"),
    Subject("MNI brain", 90, "grace"),
)


@part(size=80)
@click.argument("target", required=False)
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path, file_okay=False),
    help="Where references are kept.",
)
@click.option(
    "--only",
    multiple=True,
    help="Part of a subject's name, such as 'engine under grace'; repeatable.",
)
def interpolation(
    target: str | None, output: Path | None, size: int, only: tuple[str, ...]
) -> Iterator[Measurement]:
    """Errors of interpolation alone, of ways to carry light from texels to pixels."""
    for name, bench in benches(target, SUBJECTS, without_lobes, output, size, only):
        found = {**errors_of_ways(bench), **errors_of_moves(bench)}
        figures = {
            f"{way}: {what}": value
            for way, spread in found.items()
            for what, value in percents(spread).items()
        }
        yield Measurement(name, figures, table(found))


def without_lobes(light: str) -> Mapping[str, int]:
    """What scenes say so that all light is carried by texels."""
    if light == "constant light":
        return {}
    return {"lobes": 0}


def percents(spread: Spread) -> dict[str, float]:
    """A spread as figures."""
    return {
        "RMSE, %": 100.0 * spread.rmse,
        "99th percentile, %": 100.0 * spread.p99,
        "bias, %": 100.0 * spread.bias,
    }


def table(found: Mapping[str, Spread]) -> str:
    """Spreads in Markdown, by their names."""
    rows = (
        (way, *(f"{value:.2f}" for value in percents(spread).values()))
        for way, spread in found.items()
    )
    return markdown(("texels", "RMSE, %", "99th percentile, %", "bias, %"), rows)
