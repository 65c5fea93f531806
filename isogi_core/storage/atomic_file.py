"""Files that are written whole or not at all."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from uuid import uuid4

PARTIAL = ".partial"
"""Suffix of a file that is being written. Readers and listings pass over it."""


def write_whole(path: Path, data: bytes) -> None:
    """Write the bytes to the file ``path``. A reader sees the former file or the new one, never a part of it."""
    with partial_file(path, data) as written:
        os.replace(written, path)


@contextmanager
def partial_file(path: Path, data: bytes, sync: bool = False) -> Iterator[Path]:
    """Write ``data`` to a new file beside ``path``, for the block to rename; delete it afterwards where it is left.

    ``sync`` brings the data to the disk before the block begins. Raises OSError.
    """
    written = path.with_name(f"{path.name}.{uuid4().hex}{PARTIAL}")
    try:
        with written.open("xb") as file:
            file.write(data)
            if sync:
                file.flush()
                os.fsync(file.fileno())
        yield written
    finally:
        written.unlink(missing_ok=True)


def sync_folder(folder: Path) -> None:
    """Bring the names in a folder to the disk, so that they survive a loss of power."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
