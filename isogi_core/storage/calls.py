"""Statistics of the calls to a store by kind: their number, their time, and how many failed."""

import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager

from isogi_core.errors import ChangedError
from isogi_core.storage.backend import Backend, Entry, StoredObject


class Calls:
    """Statistics of calls by kind: ``get``, ``put``, ``delete``, ``move`` and ``list``.

    ``seconds`` is the sum of their times. Safe to use from many threads.
    """

    def __init__(self) -> None:
        """Begin at zero."""
        self.count: Counter[str] = Counter()
        self.failed: Counter[str] = Counter()
        self.seconds: Counter[str] = Counter()
        self._lock = threading.Lock()

    @contextmanager
    def counting(self, kind: str) -> Iterator[None]:
        """Count the block as a call of a ``kind``, which has failed if the block raises.

        A ChangedError is no failure: the store has answered that another writer was faster.
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
            # Counters are not atomic.
            with self._lock:
                self.count[kind] += 1
                self.failed[kind] += failed
                self.seconds[kind] += seconds  # type: ignore[assignment]


class CountedBackend:
    """A backend that counts the calls to another ``backend`` in ``calls``."""

    def __init__(self, backend: Backend, calls: Calls) -> None:
        """Pass all calls on to ``backend``."""
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
