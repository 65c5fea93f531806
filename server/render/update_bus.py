"""The update bus: tells requests and streams which chunks have new light."""

from __future__ import annotations

import asyncio
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from isogi_core.prepared.prepared_scene import Index


@dataclass(eq=False)
class Pending:
    """``chunks`` of a ``bake`` that are waited for: ``some`` is set with the first update, ``all``
    with the last.

    The last update of a chunk says that no more of it is going to be baked: it is final or given
    up. ``lit`` is set with ``all``, and once each of those that were ``dark`` has had an update.
    """

    bake: str
    chunks: set[Index]
    dark: set[Index] = field(default_factory=set)
    some: asyncio.Event = field(default_factory=asyncio.Event)
    lit: asyncio.Event = field(default_factory=asyncio.Event)
    all: asyncio.Event = field(default_factory=asyncio.Event)

    def note(self, index: Index, more: bool) -> None:
        """Note an update of a chunk, and whether there will be more."""
        if index in self.chunks:
            self.some.set()
            if not more:
                self.chunks.discard(index)
        if index in self.dark:
            self.dark.discard(index)
            if not self.dark:
                self.lit.set()
        if not self.chunks:
            self.lit.set()
            self.all.set()


class UpdateBus:
    """The updates so far, numbered. All but ``publish`` belongs to the event loop that made it."""

    def __init__(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._count = 0
        self._last: dict[tuple[str, Index], tuple[int, bool]] = {}
        self._newest: dict[str, int] = {}
        self._pending: set[Pending] = set()

    def publish(self, bake: str, index: Index, more: bool) -> None:
        """Say that a chunk of a bake has new light, or its task failed, and whether ``more`` is
        coming. Any thread.
        """
        if not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._note, bake, index, more)

    def newest(self, bake: str) -> int:
        """The number of the newest update of a bake; 0 where there was none."""
        return self._newest.get(bake, 0)

    @contextmanager
    def pending(
        self, bake: str, chunks: Collection[Index], since: int, dark: Collection[Index] = ()
    ) -> Iterator[Pending]:
        """Watch ``chunks`` of a bake, some of which are ``dark``, from the update after number
        ``since`` on.
        """
        pending = Pending(bake, set(chunks), set(dark))
        for index in chunks:
            number, more = self._last.get((bake, index), (0, True))
            if number > since:
                pending.note(index, more)
        self._pending.add(pending)
        try:
            yield pending
        finally:
            self._pending.discard(pending)

    def _note(self, bake: str, index: Index, more: bool) -> None:
        self._count += 1
        self._newest[bake] = self._count
        self._last[bake, index] = self._count, more
        for pending in self._pending:
            if pending.bake == bake:
                pending.note(index, more)
