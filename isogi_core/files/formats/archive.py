"""Archives: ZIP files of several files, as the slices of a series, or a header and its data."""

import io
import weakref
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from isogi_core.errors import VolumeError

MAX_MEMBERS = 8192
"""Files that an archive may hold."""

MEMBER_HEADER_BYTES = 1 << 16
"""Bytes that a file of an archive may have besides its voxels, on the average."""

VOXEL_BYTES = 8
"""Bytes that a voxel may take in a file."""

MEMORY_BYTES = 1 << 26
"""Bytes of a file that is read into memory as a whole, so that a reader may jump in it."""

NO_VOLUMES = ("__MACOSX", "DICOMDIR", "Thumbs.db", "desktop.ini")
"""Names that systems leave in archives and folders, which hold nothing to show."""


class Archive:
    """The files of a ZIP ``file``, which stays open, and is closed with this if it was opened by
    its ``path``; ``name`` is for messages. They may unpack to as many bytes as ``voxels`` voxels
    take. Raises VolumeError.
    """

    def __init__(self, file: IO[bytes], name: str, voxels: int, path: Path | None = None) -> None:
        """Read its list of files alone."""
        if path is not None:
            weakref.finalize(self, file.close)
        self.path = path
        self._name = name
        self._zip = zipfile.ZipFile(file)
        self._members = {
            Path(each.filename): each for each in self._zip.infolist() if _may_show(each)
        }
        if len(self._members) > MAX_MEMBERS:
            raise VolumeError(
                f"'{name}' holds {len(self._members)} files, and {MAX_MEMBERS} are the most that "
                "may be: save it as one file."
            )
        size = sum(each.file_size for each in self._members.values())
        most = VOXEL_BYTES * voxels + MEMBER_HEADER_BYTES * len(self._members)
        if size > most:
            raise VolumeError(
                f"'{name}' unpacks to {size} bytes, and {most} are the most that may be: save a "
                "smaller part."
            )

    @property
    def paths(self) -> list[Path]:
        """The paths of its files, in their order."""
        return sorted(self._members)

    @contextmanager
    def opened(self, path: Path) -> Iterator[IO[bytes]]:
        """Yield one of its files, at its beginning. Raises VolumeError if there is none."""
        member = self._members.get(path)
        if member is None:
            raise VolumeError(f"There is no file '{path}' in '{self._name}': add it.")
        with self._zip.open(member) as file:
            if member.file_size <= MEMORY_BYTES:
                yield io.BytesIO(file.read())
            else:
                yield file


def _may_show(member: zipfile.ZipInfo) -> bool:
    """Return True for a file that may be a volume: no folder, and no file that a system
    left there.
    """
    parts = Path(member.filename).parts
    return not member.is_dir() and not any(
        part.startswith(".") or part in NO_VOLUMES for part in parts
    )
