"""A cluster by simulation: how far the queue, the scheduler and the store carry. See docs/scaling.md."""

import json
import logging
from pathlib import Path
from typing import Any

import click

from benchmarks.common import benchmark_scene
from benchmarks.simulator.recording import FOLDER, load

RECORDED = {"casting": ("demo:casting", 6, 64), "engine": (None, 6, 192)}
"""What is recorded, by name: a scene (None: the engine block under grace), views of an orbit, and pixels a side."""

TARGET = 0.05


@click.command()
@click.option("--record", "name", type=click.Choice(list(RECORDED)), help="Bake a scene and note what it takes, first.")
@click.option("--recording", default="casting", show_default=True, help="A name, or a file.")
@click.option("--only", multiple=True, help="This sweep alone; may be told more than once.")
@click.option("--quick", is_flag=True, help="The first two values of each sweep.")
@click.option("--plots", type=click.Path(path_type=Path), help="Draw pictures into this folder, such as docs/scaling.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def main(
    name: str | None, recording: str, only: tuple[str, ...], quick: bool, plots: Path | None, as_json: bool
) -> None:
    """Simulate 2 to 512 workers and 1 to 1,000 visitors with the real queue and baker."""
    from benchmarks.simulator.sweeps import SWEEPS  # noqa: PLC0415 (the option's help needs none of it)

    logging.getLogger("isogi.worker").setLevel(logging.CRITICAL)  # what fails here fails on purpose
    if name is not None:
        make(name)
    unknown = set(only) - set(SWEEPS)
    if unknown:
        raise click.UsageError(f"There is no sweep {', '.join(sorted(unknown))}: choose of {', '.join(SWEEPS)}.")
    made = load(recording)
    found = {
        sweep: run(made, quick, silent if as_json else tell)
        for sweep, run in SWEEPS.items()
        if not only or sweep in only
    }
    if plots is not None:
        from benchmarks.simulator.plots import draw  # noqa: PLC0415 (matplotlib is optional)

        draw(found, plots)
    if as_json:
        click.echo(json.dumps({"origin": made.origin, **found}, allow_nan=False))


def make(name: str) -> None:
    """Record a scene into the repository."""
    from benchmarks.simulator.record import record  # noqa: PLC0415 (loads the renderer)

    target, views, size = RECORDED[name]
    record(benchmark_scene(target), views, size, TARGET).save(FOLDER / f"{name}.json")


def tell(sweep: str, row: dict[str, Any]) -> None:
    """Print a run."""
    figures = ", ".join(
        f"{key} {value:.4g}" if isinstance(value, float) else f"{key} {value}" for key, value in row.items()
    )
    click.echo(f"{sweep}: {figures}")


def silent(sweep: str, row: dict[str, Any]) -> None:
    """Print nothing."""


if __name__ == "__main__":
    main()
