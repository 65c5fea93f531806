"""Calls to a store, counted by what they do: how many, the time they took, and how many failed."""

import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager

from isogi_core.errors import ChangedError
from isogi_core.storage.backend import Backend, Entry, StoredObject


class Calls:
    """Counts of calls by kind: ``get``, ``put``, ``delete``, ``move`` and ``list``. Any thread may
    use it.
    """

    def __init__(self) -> None:
        """None yet."""
        self.count: Counter[str] = Counter()
        self.failed: Counter[str] = Counter()
        self.seconds: Counter[str] = Counter()
        self._lock = threading.Lock()

    @contextmanager
    def counting(self, kind: str) -> Iterator[None]:
        """Count the block as a call of a ``kind``, failed if it raises.

        One that finds that somebody else has written is none that failed.
        """
        begun = time.perf_counter()
        failed = 0
        try:
            yield
        except ChangedError:
            raise
        except Exception:
            failed = 1
            raise
        finally:
            seconds = time.perf_counter() - begun
            with self._lock:
                self.count[kind] += 1
                self.failed[kind] += failed
                self.seconds[kind] += seconds  # type: ignore[assignment]


class CountedBackend:
    """A ``backend`` whose ``calls`` are counted."""

    def __init__(self, backend: Backend, calls: Calls) -> None:
        """Pass all calls on to a backend."""
        self._backend = backend
        self._calls = calls

    def get(self, key: str, known: StoredObject | None = None) -> StoredObject | None:
        """See ``Backend``."""
        with self._calls.counting("get"):
            return self._backend.get(key, known)

    def put(self, key: str, data: bytes, former: StoredObject | None) -> None:
        """See ``Backend``."""
        with self._calls.counting("put"):
            self._backend.put(key, data, former)

    def create_sentinel(self, data: bytes) -> None:
        """See ``Backend``."""
        with self._calls.counting("put"):
            self._backend.create_sentinel(data)

    def check_writable(self, data: bytes) -> None:
        """See ``Backend``."""
        with self._calls.counting("put"):
            self._backend.check_writable(data)

    def delete(self, key: str) -> None:
        """See ``Backend``."""
        with self._calls.counting("delete"):
            self._backend.delete(key)

    def move(self, key: str, to: str) -> None:
        """See ``Backend``."""
        with self._calls.counting("move"):
            self._backend.move(key, to)

    def entries(self) -> Iterator[Entry]:
        """See ``Backend``."""
        with self._calls.counting("list"):
            yield from self._backend.entries()

    def folders(self, folder: str) -> list[str]:
        """See ``Backend``."""
        with self._calls.counting("list"):
            return self._backend.folders(folder)

    def keys(self, folder: str) -> Iterator[str]:
        """See ``Backend``."""
        with self._calls.counting("list"):
            yield from self._backend.keys(folder)
