"""Records that are kept of a pool's rows: how texels are lit stays while a camera moves alone."""

import threading
from collections.abc import Callable, Hashable
from functools import cached_property

import numpy as np

from isogi_core.cache.page_pool import Held, PagePool
from isogi_core.frame.texel_reading import Reading
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.shading.irradiance_ratio import RECORD, recall_records

ENTRY = 4 * RECORD + 4
"""Bytes of a row: its record, and the age of the pool at which that was filled."""


class RowRecords:
    """Records of the first rows of a pool, under one light; see ``fill_records``. Safe to use from many threads.

    Those who ask see whether a light ``stays``: while it turns, to keep any would be for nothing.
    """

    def __init__(self, budget: int) -> None:
        """Keep none yet, and ``budget`` bytes of them at most; they are taken as rows are filled."""
        self._most = budget // ENTRY
        self._light: Hashable = None
        self._asked: Hashable = None
        self._taken = 0
        self._lock = threading.Lock()

    @property
    def nbytes(self) -> int:
        """Bytes that they take."""
        return ENTRY * self._taken

    @cached_property
    def _records(self) -> np.ndarray:
        return np.empty((self._most, RECORD), np.float32)

    @cached_property
    def _filled(self) -> np.ndarray:
        return np.zeros(self._most, np.int32)

    def stays(self, light: Hashable) -> bool:
        """Whether that ``light`` is asked for again, or records of it are kept."""
        asked, self._asked = self._asked, light
        return light in (asked, self._light)

    def of(
        self,
        light: Hashable,
        reading: Reading,
        pool: PagePool,
        held: Held,
        fill: Callable[[np.ndarray], np.ndarray],
        tiles: Tiles,
    ) -> np.ndarray | None:
        """The records of texels that are all settled, by their ``reading`` in a ``pool``, (texels, RECORD).

        ``light`` names the pool, and all that they depend on besides. Those that are not kept are found by ``fill``,
        which is given the texels' numbers, and kept in place of another light's. None while another thread is at it.
        Raises Cancelled.
        """
        if not self._lock.acquire(blocking=False):
            return None
        try:
            if self._light != light:
                self._light, self._filled[:] = light, 0
            return self._recall(reading, pool, held, fill, tiles)
        finally:
            self._lock.release()

    def _recall(
        self, reading: Reading, pool: PagePool, held: Held, fill: Callable[[np.ndarray], np.ndarray], tiles: Tiles
    ) -> np.ndarray:
        rows, grade = reading.rows, reading.grade
        records, lacking = np.empty((len(rows), RECORD), np.float32), np.empty(len(rows), np.bool_)
        kept = pool.written, self._filled, self._records

        def _piece(a: int, b: int) -> None:
            recall_records(rows[a:b], grade[a:b], *kept, records[a:b], lacking[a:b])

        tiles.run(_piece, len(rows), tiles.even(len(rows)))
        new = np.flatnonzero(lacking)
        if len(new):
            records[new] = fill(new)
            own = new[rows[new] < self._most]
            self._records[rows[own]], self._filled[rows[own]] = records[own], held.age
            self._taken = max(self._taken, int(rows[own].max(initial=-1)) + 1)
        return records
