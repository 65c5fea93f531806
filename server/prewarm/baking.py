"""The baking of a prewarm: what it works with, a few chunks at a time, and the rehearsal that
forecasts its cost.

Of what is rehearsed nothing is kept: it measures what ``worker.progress`` estimates by.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from itertools import groupby, islice
from pathlib import Path

import numpy as np

from isogi_core.bake.bake_spec import BakeSpec
from isogi_core.bake.noise import Effort, Until, relative_error
from isogi_core.bake.refine import refine
from isogi_core.bake.texel_light import FIRST_LEVEL, Light
from isogi_core.cache.chunk_record import Chunk
from isogi_core.cache.chunk_store import ChunkStore
from isogi_core.cache.costs import Cost
from isogi_core.cache.scene_caches import Caches
from isogi_core.errors import Cancelled
from isogi_core.frame.demand import Demand
from isogi_core.frame.frame import Frame
from isogi_core.frame.rays.picture_plan import Prices
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.texel_reading import Stage
from isogi_core.model.view import View
from isogi_core.model.volume import Isovalue
from isogi_core.plan.scene import Scene
from isogi_core.prepared.prepared_scene import Index
from isogi_core.storage.backend import StoreUrl
from server.render.bakes import BackgroundBake, Patience
from server.render.engine import RenderEngine
from server.settings import cores
from worker.bake_requests import Viewer, next_until
from worker.errors import WorkersError
from worker.progress import (
    PER_TASK,
    ChunkCost,
    CostEstimate,
    Pace,
    TimeEstimator,
    TimeLeft,
    extrapolated,
    relative_standard_error,
    seconds_per_texel,
)
from worker.tasks import BakeTask, cost_of, load_kernels, results_of, sample_texels


@dataclass(frozen=True)
class Step:
    """How far a prewarm is: ``done`` of ``total`` ``unit``s of ``what`` it does now, and the time
    that the rest takes.

    ``share`` is the share of all its work that is done.
    """

    what: str
    unit: str
    done: int
    total: int
    share: float
    left: TimeLeft | None = None

    def __str__(self) -> str:
        """For a person."""
        return f"{self.what}: {self.done:,} of {self.total:,} {self.unit}s."


@dataclass(frozen=True)
class Batch:
    """What is baked together: texels of one bake, until they have ``enough`` samples.

    They are projected onto an isosurface where one is ``shown``, finer than the plan's by
    ``fineness`` steps, and of the ``side`` of several surfaces whose light has this digest, kept in
    ``caches``; of the scene's own where it is empty.
    """

    shown: Isovalue | None
    enough: int = FIRST_LEVEL
    fineness: int = 0
    side: str = ""
    caches: Caches | None = field(default=None, compare=False, repr=False)

    @property
    def order(self) -> tuple[bool, float, int, str, int]:
        """Sorts batches: texels on their own isosurfaces first, and the fewest samples first."""
        return (
            self.shown is not None,
            float(self.shown or 0.0),
            self.fineness,
            self.side,
            self.enough,
        )

    @property
    def usual(self) -> bool:
        """Whether the texels are the scene's own."""
        return not (self.fineness or self.side)


