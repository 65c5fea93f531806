"""Files that people name: opened where they are regular, as a device or a pipe would be read for ever."""

import errno
import os
import stat
from pathlib import Path
from typing import IO, Any

NO_FILE = "it is a device, a pipe or a socket, and no file"


def open_regular(path: Path) -> IO[bytes]:
    """A regular file, open for reading. Raises OSError: for all else, and for names that no system can hold, too."""
    try:
        mode = path.stat().st_mode
    except ValueError as error:
        raise OSError(errno.EINVAL, str(error)) from error
    if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
        raise OSError(errno.EINVAL, NO_FILE)
    return path.open("rb")


def read_small(path: Path, most: int) -> bytes:
    """What a regular file holds. Raises OSError as ``open_regular`` does, and where it has more than ``most`` bytes."""
    with open_regular(path) as file:
        data = file.read(most + 1)
    if len(data) > most:
        raise OSError(errno.EFBIG, f"it has more than {most} bytes")
    return data


MAX_REPEATED_CHARACTERS = 60
"""Characters of a value that messages repeat."""


def in_short(value: Any) -> str:
    """A value as a message repeats it, cut short; also a number of more digits than Python writes."""
    try:
        text = repr(value)
    except (ValueError, RecursionError):
        return "a number of many digits, or lists in lists"
    return text if len(text) <= MAX_REPEATED_CHARACTERS else f"{text[:MAX_REPEATED_CHARACTERS]}…"


def reason_of(error: OSError) -> str:
    """What the system, or this module, says of a file that cannot be read."""
    return error.strerror or os.strerror(error.errno or errno.EIO)
