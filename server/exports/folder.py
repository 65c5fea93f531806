"""Exported files that a server keeps on its disk, within a quota, while the jobs that made them are known."""

import asyncio
import shutil
import tempfile
from collections.abc import Container
from contextlib import suppress
from pathlib import Path

from isogi_core.storage.atomic_file import PARTIAL_SUFFIX
from server.errors import FullError, UnknownResultError

TOO_LARGE = (
    "This export takes about {needed:,} MB, and this server keeps {quota:,} MB of exports (exports_mb): ask its"
    " operator for more, or use isogi export."
)
FILE_GONE = "The file of the job '{job}' is not there: it is not made yet, or gave way to newer ones; export it again."
MEGABYTE = 1 << 20


class ExportFolder:
    """A temporary folder of at most ``quota`` bytes, with a folder for each job. ``turn`` is held to make a file."""

    def __init__(self, quota: int) -> None:
        """Make no folder yet; without a quota there are no exports."""
        self.quota = quota
        self.turn = asyncio.Lock()
        self._folder: Path | None = None

    def check(self, needed: int) -> None:
        """Raise FullError where a file of about so many bytes never fits."""
        if needed > self.quota:
            sizes = {"needed": -(-needed // MEGABYTE), "quota": self.quota // MEGABYTE}
            raise FullError(TOO_LARGE.format(**sizes))

    def place(self, job: str, name: str) -> Path:
        """Where the file of a job is to be made, under the name that it is fetched by."""
        if self._folder is None:
            self._folder = Path(tempfile.mkdtemp(prefix="isogi-exports-"))
        (self._folder / job).mkdir(exist_ok=True)
        return self._folder / job / name

    def find(self, job: str) -> Path:
        """The file of a job. Raises UnknownResultError where there is none."""
        files = self._folder.glob(f"{job}/*") if self._folder else iter(())
        found = next((path for path in files if path.suffix != PARTIAL_SUFFIX), None)
        if found is None:
            raise UnknownResultError(FILE_GONE.format(job=job))
        return found

    def make_room(self, known: Container[str], needed: int) -> None:
        """Delete the files of jobs that are not ``known`` any more, and the oldest until so many bytes are free."""
        if self._folder is None:
            return
        aged = sorted(self._folder.iterdir(), key=lambda path: (path.name in known, path.stat().st_mtime))
        sizes = {path: sum(file.stat().st_size for file in path.iterdir()) for path in aged}
        total = sum(sizes.values())
        for path, size in sizes.items():
            if total + needed > self.quota or path.name not in known:
                total -= size
                shutil.rmtree(path)

    def close(self) -> None:
        """Delete all of it."""
        if self._folder is not None:
            with suppress(OSError):
                shutil.rmtree(self._folder)
