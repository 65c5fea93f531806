"""The update bus: tells requests and streams which chunks have new light."""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from isogi_core.prepared.prepared_scene import Index

MOST_UPDATES = 100_000
"""Chunks whose last update is remembered, of all bakes together: some 30 MB. Requests ask for
those of the moments since their picture was drawn.
"""

MOST_BAKES = 1000
"""Bakes whose newest update is remembered."""


@dataclass(eq=False)
class Pending:
    """Chunks that a request waits for, of the bake with the name ``bake``.

    ``some`` is set with the first update of any of the ``chunks``, ``all`` with the last update of
    the last one: a chunk's last update says that it is final or given up. ``lit`` is set with
    ``all``, or once each of the ``dark`` chunks, which had no light, has had an update: then no
    part of the picture is without light, so it is worth drawing at once. If there are no chunks,
    no event is ever set.
    """

    bake: str
    chunks: set[Index]
    dark: set[Index] = field(default_factory=set)
    some: asyncio.Event = field(default_factory=asyncio.Event)
    lit: asyncio.Event = field(default_factory=asyncio.Event)
    all: asyncio.Event = field(default_factory=asyncio.Event)

    def note(self, index: Index, more: bool) -> None:
        """Note an update of a chunk, and set the events that it completes. ``more`` says that
        the chunk will have further updates.
        """
        # Any update shows something new; only the last one of a chunk ends the wait for it.
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
    """Tells waiting requests of new light in chunks. Updates are numbered from 1.

    All methods but ``publish`` belong to the event loop that created the bus.
    """

    def __init__(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._count = 0
        # Of each chunk: the number of its newest update, and True if more follow; the oldest first.
        # Too old entries are forgotten, all of them with numbers up to ``_chunks_forgotten_to``. A
        # chunk without an entry counts as updated at that number. The same holds for bakes.
        self._newest_of_chunk: OrderedDict[tuple[str, Index], tuple[int, bool]] = OrderedDict()
        self._chunks_forgotten_to = 0
        self._newest_of_bake: OrderedDict[str, int] = OrderedDict()
        self._bakes_forgotten_to = 0
        self._pending: set[Pending] = set()

    def publish(self, bake: str, index: Index, more: bool) -> None:
        """Report from any thread that a chunk of a bake has new light, or that its task failed,
        and if ``more`` updates of it will come.
        """
        if not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._note, bake, index, more)

    def newest(self, bake: str) -> int:
        """Return a number that no update of a bake has exceeded: that of its newest update, or the
        largest forgotten one if that update was forgotten or is older; 0 if there was none.
        """
        # Chunks without an entry count as updated at the number that was forgotten last: a frame
        # that is drawn now has seen all updates up to it.
        number = self._newest_of_bake.get(bake, self._bakes_forgotten_to)
        return max(number, self._chunks_forgotten_to)

    @contextmanager
    def pending(
        self, bake: str, chunks: Collection[Index], since: int, dark: Collection[Index] = ()
    ) -> Iterator[Pending]:
        """Yield the events of ``chunks`` of a bake while the block runs. Some of the chunks are
        ``dark``: they had no light in the frame that was drawn last.

        ``since`` is the answer of ``newest`` for this bake before that frame was drawn. Updates of
        the chunks with larger numbers set events, also those that came before this call.

        If an update of a chunk with a larger number may have been forgotten, the chunk counts as
        updated for the last time: a frame that is drawn again in vain is better than one that waits
        for an update that has passed.
        """
        pending = Pending(bake, set(chunks), set(dark))
        # Catch up with the updates since the frame was drawn.
        for index in chunks:
            number, more = self._newest_of_chunk.get(
                (bake, index), (self._chunks_forgotten_to, False)
            )
            if number > since:
                pending.note(index, more)
        self._pending.add(pending)
        try:
            yield pending
        finally:
            self._pending.discard(pending)

    def _note(self, bake: str, index: Index, more: bool) -> None:
        """Number an update, remember it as the newest of its chunk and of its bake, and pass it
        on to the requests that wait for this bake. Runs on the event loop.
        """
        self._count += 1
        self._newest_of_chunk[bake, index] = self._count, more
        self._newest_of_chunk.move_to_end((bake, index))
        self._newest_of_bake[bake] = self._count
        self._newest_of_bake.move_to_end(bake)
        # Bakes come and go with each cut and isovalue: forget the oldest entry. Those forgotten
        # before have smaller numbers, so this one bounds them all.
        if len(self._newest_of_chunk) > MOST_UPDATES:
            _, (number, _) = self._newest_of_chunk.popitem(last=False)
            self._chunks_forgotten_to = number
        if len(self._newest_of_bake) > MOST_BAKES:
            _, self._bakes_forgotten_to = self._newest_of_bake.popitem(last=False)
        for pending in self._pending:
            if pending.bake == bake:
                pending.note(index, more)
