"""The stamps of use: when light was last read for a frame, so that a full store can let go of what nobody looks at.

What was written says when it was baked and not when it was looked at. A stamp is a small object for each layer whose
own date tells; a store that takes none is read as well.
"""

import logging
import threading
import time
from collections.abc import Callable, Sequence

from isogi_core.cache.inventory import USED
from isogi_core.cache.root import Root
from isogi_core.errors import StoreError

log = logging.getLogger("isogi.cache")

STAMP_EVERY = 3600.0
"""Seconds after which light that is in use is stamped again."""


class Use:
    """The use of layers, by their ``digests``, in the store at ``root``. Safe to use from many threads."""

    def __init__(self, root: Root, digests: Sequence[str], clock: Callable[[], float] = time.monotonic) -> None:
        """Nothing was used yet."""
        self._root = root
        self._digests = digests
        self._clock = clock
        self._due = clock()
        self._lock = threading.Lock()

    def tell(self) -> None:
        """Light is read: stamp its layers, unless that was done less than STAMP_EVERY seconds ago."""
        with self._lock:
            if self._clock() < self._due:
                return
            self._due = self._clock() + STAMP_EVERY
        threading.Thread(target=self._stamp, name="stamp", daemon=True).start()

    def _stamp(self) -> None:
        try:
            for digest in self._digests:
                key = f"{USED}/{digest}"
                self._root.put(key, b"", self._root.get(key))
        except StoreError as error:
            log.info("When light was used cannot be kept: %s", error)