@dataclass(eq=False)
class PrewarmContext:
    """What a prewarm of one ``scene`` to a ``target`` error works with, for a ``viewer``.

    ``frame_of`` makes the frame of a view with the light baked so far; ``refine`` takes one step of
    the check of its picture, which weighs its ways at given prices, and says whether there was one;
    it raises Cancelled once an event is set.
    ``report`` takes each step, and ``cancelled`` stops it. Baking ends at ``deadline``, and the
    workers are taken for broken after ``patience`` seconds without anything new. Texels of whole
    isosurfaces are to have as many samples as ``rung`` at least; ``climbed`` is told when they are
    to have more.
    """

    engine: RenderEngine
    scene: Scene
    target: float
    viewer: Viewer
    frame_of: Callable[[View], Frame]
    refine: Callable[[View, Prices, threading.Event], bool]
    report: Callable[[Step], None]
    deadline: float = math.inf
    patience: float = math.inf
    cancelled: threading.Event = field(default_factory=threading.Event)
    begun: float = field(default_factory=time.monotonic)
    rung: int = FIRST_LEVEL
    climbed: Callable[[int], None] = lambda _: None

    @property
    def renderer(self) -> Renderer:
        """The renderer of the scene."""
        return self.engine.renderer(self.scene.id)

    def store_of(self, batch: Batch) -> ChunkStore:
        """The chunk store that a batch is baked into."""
        caches = batch.caches or self.engine.renderer(self.scene.id, batch.fineness).caches
        return caches.chunk_store_of(batch.shown)

    def bake_of(self, batch: Batch, demands: Iterable[Demand]) -> tuple[str, Stage]:
        """The name of the bake that a batch is of, and the stage that has these ``demands`` of it
        baked.
        """
        stage = Stage(tuple(demands), self.target, batch.enough, batch.caches)
        return self.engine.bake_at(self.scene.id, "gi", stage, batch.fineness), stage

    @property
    def seconds(self) -> float:
        """Seconds since it began."""
        return time.monotonic() - self.begun

    @property
    def left(self) -> float:
        """Seconds until the deadline, none once it is over."""
        return max(self.deadline - time.monotonic(), 0.0)

    def late(self, end: float) -> bool:
        """Whether the monotonic clock is at the ``end``. Raises Cancelled where it was stopped."""
        self.check()
        return time.monotonic() >= end

    def check(self) -> None:
        """Raises Cancelled where it was stopped."""
        if self.cancelled.is_set():
            raise Cancelled("This prewarm was stopped.")


REPORT_SECONDS = 1.0
"""Seconds between two reports of how far the baking is."""

CHUNKS_PER_PART = 64
PARTS_AT_ONCE = 3
"""Chunks that are asked for together, at least, and how many such parts at once."""

ASSUMED_TIME_RATIOS = (0.6, 0.8, 1.0, 1.25, 1.6)
"""Times that baking takes over those forecast, before any is known."""

Wish = tuple[Batch, Demand]
"""A chunk's texels that are to be baked, and the batch that they are of."""


@dataclass(frozen=True)
class Expected:
    """How long a round of baking is expected to take, and the rounds ``later``: seconds of all
    workers together.

    ``span`` is where in all of the work the round begins and ends, as shares of it.
    """

    seconds: float
    later: float
    span: tuple[float, float]


