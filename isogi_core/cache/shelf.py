"""Shelves: what every kind of store can do with objects by their keys. They raise what their libraries raise."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol


@dataclass(frozen=True)
class Found:
    """The bytes of an object, and the ``tag`` that its store knows this very content by, where it has such."""

    data: bytes
    tag: str = field(default="", compare=False)


class Entry(NamedTuple):
    """An object as a list has it: its key, its bytes, and when it was written by the store's calendar; NaN if unknown.

    Ages serve people and tidying alone, and never who owns what.
    """

    key: str
    size: int
    written: float

    def age(self, now: float) -> float:
        """Seconds since it was written."""
        return now - self.written


class Shelf(Protocol):
    """Objects by keys such as ``a/b``. OSError with an errno tells what is wrong where that is known."""

    def get(self, key: str, known: Found | None = None) -> Found | None:
        """The object, or None where there is none; ``known`` itself where the store says that it still stands."""
        ...

    def put(self, key: str, data: bytes, former: Found | None) -> None:
        """Write an object in place of the ``former``; ChangedError where another stands there, if that can be told."""
        ...

    def found(self, data: bytes) -> None:
        """Write the sentinel; ChangedError where there is one."""
        ...

    def delete(self, key: str) -> None:
        """Delete an object, if it is there."""
        ...

    def names(self, folder: str) -> list[str]:
        """Names of the folders right under ``folder``, which is empty for the root."""
        ...

    def keys(self, folder: str) -> Iterator[str]:
        """Keys of all objects under ``folder``."""
        ...

    def entries(self) -> Iterator[Entry]:
        """All objects, and what is half written."""
        ...

    def move(self, key: str, to: str) -> None:
        """Have an object, if it is there, under another key."""
        ...

    def prove(self, data: bytes) -> None:
        """Raise what writing would; ``data`` is what the sentinel holds. Nothing is changed."""
        ...
