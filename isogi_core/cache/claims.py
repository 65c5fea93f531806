"""Claims of chunks, so that bakers over one store take different ones. They are hints that save time, never locks.

A claim is a small object beside the light. Claims are made only after another baker was noticed, as a baker alone has
no use for them. After a long enough wait a claim is taken over, as its owner may have been killed. Where claims cannot
be read or written, baking goes on without them.
"""

import logging
import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from isogi_core.cache.inventory import CLAIMS_FOLDER
from isogi_core.errors import ChangedError, StoreError
from isogi_core.storage.backend import StoredObject
from isogi_core.storage.store import Store

log = logging.getLogger("isogi.cache")

CONTENDED_SECONDS = 60.0
"""Seconds for which claims are made after another baker was noticed."""


class Claims:
    """The claims in a ``store``, as one process knows them."""

    def __init__(self, store: Store, clock: Callable[[], float] = time.monotonic) -> None:
        """Begin without contention."""
        self._store, self._clock = store, clock
        self._contended = -math.inf

    def note_contention(self) -> None:
        """Note that another baker worked on the same chunk: read and write claims for a while."""
        self._contended = self._clock()

    @contextmanager
    def on(self, name: str, owner: str, insist: bool = False) -> Iterator[bool]:
        """Claim the chunk of this ``name`` for its ``owner`` while the block runs; yields whether it is free to bake.

        An owner takes over its own former claim, and with ``insist`` anybody's. An empty owner claims nothing.
        """
        if not owner or self._clock() - self._contended > CONTENDED_SECONDS:
            yield True
            return
        key = f"{CLAIMS_FOLDER}/{name}"
        ours = self._claim(key, owner.encode(), insist)
        try:
            yield ours
        finally:
            if ours:
                with suppress(StoreError):
                    self._store.delete(key)

    def _claim(self, key: str, mark: bytes, insist: bool) -> bool:
        """Make a claim; True also where the store takes no claims."""
        try:
            if self._put(key, mark, None):
                return True
            former = self._store.get(key)
            if (former is None or insist or former.data == mark) and self._put(key, mark, former):
                return True
        except StoreError as error:
            log.info("A chunk cannot be claimed: %s", error)
            return True
        self.note_contention()
        return False

    def _put(self, key: str, mark: bytes, former: StoredObject | None) -> bool:
        """Write a claim in place of the former one; False where that has changed."""
        with suppress(ChangedError):
            self._store.put(key, mark, former)
            return True
        return False
