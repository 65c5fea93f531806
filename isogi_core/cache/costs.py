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

from isogi_core.bake.precision import FIRST_RUNG
from isogi_core.bake.recipe import Index

log = logging.getLogger("isogi.cache")

SAVE_EVERY = 30.0
"""Seconds after which costs that have grown are written again."""


class Cost(NamedTuple):
    """Processor seconds that were spent on ``paths`` of light; of so many ``texels`` they were the first.

    The first light of a texel takes ``first`` of these seconds: it comes with work that is done once.
    """

    seconds: float = 0.0
    paths: int = 0
    texels: int = 0
    first: float = 0.0

    @property
    def rate(self) -> float | None:
        """Seconds that a path takes after the first light; None where there was none."""
        paths = self.paths - FIRST_RUNG * self.texels
        return (self.seconds - self.first) / paths if paths > 0 else None

    def plus(self, other: "Cost") -> "Cost":
        """Both together."""
        return Cost(*(mine + theirs for mine, theirs in zip(self, other, strict=True)))  # type: ignore[arg-type]


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
        """Seconds that a path from a chunk takes: as measured there, else what is common; None before the first."""
        with self._lock:
            own = self._chunks.get(index, Cost()).rate
            if self._common is None and own is None:
                self._common = self._usual()
            return self._common if own is None else own

    @property
    def total(self) -> Cost:
        """The costs of all chunks together."""
        return self._total

    def _usual(self) -> float | None:
        """The median rate of all chunks; before there is one, that of the first light that came fastest."""
        rates = [cost.rate for cost in self._chunks.values() if cost.rate is not None]
        first = (cost.seconds / cost.paths for cost in self._chunks.values() if cost.paths)
        return statistics.median(rates) if rates else min(first, default=None)

    def read(self) -> None:
        """Take over what the store has. What is missing or damaged there counts as unknown."""
        try:
            stored = sync(self._place("r").get())
            chunks = {
                place(key): Cost(float(s), int(p), int(t), float(f)) for key, (s, p, t, f) in parse(stored).items()
            }
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
