"""Copies of normalised volumes and of small files, kept in a folder of this machine."""

import io
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from isogi_core.errors import VolumeError
from isogi_core.files.mappings import scratch
from isogi_core.files.voxel_file import HEADER_BYTES, Draft, new_voxels, read_voxels
from isogi_core.kernels._cache_folder import locked
from isogi_core.storage.atomic_file import write_whole

MAX_COPIES_MB = 65536
"""Most megabytes of copies, unless ``ISOGI_VOLUME_CACHE_MB`` says otherwise."""

COPY_SUFFIX = ".voxels"

Copy = tuple[np.ndarray, dict[str, Any]]
"""The voxels of a copy, mapped, and the facts of their volume."""


def copies_folder() -> Path:
    """The folder of copies: ``$ISOGI_VOLUME_CACHE``, or ``isogi/volumes`` in the user's cache folder."""
    given = os.environ.get("ISOGI_VOLUME_CACHE")
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return Path(given) if given else base / "isogi" / "volumes"


def most_bytes() -> int:
    """Most bytes of copies; VolumeError where the environment variable is no number."""
    given = os.environ.get("ISOGI_VOLUME_CACHE_MB") or str(MAX_COPIES_MB)
    if not given.isdecimal():
        raise VolumeError(f"ISOGI_VOLUME_CACHE_MB is '{given}': give a whole number of megabytes.")
    return int(given) << 20


def find_copy(key: str) -> Copy | None:
    """Open a copy; None where there is none."""
    path = copies_folder() / f"{key}{COPY_SUFFIX}"
    found = read_voxels(path)
    if found is not None:
        with suppress(OSError):
            os.utime(path)
    return found


def get_copy(key: str, size: int, make: Callable[[Draft], dict[str, Any]]) -> Copy:
    """Open the copy of a volume of ``size`` bytes; where there is none, ``make`` writes it and returns its facts.

    One of all processes and threads makes it. It is found by the volume's own digest too. Raises VolumeError where the
    folder has no room or cannot be written, and what ``make`` raises.
    """
    folder = copies_folder()
    with _write_errors(folder), locked(folder / f"{key}.lock"):
        found = find_copy(key)
        if found is None:
            _make_room(folder, size)
            _write(folder, key, make)
            found = find_copy(key)
    if found is None:
        raise VolumeError(f"The copy of a volume in {folder} is gone or damaged as soon as made: check that disk.")
    return found


def get_file(key: str, name: str, fetch: Callable[[], bytes]) -> Path:
    """The path, ending in ``name``, of the copy of a small file; where there is none, ``fetch`` gives its bytes.

    Raises VolumeError where the folder cannot be written, and what ``fetch`` raises.
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
    """What was measured of all voxels of a volume, by ``measure`` once, and then read from a file of that ``name``.

    The ``key`` is the volume's own digest. Processes that ask at the same time may each measure it. Where there is no
    file, and none can be written, it is measured again.
    """
    path = copies_folder() / key / f"{name}.npy"
    with suppress(OSError, ValueError, EOFError):  # none, or a damaged one
        os.utime(path)
        return np.asarray(np.load(path))
    found, file = measure(), io.BytesIO()
    np.save(file, found)
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, file.getvalue())
    return found


def get_scratch(count: int, dtype: Any) -> np.ndarray:
    """An array of ``count`` numbers, of any values, that lies in a file of the folder for as long as it is there."""
    return scratch(copies_folder(), count, dtype)


@contextmanager
def _write_errors(folder: Path) -> Iterator[None]:
    """Raise VolumeError where a copy cannot be written."""
    try:
        yield
    except OSError as error:
        reason = f"The copy of a volume cannot be kept in {folder} ({error.strerror or error})"
        raise VolumeError(f"{reason}: make room, or name another folder by ISOGI_VOLUME_CACHE.") from error


def _write(folder: Path, key: str, make: Callable[[Draft], dict[str, Any]]) -> None:
    """Write a copy, and link it by its digest."""
    path = folder / f"{key}{COPY_SUFFIX}"
    with new_voxels(path) as draft:
        facts = make(draft)
    with suppress(OSError):  # a disk without links: a second copy is made by the digest
        os.link(path, folder / f"{facts['digest']}{COPY_SUFFIX}")


def _make_room(folder: Path, size: int) -> None:
    """Delete half-made copies, and then the copies used longest ago until one of ``size`` bytes more fits.

    A copy that a process has mapped stays readable for it. Raises VolumeError where the disk still has no room.
    """
    for partial in folder.glob("*.partial"):
        with suppress(OSError), locked(partial.with_suffix(".lock"), wait=False) as ours:
            if ours:
                partial.unlink()
    kept = _copies(folder)
    total, most = size + HEADER_BYTES + sum(state.st_size for state, _ in kept), most_bytes()
    for state, names in kept:
        if total <= most:
            break
        total -= state.st_size
        for name in names:
            name.unlink(missing_ok=True)
    free = shutil.disk_usage(folder).free
    if free < size + HEADER_BYTES:
        need = f"The volume takes {size / 1e9:.1f} GB in {folder}, where {free / 1e9:.1f} GB are free"
        raise VolumeError(f"{need}: make room, or name another folder by ISOGI_VOLUME_CACHE.")


def _copies(folder: Path) -> list[tuple[os.stat_result, list[Path]]]:
    """The copies with all of their names, those used longest ago first."""
    found: dict[int, tuple[os.stat_result, list[Path]]] = {}
    for path in (*folder.glob(f"*{COPY_SUFFIX}"), *folder.glob("*/*")):
        with suppress(FileNotFoundError):
            state = path.stat()
            found.setdefault(state.st_ino, (state, []))[1].append(path)
    return sorted(found.values(), key=lambda each: each[0].st_mtime)
