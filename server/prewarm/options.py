"""The options of ``isogi prewarm`` as an order, and who carries it out: this process, or a server."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from server.errors import ParameterError
from server.prewarm.order import PrewarmOrder, order_of
from server.prewarm.summary import Summary


@dataclass(frozen=True)
class Way:
    """How it is done: not at all (``dry_run``), where it was stopped (``go_on``), on a ``server``, or left to that."""

    dry_run: bool = False
    go_on: bool = False
    server: str | None = None
    detach: bool = False


def carry_out(
    target: str, given: Mapping[str, Any], way: Way, work: Mapping[str, str | None]
) -> tuple[Summary | None, str]:
    """The summary; none, and the job's address, where a server is left to it. Raises UsageError, and as ``prewarm``."""
    told = told_by(given)
    if way.go_on and (set(told) - {"deadline"} or way.dry_run or way.server):
        raise click.UsageError("--continue goes on with what was asked for: leave all but --deadline, --workers … out.")
    if way.detach and not way.server:
        raise click.UsageError("--detach leaves a server to it: say which by --server.")
    if way.server is not None:
        return on_server(target, order_of(told), way, work)
    return alone(target, order_of(told), way, work), ""


def alone(target: str, order: PrewarmOrder, way: Way, work: Mapping[str, str | None]) -> Summary:
    """Have workers of this process do it."""
    from server.cli import settings_from  # noqa: PLC0415 (it imports this)
    from server.prewarm.command import go_on, prewarm  # noqa: PLC0415 (pydantic, numba)

    settings = settings_from(None, **work)
    return go_on(target, settings, order.deadline) if way.go_on else prewarm(target, order, settings, way.dry_run)


def on_server(target: str, order: PrewarmOrder, way: Way, work: Mapping[str, str | None]) -> tuple[Summary | None, str]:
    """Have a server do it."""
    own = [name for name, value in work.items() if value is not None]
    if own:
        raise click.UsageError(f"--{own[0]} is the server's own: leave it out, or leave --server out.")
    from server.prewarm.remote import follow, posted  # noqa: PLC0415 (httpx)

    assert way.server is not None
    with posted(way.server, target, order, way.dry_run) as job:
        return (None, job.address) if way.detach else (follow(job), job.address)


def told_by(given: Mapping[str, Any]) -> dict[str, Any]:
    """The document of an order that options tell."""
    told = {name: value for name, value in given.items() if value not in (None, ())}
    file = told.pop("views_file", None)
    directions = [direction_in(text) for text in told.pop("directions", ())]
    directions += [] if file is None else directions_in(file)
    orbits = [orbit_in(text) for text in told.pop("orbits", ())]
    return told | {name: each for name, each in (("directions", directions), ("orbits", orbits)) if each}


def direction_in(text: str) -> dict[str, str]:
    """The direction in a text such as ``azimuth=40,elevation=30``."""
    pairs = [part.partition("=") for part in text.split(",")]
    if not all(name and equals for name, equals, _ in pairs):
        raise ParameterError(f"view must be such as azimuth=40,elevation=30, not '{text[:40]}'.", "view")
    return {name.strip(): value.strip() for name, _, value in pairs}


def orbit_in(text: str) -> dict[str, str]:
    """The orbit in a text such as ``36@20`` or ``36``."""
    count, at, elevation = text.partition("@")
    return {"count": count, "elevation": elevation} if at else {"count": count}


def directions_in(file: Path) -> list[Any]:
    """The ``directions`` in a JSON or TOML file, each such as {"azimuth": 40, "elevation": 30}."""
    try:
        text = file.read_text(encoding="utf-8")
        document = tomllib.loads(text) if file.suffix == ".toml" else json.loads(text)
    except ValueError as error:
        raise ParameterError(f"{file.name} cannot be read: {error}.", "views-file") from None
    found = document.get("directions") if isinstance(document, dict) else document
    if not isinstance(found, list) or not found:
        raise ParameterError(f'{file.name} needs a list "directions", such as [{{"azimuth": 40}}].', "views-file")
    return found
