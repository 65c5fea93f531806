"""Costs: what baking took, chunk by chunk. Kept beside the light, so that time left can be told after a restart.

Chunks are the same bytes whoever bakes them, and so say nothing of time; one small object a bake does. It is
written whole, by the process that owns the queue; where it is lost, times are measured anew.
"""

import json
import logging
import statistics
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from zarr.core.buffer import default_buffer_prototype
from zarr.core.common import AccessModeLiteral
from zarr.core.sync import sync
from zarr.storage import StorePath
from zarr.storage._common import make_store_path

from isogi_core.bake.recipe import Index

log = logging.getLogger("isogi.cache")

SAVE_EVERY = 30.0
"""Seconds after which costs that have grown are written again."""


class Cost(NamedTuple):
    """Processor seconds that were spent on ``paths`` of light; of so many ``texels`` they were the first."""

    seconds: float = 0.0
    paths: int = 0
    texels: int = 0

    def plus(self, other: "Cost") -> "Cost":
        """Both together."""
        return Cost(self.seconds + other.seconds, self.paths + other.paths, self.texels + other.texels)


class Costs:
    """The costs of the bake ``digest`` in the store under ``root``, a folder or URL. Safe to use from many threads."""

    def __init__(self, root: str | Path, digest: str, clock: Callable[[], float] = time.monotonic) -> None:
        """Know nothing yet."""
        self._root, self._path = str(root).removeprefix("file://"), f"costs/{digest}.json"
        self._clock = clock
        self._chunks: dict[Index, Cost] = {}
        self._total = Cost()
        self._common: float | None = None
        self._grown: float | None = None
        self._lock = threading.Lock()

    def add(self, index: Index, cost: Cost) -> None:
        """Take in what a task at a chunk took."""
        with self._lock:
            self._chunks[index] = self._chunks.get(index, Cost()).plus(cost)
            self._total, self._common = self._total.plus(cost), None
            self._grown = self._clock() if self._grown is None else self._grown

    def rate(self, index: Index) -> float | None:
        """Seconds that a path from a chunk takes: as measured there, else the median of all; None before the first."""
        with self._lock:
            own = self._chunks.get(index)
            if own is not None and own.paths:
                return own.seconds / own.paths
            if self._common is None and self._total.paths:
                self._common = statistics.median(cost.seconds / cost.paths for cost in self._lit)
            return self._common

    @property
    def total(self) -> Cost:
        """The costs of all chunks together."""
        return self._total

    @property
    def _lit(self) -> list[Cost]:
        return [cost for cost in self._chunks.values() if cost.paths]

    def read(self) -> None:
        """Take over what the store has. What is missing or damaged there counts as unknown."""
        try:
            stored = sync(self._place("r").get())
            chunks = {place(key): Cost(float(s), int(p), int(t)) for key, (s, p, t) in parse(stored).items()}
        except FileNotFoundError:
            return
        except Exception as error:
            log.info("What the bake took before is unknown: %s", error)
            return
        with self._lock:
            for index, cost in chunks.items():
                self._chunks[index] = self._chunks.get(index, Cost()).plus(cost)
                self._total, self._common = self._total.plus(cost), None

    def save(self, at_once: bool = True) -> None:
        """Write what has grown, or only what has been waiting for SAVE_EVERY seconds. A store that cannot is told."""
        with self._lock:
            if self._grown is None or not (at_once or self._clock() - self._grown >= SAVE_EVERY):
                return
            self._grown = None
            text = json.dumps({"/".join(map(str, index)): cost for index, cost in self._chunks.items()})
        try:
            sync(self._place("a").set(default_buffer_prototype().buffer.from_bytes(text.encode())))
        except Exception as error:
            log.warning("What the bake took cannot be kept: %s", error)

    def _place(self, mode: AccessModeLiteral) -> StorePath:
        """Where the object is, or is to be; FileNotFoundError where there is no such store to be read."""
        return sync(make_store_path(self._root, path=self._path, mode=mode))


def parse(stored: "object | None") -> dict[str, list[float]]:
    """The chunks in an object; none where there is none."""
    return {} if stored is None else json.loads(stored.to_bytes())  # type: ignore[attr-defined]


def place(key: str) -> Index:
    """The chunk that a key names: z/y/x."""
    z, y, x = map(int, key.split("/"))
    return z, y, x
