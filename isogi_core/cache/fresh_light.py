"""Light that is newer than the store: it stays in memory while it converges.

A chunk is written when its light rests, or after some seconds, and not after every task. Chunks
here are never changed in place: each is as whole and consistent as one of the store.
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
"""Seconds after which light is written even if more is coming.
A kill loses at most this much, and other servers find light this late.
"""

REST_SECONDS = 1.0
"""Seconds without new light after which the light of a chunk rests, if no more is asked for."""

KEPT_SECONDS = 10.0
"""Seconds for which written light stays here, so that the next task need not read it."""


@dataclass(frozen=True, eq=False)
class Fresh:
    """A ``chunk`` of light in memory, in seconds of the clock: ``last`` its newest light, ``since``
    its oldest unwritten light.

    ``changed`` marks the layers that have unwritten light, none of them if all is written.
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
        """Return the chunk ``index`` if some of its light is not written yet, else None:
        the store has it then.
        """
        found = self._chunks.get(index)
        if found is not None and any(found.changed):
            return found.chunk
        return None

    def some(self, index: Index, offsets: np.ndarray) -> Chunk | None:
        """Return the light of those texels at ``offsets`` that the chunk ``index`` has here;
        None if the chunk must be read from the store.

        A chunk here has all light that the store has of it, and newer light: texels that it lacks
        have no light there either.
        """
        found = self._chunks.get(index)
        if found is None:
            return None
        chunk = found.chunk
        # Send only the texels that are asked for: a worker needs no others.
        rows = np.flatnonzero(np.isin(chunk.offsets, offsets))
        return Chunk(index, chunk.offsets[rows], chunk.light.rows(rows))

    def put(self, chunk: Chunk, changed: Sequence[bool]) -> None:
        """Take new light of a chunk's texels: of all of them, or of some if the others are here
        already.

        ``changed`` marks the layers that have new light.
        """
        now = self._clock()
        with self._lock:
            known = self._chunks.get(chunk.index)
            if known is None:
                self._chunks[chunk.index] = Fresh(chunk, tuple(changed), now, now)
                return
            # ``with_texels`` copies, so readers of the former chunk see no change.
            whole = known.chunk.with_texels(chunk.offsets)
            whole.light.put(whole.rows_of(chunk.offsets), chunk.light)
            unwritten = tuple(a or b for a, b in zip(known.changed, changed, strict=True))
            # The time of the oldest unwritten light decides when the chunk must be written.
            since = known.since if any(known.changed) else now
            self._chunks[chunk.index] = Fresh(whole, unwritten, since, now)

    def due(self, is_wanted: Callable[[Index], bool]) -> list[Fresh]:
        """Return the chunks to write now: those whose light rests, and those that have waited for
        WRITE_SECONDS.

        The light of a chunk rests if none came for REST_SECONDS and no more is requested of it, so
        that ``is_wanted`` is false.
        """
        now = self._clock()
        with self._lock:
            unwritten = [each for each in self._chunks.values() if any(each.changed)]
        return [
            each
            for each in unwritten
            if now - each.since >= WRITE_SECONDS
            or (now - each.last >= REST_SECONDS and not is_wanted(each.chunk.index))
        ]

    def unwritten(self) -> list[Fresh]:
        """Return all chunks with unwritten light."""
        with self._lock:
            return [each for each in self._chunks.values() if any(each.changed)]

    def written(self, fresh: Fresh) -> None:
        """Mark the light of ``fresh`` as written, unless newer light of the chunk has come."""
        index = fresh.chunk.index
        with self._lock:
            # If newer light came during the write, the entry is another one, and stays unwritten.
            if self._chunks.get(index) is fresh:
                none = (False,) * len(fresh.changed)
                self._chunks[index] = replace(fresh, changed=none)

    def drop(self, index: Index) -> None:
        """Forget a chunk whose light cannot be written."""
        with self._lock:
            self._chunks.pop(index, None)

    def sweep(self, busy: Callable[[Index], bool]) -> None:
        """Forget chunks whose light is written and whose last light came KEPT_SECONDS ago, unless
        a task of theirs is in flight, which makes them ``busy``.

        A task may bring light of some texels only. If the others were forgotten meanwhile, ``put``
        would take these few for the whole chunk, and hide the others in the store.
        """
        now = self._clock()
        # Keep the lock, so that no light comes between the test and the deletion.
        with self._lock:
            for index, each in list(self._chunks.items()):
                if now - each.last >= KEPT_SECONDS and not any(each.changed) and not busy(index):
                    del self._chunks[index]

    def __len__(self) -> int:
        return len(self._chunks)


STORES: "weakref.WeakKeyDictionary[Store, dict[str, FreshLight]]" = weakref.WeakKeyDictionary()
"""The light of each store that this process has open,
by the digests of bakes. Closed stores drop out.
"""

LOCK = threading.Lock()


def fresh_light(store: Store, digest: str) -> FreshLight:
    """Return the unwritten light of the bake ``digest`` in a ``store``:
    the same object for everyone in this process.
    """
    with LOCK:
        return STORES.setdefault(store, {}).setdefault(digest, FreshLight())


def texels_of(chunks: Collection[Chunk], texels: int) -> tuple[np.ndarray, Light]:
    """Join the texels of some chunks of ``texels`` texels:
    return their places (see ``Chunks.of_parts``) and light.
    """
    places = [number * texels + chunk.offsets for number, chunk in enumerate(chunks)]
    light = Light.joined([chunk.light for chunk in chunks])
    return np.concatenate(places).astype(np.int32), light
