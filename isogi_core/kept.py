"""Results that are kept for the next time they are asked for."""

import threading
from collections import OrderedDict
from collections.abc import Callable
from typing import Generic, Protocol, TypeVar


class Sized(Protocol):
    """What knows how much memory it takes."""

    @property
    def nbytes(self) -> int:
        """Bytes, at this moment."""
        ...


K = TypeVar("K")
V = TypeVar("V", bound=Sized)


class Kept(Generic[K, V]):
    """The newest results of a costly function; two threads that want the same one make it once."""

    def __init__(self, most: int) -> None:
        """Keep at most ``most`` bytes, the newest result in any case."""
        self._most = most
        self._lock = threading.Lock()
        self._made: OrderedDict[K, tuple[threading.Lock, list[V]]] = OrderedDict()

    def get(self, key: K, make: Callable[[], V]) -> V:
        """The result for ``key``, made by ``make`` when it is not kept."""
        with self._lock:
            lock, cell = self._made.setdefault(key, (threading.Lock(), []))
            self._made.move_to_end(key)
        with lock:
            new = not cell
            if new:
                cell.append(make())
        if new:
            self._forget()
        return cell[0]

    def clear(self) -> None:
        """Keep nothing."""
        with self._lock:
            self._made.clear()

    @property
    def nbytes(self) -> int:
        """Bytes of all that is kept."""
        return sum(value.nbytes for _, cell in self._made.values() for value in cell)

    def _forget(self) -> None:
        """Let go of the oldest results until the rest fits."""
        with self._lock:
            while self.nbytes > self._most and len(self._made) > 1:
                self._made.popitem(last=False)
