"""All errors that the domain raises on purpose. The message of each is one sentence for a
person.
"""

from difflib import get_close_matches
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable


def advice(word: str, known: "Iterable[str]") -> str:
    """Return the end of a sentence about an unknown ``word``: the known word that it resembles,
    else all of them.
    """
    names = list(known)
    close = get_close_matches(word, names, 1)
    if close:
        return f"did you mean '{close[0]}'?"
    if names:
        return f"choose from {', '.join(names)}."
    return "leave it out."


def readable(name: object) -> str:
    r"""Return the ``name`` of a file as text of valid Unicode: a byte that is not UTF-8, which
    names of files may hold, becomes ``\xf6``.
    """
    text = str(name)
    try:
        return text.encode("utf-8", "surrogateescape").decode("utf-8", "backslashreplace")
    except UnicodeEncodeError:  # half a pair of UTF-16, which no name of a file has
        return text.encode("utf-8", "backslashreplace").decode()


class IsogiError(Exception):
    """Base of all errors. Its message says what is wrong, where, and what to do about it."""

    def __str__(self) -> str:
        """Return the sentence, in which names of files are readable."""
        return readable(super().__str__())


class VolumeError(IsogiError):
    """A volume is missing, damaged, contradicts itself, or is of a kind that cannot be rendered."""


class LightError(IsogiError):
    """A light is missing, damaged or has no meaning (negative, not finite, no pixels)."""


class SceneError(IsogiError):
    """A scene file does not parse, or one of its settings has no meaning."""


class ViewError(IsogiError):
    """A view (isovalue, camera, light rotation, size) is outside what the scene allows."""


class UnwritableError(IsogiError):
    """The file for the result of some work cannot be written."""


class StoreError(IsogiError):
    """The cache's store cannot be read or written, or holds another scene's light."""


class NoRoomError(StoreError):
    """The light of a view does not fit the memory that it may take."""


class StoreAwayError(StoreError):
    """The store cannot be used at the moment; later requests may succeed. Nothing that it keeps
    is lost.
    """


class StoreFullError(StoreAwayError):
    """The store has no room for more light; what it keeps can be read."""


class StoreReadOnlyError(StoreAwayError):
    """The store can only be read."""


class StoreUrlError(StoreError):
    """The URL of a store contains a secret."""


class ChangedError(StoreError):
    """Another process has written an object in the meantime: read it again."""


class DamagedChunkError(StoreError):
    """A chunk's bytes are not what was written: cut, flipped, or another scene's."""


class SharedMemoryError(IsogiError):
    """Data that another process shared is gone."""


class ReportError(IsogiError):
    """Data that a report needs (a reference, results of a former run) is damaged, or belongs to
    another scene or view.
    """


class Cancelled(IsogiError):
    """Nobody waits for this frame any longer; work on it stopped between two tiles."""
