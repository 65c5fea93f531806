"""The rehearsal of a few chunks, of which nothing is kept: it measures what ``worker.progress`` estimates by."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np

from isogi_core.bake.bake_spec import BakeSpec
from isogi_core.bake.noise import Effort, Until, relative_error
from isogi_core.bake.precision import FIRST_LEVEL
from isogi_core.bake.refine import refine
from isogi_core.bake.texel_light import Light
from isogi_core.cache.chunk import Chunk
from isogi_core.cache.chunk_store import ChunkStore
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.view_texels import Demand
from isogi_core.storage.url import StoreUrl
from server.settings import cores
from worker.bake_requests import next_until
from worker.kernels import load_kernels
from worker.progress import (
    PER_TASK,
    ChunkCost,
    CostEstimate,
    extrapolated,
    relative_standard_error,
    seconds_per_texel,
)
from worker.tasks import BakeTask, cost_of, results_of, sample_texels

NEVER = 1e-9
"""A target error that the first paths do not reach."""

SCHEDULED = Path("/proc/thread-self/schedstat")
"""Where Linux counts the nanoseconds that a thread ran, and those that it could have run but had no core."""


def rehearse(renderer: Renderer, demand: Demand, until: Until, most: float, cancelled: threading.Event) -> ChunkCost:
    """Bake what a chunk lacks ``until`` then, and measure it; beyond ``most`` seconds the cost is extrapolated."""
    store = renderer.caches.chunk_store_of(demand.shown)
    spec = store.spec
    texels = spec.prepared.lattice.positions(demand.index, demand.offsets)
    maps = first_light(spec, texels) - first_light(spec, texels)
    chunk = store.load(demand.index).with_texels(demand.offsets)
    rows = chunk.rows_of(demand.offsets)
    light = chunk.light.rows(rows)
    begun, processor = ready_time(), time.thread_time()
    tasks, paths = climb_all(light, texels, spec, demand, until, (time.perf_counter() + most, cancelled))
    more = 1.0 + Effort.of(relative_error(light, spec), light.samples, *until).left / max(paths, 1)
    seconds, processor = ready_time() - begun, time.thread_time() - processor
    chunk.light.put(rows, light)
    begun = ready_time()
    stored = stored_size(store, chunk)
    seconds += tasks * (ready_time() - begun)
    return ChunkCost(len(texels), more * seconds, more * processor, tasks * more, max(maps, 0.0), stored)


def ready_time() -> float:
    """Seconds that this thread ran, or could have run; on systems that do not say, those by the clock."""
    try:
        ran, waited, *_ = SCHEDULED.read_text(encoding="ascii").split()
    except OSError:
        return time.perf_counter()
    return (int(ran) + int(waited)) * 1e-9


def climb_all(
    light: Light,
    texels: np.ndarray,
    spec: BakeSpec,
    demand: Demand,
    until: Until,
    limit: tuple[float, threading.Event],
) -> tuple[int, int]:
    """Do the tasks of a chunk to its ``light``, in place: how many, and their paths. Ends at its ``limit``."""
    effort, tasks, paths = demand.effort, 0, 0
    while True:
        place = (spec.prepared.scene.source, spec.plan, spec.digest, StoreUrl(""), demand.index)
        what = demand.offsets, demand.footprints, next_until(effort), until.target
        task = BakeTask(*place, *what, enough=until.enough)
        before, since = light.samples, time.thread_time()
        sample_texels(light, texels, spec, task)
        cost = cost_of(light.samples, before, time.thread_time() - since)
        result = replace(results_of(light, spec, [task])[0], cost=cost)
        tasks, paths = tasks + 1, paths + cost.paths
        if not result.unfinished or time.perf_counter() > limit[0] or limit[1].is_set():
            return tasks, paths
        effort = result.effort


def first_light(spec: BakeSpec, texels: np.ndarray) -> float:
    """Seconds that the first paths of texels take; maps that they need are made, where they are not kept."""
    begun = ready_time()
    refine(Light.dark(spec.plan, len(texels)), texels, spec, FIRST_LEVEL, NEVER)
    return ready_time() - begun


def stored_size(store: ChunkStore, chunk: Chunk) -> int:
    """Bytes that a chunk's objects would take."""
    pairs = zip(store.layers, chunk.light.parts, strict=True)
    return sum(len(layer.encode(chunk.index, chunk.offsets, part)) for layer, part in pairs)


