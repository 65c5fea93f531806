"""Every error that the domain raises on purpose. Each speaks to a person in one sentence."""

from difflib import get_close_matches
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable


def advice(word: str, known: "Iterable[str]") -> str:
    """End a sentence about an unknown word: by the known word that it resembles, else by all of
    them.
    """
    names = list(known)
    close = get_close_matches(word, names, 1)
    if close:
        return f"did you mean '{close[0]}'?"
    if names:
        return f"choose from {', '.join(names)}."
    return "leave it out."


def readable(name: object) -> str:
    r"""The ``name`` of a file as text of valid Unicode: a byte that is not UTF-8, as the system may
    have in a name, becomes ``\xf6``.
    """
    text = str(name)
    try:
        return text.encode("utf-8", "surrogateescape").decode("utf-8", "backslashreplace")
    except UnicodeEncodeError:  # half a pair of UTF-16, which no name of a file has
        return text.encode("utf-8", "backslashreplace").decode()


class IsogiError(Exception):
    """Base of all errors that say what is wrong, where, and what to do about it."""

    def __str__(self) -> str:
        """The sentence, in which names of files are readable."""
        return readable(super().__str__())


class VolumeError(IsogiError):
    """A volume is missing, damaged, lying about itself, or of a kind that cannot be rendered."""


class LightError(IsogiError):
    """A light is missing, damaged or has no meaning (negative, not finite, no pixels)."""


class SceneError(IsogiError):
    """A scene file does not parse, or one of its settings has no meaning."""


class ViewError(IsogiError):
    """A view (isovalue, camera, light rotation, size) is outside what the scene allows."""


class UnwritableError(IsogiError):
    """A file that work is to end in cannot be written."""


class StoreError(IsogiError):
    """The cache's store cannot be read or written, or holds another scene's light."""


class NoRoomError(StoreError):
    """The light of a view does not fit the memory that it may take."""


class StoreAwayError(StoreError):
    """The store cannot be used at the moment; what is asked of it later may come. Nothing that it
    keeps is lost.
    """


class StoreFullError(StoreAwayError):
    """The store has no room for more light; what it keeps can be read."""


class StoreReadOnlyError(StoreAwayError):
    """The store can only be read."""


class StoreUrlError(StoreError):
    """The name of a store holds what is secret."""


class ChangedError(StoreError):
    """Somebody else has written an object meanwhile: read it again."""


class DamagedChunkError(StoreError):
    """A chunk's bytes are not what was written: cut, flipped, or another scene's."""


class SharedMemoryError(IsogiError):
    """What another process shared is gone."""


class ReportError(IsogiError):
    """What a report needs (a reference, data of a former run) is damaged, or of something else."""


class Cancelled(IsogiError):
    """Nobody waits for this frame any more; work on it stopped between two tiles."""
