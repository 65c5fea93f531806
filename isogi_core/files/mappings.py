"""Files that are mapped into memory, and the budget that decides which files are.

The system may take back pages of mapped files: they count as memory of a process until others need
it.
"""

import mmap
import os
import sys
import tempfile
from pathlib import Path
from typing import IO, Any

import numpy as np

from isogi_core.errors import VolumeError

DEFAULT_BUDGET_MB = 2048
"""Megabytes of voxels that a process has room for, unless ``ISOGI_VOLUME_MB`` says otherwise."""

UNMAPPED_SHARE = 1 / 8
"""Share of the budget up to which a volume's voxels are in each process's own memory, and not
mapped.
"""

NO_RESERVE = getattr(mmap, "MAP_NORESERVE", 0x4000 if sys.platform == "linux" else 0)
"""Flag against reserving memory: a private mapping takes none unless it is written to, which
nothing does.
"""


def budget() -> int:
    """Return the most bytes of voxels in memory. Raises VolumeError if the environment variable is
    no such number.
    """
    given = os.environ.get("ISOGI_VOLUME_MB") or str(DEFAULT_BUDGET_MB)
    if not given.isdecimal() or not int(given):
        raise VolumeError(
            f"ISOGI_VOLUME_MB is '{given}': give a whole number of megabytes, from 1 on."
        )
    return int(given) << 20


def require_memory(size: int, what: str, otherwise: str) -> None:
    """Raise VolumeError if ``size`` bytes are more than the budget. Its message says ``what`` takes
    them, and ``otherwise`` advises.
    """
    if size > budget():
        raise VolumeError(
            f"{what} {size / 1e6:.0f} MB of memory: {otherwise}, or give more by ISOGI_VOLUME_MB."
        )


def map_file(file: IO[bytes], offset: int) -> np.ndarray:
    """Map the content of a file from a byte on, float32. Writing to the array would take memory of
    this process.
    """
    flags = mmap.MAP_PRIVATE | NO_RESERVE
    access = mmap.PROT_READ | mmap.PROT_WRITE
    mapping = mmap.mmap(file.fileno(), 0, flags=flags, prot=access)
    return np.frombuffer(mapping, np.float32, offset=offset)


def scratch(folder: Path, count: int, dtype: Any) -> np.ndarray:
    """Return an array of ``count`` numbers, of any values, in a file that has no name; in memory if
    the disk is full.
    """
    size = count * np.dtype(dtype).itemsize
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as file:
            os.posix_fallocate(file.fileno(), 0, size)
            mapping = mmap.mmap(file.fileno(), size)
    except (OSError, ValueError, AttributeError):  # a full disk; no bytes; another system
        return np.empty(count, dtype)
    return np.frombuffer(mapping, dtype)
