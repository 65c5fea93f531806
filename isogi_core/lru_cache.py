"""A cache of costly results that keeps the newest within a limit of bytes."""

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Generic, Protocol, TypeVar

OVERHEAD = 4 << 10
"""Bytes that a result is counted with besides its own: without arrays it takes memory too."""


NONE: Mapping[Any, int] = MappingProxyType({})


class Sized(Protocol):
    """What knows how much memory it takes."""

    @property
    def nbytes(self) -> int:
        """Bytes, at this moment."""
        ...


K = TypeVar("K")
V = TypeVar("V", bound=Sized)


@dataclass(eq=False)
class Cell(Generic[V]):
    """The place of a result: none or one ``value``, made under a ``lock``; and how many ask for it."""

    lock: threading.Lock = field(default_factory=threading.Lock)
    value: list[V] = field(default_factory=list)
    asking: int = 0

    @property
    def nbytes(self) -> int:
        """Bytes that it is counted with."""
        return OVERHEAD + sum(value.nbytes for value in self.value)


class LruCache(Generic[K]):
    """The newest results of costly functions; two threads that want the same one make it once."""

    def __init__(self, most: int, limits: Mapping[Any, int] = NONE) -> None:
        """Keep at most ``most`` bytes, OVERHEAD for each result among them, the newest in any case.

        ``limits`` are the bytes of results of some kinds: of keys that are tuples, the first entry is the kind.
        """
        self._most, self._limits = most, limits
        self._lock = threading.Lock()
        self._made: OrderedDict[K, Cell[Any]] = OrderedDict()

    def get(self, key: K, make: Callable[[], V]) -> V:
        """The result for ``key``, made by ``make`` when it is not kept.

        Raises what ``make`` raises; whoever waited for that result then makes it in turn.
        """
        with self._lock:
            cell: Cell[V] = self._made.setdefault(key, Cell())
            cell.asking += 1
            self._made.move_to_end(key)
        try:
            with cell.lock:
                new = not cell.value
                if new:
                    cell.value.append(make())
                value = cell.value[0]
        finally:
            self._leave(key, cell)
        if new:
            self._forget(key)
        return value

    def held(self, key: K) -> Any | None:
        """The result for ``key`` where it is kept; that makes it no newer."""
        with self._lock:
            cell = self._made.get(key)
            return cell.value[0] if cell is not None and cell.value else None

    def drop(self, key: K) -> None:
        """Let go of the result for ``key``, if it is kept."""
        with self._lock:
            self._made.pop(key, None)

    def make_room(self, size: int) -> None:
        """Let go of the oldest results until one of ``size`` bytes fits beside the rest: before it is made."""
        with self._lock:
            total = self._sum() + size
            for key in [key for key, cell in self._made.items() if cell.value]:
                if total <= self._most:
                    return
                total -= self._made.pop(key).nbytes

    def settle(self) -> None:
        """Let go of the oldest results until the rest fits: results may have grown."""
        with self._lock:
            self._shrink(list(self._made), self._most)

    def clear(self) -> None:
        """Keep nothing."""
        with self._lock:
            self._made.clear()

    @property
    def nbytes(self) -> int:
        """Bytes of all that is kept, OVERHEAD for each result among them."""
        with self._lock:
            return self._sum()

    def _sum(self) -> int:
        return sum(cell.nbytes for cell in self._made.values())

    def _leave(self, key: K, cell: Cell[Any]) -> None:
        """Stop asking for a result; the place of one that could not be made goes with the last that asks."""
        with self._lock:
            cell.asking -= 1
            if not cell.asking and not cell.value and self._made.get(key) is cell:
                del self._made[key]

    def _forget(self, newest: K) -> None:
        """Let go of the oldest results until the rest fits: those of the newest one's kind, and all together."""
        with self._lock:
            kind = kind_of(newest)
            if kind in self._limits:
                self._shrink([key for key in self._made if kind_of(key) == kind], self._limits[kind])
            self._shrink(list(self._made), self._most)

    def _shrink(self, keys: list[K], most: int) -> None:
        """Let go of results with these keys, the oldest first, until the rest of them fits; the last stays."""
        total = sum(self._made[key].nbytes for key in keys)
        for key in keys[:-1]:
            if total <= most:
                return
            total -= self._made.pop(key).nbytes


def kind_of(key: Hashable) -> Hashable:
    """The kind of result that a key is of: the first entry of a tuple."""
    return key[0] if isinstance(key, tuple) and key else None
