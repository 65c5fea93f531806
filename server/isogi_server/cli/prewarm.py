"""``isogi prewarm``: light is baked ahead by workers of this process, or by a server whose job
the command follows.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from isogi_core.bake.texel_light import FIRST_LEVEL
from isogi_core.errors import Cancelled, IsogiError, SceneError
from isogi_core.plan.scene import Scene
from isogi_core.plan.variants import at_time
from isogi_server.cli.film_path import at_step, steps_in
from isogi_server.cli.render import working
from isogi_server.errors import LibraryError, ParameterError, UnknownSceneError
from isogi_server.prewarm.baking import PrewarmContext, Step
from isogi_server.prewarm.order import PrewarmOrder, Views, order_of
from isogi_server.prewarm.record import Record, Summary, last_unfinished
from isogi_server.prewarm.work import carry_out, carry_out_dry, wanted
from isogi_server.progress import Progress, open_scene
from isogi_server.render.engine import RenderEngine
from isogi_server.render.patience import STALLED_SECONDS
from isogi_server.render.stores import root_of
from isogi_server.settings import Settings
from isogi_server.values import document_in
from isogi_server.views import goal_of
from isogi_worker.bake_requests import Viewer
from isogi_worker.progress import TimeLeft

if TYPE_CHECKING:
    from isogi.client import Job
    from isogi.client import Progress as JobProgress

__all__ = [
    "detach",
    "fields_given",
    "follow",
    "order_of",
    "prewarm",
    "prewarm_series",
    "print_summaries",
    "resume",
]


COMMAND = Viewer("prewarm", patient=True)
"""The viewer for whom a prewarm by this command bakes."""

PREWARM_STOPPED = "This was stopped, and what is baked is kept: the same with --continue goes on."


def prewarm(target: str, order: PrewarmOrder, settings: Settings, dry: bool = False) -> Summary:
    """Bake the light that an ``order`` asks for in a scene or volume, and return a summary; if
    ``dry``, only forecast it.

    Raises SceneError, VolumeError, LightError and ViewError before any work, and StoreError and
    WorkersError later. However it ends, baked light stays, and the record in the store holds the
    order.
    """
    begun = time.monotonic()
    return prewarm_scene(open_scene(target, settings), order, settings, dry, begun)


def prewarm_series(
    target: str, times: str | None, order: PrewarmOrder, settings: Settings, dry: bool = False
) -> Iterator[Summary]:
    """Yield the summary of ``prewarm`` at each step of a series that ``times`` names; at the
    scene's step if it is None.

    The deadline of the order is that of all steps together, shared evenly among those that are
    left. Raises as ``prewarm`` does, and ParameterError for steps that do not exist.
    """
    if times is None:
        yield prewarm(target, order, settings, dry)
        return
    begun = time.monotonic()
    first = open_scene(target, settings)
    steps = steps_in(times, first)
    for done, step in enumerate(steps):
        if step == first.volume.moment[0]:
            scene = first
        else:
            scene = at_time(first, step, first.id)
        # Time that a step does not use is shared by the later ones.
        now = time.monotonic()
        if order.deadline is None:
            left = None
        else:
            left = max(begun + order.deadline - now, 0.0) / (len(steps) - done)
        with at_step(step):
            summary = prewarm_scene(
                scene, order.model_copy(update={"deadline": left}), settings, dry, now
            )
        yield summary.model_copy(update={"time": step})


def prewarm_scene(
    scene: Scene,
    order: PrewarmOrder,
    settings: Settings,
    dry: bool = False,
    begun: float | None = None,
    rung: int = FIRST_LEVEL,
) -> Summary:
    """Do the work of ``prewarm`` for an open scene; time counts from ``begun``.

    ``rung`` is the least number of samples for texels of whole isosurfaces that are not good enough
    with fewer.
    """
    if begun is None:
        begun = time.monotonic()
    # Refuse views that are not allowed before any work.
    Views(order, scene, settings)
    record = Record(root_of(settings), scene, order, "command")
    with Progress() as bar:
        bar.begin("loading kernels")
        with working(scene, settings, with_workers=not dry) as engine:
            bar.begin("planning")
            context = context_of(engine, scene, order, partial(show, bar), begun)
            context.rung = rung
            what = wanted(context, order, settings)
            if dry:
                return carry_out_dry(context, what)
            try:
                with record.recording(context, PREWARM_STOPPED):
                    return record.close(
                        carry_out(context, what, lambda ahead: record.keep(ahead=ahead))
                    )
            except KeyboardInterrupt:
                raise Cancelled(PREWARM_STOPPED) from None


def print_summaries(summaries: Iterable[Summary], as_json: bool) -> int:
    """Print each of the ``summaries`` as it comes; return the number of chunks that could not
    be baked.
    """
    failed = 0
    for summary in summaries:
        click.echo(summary.model_dump_json() if as_json else str(summary))
        failed += summary.failed
    return failed


def show(bar: Progress, step: Step) -> None:
    """Draw a step on the bar."""
    bar.name(step.what.lower(), step.unit)
    bar.show(step.done, step.total, step.left)


def resume(target: str, settings: Settings, deadline: float | None) -> Summary:
    """Resume the last prewarm of a scene that was not completed. Raises SceneError if there is
    none.
    """

    scene = open_scene(target, settings)
    root = root_of(settings)
    document = last_unfinished(root, scene)
    if document is None:
        raise SceneError(
            f"There is no unfinished prewarm of {scene.name} in {root.url}: say which light to "
            "bake."
        )
    return prewarm(target, document.order.model_copy(update={"deadline": deadline}), settings)


def context_of(
    engine: RenderEngine,
    scene: Scene,
    order: PrewarmOrder,
    report: Callable[[Step], None],
    begun: float,
) -> PrewarmContext:
    """Return the context of a prewarm by this command, whose time began at ``begun``."""
    goal = goal_of(scene, order.target_error)
    if order.deadline is None:
        deadline = math.inf
    else:
        deadline = begun + order.deadline
    # No other client uses this engine, so frames and checks need no queue as those of a server do.
    return PrewarmContext(
        engine,
        scene,
        goal,
        COMMAND,
        lambda view: engine.survey(scene.id, view, goal),
        lambda view, prices, over: engine.check(scene.id, view, goal, prices=prices, over=over),
        report,
        deadline,
        STALLED_SECONDS,
        begun=begun,
    )


def fields_given(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of an order that the options give."""
    # Options that are left out take the defaults of the order.
    fields = {name: value for name, value in given.items() if value not in (None, ())}
    file = fields.pop("views_file", None)
    directions = [direction_in(text) for text in fields.pop("directions", ())]
    if file is None:
        directions += []
    else:
        directions += directions_in(file)
    orbits = [orbit_in(text) for text in fields.pop("orbits", ())]
    return fields | {
        name: each for name, each in (("directions", directions), ("orbits", orbits)) if each
    }


