"""Files of voxels: the normalised voxels of one volume, as kernels take them, to be mapped into memory.

All processes of a machine that map the same file share one copy of it, the system's page cache, which takes what
memory is free and gives it back when it is wanted. Bytes: a header of HEADER bytes, JSON and spaces, then the voxels,
float32 in the machine's own order, x fastest.
"""

import json
import math
import mmap
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import google_crc32c
import numpy as np

from isogi_core.files.resident import RESIDENT

HEADER = 16384
"""Bytes before the voxels: whole pages, so that voxels lie as in memory of their own."""

FORMAT = f"isogi voxels 1 {sys.byteorder}"

NO_RESERVE = getattr(mmap, "MAP_NORESERVE", 0x4000 if sys.platform == "linux" else 0)
"""A private mapping takes no memory unless it is written to, and nobody does: none need be set aside for it."""

Shape = tuple[int, ...]


@contextmanager
def new_voxels(path: Path) -> Iterator["Draft"]:
    """A draft of the file ``path``, which is there whole, and safe from a loss of power, once the block has ended.

    Its own name ends in ``.partial``; it is removed where the block fails.
    """
    partial = path.with_suffix(".partial")
    try:
        with open(partial, "wb") as file:
            file.seek(HEADER)
            yield Draft(file)
            file.flush()
            os.fsync(file.fileno())
        os.replace(partial, path)
        sync_folder(path.parent)
    finally:
        partial.unlink(missing_ok=True)


class Draft:
    """A file of voxels that is being written, plane by plane; it begins to be one with its ``seal``."""

    def __init__(self, file: IO[bytes]) -> None:
        """Write to ``file``, which is at the byte after the header."""
        self._file = file

    def write(self, plane: np.ndarray) -> None:
        """Add one plane of voxels (ny, nx), float32."""
        self._file.write(plane.data)

    def voxels(self, shape: Shape) -> np.ndarray:
        """What was written, mapped."""
        self._file.flush()
        with open(self._file.name, "rb") as file:
            return _map(file).reshape(shape)

    def seal(self, shape: Shape, facts: dict[str, Any]) -> None:
        """Write the header: the ``shape`` (z, y, x) and what else there is to be told of the volume."""
        body = json.dumps({"shape": shape, "facts": facts})
        head = json.dumps({"format": FORMAT, "crc32c": google_crc32c.value(body.encode()), "body": body})
        self._file.seek(0)
        self._file.write(head.encode().ljust(HEADER))


def read_voxels(path: Path) -> tuple[np.ndarray, dict[str, Any]] | None:
    """The voxels, mapped and not read, and the facts in a file; None where there is none, or it is damaged.

    Damage that is seen is that of the header, and that of a file cut short. The array may be written to and nobody
    should: that would take memory of this process alone.
    """
    try:
        with open(path, "rb") as file:
            found = _read_header(file.read(HEADER))
            if found is None or os.fstat(file.fileno()).st_size != HEADER + 4 * math.prod(found[0]):
                return None
            return _map(file).reshape(found[0]), found[1]
    except FileNotFoundError:
        return None


def _map(file: IO[bytes]) -> np.ndarray:
    """All voxels in a file; float32."""
    flags, access = mmap.MAP_PRIVATE | NO_RESERVE, mmap.PROT_READ | mmap.PROT_WRITE
    mapping = mmap.mmap(file.fileno(), 0, flags=flags, prot=access)
    RESIDENT.watch(mapping)
    return np.frombuffer(mapping, np.float32, offset=HEADER)


def _read_header(header: bytes) -> tuple[Shape, dict[str, Any]] | None:
    try:
        head = json.loads(header)
        body = head["body"]
        if head["format"] != FORMAT or head["crc32c"] != google_crc32c.value(body.encode()):
            return None
        told = json.loads(body)
        return tuple(told["shape"]), {key: _tuples(value) for key, value in told["facts"].items()}
    except (ValueError, KeyError, TypeError, AttributeError):
        return None


def _tuples(value: Any) -> Any:
    """Lists of JSON as the tuples that they were."""
    return tuple(value) if isinstance(value, list) else value


def sync_folder(folder: Path) -> None:
    """Have the names in a folder survive a loss of power."""
    number = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(number)
    finally:
        os.close(number)
