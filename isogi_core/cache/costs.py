"""Costs of baking, chunk by chunk, kept in the store so that time left can be estimated after a
restart.

Chunks themselves hold no times, as their bytes must not depend on the machine that baked them. The
costs of a bake are the attributes of one small Zarr group, written whole by the process that owns
the queue. If two servers bake into one store, the last write stays. Lost costs are measured again.
"""

import json
import logging
import math
import threading
import time
from bisect import bisect_left, insort
from collections.abc import Callable, Iterable
from functools import reduce
from typing import Any, NamedTuple

from isogi_core.bake.texel_light import FIRST_LEVEL
from isogi_core.cache.inventory import COSTS_FOLDER
from isogi_core.prepared.prepared_scene import Index
from isogi_core.storage.store import Store, StoreLike

log = logging.getLogger("isogi.cache")

SAVE_EVERY = 30.0
"""Seconds from the first unsaved change of the costs after which they are written again: a kill
loses the costs of at most this time.
"""


TASK_OVERHEAD_SECONDS = 1.0 / 512.0
"""Processor seconds of a worker that a task takes for each chunk in addition to its paths."""


class Cost(NamedTuple):
    """The work of a bake: processor ``seconds`` for ``paths``, and the ``texels`` that got their
    first light.

    ``first`` of these seconds went into first light. These include work that is done once a texel,
    such as finding its surface, and so do not measure the cost of a path.
    """

    seconds: float = 0.0
    paths: int = 0
    texels: int = 0
    first: float = 0.0

    @property
    def rate(self) -> float | None:
        """Seconds per path of light after the first, None if there was none."""
        # Leave out first light, whose seconds include work that is done once a texel.
        paths = self.paths - FIRST_LEVEL * self.texels
        if paths > 0:
            return (self.seconds - self.first) / paths
        return None

    def ahead(self, paths: float, unlit: int = 0) -> float:
        """Return the processor seconds that further ``paths`` will take, judged by this cost; 0 if
        it has no paths.

        Of these ``paths``, FIRST_LEVEL for each of ``unlit`` texels are first light, which takes as
        long for a texel as before. If this cost has no first light, or no other, each path takes
        the mean time of all.
        """
        if self.rate is None or not self.texels:
            return paths * self.seconds / max(self.paths, 1)
        first = self.first / self.texels
        return self.rate * (paths - FIRST_LEVEL * unlit) + first * unlit

    def plus(self, other: "Cost") -> "Cost":
        """Return the sum of both costs."""
        return Cost(*(a + b for a, b in zip(self, other, strict=True)))  # type: ignore[arg-type]

    def minus(self, other: "Cost") -> "Cost":
        """Return the cost of the work that was done after the ``other`` was taken."""
        return Cost(*(a - b for a, b in zip(self, other, strict=True)))  # type: ignore[arg-type]


class Costs:
    """The costs of the bake ``digest`` in a ``store``, in memory and as an object there.

    Safe to use from many threads.
    """

    def __init__(
        self, store: StoreLike, digest: str, clock: Callable[[], float] = time.monotonic
    ) -> None:
        """Begin without costs, and without reading the store."""
        self._store = Store.of(store)
        self._key = f"{COSTS_FOLDER}/{digest}/zarr.json"
        self._clock = clock
        self._chunks: dict[Index, Cost] = {}
        self._rates: list[float] = []
        self._fastest: float | None = None
        self._total = Cost()
        self._changed_at: float | None = None
        self._lock = threading.Lock()
        self._writing = threading.Lock()

    def add(self, index: Index, cost: Cost) -> None:
        """Add the cost of a task that baked the chunk ``index``."""
        with self._lock:
            self._add(index, cost)
            if self._changed_at is None:
                self._changed_at = self._clock()

    def rate(self, index: Index) -> float | None:
        """Return the seconds per path of a chunk, as measured there,
        else the common rate; None before the first task.
        """
        with self._lock:
            measured = self._chunks.get(index, Cost()).rate
            return self._common_rate if measured is None else measured

    def of(self, indices: Iterable[Index]) -> Cost:
        """Return the sum of the costs of some chunks."""
        with self._lock:
            return reduce(
                Cost.plus,
                (self._chunks[index] for index in indices if index in self._chunks),
                Cost(),
            )

    @property
    def total(self) -> Cost:
        """The costs of all chunks together."""
        return self._total

    @property
    def _common_rate(self) -> float | None:
        """The median rate of all chunks, in processor seconds per path. The caller must hold the
        lock.

        Before any chunk has a rate, all paths were of first light. Then it is the lowest number of
        seconds per path of any task, None before the first task. The seconds of first light include
        work that is done once a texel, so the lowest number is nearest to the cost of a path.
        """
        # Counted from either end, this is the middle: one rate, or two if their number is even.
        middle = len(self._rates) // 2
        if self._rates:
            return (self._rates[middle] + self._rates[~middle]) / 2
        return self._fastest

    def _add(self, index: Index, cost: Cost) -> None:
        """Add a cost to that of the chunk ``index``, and update total and rates.

        The caller must hold the lock.
        """
        before = self._chunks.get(index, Cost())
        after = self._chunks[index] = before.plus(cost)
        self._total = self._total.plus(cost)
        # Replace the chunk's rate in the sorted list, so that the median needs no sort.
        if before.rate is not None:
            del self._rates[bisect_left(self._rates, before.rate)]
        if after.rate is not None:
            insort(self._rates, after.rate)
        if cost.paths:
            self._fastest = min(cost.seconds / cost.paths, self._fastest or math.inf)

    def read(self) -> None:
        """Add the costs in the store to those in memory. Call it once, as a second call would count
        them twice.

        Nothing is added if there are no costs in the store, or if they are damaged or cannot be
        read. The last two are logged; no error is raised.
        """
        try:
            found = self._store.get(self._key)
            if found is None:
                return
            chunks = costs_in(found.data)
        except Exception as error:
            log.info("The costs of earlier baking cannot be read: %s", error)
            return
        with self._lock:
            for index, cost in chunks.items():
                self._add(index, cost)

    def save(self, at_once: bool = True) -> None:
        """Write the costs to the store if they have changed; without ``at_once`` only if the first
        unsaved change is at least SAVE_EVERY seconds old.

        If that fails, it is logged, and the costs count as changed just now, so that a later call
        tries again. Nothing is written to a read-only store.
        """
        if self._store.read_only:
            return
        with self._writing:
            with self._lock:
                if self._changed_at is None:
                    return
                if not at_once and self._clock() - self._changed_at < SAVE_EVERY:
                    return
                # Costs that are added during the write mark themselves as changed again.
                self._changed_at = None
                chunks = {
                    "/".join(map(str, index)): list(cost) for index, cost in self._chunks.items()
                }
            try:
                group = {"zarr_format": 3, "node_type": "group", "attributes": {"chunks": chunks}}
                self._store.put(self._key, json.dumps(group).encode(), self._store.get(self._key))
            except Exception as error:
                log.warning("The costs of baking cannot be stored: %s", error)
                with self._lock:
                    self._changed_at = self._clock()


def costs_in(stored: bytes) -> dict[Index, Cost]:
    """Return the costs of chunks in an object of the store.

    Raises errors of many kinds if it is damaged.
    """
    kept: Any = json.loads(stored)["attributes"]["chunks"]
    return {
        place(key): Cost(float(s), int(p), int(t), float(f)) for key, (s, p, t, f) in kept.items()
    }


def place(key: str) -> Index:
    """Return the index of the chunk that a key z/y/x names."""
    z, y, x = map(int, key.split("/"))
    return z, y, x