def direction_in(text: str) -> dict[str, str]:
    """Return the direction in a text such as ``azimuth=40,elevation=30``. Raises ParameterError."""
    pairs = [part.partition("=") for part in text.split(",")]
    if not all(name and equals for name, equals, _ in pairs):
        raise ParameterError(
            f"view must be such as azimuth=40,elevation=30, not '{text[:40]}'.", "view"
        )
    return {name.strip(): value.strip() for name, _, value in pairs}


def orbit_in(text: str) -> dict[str, str]:
    """Return the orbit in a text such as ``36@20`` or ``36``."""
    count, at, elevation = text.partition("@")
    if at:
        return {"count": count, "elevation": elevation}
    return {"count": count}


def directions_in(file: Path) -> list[Any]:
    """Return the ``directions`` in a JSON or TOML file, each such as {"azimuth": 40,
    "elevation": 30}. Raises ParameterError.
    """
    document = document_in(file, json.loads)
    if isinstance(document, dict):
        found = document.get("directions")
    else:
        found = document
    if not isinstance(found, list) or not found:
        raise ParameterError(
            f'{file.name} needs a list "directions", such as [{{"azimuth": 40}}].', "views-file"
        )
    return found


def detach(server: str, target: str, order: PrewarmOrder, dry: bool) -> str:
    """Start a job on a server, and return its address. Raises as ``posted`` does."""
    with posted(server, target, order, dry) as job:
        return job.address


def follow(server: str, target: str, order: PrewarmOrder, dry: bool) -> Summary:
    """Start a job on a server, follow it with a bar, and return its summary. Raises as ``posted``
    does.

    An interrupt of the command dismisses the job.
    """
    with posted(server, target, order, dry) as job, Progress("prewarm", "percent") as bar:

        def show(done: JobProgress) -> None:
            if done.time_left is None:
                left = None
            else:
                left = TimeLeft(*done.time_left)
            bar.show(done.progress, 100, left, done.message)

        try:
            return Summary.model_validate(job.wait(show))
        except KeyboardInterrupt:
            job.dismiss()
            raise


@contextmanager
def posted(server: str, target: str, order: PrewarmOrder, dry: bool) -> Iterator[Job]:
    """Start a job on a server, and yield it. Errors of the client become those of the command.

    Raises UnknownSceneError, ParameterError if the server refuses, IsogiError, and LibraryError if
    a library of the client is missing.
    """
    try:
        from isogi import client  # noqa: PLC0415 (its libraries are an extra)
    except ModuleNotFoundError as error:
        raise LibraryError(
            f"isogi prewarm --server needs {error.name}: pip install 'isogi[client]'."
        ) from None
    try:
        with client.Isogi(server) as isogi:
            scene = scene_named(target, [each["id"] for each in isogi.scenes()])
            yield isogi.prewarm(
                scene, dry_run=dry, **order.model_dump(mode="json", exclude_defaults=True)
            )
    except client.NotFoundError as error:
        raise UnknownSceneError(error.detail) from None
    except client.RefusedError as error:
        raise ParameterError(error.detail) from None
    except client.IsogiError as error:
        raise IsogiError(error.detail) from None


def scene_named(target: str, scenes: list[str]) -> str:
    """Return the scene that is meant, by its id or the name of its file. Raises
    UnknownSceneError if the server has none such.
    """
    for name in (target, Path(target).stem.lower(), target.removeprefix("demo:")):
        if name in scenes:
            return name
    raise UnknownSceneError(f"The server shows no scene '{target}'; it shows: {', '.join(scenes)}.")
