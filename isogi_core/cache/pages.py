"""The page pool: light of decoded chunks in arrays of fixed size that kernels read through a table.

Rows of light live in pages of PAGE rows; ``table`` leads from (slot of a chunk, texel) to a row.
A frame holds the chunks that it reads, so that what it points to is not given away under it.
"""

import threading
from collections import OrderedDict
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from isogi_core.bake.look import Look
from isogi_core.bake.recipe import Index
from isogi_core.cache.chunk import Chunks
from isogi_core.cache.rows import fill_rows, new_rows, reflected_share
from isogi_core.errors import StoreError
from isogi_core.kernels.lattice import UNLIT, Lattice

PAGE = 64
"""Rows of a page."""

FEWEST_CHUNKS = 8
"""Chunks that the table has room for however small the budget is."""


@dataclass(eq=False)
class Entry:
    """A chunk in the pool: its ``slot`` in the table, its pages, how many hold it, and whether it is still listed."""

    slot: int
    pages: np.ndarray
    held: int = 0
    stale: bool = False
    listed: bool = True


class Held(NamedTuple):
    """Chunks that stay: their ``slots`` (n,) int32, -1 where absent, and the ``age`` of the pool they were found in.

    Where the age is the same, so is what the slots lead to.
    """

    slots: np.ndarray
    age: int


class PagePool:
    """Light in memory, at most ``budget`` bytes. Safe to use from many threads.

    A row has the ``transfer`` (channels, columns of all terms), the ``scatter``, the relative ``error`` and the
    ``stamp``: see ``fill_rows``. Where light is kept for several albedos it also has the share of its variance that is
    ``reflected``.
    """

    def __init__(self, look: Look, budget: int) -> None:
        """Set the arrays aside, for what frames of ``look`` read and no more; memory is taken as they fill."""
        texels = look.recipe.lattice.texels
        pages = max(budget // page_bytes(look), 1)
        slots = max(pages // pages_of_sheet(look.recipe.lattice), FEWEST_CHUNKS)
        self.look = look
        self.rows = new_rows(look, pages * PAGE)
        self.transfer, self.scatter, self.error, self.stamp = self.rows
        self.reflected = np.empty(pages * PAGE if look.plan.nodes else 0, np.float32)
        self.table = np.empty((slots, texels), np.int32)
        self._free_pages = list(range(pages))[::-1]
        self._free_slots = list(range(slots))
        self._entries: OrderedDict[Index, Entry] = OrderedDict()
        self._age = 0
        self._lock = threading.Lock()

    def missing(self, indices: Sequence[Index]) -> list[Index]:
        """Those of the chunks that are not in the pool or known to be outdated."""
        with self._lock:
            found = map(self._entries.get, indices)
            return [index for index, entry in zip(indices, found, strict=True) if entry is None or entry.stale]

    def outdate(self, index: Index) -> None:
        """Say that the store has newer light of a chunk. What is here may be shown until it is read."""
        with self._lock:
            if index in self._entries:
                self._entries[index].stale = True

    def insert(self, chunks: Chunks, keep: Collection[Index] = ()) -> None:
        """Put decoded chunks into the pool in place of what was there; the chunks ``keep`` do not make room for them.

        Raises StoreError, and drops none, when the budget cannot hold them.
        """
        counts = np.diff(chunks.bounds)
        with self._lock:
            self._age += 1
            entries = self._allocate(-(-counts // PAGE), {*keep} - {*chunks.indices})
            rows = rows_in([entry.pages for entry in entries], counts)
            slots = np.array([entry.slot for entry in entries], np.int32)
            self.table[slots] = UNLIT
            self.table[np.repeat(slots, counts), chunks.offsets] = fill_rows(self.rows, rows, chunks.light, self.look)
            if self.look.plan.nodes:
                self.reflected[rows] = reflected_share(chunks.light, self.look)
            for index, entry in zip(chunks.indices, entries, strict=True):
                former = self._entries.pop(index, None)
                self._entries[index] = entry
                if former is not None:
                    self._release(former)

    @contextmanager
    def hold(self, indices: Sequence[Index]) -> Iterator[Held]:
        """Where the chunks are; they and their rows stay while the block runs."""
        with self._lock:
            age = self._age
            found = [self._entries.get(index) for index in indices]
            for index, entry in zip(indices, found, strict=True):
                if entry is not None:
                    entry.held += 1
                    self._entries.move_to_end(index)
        try:
            yield Held(np.array([-1 if entry is None else entry.slot for entry in found], np.int32), age)
        finally:
            with self._lock:
                for entry in found:
                    if entry is not None:
                        entry.held -= 1
                        self._give_back(entry)

    def _allocate(self, pages: np.ndarray, keep: Collection[Index]) -> list[Entry]:
        """New entries with so many ``pages`` each, taken from the longest unused chunks but ``keep`` where need be."""
        total = int(pages.sum())
        if not self._has_room(total, len(pages)):
            self._make_room(total, len(pages), [i for i, e in self._entries.items() if not e.held and i not in keep])
        taken = np.array([self._free_pages.pop() for _ in range(total)], np.int32)
        bounds = [0, *np.cumsum(pages).tolist()]
        return [Entry(self._free_slots.pop(), taken[a:b]) for a, b in pairwise(bounds)]

    def _has_room(self, pages: int, slots: int) -> bool:
        return len(self._free_pages) >= pages and len(self._free_slots) >= slots

    def _make_room(self, pages: int, slots: int, spare: Sequence[Index]) -> None:
        """Drop chunks of ``spare``, in this order, until so many pages and slots are free.

        Raises StoreError, and drops none, where all of them are too few.
        """
        most = len(self._free_pages) + sum(len(self._entries[index].pages) for index in spare)
        if most < pages or len(self._free_slots) + len(spare) < slots:
            raise StoreError(
                f"The light of this view does not fit the memory for {len(self.scatter)} texels:"
                " ask for a closer view or fewer pixels, or give light more memory."
            )
        for index in spare:
            if self._has_room(pages, slots):
                return
            self._release(self._entries.pop(index))

    def _release(self, entry: Entry) -> None:
        """Let go of an entry that the pool no longer lists; its pages are free when nobody holds it."""
        entry.listed = False
        self._give_back(entry)

    def _give_back(self, entry: Entry) -> None:
        """Free an entry's pages, the last first: they are taken upwards again, as memory is read fastest."""
        if entry.held == 0 and not entry.listed and entry.slot >= 0:
            self._free_pages.extend(entry.pages[::-1].tolist())
            self._free_slots.append(entry.slot)
            entry.slot = -1


def pages_of_sheet(lattice: Lattice) -> int:
    """Pages that a chunk of a surface takes at least: the table has room for so many chunks as that makes."""
    return lattice.rows // PAGE


def page_bytes(look: Look) -> int:
    """Bytes that a page of a ``look`` takes, its part of the table among them."""
    lattice = look.recipe.lattice
    return PAGE * 4 * (
        look.channels * look.columns + (4 if look.plan.nodes else 3)
    ) + lattice.texels * 4 // pages_of_sheet(lattice)


def rows_in(pages: Sequence[np.ndarray], counts: np.ndarray) -> np.ndarray:
    """Rows of chunks' texels, of which each has ``counts`` (chunks,): they fill its own ``pages``; (texels,) int32."""
    each = [(own[:, None] * PAGE + np.arange(PAGE, dtype=np.int32)).ravel() for own in pages]
    return np.concatenate([np.empty(0, np.int32), *(rows[:count] for rows, count in zip(each, counts, strict=True))])
