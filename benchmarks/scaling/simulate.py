"""A cluster by simulation: how far the queue, the scheduler and the store carry.

    python -m benchmarks.scaling simulate [--recording casting] [--only workers] [--quick] [--record
    engine]

Figures are named by the sweep, by what differs in it, and by what was measured.
"""

import logging
from collections.abc import Mapping
from typing import Any

import click

from benchmarks.common.measurement import Measurement, markdown, shown
from benchmarks.common.scenes import benchmark_scene
from benchmarks.common.suite import part
from benchmarks.scaling.simulator.plots import draw
from benchmarks.scaling.simulator.record import record as record_scene
from benchmarks.scaling.simulator.recording import FOLDER, load
from benchmarks.scaling.simulator.sweeps import SWEEPS, VARIED, Rows

RECORDED = {"casting": ("demo:casting", 6, 64), "engine": (None, 6, 192)}
"""What is recorded, by name: a scene (None: the engine block under grace), views of an orbit, and
pixels a side.
"""

TARGET = 0.05


@part()
@click.option(
    "--record",
    "name",
    type=click.Choice(list(RECORDED)),
    help="Bake a scene and note what it takes, first.",
)
@click.option("--recording", default="casting", show_default=True, help="A name, or a file.")
@click.option(
    "--only", multiple=True, type=click.Choice(list(SWEEPS)), help="This sweep alone; repeatable."
)
@click.option("--quick", is_flag=True, help="The first two values of each sweep.")
def simulate(name: str | None, recording: str, only: tuple[str, ...], quick: bool) -> Measurement:
    """2 to 512 workers and 1 to 1,000 visitors, by simulation with the real queue and baker."""
    logging.getLogger("isogi.worker").setLevel(logging.CRITICAL)  # what fails here fails on purpose
    if name is not None:
        target, views, size = RECORDED[name]
        record_scene(benchmark_scene(target), views, size, TARGET).save(FOLDER / f"{name}.json")
    made = load(recording)
    found = {
        sweep: run(made, quick, tell) for sweep, run in SWEEPS.items() if not only or sweep in only
    }
    figures = {
        key: value
        for sweep, rows in found.items()
        for key, value in figures_of(sweep, rows).items()
    }
    text = "\n\n".join(f"## {sweep}\n\n{table(rows)}" for sweep, rows in found.items())
    return Measurement(
        f"simulated, as the {made.origin['volume']} was recorded", figures, text, draw(found)
    )


def figures_of(sweep: str, rows: Rows) -> dict[str, Any]:
    """The figures of a sweep by name."""
    found: dict[str, Any] = {}
    for row in rows:
        varied = ", ".join(f"{name} {shown(row[name])}" for name in VARIED if name in row)
        found |= {
            ": ".join(filter(None, (sweep, varied, name))): row[name]
            for name in row
            if name not in VARIED
        }
    return found


def table(rows: Rows) -> str:
    """A sweep in Markdown."""
    return markdown(
        list(rows[0]), ([shown(value) for value in row.values()] for row in rows), left=0
    )


def tell(sweep: str, row: Mapping[str, Any]) -> None:
    """Say that a run is done."""
    click.echo(
        f"{sweep}: {', '.join(f'{name} {shown(row[name])}' for name in VARIED if name in row)}",
        err=True,
    )
