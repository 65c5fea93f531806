"""Results that are kept for the next time they are asked for."""

import threading
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Generic, Protocol, TypeVar

OVERHEAD = 4 << 10
"""Bytes that a result is counted with besides its own: without arrays it takes memory too."""


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
    """The place of a result: none or one ``value``, the ``lock`` to make it under, and how many are asking for it."""

    lock: threading.Lock = field(default_factory=threading.Lock)
    value: list[V] = field(default_factory=list)
    asking: int = 0

    @property
    def nbytes(self) -> int:
        """Bytes that it is counted with."""
        return OVERHEAD + sum(value.nbytes for value in self.value)


class Kept(Generic[K]):
    """The newest results of costly functions; two threads that want the same one make it once."""

    def __init__(self, most: int) -> None:
        """Keep at most ``most`` bytes, OVERHEAD for each result among them, the newest in any case."""
        self._most = most
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
        finally:
            self._leave(key, cell)
        if new:
            self._forget()
        return cell.value[0]

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

    def _forget(self) -> None:
        """Let go of the oldest results until the rest fits."""
        with self._lock:
            total = self._sum()
            while total > self._most and len(self._made) > 1:
                total -= self._made.popitem(last=False)[1].nbytes
