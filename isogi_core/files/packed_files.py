"""Files as they are on the disk: their content, also packed by gzip or bzip2, their ends, and their
state.
"""

import bz2
import errno
import gzip
import hashlib
import os
import stat
import zlib
from collections.abc import Iterable
from pathlib import Path
from typing import IO, Any

GZIP_MAGIC = b"\x1f\x8b"
BZIP2_MAGIC = b"BZh"

READ_BYTES = 1 << 24
"""Most bytes that are read at once."""

Content = IO[bytes] | gzip.GzipFile | bz2.BZ2File

PACKING_DAMAGE = (OSError, EOFError, zlib.error)
"""Errors that a packed file raises if it is damaged."""

CUT_SHORT_NOTE = (
    "The gzip file ends before its checksum: its voxels are all there, but "
    "nothing says that they are right."
)


def content_of(file: IO[bytes]) -> Content:
    """Return the content of a ``file`` at its beginning. If it begins as gzip or bzip2, it is
    unpacked while it is read.
    """
    head = file.read(len(BZIP2_MAGIC))
    file.seek(0)
    if head.startswith(GZIP_MAGIC):
        return gzip.GzipFile(fileobj=file)
    if head == BZIP2_MAGIC:
        return bz2.BZ2File(file)
    return file


def read_end(content: Content) -> int:
    """Return the number of bytes after those that were read: none or one.

    A checksum at the end is compared. If gzip's is missing, this is passed over: ``cut_notes``
    reports it. Raises one of PACKING_DAMAGE.
    """
    try:
        return len(content.read(1))
    except EOFError:
        if isinstance(content, gzip.GzipFile):
            return 0
        raise


def cut_notes(file: IO[bytes], size: int) -> tuple[str, ...]:
    """Return the note CUT_SHORT_NOTE for a gzip ``file`` that begins here, whose content of
    ``size`` bytes is whole, but whose checksum is not.

    A gzip file ends with the size of its content. If it does not, it is unpacked up to that size,
    and no further.
    """
    start = file.tell()
    packed = file.read(2) == GZIP_MAGIC
    try:
        file.seek(-4, 2)
        said = int.from_bytes(file.read(4), "little")
        file.seek(start)
        if packed and said != size % (1 << 32) and _is_cut(file, size):
            return (CUT_SHORT_NOTE,)
        return ()
    except OSError:  # shorter than four bytes
        return ()
    finally:
        file.seek(start)


def _is_cut(file: IO[bytes], size: int) -> bool:
    """Return True if a gzip file's content has ``size`` bytes, and then the file ends too early."""
    content = gzip.GzipFile(fileobj=file)
    left = size
    try:
        while left > 0 and (block := content.read(min(left, READ_BYTES))):
            left -= len(block)
        content.read(1)
    except EOFError:
        return left <= 0
    except PACKING_DAMAGE:
        return False
    return False


NO_FILE = "it is a device, a pipe or a socket, and no file"


def open_regular(path: Path) -> IO[bytes]:
    """Open a regular file for reading. Raises OSError, also for all that is no file, and for names
    that no system can hold.
    """
    try:
        mode = path.stat().st_mode
    except ValueError as error:
        raise OSError(errno.EINVAL, str(error)) from error
    if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
        raise OSError(errno.EINVAL, NO_FILE)
    return path.open("rb")


def read_small(path: Path, most: int) -> bytes:
    """Return the content of a regular file. Raises OSError as ``open_regular`` does, and if it has
    more than ``most`` bytes.
    """
    with open_regular(path) as file:
        data = file.read(most + 1)
    if len(data) > most:
        raise OSError(errno.EFBIG, f"it has more than {most} bytes")
    return data


MAX_REPEATED_CHARACTERS = 60
"""Characters of a value that messages repeat."""


def in_short(value: Any) -> str:
    """Return a value as a message repeats it, cut short; also a number of more digits than Python
    writes.
    """
    try:
        text = repr(value)
    except (ValueError, RecursionError):
        return "a number of many digits, or lists in lists"
    if len(text) <= MAX_REPEATED_CHARACTERS:
        return text
    return f"{text[:MAX_REPEATED_CHARACTERS]}…"


def reason_of(error: OSError) -> str:
    """Return the reason why a file cannot be read, as the system or this module states it."""
    return error.strerror or os.strerror(error.errno or errno.EIO)


def line_of(error: BaseException) -> str:
    """Return an error's type and message, on one short line."""
    message = " ".join(str(error).split())
    if message:
        return f"{type(error).__name__}: {message[:200]}"
    return type(error).__name__


def stamp_of(files: Iterable[Path]) -> str:
    """Return a digest (hex) of the ``files``' names, sizes and times of change. Raises OSError if
    one is missing.
    """
    digest = hashlib.blake2b(digest_size=16)
    for path in files:
        state = path.stat()
        digest.update(f"{path} {state.st_size} {state.st_mtime_ns} {state.st_ctime_ns}\0".encode())
    return digest.hexdigest()
