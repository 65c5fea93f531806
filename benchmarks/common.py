"""What the benchmarks share: the scenes they run on, their options, and how they print figures."""

import json
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import click

from isogi_core.model.scene import Scene, load_scene

ENGINE = "engine_256x256x128_uint8.nhdr"
GRACE = "probe_grace_256x128.hdr"
Figures = Mapping[str, Any]


def shared_data() -> Path | None:
    """The folder of real volumes and probes (``$ISOGI_SHARED_DATA``), None where there is none."""
    folder = Path(os.environ.get("ISOGI_SHARED_DATA", Path(__file__).parents[2] / "shared" / "data"))
    return folder if folder.is_dir() else None


def benchmark_scene(target: str | None, light: str = "probe", **overrides: Any) -> Scene:
    """``target``, or the engine block at 70 under grace (``light`` "probe") or constant light; else the casting."""
    data = shared_data()
    if target is None and data is not None:
        lights = {"probe": {"type": "probe", "file": str(data / GRACE)}, "constant": {"type": "constant"}}
        engine = {"isovalue": 70, "albedo": 0.7, "bounces": 4, "lights": [lights[light]]}
        return load_scene(data / ENGINE, **{**engine, **overrides})
    return load_scene(target, **overrides)


def options(size: int = 512, repeats: int = 9) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Decorator: the options that all benchmarks have, with their defaults."""

    def decorate(command: Callable[..., Any]) -> Callable[..., Any]:
        for option in (
            click.option("--json", "as_json", is_flag=True, help="Print JSON."),
            click.option("--repeats", type=click.IntRange(1), default=repeats, show_default=True, help="Timed rounds."),
            click.option("--size", type=click.IntRange(1), default=size, show_default=True, help="Pixels a side."),
        ):
            command = option(command)
        return command

    return decorate


def milliseconds(taken: Mapping[str, float]) -> dict[str, float]:
    """Seconds as figures in milliseconds."""
    return {f"{name}_ms": 1000.0 * value for name, value in taken.items()}


def show(title: str, figures: Figures, as_json: bool) -> None:
    """Print figures: as JSON, or as a table with one a line."""
    if as_json:
        click.echo(json.dumps(figures, allow_nan=False))
        return
    click.echo(f"\n{title}")
    width = max(map(len, figures))
    for name, value in figures.items():
        text = f"{value:.4g}" if isinstance(value, float) else str(value)
        click.echo(f"  {name:<{width}}  {text}")