MOST_TRIED, FEWEST_TRIED = 48, 8
"""Chunks that are rehearsed, at most, and before it may be called enough."""

SURE = 0.04
"""Standard error of the mean, over the mean, at which it is enough."""

DISPATCH = 0.006
"""Processor seconds of a task that the process which hands it out takes; it needs a core too."""

START = 1.5
"""Seconds until workers have come, and have their kernels, beyond the time of the survey."""


def forecast(
    renderer: Renderer,
    demands: Sequence[Demand],
    until: Until,
    workers: int,
    budget: float,
    cancelled: threading.Event,
) -> CostEstimate:
    """Estimate the cost of the demands, baked ``until`` then, within about ``budget`` seconds.

    As many chunks are rehearsed at once as there are workers, for these share what a core has.
    """
    if not demands:
        return CostEstimate()
    load_kernels(renderer.caches.spec("gi").kinds)
    threads, chosen = min(workers, cores()), stratified(demands)
    tried = Tried(budget, cancelled)
    with ThreadPoolExecutor(threads, "rehearsal") as pool:
        for ended in [pool.submit(tried.go_through, renderer, chosen, until) for _ in range(threads)]:
            ended.result()
    texels, per_task = sum(len(demand.offsets) for demand in demands), PER_TASK + DISPATCH * (workers >= cores())
    return extrapolated(tried.all, texels, len(tried.all) == len(demands), per_task)


class Tried:
    """Rehearsals, of as many chunks as it takes; ``budget`` seconds are for all of them."""

    def __init__(self, budget: float, cancelled: threading.Event) -> None:
        """Have tried nothing yet."""
        self.all: list[ChunkCost] = []
        self._each, self._end, self._cancelled = budget / 4.0, time.monotonic() + budget, cancelled
        self._lock = threading.Lock()

    def go_through(self, renderer: Renderer, demands: Iterator[Demand], until: Until) -> None:
        """Rehearse what comes next until it is enough; several threads may."""
        while not self._enough() and (demand := self._next(demands)):
            one = rehearse(renderer, demand, until, self._each, self._cancelled)
            with self._lock:
                self.all.append(one)

    def _next(self, demands: Iterator[Demand]) -> Demand | None:
        with self._lock:
            return next(demands, None)

    def _enough(self) -> bool:
        """Whether the time is over, or the mean is known well enough."""
        with self._lock:
            known = len(self.all) >= FEWEST_TRIED and relative_standard_error(seconds_per_texel(self.all)) <= SURE
        return known or (bool(self.all) and time.monotonic() > self._end) or self._cancelled.is_set()


def stratified(demands: Sequence[Demand]) -> Iterator[Demand]:
    """At most MOST_TRIED demands, spread evenly over all texels, so that large chunks come more often than small ones.

    All of them where they are few.
    """
    if len(demands) <= FEWEST_TRIED:
        return iter(demands)
    ordered = sorted(demands, key=lambda demand: demand.index)
    ends = np.cumsum([len(demand.offsets) for demand in ordered])
    places = (radical_inverse(n) * ends[-1] for n in range(1, 8 * MOST_TRIED))
    taken = dict.fromkeys(int(np.searchsorted(ends, place, "right")) for place in places)
    return islice((ordered[number] for number in taken), MOST_TRIED)


def radical_inverse(number: int) -> float:
    """Van der Corput's sequence to base 2: each part of it is spread evenly over [0, 1)."""
    return int(f"{number:032b}"[::-1], 2) / 2.0**32
