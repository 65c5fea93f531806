"""Claims: who is at which chunk, so that bakers over one store take different ones. Hints that save time, never locks.

A claim is a small object beside the light. It is made where somebody else was met, and only then: who bakes alone has
no use for it. Whoever has waited long enough takes it over: its owner may have been killed. Where claims cannot be
read or written, baking goes on without.
"""

import logging
import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from isogi_core.cache.inventory import CLAIMS
from isogi_core.cache.root import Root
from isogi_core.cache.shelf import Found
from isogi_core.errors import ChangedError, StoreError

log = logging.getLogger("isogi.cache")

COMPANY = 60.0
"""Seconds for which claims are made after somebody else was met."""


class Claims:
    """The claims in the store at ``root``, as one process knows them."""

    def __init__(self, root: Root, clock: Callable[[], float] = time.monotonic) -> None:
        """Have met nobody yet."""
        self._root, self._clock = root, clock
        self._met = -math.inf

    def meet(self) -> None:
        """Somebody else has been at what this process was at: look and tell who is at what, for a while."""
        self._met = self._clock()

    @contextmanager
    def on(self, name: str, owner: str, insist: bool = False) -> Iterator[bool]:
        """Whether the chunk of this ``name`` is its ``owner``'s while the block runs, and not somebody else's.

        An owner's former claim is its own, and anybody's is where it does ``insist``. Who has no name claims nothing.
        """
        if not owner or self._clock() - self._met > COMPANY:
            yield True
            return
        key = f"{CLAIMS}/{name}"
        ours = self._claim(key, owner.encode(), insist)
        try:
            yield ours
        finally:
            if ours:
                with suppress(StoreError):
                    self._root.delete(key)

    def _claim(self, key: str, mark: bytes, insist: bool) -> bool:
        """Whether the claim could be made, or nobody can make any."""
        try:
            if self._put(key, mark, None):
                return True
            former = self._root.get(key)
            if (former is None or insist or former.data == mark) and self._put(key, mark, former):
                return True
        except StoreError as error:
            log.info("A chunk cannot be claimed: %s", error)
            return True
        self.meet()
        return False

    def _put(self, key: str, mark: bytes, former: Found | None) -> bool:
        """Write a claim in place of the former one; whether that was still so."""
        with suppress(ChangedError):
            self._root.put(key, mark, former)
            return True
        return False
