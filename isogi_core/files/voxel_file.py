"""Files of normalised voxels, which are mapped into memory."""

import json
import math
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import google_crc32c
import numpy as np

from isogi_core.files.mappings import map_file
from isogi_core.storage.atomic_file import PARTIAL_SUFFIX, sync_folder

HEADER_BYTES = 16384
"""Bytes before the voxels, whole pages for their alignment."""

VOXEL_FORMAT = f"isogi voxels 1 {sys.byteorder}"

Shape = tuple[int, ...]


@contextmanager
def new_voxels(path: Path) -> Iterator["Draft"]:
    """Write the file ``path`` by a draft; after the block the file is whole, and safe from a loss of power.

    The draft's name ends in ``.partial``; it is deleted where the block fails.
    """
    partial = path.with_suffix(PARTIAL_SUFFIX)
    try:
        with open(partial, "wb") as file:
            file.seek(HEADER_BYTES)
            yield Draft(file)
            file.flush()
            os.fsync(file.fileno())
        os.replace(partial, path)
        sync_folder(path.parent)
    finally:
        partial.unlink(missing_ok=True)


class Draft:
    """A file of voxels that is being written, plane by plane; ``seal`` makes it valid."""

    def __init__(self, file: IO[bytes]) -> None:
        """Write to ``file``, which is at the byte after the header."""
        self._file = file

    def write(self, plane: np.ndarray) -> None:
        """Add one plane of voxels (ny, nx), float32."""
        self._file.write(plane.data)

    def voxels(self, shape: Shape) -> np.ndarray:
        """Map the voxels that were written."""
        self._file.flush()
        with open(self._file.name, "rb") as file:
            return map_file(file, HEADER_BYTES).reshape(shape)

    def seal(self, shape: Shape, facts: dict[str, Any]) -> None:
        """Write the header: the ``shape`` (z, y, x) and the other facts of the volume."""
        body = json.dumps({"shape": shape, "facts": facts})
        head = json.dumps({"format": VOXEL_FORMAT, "crc32c": google_crc32c.value(body.encode()), "body": body})
        self._file.seek(0)
        self._file.write(head.encode().ljust(HEADER_BYTES))


def read_voxels(path: Path) -> tuple[np.ndarray, dict[str, Any]] | None:
    """Map the voxels of a file, and read its facts; None where it is missing or damaged.

    Damage of the header and a wrong size are detected. Do not write to the array: that would take memory of this
    process.
    """
    try:
        with open(path, "rb") as file:
            found = _read_header(file.read(HEADER_BYTES))
            if found is None or os.fstat(file.fileno()).st_size != HEADER_BYTES + 4 * math.prod(found[0]):
                return None
            return map_file(file, HEADER_BYTES).reshape(found[0]), found[1]
    except FileNotFoundError:
        return None


def _read_header(header: bytes) -> tuple[Shape, dict[str, Any]] | None:
    try:
        head = json.loads(header)
        body = head["body"]
        if head["format"] != VOXEL_FORMAT or head["crc32c"] != google_crc32c.value(body.encode()):
            return None
        content = json.loads(body)
        return tuple(content["shape"]), {key: _tuples(value) for key, value in content["facts"].items()}
    except (ValueError, KeyError, TypeError, AttributeError):
        return None


def _tuples(value: Any) -> Any:
    """JSON lists as tuples."""
    return tuple(value) if isinstance(value, list) else value