class Baking:
    """One round: has what is wanted baked, chunks first of which most is seen, batch after batch.

    It ends at ``end``, by the monotonic clock; ``done`` chunks are baked or given up by then, and
    ``failures`` says why the latter were.
    """

    def __init__(
        self, context: PrewarmContext, wishes: Iterable[Wish], expected: Expected, end: float
    ) -> None:
        """Ask for nothing yet."""
        self.wishes = sorted(wishes, key=lambda wish: (wish[0].order, -wish[1].weight))
        self.failures: dict[Index, str] = {}
        self.done = 0
        self._context = context
        self._end = end
        self._expected = expected
        self._estimator = TimeEstimator(prior=ASSUMED_TIME_RATIOS)
        self._pace = Pace(time.monotonic)
        self._worked = 0.0
        self._open: list[tuple[Batch, BackgroundBake]] = []
        self._waiting: deque[tuple[Batch, list[Demand]]] = deque()
        self._patience = Patience(context.patience)
        self._before = self._cost()

    @property
    def late(self) -> bool:
        """Whether the time is over, and not all chunks are baked or given up."""
        return self.done < len(self.wishes) and time.monotonic() >= self._end

    @property
    def spent(self) -> Cost:
        """The paths and the seconds of the processor that these chunks took meanwhile."""
        now = self._cost()
        before = self._before
        return Cost(now.seconds - before.seconds, now.paths - before.paths)

    def run(self) -> None:
        """Bake until all is, or the time is over; nothing more is wanted then. Raises WorkersError,
        and Cancelled.
        """
        self._waiting.extend(self._parts())
        try:
            while not self.late and self._filled():
                self._report()
                self._wait()
                self._settle()
            self._report()
        finally:
            self._context.engine.leave(self._context.viewer)

    def _parts(self) -> Iterator[tuple[Batch, list[Demand]]]:
        size = max(CHUNKS_PER_PART, 2 * self._context.engine.baker.workers)
        for batch, group in groupby(self.wishes, lambda wish: wish[0]):
            while part := [demand for _, demand in islice(group, size)]:
                yield batch, part

    def _filled(self) -> bool:
        """Ask for more where there is room; whether anything is asked for.

        A batch begins when the one before has ended: together, texels of a chunk would be taken to
        the samples of that which wants more.
        """
        context = self._context
        waiting = self._waiting
        while (
            waiting
            and len(self._open) < PARTS_AT_ONCE
            and all(batch == waiting[0][0] for batch, _ in self._open)
        ):
            batch, demands = waiting.popleft()
            bake, stage = context.bake_of(batch, demands)
            self._open.append((batch, context.engine.bake(bake, stage, context.viewer)))
        return bool(self._open)

    def _wait(self) -> None:
        """Wait for the oldest part, not long. Raises Cancelled, and WorkersError where nothing
        comes.
        """
        context = self._context
        now = time.monotonic()
        context.check()
        engine = context.engine
        if engine.workforce.missing:
            raise WorkersError(engine.workforce.missing)
        self._patience.check(engine.baker.paths, engine.workforce.preparing, engine.unready())
        self._open[0][1].wait(max(min(REPORT_SECONDS, self._end - now), 0.0))

    def _settle(self) -> None:
        """Count what is baked or given up."""
        for part in [each for each in self._open if not each[1].waiting()]:
            self._open.remove(part)
            self.done += len(part[1].chunks)
            self.failures |= part[1].failures()

    def _report(self) -> None:
        """Say how far it is, and what the rest takes."""
        total = len(self.wishes)
        open_now = [baking for _, baking in self._open]
        done = self.done + sum(len(each.chunks) - each.waiting() for each in open_now)
        (first, last) = self._expected.span
        share = done / max(total, 1)
        self._context.report(
            Step("Baking", "chunk", done, total, first + (last - first) * share, self._left(share))
        )

    def _left(self, share: float) -> TimeLeft:
        """The time that the rest takes once a ``share`` is done, at the pace of late."""
        workers = self._context.engine.baker.workers
        round_seconds = self._expected.seconds / workers
        later = self._expected.later / workers
        worked = share * round_seconds
        self._pace.working(1)
        self._pace.spent(worked - self._worked)
        self._worked = worked
        return self._estimator.estimate("baking", round_seconds - worked + later, worked).times(
            self._pace.value
        )

    def _cost(self) -> Cost:
        chunks: dict[str, set[Index]] = {}
        for batch, group in groupby(self.wishes, lambda wish: wish[0]):
            demands = [demand for _, demand in group]
            bake, _ = self._context.bake_of(batch, demands)
            chunks.setdefault(bake, set()).update(each.index for each in demands)
        total = Cost()
        for bake, indices in chunks.items():
            total = total.plus(self._context.engine.baker.spent(bake, indices))
        return total


UNREACHED_ERROR = 1e-9
"""A target error that the first paths do not reach."""

SCHEDULED = Path("/proc/thread-self/schedstat")
"""Where Linux counts the nanoseconds that a thread ran, and those that it could have run but had no
core.
"""


def rehearse(
    renderer: Renderer, demand: Demand, until: Until, most: float, cancelled: threading.Event
) -> ChunkCost:
    """Bake what a chunk lacks ``until`` then, and measure it; beyond ``most`` seconds the cost is
    extrapolated.
    """
    store = renderer.caches.chunk_store_of(demand.shown)
    spec = store.spec
    texels = spec.prepared.lattice.positions(demand.index, demand.offsets)
    maps = first_light(spec, texels) - first_light(spec, texels)
    chunk = store.load(demand.index).with_texels(demand.offsets)
    rows = chunk.rows_of(demand.offsets)
    light = chunk.light.rows(rows)
    begun = ready_time()
    processor = time.thread_time()
    tasks, paths = climb_all(
        light, texels, spec, demand, until, (time.perf_counter() + most, cancelled)
    )
    more = 1.0 + Effort.of(relative_error(light, spec), light.samples, *until).left / max(paths, 1)
    seconds = ready_time() - begun
    processor = time.thread_time() - processor
    chunk.light.put(rows, light)
    begun = ready_time()
    stored = stored_size(store, chunk)
    seconds += tasks * (ready_time() - begun)
    return ChunkCost(
        len(texels), more * seconds, more * processor, tasks * more, max(maps, 0.0), stored
    )


