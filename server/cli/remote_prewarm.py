"""``isogi prewarm --server``: a running server bakes ahead; the command follows its job or leaves it alone."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from isogi_client import Isogi, Job, NotFoundError, RefusedError
from isogi_client import IsogiError as ClientError
from isogi_client import Progress as JobProgress
from isogi_core.errors import IsogiError
from server.errors import ParameterError, UnknownSceneError
from server.prewarm.order import PrewarmOrder
from server.prewarm.record import Summary
from server.progress import Progress
from worker.progress import TimeLeft


def detach(server: str, target: str, order: PrewarmOrder, dry: bool) -> str:
    """Begin a job on a server; its address. Raises as ``posted`` does."""
    with posted(server, target, order, dry) as job:
        return job.address


def follow(server: str, target: str, order: PrewarmOrder, dry: bool) -> Summary:
    """The summary of a server's job, once it has ended; a bar shows how far it is. Raises as ``posted`` does.

    An interrupt of the command dismisses the job.
    """
    with posted(server, target, order, dry) as job, Progress("prewarm", "percent") as bar:

        def show(job: JobProgress) -> None:
            left = None if job.time_left is None else TimeLeft(*job.time_left)
            bar.show(job.progress, 100, left, job.message)

        try:
            return Summary.model_validate(job.wait(show))
        except KeyboardInterrupt:
            job.dismiss()
            raise


@contextmanager
def posted(server: str, target: str, order: PrewarmOrder, dry: bool) -> Iterator[Job]:
    """The job that a server begins. Raises UnknownSceneError, ParameterError where it refuses, and IsogiError."""
    with Isogi(server) as isogi, translated():
        scene = scene_named(target, [each["id"] for each in isogi.scenes()])
        yield isogi.prewarm(scene, dry_run=dry, **order.model_dump(mode="json", exclude_defaults=True))


def scene_named(target: str, scenes: list[str]) -> str:
    """The scene that is meant: by its id, or the name of its file; UnknownSceneError where the server has none such."""
    for name in (target, Path(target).stem.lower(), target.removeprefix("demo:")):
        if name in scenes:
            return name
    raise UnknownSceneError(f"The server shows no scene '{target}'; it shows: {', '.join(scenes)}.")


@contextmanager
def translated() -> Iterator[None]:
    """The client's errors as the command's: a refusal is wrong use, a failure an error, both in the server's words."""
    try:
        yield
    except NotFoundError as error:
        raise UnknownSceneError(error.detail) from None
    except RefusedError as error:
        raise ParameterError(error.detail) from None
    except ClientError as error:
        raise IsogiError(error.detail) from None
