"""The page pool: light of decoded chunks in arrays of fixed size that kernels read through a table.

Rows of light live in pages of PAGE rows; ``table`` leads from (slot of a chunk, texel) to a row.
A frame holds the chunks that it reads, so that what it points to is not given away under it.
"""

import threading
from collections import OrderedDict
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from isogi_core.bake.light import Light, Part
from isogi_core.bake.look import Look
from isogi_core.bake.moments import path_deviation
from isogi_core.bake.noise import DARKEST, level, standard_error
from isogi_core.bake.precision import rung_codes, samples_of
from isogi_core.bake.recipe import Index
from isogi_core.cache.chunk import Chunk
from isogi_core.cache.record import TEXELS
from isogi_core.errors import StoreError
from isogi_core.kernels.lattice import BURIED_ROW, UNLIT, VOID_ROW
from isogi_core.model.plan import FEWEST

PAGE = 64
"""Rows of a page."""

PAGES_PER_CHUNK = 4
"""Pages that a chunk of a surface takes at least: the table has room for so many chunks as that makes."""

RUNGS = 32
"""More than the rungs of the ladder of sample counts."""

CHECKSUMS = 509
"""Checksums of light that is only shown: with the rungs of three parts, all that single floats count exactly."""

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

    A row has the ``transfer`` (channels, n²), the ``scatter``, the relative ``error`` and the ``stamp``, see
    ``stamps_of``. Scatter is the standard error of the luminance over the standard deviation of one path's, see
    ``bake.moments``.
    """

    def __init__(self, look: Look, budget: int) -> None:
        """Set the arrays aside, for what frames of ``look`` read and no more; memory is taken as they fill."""
        n, channels = look.order**2, look.channels
        page_bytes = PAGE * 4 * (channels * n + 3) + TEXELS * 4 // PAGES_PER_CHUNK
        pages = max(budget // page_bytes, 1)
        slots = max(pages // PAGES_PER_CHUNK, FEWEST_CHUNKS)
        self.look = look
        self.transfer = np.empty((pages * PAGE, channels, n), np.float32)
        self.scatter = np.empty(pages * PAGE, np.float32)
        self.error = np.empty(pages * PAGE, np.float32)
        self.stamp = np.empty(pages * PAGE, np.float32)
        self.table = np.empty((slots, TEXELS), np.int32)
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

    def insert(self, chunk: Chunk, keep: Collection[Index] = ()) -> None:
        """Put a decoded chunk into the pool in place of what was there; the chunks ``keep`` do not make room for it.

        Raises StoreError when the budget cannot hold it.
        """
        light = chunk.light
        rows_of_light = light.transfer[:, :, : self.look.order**2]
        wrong = standard_error(light, self.look)
        error = wrong / level(light, self.look)
        scatter = wrong / np.maximum(path_deviation(light, self.look), DARKEST * self.look.unit)
        stamps, marks = stamps_of(light), marks_of(light)
        with self._lock:
            self._age += 1
            entry = self._allocate(-(-len(chunk.offsets) // PAGE), {*keep} - {chunk.index})
            rows = (entry.pages[:, None] * PAGE + np.arange(PAGE)).ravel()[: len(chunk.offsets)]
            self.transfer[rows] = rows_of_light
            self.scatter[rows], self.error[rows], self.stamp[rows] = scatter, error, stamps
            self.table[entry.slot] = UNLIT
            self.table[entry.slot, chunk.offsets] = np.where(marks < 0, marks, rows)
            former = self._entries.pop(chunk.index, None)
            self._entries[chunk.index] = entry
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

    def _allocate(self, pages: int, keep: Collection[Index]) -> Entry:
        """A new entry with so many pages, taken from the longest unused chunks but ``keep`` where need be."""
        if not self._has_room(pages):
            self._make_room(pages, [i for i, e in self._entries.items() if not e.held and i not in keep])
        taken = np.array([self._free_pages.pop() for _ in range(pages)], np.int64)
        return Entry(self._free_slots.pop(), taken)

    def _has_room(self, pages: int) -> bool:
        return len(self._free_pages) >= pages and bool(self._free_slots)

    def _make_room(self, pages: int, spare: Sequence[Index]) -> None:
        """Drop chunks of ``spare``, in this order, until so many pages are free.

        Raises StoreError, and drops none, where all of them are too few.
        """
        most = len(self._free_pages) + sum(len(self._entries[index].pages) for index in spare)
        if most < pages or not (spare or self._free_slots):
            raise StoreError(
                f"The light of this view does not fit the memory for {len(self.scatter)} texels:"
                " ask for a closer view or fewer pixels, or give light more memory."
            )
        for index in spare:
            if self._has_room(pages):
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


def stamps_of(light: Light) -> np.ndarray:
    """How far each texel is baked, as one number: RUNGS^p times the rung of each part p, summed; (texels,) float32.

    Above these stands a checksum of what is shown without samples, since an earlier plan's light may grow too.
    """
    weights = RUNGS ** np.arange(len(light.parts))
    rungs = weights @ [rung_codes(part.samples) for part in light.parts]
    shown = sum(shown_bits(part) for part in light.parts)
    return np.asarray(rungs + RUNGS ** len(light.parts) * (shown % CHECKSUMS), np.float32)


def shown_bits(part: Part) -> np.ndarray:
    """The bits of coefficients as numbers, summed, of texels that have no samples; 0 of the others; (texels,) int64."""
    sums, rows = np.zeros(len(part.samples), np.int64), np.flatnonzero(part.samples == 0)
    sums[rows] = part.coefficients[rows].view(np.int32).sum(axis=(1, 2), dtype=np.int64)
    return sums


def fewest_samples(stamps: np.ndarray, parts: int) -> np.ndarray:
    """The fewest samples of any part of texels with these ``stamps``, 0 where one is not baked; (texels,) int32."""
    rungs = np.maximum(stamps, 0).astype(np.int64)[None] // RUNGS ** np.arange(parts)[:, None] % RUNGS
    return samples_of(rungs.min(axis=0).astype(np.uint8))


def marks_of(light: Light) -> np.ndarray:
    """BURIED_ROW, VOID_ROW or UNLIT for texels of that kind, else 0; (texels,) int32.

    Buried are those from which no path of any part ever left; of irradiance, dark says nothing of that. Unlit are
    those of which reflected light alone is known: that is no light to be shown.
    """
    none = np.array([~part.coefficients.any(axis=(1, 2)) for part in light.parts])
    straight = np.array([part.layer.kind != "indirect" for part in light.parts])
    unlit = (none & [part.samples == 0 for part in light.parts])[straight].any(axis=0)
    dark = none.all(axis=0) & all(part.layer.kind != "irradiance" for part in light.parts)
    buried = np.where(dark & (light.samples >= FEWEST), BURIED_ROW, 0)
    return np.where(light.void, VOID_ROW, np.where(unlit, UNLIT, buried)).astype(np.int32)
