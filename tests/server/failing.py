"""Stores whose calls fail when they are told to, on the disk and in a bucket."""

import errno
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from uuid import uuid4

import pytest

from isogi_core.storage.backend import StoreUrl
from isogi_core.storage.folder import Folder
from tests.s3 import Call, Fault, S3Server

CALLS = ("get", "put", "create_sentinel", "folders", "check_writable")
"""What is asked of a folder while a scene is baked and shown."""


class Failing:
    """A new store at ``place``; ``fails`` is told the number of each call, from 1, and whether it
    fails.

    ``calls`` counts them.
    """

    def __init__(self, place: StoreUrl) -> None:
        self.place = place
        self.calls = 0
        self.fails: Callable[[int], bool] = lambda number: False

    def failing(self) -> bool:
        """Count a call; whether it fails."""
        self.calls += 1
        return self.fails(self.calls)

    def objects(self) -> dict[str, bytes]:
        """The stored chunks and what describes them, by key."""
        raise NotImplementedError


class FailingFolder(Failing):
    """A folder of which a call fails as a broken disk does."""

    def objects(self) -> dict[str, bytes]:
        folder = self.place.folder
        files = [
            path
            for path in folder.rglob("*")
            if path.is_file() and not {"costs", "used"} & {*path.parts}
        ]
        return {str(path.relative_to(folder)): path.read_bytes() for path in files}


class FailingBucket(Failing):
    """A bucket of which a call is refused, fails, or is done and not answered, in turn."""

    FAULTS: tuple[Fault, ...] = (503, "lost", "short", 403, "no-bucket", 500, "drop")

    def __init__(self, place: StoreUrl, s3: S3Server) -> None:
        super().__init__(place)
        self._s3 = s3

    def fault(self, call: Call) -> Fault | None:
        """What becomes of a call."""
        if self.failing():
            return self.FAULTS[self.calls % len(self.FAULTS)]
        return None

    def objects(self) -> dict[str, bytes]:
        prefix = self.place.url.removeprefix("s3://isogi/") + "/"
        kept = {
            key.removeprefix(prefix): data
            for key, data in self._s3.objects.items()
            if key.startswith(prefix)
        }
        return {key: data for key, data in kept.items() if not key.startswith(("costs/", "used/"))}


@contextmanager
def failing_folder(folder: Path) -> Iterator[Failing]:
    """A new folder under ``folder``; all calls to folders of this process are its own meanwhile."""
    failing = FailingFolder(StoreUrl(str(folder / uuid4().hex)))
    with pytest.MonkeyPatch.context() as patch:
        for name in CALLS:
            patch.setattr(Folder, name, counted(getattr(Folder, name), failing))
        yield failing


def counted(call: Callable[..., Any], failing: Failing) -> Callable[..., Any]:
    """A call of a folder that fails with the store."""

    def ask(folder: Folder, *args: Any, **more: Any) -> Any:
        if failing.failing():
            raise OSError(errno.EIO, "Input/output error")
        return call(folder, *args, **more)

    return ask


@contextmanager
def failing_bucket(s3: S3Server) -> Iterator[Failing]:
    """A new place in a bucket, all of whose calls are its own meanwhile."""
    failing = FailingBucket(StoreUrl(f"{s3.url}-{uuid4().hex}", seconds=2.0, retries=0), s3)
    s3.fault = failing.fault
    yield failing
    s3.fault = lambda call: None
