"""Light that is newer than the store: it stays in memory while it converges, and is written once it
rests, or after some seconds.

Chunks here are never changed in place: each is as whole and consistent as one of the store.
"""

import threading
import time
import weakref
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from isogi_core.bake.texel_light import Light
from isogi_core.cache.chunk_record import Chunk
from isogi_core.prepared.prepared_scene import Index
from isogi_core.storage.store import Store

WRITE_SECONDS = 4.0
"""Seconds after which light is written though more is coming: so much a kill may lose, and so late
other servers find it.
"""

REST_SECONDS = 1.0
"""Seconds without new light after which that of a chunk rests, where no more is asked for."""

KEPT_SECONDS = 10.0
"""Seconds for which written light stays here, so that the next task need not read it."""


@dataclass(frozen=True, eq=False)
class Fresh:
    """A ``chunk`` with light that came ``last``, and ``since`` when some of it is not written.

    ``changed`` is which layers have such light: none where all is written.
    """

    chunk: Chunk
    changed: tuple[bool, ...]
    since: float
    last: float


class FreshLight:
    """The chunks of one bake that are newer than the store. Safe to use from many threads."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """Begin without light."""
        self._clock = clock
        self._chunks: dict[Index, Fresh] = {}
        self._lock = threading.Lock()

    def newer(self, index: Index) -> Chunk | None:
        """A chunk with light that is not written yet; None where the store has all that there is
        here.
        """
        found = self._chunks.get(index)
        if found is not None and any(found.changed):
            return found.chunk
        return None

    def some(self, index: Index, offsets: np.ndarray) -> Chunk | None:
        """The light of a chunk's texels at ``offsets``, of those that it has; None where the chunk
        has to be read from the store.
        """
        found = self._chunks.get(index)
        if found is None:
            return None
        chunk = found.chunk
        rows = np.flatnonzero(np.isin(chunk.offsets, offsets))
        return Chunk(index, chunk.offsets[rows], chunk.light.rows(rows))

    def put(self, chunk: Chunk, changed: Sequence[bool]) -> None:
        """Take new light of a chunk's texels: of all of them, or of some where the others are here.

        ``changed`` is which layers have new light.
        """
        now = self._clock()
        with self._lock:
            known = self._chunks.get(chunk.index)
            if known is None:
                self._chunks[chunk.index] = Fresh(chunk, tuple(changed), now, now)
                return
            whole = known.chunk.with_texels(chunk.offsets)
            whole.light.put(whole.rows_of(chunk.offsets), chunk.light)
            unwritten = tuple(a or b for a, b in zip(known.changed, changed, strict=True))
            since = known.since if any(known.changed) else now
            self._chunks[chunk.index] = Fresh(whole, unwritten, since, now)

    def due(self, open_now: Callable[[Index], bool]) -> list[Fresh]:
        """What is to be written now: light that rests, or that has waited for WRITE_SECONDS.

        Light rests where no more is asked for: where its chunk is not ``open_now``.
        """
        now = self._clock()
        with self._lock:
            unwritten = [each for each in self._chunks.values() if any(each.changed)]
        return [
            each
            for each in unwritten
            if now - each.since >= WRITE_SECONDS
            or (now - each.last >= REST_SECONDS and not open_now(each.chunk.index))
        ]

    def unwritten(self) -> list[Fresh]:
        """All that is not written."""
        with self._lock:
            return [each for each in self._chunks.values() if any(each.changed)]

    def written(self, fresh: Fresh) -> None:
        """Note that some light was written; what came since then is still to be."""
        index = fresh.chunk.index
        with self._lock:
            if self._chunks.get(index) is fresh:
                none = (False,) * len(fresh.changed)
                self._chunks[index] = replace(fresh, changed=none)

    def drop(self, index: Index) -> None:
        """Forget a chunk, whose light cannot be written."""
        with self._lock:
            self._chunks.pop(index, None)

    def sweep(self, busy: Callable[[Index], bool]) -> None:
        """Forget what was written KEPT_SECONDS ago, but for chunks that are ``busy``: their tasks
        bring light of some texels alone.
        """
        now = self._clock()
        with self._lock:
            for index, each in list(self._chunks.items()):
                if now - each.last >= KEPT_SECONDS and not any(each.changed) and not busy(index):
                    del self._chunks[index]

    def __len__(self) -> int:
        return len(self._chunks)


STORES: "weakref.WeakKeyDictionary[Store, dict[str, FreshLight]]" = weakref.WeakKeyDictionary()
"""The light of each store that this process has open, by the digests of bakes."""

LOCK = threading.Lock()


def fresh_light(store: Store, digest: str) -> FreshLight:
    """The light of a bake that is newer than a ``store``, one for all that this process reads of
    it.
    """
    with LOCK:
        return STORES.setdefault(store, {}).setdefault(digest, FreshLight())


def texels_of(chunks: Collection[Chunk], texels: int) -> tuple[np.ndarray, Light]:
    """The places of the texels of some chunks, each of so many ``texels``, and their light: see
    ``Chunks.of_parts``.
    """
    places = [number * texels + chunk.offsets for number, chunk in enumerate(chunks)]
    light = Light.joined([chunk.light for chunk in chunks])
    return np.concatenate(places).astype(np.int32), light
