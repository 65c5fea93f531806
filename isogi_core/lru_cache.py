"""A cache of costly results that keeps the newest within a limit of bytes."""

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Generic, Protocol, TypeVar

OVERHEAD_BYTES = 4 << 10
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
    """The place of a result: none or one ``value``, made under a ``lock``; and how many ask for it.

    ``nbytes`` are those that it was counted with last.
    """

    lock: threading.Lock = field(default_factory=threading.Lock)
    value: list[V] = field(default_factory=list)
    asking: int = 0
    nbytes: int = 0


class LruCache(Generic[K]):
    """The newest results of costly functions; two threads that want the same one make it once.

    Results may grow. What they take is counted when they are made, whenever they are asked for, and
    in ``settle``.
    """

    def __init__(self, most: int, limits: Mapping[Any, int] = NONE) -> None:
        """Keep at most ``most`` bytes, OVERHEAD_BYTES for each result among them, the newest in any
        case.

        ``limits`` are the bytes of results of some kinds: of keys that are tuples, the first entry
        is the kind.
        """
        self._most = most
        self._limits = limits
        self._lock = threading.Lock()
        self._made: OrderedDict[K, Cell[Any]] = OrderedDict()
        self._total = 0
        self._kinds = dict.fromkeys(limits, 0)

    def get(self, key: K, make: Callable[[], V]) -> V:
        """The result for ``key``, made by ``make`` when it is not kept.

        Raises what ``make`` raises; whoever waited for that result then makes it in turn.
        """
        with self._lock:
            cell: Cell[V] = self._made.setdefault(key, Cell())
            cell.asking += 1
            self._made.move_to_end(key)
        new = False
        try:
            with cell.lock:
                if new := not cell.value:
                    cell.value.append(make())
                return cell.value[0]
        finally:
            self._leave(key, cell, new)

    def held(self, key: K) -> Any | None:
        """The result for ``key`` where it is kept; that makes it no newer."""
        with self._lock:
            cell = self._made.get(key)
            if cell is not None and cell.value:
                return cell.value[0]
            return None

    def drop(self, key: K) -> None:
        """Let go of the result for ``key``, if it is kept."""
        with self._lock:
            if key in self._made:
                self._pop(key)

    def make_room(self, size: int) -> None:
        """Let go of the oldest results until one of ``size`` bytes fits beside the rest: before it
        is made.
        """
        with self._lock:
            self._count_all()
            for key in [key for key, cell in self._made.items() if cell.value]:
                if self._total + size <= self._most:
                    return
                self._pop(key)

    def settle(self) -> None:
        """Let go of the oldest results until the rest fits: results may have grown."""
        with self._lock:
            self._count_all()
            self._forget()

    def clear(self) -> None:
        """Keep nothing."""
        with self._lock:
            self._made.clear()
            self._kinds = dict.fromkeys(self._limits, 0)
            self._total = 0

    @property
    def nbytes(self) -> int:
        """Bytes of all that is kept, as it was counted last, OVERHEAD_BYTES for each result among
        them.
        """
        return self._total

    def _leave(self, key: K, cell: Cell[Any], new: bool) -> None:
        """Stop asking for a result, and count it; the place of one that could not be made goes with
        the last that asks.

        A ``new`` one makes room for itself.
        """
        with self._lock:
            cell.asking -= 1
            if self._made.get(key) is not cell:
                return
            if not cell.value:
                if not cell.asking:
                    self._pop(key)
                return
            self._count(key, cell)
            if new:
                self._forget(result_kind(key))

    def _count(self, key: K, cell: Cell[Any]) -> None:
        """Count a result with what it takes now."""
        now = OVERHEAD_BYTES + cell.value[0].nbytes
        self._add(key, now - cell.nbytes)
        cell.nbytes = now

    def _count_all(self) -> None:
        for key, cell in self._made.items():
            if cell.value:
                self._count(key, cell)

    def _add(self, key: K, size: int) -> None:
        self._total += size
        if (kind := result_kind(key)) in self._kinds:
            self._kinds[kind] += size

    def _pop(self, key: K) -> None:
        """Let go of a result."""
        self._add(key, -self._made.pop(key).nbytes)

    def _forget(self, newest: Hashable = None) -> None:
        """Let go of the oldest results until the rest fits: those of the ``newest`` one's kind, and
        all together.

        The last stays.
        """
        if newest in self._kinds and self._kinds[newest] > self._limits[newest]:
            for key in [key for key in self._made if result_kind(key) == newest][:-1]:
                if self._kinds[newest] <= self._limits[newest]:
                    break
                self._pop(key)
        while self._total > self._most and len(self._made) > 1:
            self._pop(next(iter(self._made)))


def result_kind(key: Hashable) -> Hashable:
    """The kind of result that a key is of: the first entry of a tuple."""
    if isinstance(key, tuple) and key:
        return key[0]
    return None
