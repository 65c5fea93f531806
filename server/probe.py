"""The probe: whether the store is there and takes light."""

import threading
import time
from collections.abc import Callable

from isogi_core.cache.root import Root, Where
from isogi_core.errors import StoreError, StoreReadOnlyError

KEPT = 5.0
"""Seconds for which a finding stands: probes come often, and from many."""


class StoreProbe:
    """Looks for a store's sentinel, and tries whether it could be written. Safe to use from many threads."""

    def __init__(self, store: Where, clock: Callable[[], float] = time.monotonic) -> None:
        """Probe ``store`` when it is asked for the first time."""
        self._root = Root.of(store)
        self._clock = clock
        self._lock = threading.Lock()
        self._found: list[str] = []
        self._until = -1.0

    def reasons(self) -> list[str]:
        """Why light cannot be read or kept; none where it can, or where the store is one that is only read.

        Looked up at most every ``KEPT`` seconds.
        """
        with self._lock:
            if self._clock() >= self._until:
                self._found = self._look()
                self._until = self._clock() + KEPT
            return self._found

    def _look(self) -> list[str]:
        try:
            self._root.prove()
        except StoreReadOnlyError:
            return []
        except StoreError as error:
            return [str(error)]
        return []
