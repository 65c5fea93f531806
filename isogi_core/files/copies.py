"""Copies: volumes that were made ready once, kept in a folder of this machine for whoever opens them next.

A copy is a file of voxels (see ``files.voxels``), named by a key: the stamp of what it was made from, or the digest of
the volume that it holds. The folder is bounded; copies that were used last are kept.
"""

import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Any

import numpy as np

from isogi_core.errors import VolumeError
from isogi_core.files.voxels import HEADER, Draft, new_voxels, read_voxels
from isogi_core.kernels._folder import locked

MOST = 65536
"""Megabytes of copies that are kept, unless ``ISOGI_VOLUME_CACHE_MB`` says otherwise."""

SUFFIX = ".voxels"

Found = tuple[np.ndarray, dict[str, Any]]


def copies_folder() -> Path:
    """Where copies are kept: ``$ISOGI_VOLUME_CACHE``, or ``isogi/volumes`` in the user's cache folder."""
    told = os.environ.get("ISOGI_VOLUME_CACHE")
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return Path(told) if told else base / "isogi" / "volumes"


def most_bytes() -> int:
    """Bytes of copies that are kept; VolumeError where the environment names no such number."""
    told = os.environ.get("ISOGI_VOLUME_CACHE_MB") or str(MOST)
    if not told.isdecimal():
        raise VolumeError(f"ISOGI_VOLUME_CACHE_MB is '{told}': give a whole number of megabytes.")
    return int(told) << 20


def find_copy(key: str) -> Found | None:
    """The voxels, mapped, and the facts of a copy; None where there is none."""
    path = copies_folder() / f"{key}{SUFFIX}"
    found = read_voxels(path)
    if found is not None:
        with suppress(OSError):
            os.utime(path)
    return found


def get_copy(key: str, size: int, make: Callable[[Draft], dict[str, Any]]) -> Found:
    """The copy of a volume of ``size`` bytes, which ``make`` writes and tells the facts of where there is none yet.

    Of all processes and threads that ask at once one makes it. It is found by the volume's own digest too.
    Raises VolumeError where the folder has no room or cannot be written, and what ``make`` raises.
    """
    folder = copies_folder()
    with _telling(folder), locked(folder / f"{key}.lock"):
        found = find_copy(key)
        if found is None:
            _make_room(folder, size)
            _write(folder, key, make)
            found = find_copy(key)
    if found is None:
        raise VolumeError(f"The copy of a volume in {folder} is gone or damaged as soon as made: check that disk.")
    return found


def get_file(key: str, name: str, fetch: Callable[[], bytes]) -> Path:
    """The copy of a small file, which ``fetch`` gives the bytes of where there is none yet; its last name is ``name``.

    Raises VolumeError where the folder cannot be written, and what ``fetch`` raises.
    """
    path = copies_folder() / key / name
    if not path.exists():
        data = fetch()
        with _telling(copies_folder()):
            path.parent.mkdir(parents=True, exist_ok=True)
            with NamedTemporaryFile(dir=path.parent, delete=False) as draft:
                draft.write(data)
            os.replace(draft.name, path)
    with suppress(OSError):
        os.utime(path)
    return path


@contextmanager
def _telling(folder: Path) -> Iterator[None]:
    """Raises VolumeError for what keeps a copy from being written."""
    try:
        yield
    except OSError as error:
        told = f"The copy of a volume cannot be kept in {folder} ({error.strerror or error})"
        raise VolumeError(f"{told}: make room, or name another folder by ISOGI_VOLUME_CACHE.") from error


def _write(folder: Path, key: str, make: Callable[[Draft], dict[str, Any]]) -> None:
    """Write a copy, and give it its second name."""
    path = folder / f"{key}{SUFFIX}"
    with new_voxels(path) as draft:
        facts = make(draft)
    with suppress(OSError):  # a disk without links: who asks for the digest makes a copy of its own
        os.link(path, folder / f"{facts['digest']}{SUFFIX}")


def _make_room(folder: Path, size: int) -> None:
    """Remove copies, those used longest ago first, until one of ``size`` bytes more fits; and what was left half-made.

    A copy that a process has mapped stays there for it. Raises VolumeError where the disk has no room all the same.
    """
    for partial in folder.glob("*.partial"):
        with suppress(OSError), locked(partial.with_suffix(".lock"), wait=False) as ours:
            if ours:
                partial.unlink()
    kept = _copies(folder)
    total, most = size + HEADER + sum(state.st_size for state, _ in kept), most_bytes()
    for state, names in kept:
        if total <= most:
            break
        total -= state.st_size
        for name in names:
            name.unlink(missing_ok=True)
    free = shutil.disk_usage(folder).free
    if free < size + HEADER:
        told = f"The volume takes {size / 1e9:.1f} GB in {folder}, where {free / 1e9:.1f} GB are free"
        raise VolumeError(f"{told}: make room, or name another folder by ISOGI_VOLUME_CACHE.")


def _copies(folder: Path) -> list[tuple[os.stat_result, list[Path]]]:
    """The copies with all of their names, those used longest ago first."""
    found: dict[int, tuple[os.stat_result, list[Path]]] = {}
    for path in (*folder.glob(f"*{SUFFIX}"), *folder.glob("*/*")):
        with suppress(FileNotFoundError):
            state = path.stat()
            found.setdefault(state.st_ino, (state, []))[1].append(path)
    return sorted(found.values(), key=lambda each: each[0].st_mtime)
