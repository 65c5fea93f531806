"""Files and folders that are written whole or not at all, and the user's cache folder."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from uuid import uuid4

from isogi_core.errors import UnwritableError, ViewError

PARTIAL_SUFFIX = ".partial"
"""Suffix of a file that is being written. Readers and listings pass over it."""


def user_cache(name: str) -> Path:
    """Return the folder ``isogi/NAME`` in the user's cache folder,
    ``$XDG_CACHE_HOME`` or ``~/.cache``.
    """
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "isogi" / name


def check_folder(output: Path) -> None:
    """Raise ViewError if the folder is missing
    that the file or folder ``output`` is to be written to.
    """
    if not output.parent.is_dir():
        raise ViewError(f"There is no folder {output.parent} for {output.name}: make it first.")


def check_writable(output: Path, size: int) -> None:
    """Raise UnwritableError if a file of ``size`` bytes cannot be written to ``output``.

    Call it before the work whose result goes there. A file that is there stays as it is.
    """
    trial = output.with_name(f"{output.name}.{uuid4().hex}{PARTIAL_SUFFIX}")
    try:
        try:
            with trial.open("xb") as file:
                # Ask the file system for the room, which is faster than writing, and fails as
                # writing would.
                if hasattr(os, "posix_fallocate"):
                    os.posix_fallocate(file.fileno(), 0, max(size, 1))
        finally:
            trial.unlink(missing_ok=True)
    except OSError as error:
        raise UnwritableError(
            f"{output} cannot be written ({error.strerror}): make room for {size:,} bytes, or name "
            "another place."
        ) from error


def write_whole(path: Path, data: bytes) -> None:
    """Write ``data`` to the file ``path``, in place of a former one. Raises OSError.

    A reader sees the former file or the new one, never a part of it. The data are not forced to the
    disk, so a loss of power may damage the file.
    """
    with partial_file(path, data) as written:
        os.replace(written, path)


@contextmanager
def partial_file(path: Path, data: bytes, sync: bool = False) -> Iterator[Path]:
    """Write ``data`` to a new file next to ``path``, for the block to rename; if the block leaves
    it there, delete it.

    With ``sync``, the data are on the disk before the block begins. Raises OSError.
    """
    written = path.with_name(f"{path.name}.{uuid4().hex}{PARTIAL_SUFFIX}")
    try:
        with written.open("xb") as file:
            file.write(data)
            if sync:
                file.flush()
                os.fsync(file.fileno())
        yield written
    finally:
        written.unlink(missing_ok=True)


@contextmanager
def whole_folder(path: Path) -> Iterator[Path]:
    """Yield the path of a folder next to ``path``, for the block to create and fill; then rename it
    to ``path``.

    If the block fails, the folder is deleted. Its name is always the same, and a folder that was
    left there is deleted first: only one process at a time may write to ``path``. Raises OSError if
    ``path`` is a file, or a folder that is not empty.
    """
    partial = path.with_name(f"{path.name}{PARTIAL_SUFFIX}")
    shutil.rmtree(partial, ignore_errors=True)
    try:
        yield partial
        os.replace(partial, path)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def sync_folder(folder: Path) -> None:
    """Force the names of the files in a ``folder`` to the disk, so that new and renamed files
    survive a loss of power. Raises OSError.
    """
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