def ready_time() -> float:
    """Seconds that this thread ran, or could have run; on systems that do not say, those by the
    clock.
    """
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
    """Do the tasks of a chunk to its ``light``, in place: how many, and their paths. Ends at its
    ``limit``.
    """
    effort = demand.effort
    tasks = 0
    paths = 0
    while True:
        place = (spec.prepared.scene.source, spec.plan, spec.digest, StoreUrl(""), demand.index)
        what = demand.offsets, demand.footprints, next_until(effort), until.target
        task = BakeTask(*place, *what, enough=until.enough)
        before = light.samples
        since = time.thread_time()
        sample_texels(light, texels, spec, task)
        cost = cost_of(light.samples, before, time.thread_time() - since)
        result = replace(results_of(light, spec, [task])[0], cost=cost)
        tasks = tasks + 1
        paths = paths + cost.paths
        if not result.unfinished or time.perf_counter() > limit[0] or limit[1].is_set():
            return tasks, paths
        effort = result.effort


def first_light(spec: BakeSpec, texels: np.ndarray) -> float:
    """Seconds that the first paths of texels take; maps that they need are made, where they are not
    kept.
    """
    begun = ready_time()
    refine(Light.dark(spec.plan, len(texels)), texels, spec, FIRST_LEVEL, UNREACHED_ERROR)
    return ready_time() - begun


def stored_size(store: ChunkStore, chunk: Chunk) -> int:
    """Bytes that a chunk's objects would take."""
    pairs = zip(store.layers, chunk.light.parts, strict=True)
    return sum(len(layer.encode(chunk.index, chunk.offsets, part)) for layer, part in pairs)


MOST_TRIED = 48
FEWEST_TRIED = 8
"""Chunks that are rehearsed, at most, and before it may be called enough."""

SUFFICIENT_RELATIVE_ERROR = 0.04
"""Standard error of the mean, over the mean, at which it is enough."""

DISPATCH = 0.006
"""Processor seconds of a task that the process which hands it out takes; it needs a core too."""

WORKER_START_SECONDS = 1.5
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
    threads = min(workers, cores())
    chosen = stratified(demands)
    tried = Tried(budget, cancelled)
    with ThreadPoolExecutor(threads, "rehearsal") as pool:
        for ended in [
            pool.submit(tried.go_through, renderer, chosen, until) for _ in range(threads)
        ]:
            ended.result()
    texels = sum(len(demand.offsets) for demand in demands)
    per_task = PER_TASK + DISPATCH * (workers >= cores())
    return extrapolated(tried.all, texels, len(tried.all) == len(demands), per_task)


class Tried:
    """Rehearsals, of as many chunks as it takes; ``budget`` seconds are for all of them."""

    def __init__(self, budget: float, cancelled: threading.Event) -> None:
        """Have tried nothing yet."""
        self.all: list[ChunkCost] = []
        self._each = budget / 4.0
        self._end = time.monotonic() + budget
        self._cancelled = cancelled
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
            known = (
                len(self.all) >= FEWEST_TRIED
                and relative_standard_error(seconds_per_texel(self.all))
                <= SUFFICIENT_RELATIVE_ERROR
            )
        return (
            known or (bool(self.all) and time.monotonic() > self._end) or self._cancelled.is_set()
        )


def stratified(demands: Sequence[Demand]) -> Iterator[Demand]:
    """At most MOST_TRIED demands, spread evenly over all texels, so that large chunks come more
    often than small ones.

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
