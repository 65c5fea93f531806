"""``isogi prewarm --server``: a running server does the work, and this process shows how far it is."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import TYPE_CHECKING

from isogi_core.errors import IsogiError
from server.errors import LibraryError, ParameterError, UnknownSceneError
from server.prewarm.order import PrewarmOrder
from server.prewarm.summary import Summary
from server.progress import left_text, progress_bar
from worker.outlook import TimeLeft

if TYPE_CHECKING:
    from collections.abc import Iterator

    from isogi_client import Job, Progress

WANTED = "isogi prewarm --server needs {name}: pip install 'isogi[client]'."


@contextlib.contextmanager
def posted(server: str, target: str, order: PrewarmOrder, dry: bool) -> Iterator[Job]:
    """The job that a server begins. Raises UnknownSceneError, ParameterError where it refuses, and IsogiError."""
    try:
        from isogi_client import Isogi  # noqa: PLC0415 (an extra of its own)
    except ModuleNotFoundError as error:
        raise LibraryError(WANTED.format(name=error.name)) from None
    with Isogi(server) as isogi, translated():
        scene = scene_named(target, [each["id"] for each in isogi.scenes()])
        yield isogi.prewarm(scene, dry_run=dry, **order.model_dump(mode="json", exclude_defaults=True))


def scene_named(target: str, scenes: list[str]) -> str:
    """The scene that is meant: by its id, or the name of its file; UnknownSceneError where the server has none such."""
    for name in (target, Path(target).stem.lower(), target.removeprefix("demo:")):
        if name in scenes:
            return name
    raise UnknownSceneError(f"The server shows no scene '{target}'; it shows: {', '.join(scenes)}.")


def follow(job: Job) -> Summary:
    """The summary, once the job has ended; a bar shows how far it is. Who interrupts this dismisses the job."""
    bar = progress_bar("prewarm", "percent", 100)

    def show(facts: Progress) -> None:
        left = "" if facts.time_left is None else left_text(TimeLeft(*facts.time_left))
        bar.n = facts.progress
        bar.set_postfix_str(f"{facts.message} {left}".strip(), refresh=True)

    try:
        return Summary.model_validate(job.wait(show))
    except KeyboardInterrupt:
        job.dismiss()
        raise
    finally:
        bar.close()


@contextlib.contextmanager
def translated() -> Iterator[None]:
    """Around what asks a server: what it refuses is wrong use, and what fails is an error, in its own words."""
    from isogi_client import IsogiError as ClientError  # noqa: PLC0415
    from isogi_client import NotFoundError, RefusedError  # noqa: PLC0415

    try:
        yield
    except NotFoundError as error:
        raise UnknownSceneError(error.detail) from None
    except RefusedError as error:
        raise ParameterError(error.detail) from None
    except ClientError as error:
        raise IsogiError(error.detail) from None
