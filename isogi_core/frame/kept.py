"""Results that are kept for the next frames."""

import threading
from collections import OrderedDict
from collections.abc import Callable
from typing import Generic, TypeVar

K = TypeVar("K")
V = TypeVar("V")


class Kept(Generic[K, V]):
    """The newest few results of a costly function; two threads that want the same one make it once."""

    def __init__(self, most: int) -> None:
        """Keep at most ``most`` results."""
        self._most = most
        self._lock = threading.Lock()
        self._made: OrderedDict[K, tuple[threading.Lock, list[V]]] = OrderedDict()

    def get(self, key: K, make: Callable[[], V]) -> V:
        """The result for ``key``, made by ``make`` when it is not kept."""
        with self._lock:
            lock, cell = self._made.setdefault(key, (threading.Lock(), []))
            self._made.move_to_end(key)
            while len(self._made) > self._most:
                self._made.popitem(last=False)
        with lock:
            if not cell:
                cell.append(make())
        return cell[0]

    def clear(self) -> None:
        """Keep nothing."""
        with self._lock:
            self._made.clear()
