"""Copies of normalised volumes, files that are mapped into memory, and of small files, in a folder
of this machine.
"""

import io
import json
import math
import os
import shutil
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any

import google_crc32c
import numpy as np

from isogi_core.errors import VolumeError
from isogi_core.files.mappings import map_file, scratch
from isogi_core.kernels._cache_folder import locked
from isogi_core.storage.atomic_file import PARTIAL_SUFFIX, sync_folder, user_cache, write_whole

HEADER_BYTES = 16384
"""Bytes before the voxels, whole pages for their alignment."""

VOXEL_FORMAT = f"isogi voxels 1 {sys.byteorder}"

Shape = tuple[int, ...]


@contextmanager
def new_voxels(path: Path) -> Iterator["Draft"]:
    """Write a file of voxels to ``path``, whole or not at all: yield a draft, which the block fills
    and seals.

    After the block the draft is forced to the disk, and then renamed to ``path``: a loss of power
    leaves the new file, or the state before. If the block fails, the draft is deleted, and ``path``
    stays as it was. Drafts of one path have the same name, which ends in ``.partial``: only one
    thread of one process at a time may write to ``path``.
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
    """A file of voxels that is being written, plane by plane. Until ``seal`` has written its header
    it is not valid: ``read_voxels`` returns None for it.
    """

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
        head = json.dumps(
            {"format": VOXEL_FORMAT, "crc32c": google_crc32c.value(body.encode()), "body": body}
        )
        self._file.seek(0)
        self._file.write(head.encode().ljust(HEADER_BYTES))


def read_voxels(path: Path) -> tuple[np.ndarray, dict[str, Any]] | None:
    """Map the voxels of a file, and read its facts; return None if it is missing or damaged.

    Damage of the header and a wrong size are detected. Do not write to the array: that would take
    memory of this process.
    """
    try:
        with open(path, "rb") as file:
            found = _read_header(file.read(HEADER_BYTES))
            if found is None or os.fstat(file.fileno()).st_size != HEADER_BYTES + 4 * math.prod(
                found[0]
            ):
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
        return tuple(content["shape"]), {
            key: _tuples(value) for key, value in content["facts"].items()
        }
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None


def _tuples(value: Any) -> Any:
    """Return JSON lists as tuples."""
    if isinstance(value, list):
        return tuple(value)
    return value


MAX_COPIES_MB = 65536
"""Most megabytes of copies, unless ``ISOGI_VOLUME_CACHE_MB`` says otherwise."""

COPY_SUFFIX = ".voxels"

Copy = tuple[np.ndarray, dict[str, Any]]
"""The voxels of a copy, mapped, and the facts of their volume."""


def copies_folder() -> Path:
    """Return the folder of copies: ``$ISOGI_VOLUME_CACHE``, or ``isogi/volumes`` in the user's
    cache folder.
    """
    given = os.environ.get("ISOGI_VOLUME_CACHE")
    if given:
        return Path(given)
    return user_cache("volumes")


def most_bytes() -> int:
    """Return the most bytes that copies may take. Raises VolumeError if the environment variable is
    no number.
    """
    given = os.environ.get("ISOGI_VOLUME_CACHE_MB") or str(MAX_COPIES_MB)
    if not given.isdecimal():
        raise VolumeError(f"ISOGI_VOLUME_CACHE_MB is '{given}': give a whole number of megabytes.")
    return int(given) << 20


def find_copy(key: str) -> Copy | None:
    """Open a copy; return None if there is none."""
    path = copies_folder() / f"{key}{COPY_SUFFIX}"
    found = read_voxels(path)
    if found is not None:
        with suppress(OSError):
            os.utime(path)
    return found


def get_copy(key: str, size: int, make: Callable[[Draft], dict[str, Any]]) -> Copy:
    """Open the copy of a volume of ``size`` bytes. If there is none, ``make`` writes it and returns
    its facts, in one of all processes and threads that ask.

    It is found by the volume's digest, too. Raises VolumeError if the folder has no room or cannot
    be written, and the errors of ``make``.
    """
    folder = copies_folder()
    with _write_errors(folder), locked(folder / f"{key}.lock"):
        found = find_copy(key)
        if found is None:
            _make_room(folder, size)
            _write(folder, key, make)
            found = find_copy(key)
    if found is None:
        raise VolumeError(
            f"The copy of a volume in {folder} is gone or damaged as soon as made: check that disk."
        )
    return found


def get_file(key: str, name: str, fetch: Callable[[], bytes]) -> Path:
    """Return the path, ending in ``name``, of the copy of a small file; if there is none, ``fetch``
    returns its bytes. Raises VolumeError if the folder cannot be written, and the errors of
    ``fetch``.
    """
    path = copies_folder() / key / name
    if not path.exists():
        data = fetch()
        with _write_errors(copies_folder()):
            path.parent.mkdir(parents=True, exist_ok=True)
            write_whole(path, data)
    with suppress(OSError):
        os.utime(path)
    return path


def get_survey(key: str, name: str, measure: Callable[[], np.ndarray]) -> np.ndarray:
    """Return numbers that ``measure`` found in all voxels of a volume: it is called once, and its
    result is read from a file of that ``name`` from then on. ``key`` is the volume's digest.

    Processes that ask at the same time may each measure. If the file cannot be written, the next
    call measures again.
    """
    path = copies_folder() / key / f"{name}.npy"
    with suppress(OSError, ValueError, EOFError):  # none, or a damaged one
        os.utime(path)
        return np.asarray(np.load(path))
    found = measure()
    file = io.BytesIO()
    np.save(file, found)
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, file.getvalue())
    return found


def get_scratch(count: int, dtype: Any) -> np.ndarray:
    """Return an array of ``count`` numbers, of any values, mapped to a file of the folder that is
    deleted with the array.
    """
    return scratch(copies_folder(), count, dtype)


@contextmanager
def _write_errors(folder: Path) -> Iterator[None]:
    """Raise VolumeError if a copy cannot be written."""
    try:
        yield
    except OSError as error:
        reason = f"The copy of a volume cannot be kept in {folder} ({error.strerror or error})"
        raise VolumeError(
            f"{reason}: make room, or name another folder by ISOGI_VOLUME_CACHE."
        ) from error


def _write(folder: Path, key: str, make: Callable[[Draft], dict[str, Any]]) -> None:
    """Write a copy, and link it by its digest."""
    path = folder / f"{key}{COPY_SUFFIX}"
    with new_voxels(path) as draft:
        facts = make(draft)
    with suppress(OSError):  # a disk without links: a second copy is made by the digest
        os.link(path, folder / f"{facts['digest']}{COPY_SUFFIX}")


def _make_room(folder: Path, size: int) -> None:
    """Delete half-made copies, and then the copies used longest ago until one of ``size`` bytes
    more fits.

    A copy that a process has mapped stays readable for it. Raises VolumeError if the disk still has
    no room.
    """
    for partial in folder.glob("*.partial"):
        with suppress(OSError), locked(partial.with_suffix(".lock"), wait=False) as ours:
            if ours:
                partial.unlink()
    kept = _copies(folder)
    total = size + HEADER_BYTES + sum(state.st_size for state, _ in kept)
    most = most_bytes()
    for state, names in kept:
        if total <= most:
            break
        total -= state.st_size
        for name in names:
            name.unlink(missing_ok=True)
    free = shutil.disk_usage(folder).free
    if free < size + HEADER_BYTES:
        need = (
            f"The volume takes {size / 1e9:.1f} GB in {folder}, where {free / 1e9:.1f} GB are free"
        )
        raise VolumeError(f"{need}: make room, or name another folder by ISOGI_VOLUME_CACHE.")


def _copies(folder: Path) -> list[tuple[os.stat_result, list[Path]]]:
    """Return the copies with all of their names, those used longest ago first."""
    found: dict[int, tuple[os.stat_result, list[Path]]] = {}
    for path in (*folder.glob(f"*{COPY_SUFFIX}"), *folder.glob("*/*")):
        with suppress(FileNotFoundError):
            state = path.stat()
            found.setdefault(state.st_ino, (state, []))[1].append(path)
    return sorted(found.values(), key=lambda each: each[0].st_mtime)
