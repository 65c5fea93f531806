"""News of light: the workers' threads tell it, and coroutines wait for it."""

from __future__ import annotations

import asyncio
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from isogi_core.bake.recipe import Index


@dataclass(eq=False)
class Pending:
    """``chunks`` of a ``bake`` whose light somebody waits for: ``some`` is set with the first news, ``all`` at the end.

    A chunk is done with when no more of it is going to be baked, be it final or given up.
    """

    bake: str
    chunks: set[Index]
    some: asyncio.Event = field(default_factory=asyncio.Event)
    all: asyncio.Event = field(default_factory=asyncio.Event)

    def note(self, index: Index, more: bool) -> None:
        """Take in that a chunk has news, and whether there will be more."""
        if index in self.chunks:
            self.some.set()
            if not more:
                self.chunks.discard(index)
        if not self.chunks:
            self.all.set()


class News:
    """What has come so far, numbered. All but ``tell`` belongs to the event loop that made it."""

    def __init__(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._count = 0
        self._last: dict[tuple[str, Index], tuple[int, bool]] = {}
        self._newest: dict[str, int] = {}
        self._pending: set[Pending] = set()

    def tell(self, bake: str, index: Index, more: bool) -> None:
        """A chunk of a bake has new light, or its task failed, and whether ``more`` is coming. From any thread."""
        if not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._note, bake, index, more)

    def newest(self, bake: str) -> int:
        """The number of the newest news of a bake; 0 where there was none."""
        return self._newest.get(bake, 0)

    @contextmanager
    def pending(self, bake: str, chunks: Collection[Index], since: int) -> Iterator[Pending]:
        """Watch ``chunks`` of a bake; what came after the news of number ``since`` counts already."""
        pending = Pending(bake, set(chunks))
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
