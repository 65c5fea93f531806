"""A cache of costly results that keeps the newest within a limit of bytes."""

import threading
from collections import OrderedDict
from collections.abc import Callable, Collection, Hashable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Generic, Protocol, TypeVar

OVERHEAD_BYTES = 4 << 10
"""Bytes that are added for each result: objects without arrays take memory too.

A G-buffer without points, with its view as key, takes 3.0 kB (``tracemalloc``, CPython 3.11), of
which the key is 1.1 kB and the place in the cache 0.5 kB; this is the next power of two.
"""


NONE: Mapping[Any, int] = MappingProxyType({})
"""The limits of a cache that has none for single kinds."""


class Sized(Protocol):
    """An object that knows how much memory it takes."""

    @property
    def nbytes(self) -> int:
        """Bytes at this moment."""
        ...


K = TypeVar("K")
V = TypeVar("V", bound=Sized)


@dataclass(eq=False)
class Cell(Generic[V]):
    """The place of a result: ``value`` has at most one entry, made under a ``lock``; ``asking``
    counts the threads that ask for it.

    ``nbytes`` is the size with which it was last counted.
    """

    lock: threading.Lock = field(default_factory=threading.Lock)
    value: list[V] = field(default_factory=list)
    asking: int = 0
    nbytes: int = 0


class LruCache(Generic[K]):
    """The newest results of costly functions; two threads that ask for the same result make it
    once.

    Results may grow. Their sizes are counted when they are made, whenever they are asked for, and
    in ``settle``.
    """

    def __init__(
        self, most: int, limits: Mapping[Any, int] = NONE, lasting: Collection[Any] = ()
    ) -> None:
        """Keep at most ``most`` bytes, with OVERHEAD_BYTES for each result, but always the newest
        result.

        ``limits`` are the most bytes of results of some kinds; the kind of a key that is a tuple is
        its first entry. Of each kind that is ``lasting``, other results never drive out the newest:
        work that grows in steps would begin again at each of them.
        """
        self._most = most
        self._limits = limits
        self._lasting = lasting
        self._lock = threading.Lock()
        self._made: OrderedDict[K, Cell[Any]] = OrderedDict()
        self._total = 0
        self._kinds = dict.fromkeys(limits, 0)

    def get(self, key: K, make: Callable[[], V]) -> V:
        """Return the result for ``key``; ``make`` makes it if it is not kept.

        Raises the errors of ``make``; other threads that waited for the result then try to make it
        in turn.
        """
        # Take or add the cell of this key, and mark it as the newest.
        with self._lock:
            cell: Cell[V] = self._made.setdefault(key, Cell())
            cell.asking += 1
            self._made.move_to_end(key)
        # Only this cell is locked while the result is made: other keys need not wait.
        new = False
        try:
            with cell.lock:
                if new := not cell.value:
                    cell.value.append(make())
                return cell.value[0]
        finally:
            self._leave(key, cell, new)

    def held(self, key: K) -> Any | None:
        """Return the result for ``key`` if it is kept, else None; this does not make it newer."""
        with self._lock:
            cell = self._made.get(key)
            if cell is not None and cell.value:
                return cell.value[0]
            return None

    def drop(self, key: K) -> None:
        """Drop the result for ``key``, if it is kept."""
        with self._lock:
            if key in self._made:
                self._pop(key)

    def make_room(self, size: int) -> None:
        """Drop the oldest results until one of ``size`` bytes, which is not made yet, fits next
        to the rest.
        """
        with self._lock:
            self._count_all()
            for key in [key for key, cell in self._made.items() if cell.value]:
                if self._total + size <= self._most:
                    return
                self._pop(key)

    def settle(self) -> None:
        """Count all results, which may have grown, and drop the oldest until the rest fits."""
        with self._lock:
            self._count_all()
            self._forget()

    def clear(self) -> None:
        """Drop all results."""
        with self._lock:
            self._made.clear()
            self._kinds = dict.fromkeys(self._limits, 0)
            self._total = 0

    @property
    def most(self) -> int:
        """The limit of the bytes that are kept."""
        return self._most

    @property
    def nbytes(self) -> int:
        """Bytes of all that is kept, as last counted, with OVERHEAD_BYTES for each result."""
        return self._total

    def _leave(self, key: K, cell: Cell[Any], new: bool) -> None:
        """Stop asking for a result, and count it. If it is ``new``, older ones make room for it.

        The cell of a result that could not be made is removed with the last thread that asks for
        it.
        """
        with self._lock:
            cell.asking -= 1
            # The cell was dropped meanwhile.
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
        """Count a result with its present size."""
        now = OVERHEAD_BYTES + cell.value[0].nbytes
        self._add(key, now - cell.nbytes)
        cell.nbytes = now

    def _count_all(self) -> None:
        """Count all results with their present sizes."""
        for key, cell in self._made.items():
            if cell.value:
                self._count(key, cell)

    def _add(self, key: K, size: int) -> None:
        """Add ``size`` bytes to the total, and to the kind of a key."""
        self._total += size
        if (kind := result_kind(key)) in self._kinds:
            self._kinds[kind] += size

    def _pop(self, key: K) -> None:
        """Drop a result."""
        self._add(key, -self._made.pop(key).nbytes)

    def _forget(self, newest: Hashable = None) -> None:
        """Drop the oldest results until the rest fits: first those of the kind of the
        ``newest``, then any. The last of each stays.
        """
        # The kind's limit first: drop its oldest results, but not the last.
        if newest in self._kinds and self._kinds[newest] > self._limits[newest]:
            for key in [key for key in self._made if result_kind(key) == newest][:-1]:
                if self._kinds[newest] <= self._limits[newest]:
                    break
                self._pop(key)
        # Then the limit of all results: the newest one stays, and the newest of each kind that
        # lasts.
        if self._total <= self._most:
            return
        staying = {kind: key for key in self._made if (kind := result_kind(key)) in self._lasting}
        for key in list(self._made)[:-1]:
            if self._total <= self._most:
                break
            if staying.get(result_kind(key)) != key:
                self._pop(key)


def result_kind(key: Hashable) -> Hashable:
    """Return the kind of result that a key belongs to: the first entry of a tuple, else None."""
    if isinstance(key, tuple) and key:
        return key[0]
    return None
