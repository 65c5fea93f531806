"""What errors of files and of object stores mean for light: away, full, or only to be read."""

import errno

from isogi_core.cache.place import Place
from isogi_core.errors import StoreAwayError, StoreFullError, StoreReadOnlyError

FULL = (errno.ENOSPC, errno.EDQUOT)
CLOSED = (errno.EACCES, errno.EPERM, errno.EROFS)

WRITING = ("write", "make", "delete")
"""What is tried where a refusal means that the store can only be read."""


def told(what: str, place: Place, error: Exception) -> StoreAwayError:
    """What an ``error`` of a shelf means, as a sentence: ``what`` could not be done, such as "write a/b to"."""
    number = error.errno if isinstance(error, OSError) else None
    said = f"Cannot {what} the store at {place}: {one_line(error)}"
    if number in FULL:
        return StoreFullError(f"{said}; the store is full: make room, and baking goes on.")
    if number in CLOSED and what.startswith(WRITING):
        return StoreReadOnlyError(f"{said}; what is there is served, and nothing more is baked.")
    return StoreAwayError(f"{said}.")


def one_line(error: Exception) -> str:
    """What an error of somebody else's says, on one line, without a full stop and without an errno."""
    said = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return " ".join(said.split()).rstrip(".") or type(error).__name__
