"""The baking of a prewarm, a few chunks at a time, and the rehearsal that forecasts its cost.

A rehearsal bakes some chunks in this process without keeping their light, to measure the costs from
which ``isogi_worker.progress`` estimates the whole.
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
from isogi_core.bake.noise import Effort, Goal, relative_error
from isogi_core.bake.refine import refine
from isogi_core.bake.texel_light import FIRST_LEVEL, Light
from isogi_core.cache.chunk_record import Chunk
from isogi_core.cache.chunk_store import ChunkStore
from isogi_core.cache.costs import TASK_OVERHEAD_SECONDS, Cost
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
from isogi_server.render.bakes import BackgroundBake
from isogi_server.render.engine import RenderEngine
from isogi_server.render.patience import Patience
from isogi_server.settings import cores
from isogi_worker.bake_requests import Viewer, next_until
from isogi_worker.errors import WorkersError
from isogi_worker.progress import (
    ChunkCost,
    CostEstimate,
    Pace,
    TimeEstimator,
    TimeLeft,
    extrapolated,
    relative_standard_error,
    seconds_per_texel,
)
from isogi_worker.tasks import BakeTask, cost_of, load_kernels, results_of, sample_texels


@dataclass(frozen=True)
class Step:
    """A report of progress: ``done`` of ``total`` ``unit``s of ``what`` the prewarm does now, and
    the time that the rest takes.

    ``share`` is the share of all its work that is done.
    """

    what: str
    unit: str
    done: int
    total: int
    share: float
    left: TimeLeft | None = None

    def __str__(self) -> str:
        """Return the report as a sentence."""
        return f"{self.what}: {self.done:,} of {self.total:,} {self.unit}s."


@dataclass(frozen=True)
class Batch:
    """A set of texels that are baked together, until they reach a ``goal``.

    - ``shown``: if given, texels are projected onto that isosurface.
    - ``fineness``: steps by which the lattice is finer than the plan's.
    - ``side``, ``caches``: digest and caches of the light of one side of several surfaces; empty
      for the scene's light.
    """

    shown: Isovalue | None
    goal: Goal
    fineness: int = 0
    side: str = ""
    caches: Caches | None = field(default=None, compare=False, repr=False)

    @property
    def order(self) -> tuple[bool, float, int, str, int]:
        """Key that sorts batches:
        texels on their own isosurfaces come first, and fewer samples before more.
        """
        return (
            self.shown is not None,
            float(self.shown or 0.0),
            self.fineness,
            self.side,
            self.goal.samples,
        )

    @property
    def light(self) -> tuple[Isovalue | None, int, str]:
        """Key of the light that its texels have, equal for batches of different goals."""
        return self.shown, self.fineness, self.side

    @property
    def usual(self) -> bool:
        """True if the texels are those of the scene's light."""
        return not (self.fineness or self.side)


@dataclass(eq=False)
class PrewarmContext:
    """The things that a prewarm of one ``scene`` works with, for a ``viewer``.

    - ``goal``: of its pictures.
    - ``frame_of``: return the frame of a view with the light baked so far.
    - ``refine``: take one step of the check of a view's picture, at given prices; return False if
      there is none to take. Raises Cancelled once the event is set.
    - ``report``: called with each step of progress.
    - ``deadline``: monotonic time at which baking ends.
    - ``patience``: seconds without anything new after which the workers are taken for broken.
    - ``cancelled``: stops the prewarm when it is set.
    - ``rung``: samples that texels of whole isosurfaces are to have at least; ``rung_rose`` is
      called if it grows.
    """

    engine: RenderEngine
    scene: Scene
    goal: Goal
    viewer: Viewer
    frame_of: Callable[[View], Frame]
    refine: Callable[[View, Prices, threading.Event], bool]
    report: Callable[[Step], None]
    deadline: float = math.inf
    patience: float = math.inf
    cancelled: threading.Event = field(default_factory=threading.Event)
    begun: float = field(default_factory=time.monotonic)
    rung: int = FIRST_LEVEL
    rung_rose: Callable[[int], None] = lambda _: None

    @property
    def renderer(self) -> Renderer:
        """The renderer of the scene."""
        return self.engine.renderer(self.scene.id)

    def store_of(self, batch: Batch) -> ChunkStore:
        """Return the chunk store that a batch is baked into."""
        caches = batch.caches or self.engine.renderer(self.scene.id, batch.fineness).caches
        return caches.chunk_store_of(batch.shown)

    def goal_at(self, rung: int) -> Goal:
        """Return the goal of texels that are to have ``rung`` samples, or to be good enough by
        themselves.
        """
        return self.goal._replace(samples=rung)

    def bake_of(self, batch: Batch, demands: Iterable[Demand]) -> tuple[str, Stage]:
        """Return the name of the bake of a batch, and a stage with these ``demands`` of it."""
        stage = Stage(tuple(demands), batch.goal, batch.caches)
        return self.engine.bake_at(self.scene.id, "gi", stage, batch.fineness), stage

    @property
    def seconds(self) -> float:
        """Seconds since the prewarm began."""
        return time.monotonic() - self.begun

    @property
    def left(self) -> float:
        """Seconds until the deadline, 0 after it."""
        return max(self.deadline - time.monotonic(), 0.0)

    def late(self, end: float) -> bool:
        """Return True if the monotonic clock has reached ``end``.

        Raises Cancelled if the prewarm was stopped.
        """
        self.check()
        return time.monotonic() >= end

    def check(self) -> None:
        """Raise Cancelled if the prewarm was stopped."""
        if self.cancelled.is_set():
            raise Cancelled("This prewarm was stopped.")


REPORT_SECONDS = 1.0
"""Seconds between two reports of progress."""

CHUNKS_PER_PART = 64
PARTS_AT_ONCE = 3
"""Least number of chunks that are requested together, and most of such parts at a time."""

ASSUMED_TIME_RATIOS = (0.6, 0.8, 1.0, 1.25, 1.6)
"""Assumed ratios of true to forecast times of baking, before any is measured."""

Wish = tuple[Batch, Demand]
"""Texels of a chunk that are to be baked, with the batch that they belong to."""


@dataclass(frozen=True)
class Expected:
    """The forecast of a round of baking, in ``seconds`` of all workers together, and of the rounds
    ``later``.

    ``span`` are the shares of all work at which the round begins and ends.
    """

    seconds: float
    later: float
    span: tuple[float, float]


class Baking:
    """One round of baking: all ``wishes``, batch by batch, in each batch the chunks first of which
    most is seen.

    It ends at ``end`` by the monotonic clock. By then ``done`` chunks are baked or given up, the
    latter for the reasons in ``failures``.
    """

    def __init__(
        self, context: PrewarmContext, wishes: Iterable[Wish], expected: Expected, end: float
    ) -> None:
        """Set up without requesting light."""
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
        """True if the time is over before all chunks are baked or given up."""
        return self.done < len(self.wishes) and time.monotonic() >= self._end

    @property
    def spent(self) -> Cost:
        """The cost of the tasks on these chunks since the round began."""
        return self._cost().minus(self._before)

    def run(self) -> None:
        """Bake until everything is done or the time is over, then withdraw all requests.

        Raises WorkersError, and Cancelled.
        """
        self._waiting.extend(self._parts())
        try:
            while not self.late and self._request_parts():
                self._report()
                self._wait()
                self._settle()
            self._report()
        finally:
            self._context.engine.leave(self._context.viewer)

    def _parts(self) -> Iterator[tuple[Batch, list[Demand]]]:
        """Yield the wishes in parts of one batch each."""
        size = max(CHUNKS_PER_PART, 2 * self._context.engine.baker.workers)
        for batch, group in groupby(self.wishes, lambda wish: wish[0]):
            while part := [demand for _, demand in islice(group, size)]:
                yield batch, part

    def _request_parts(self) -> bool:
        """Request more parts if there is room; return True if any part is requested.

        A batch begins when the one before has ended. If they overlapped, texels of a chunk would
        all be taken to the samples of the batch that wants more.
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
        """Wait until the oldest part is baked or given up, at most REPORT_SECONDS, and not beyond
        the end of the round.

        Before that, raises Cancelled if the prewarm was stopped, and WorkersError if the workers
        did not start, or if no path was baked for longer than the context's patience.
        """
        context = self._context
        now = time.monotonic()
        context.check()
        engine = context.engine
        if engine.workers.missing:
            raise WorkersError(engine.workers.missing)
        self._patience.check(engine.baker.paths, engine.workers.preparing, engine.unready())
        # A part is open: ``run`` waits only if any is requested.
        _, oldest = self._open[0]
        oldest.wait(max(min(REPORT_SECONDS, self._end - now), 0.0))

    def _settle(self) -> None:
        """Count the parts that are baked or given up."""
        for part in [each for each in self._open if not each[1].waiting()]:
            self._open.remove(part)
            self.done += len(part[1].chunks)
            self.failures |= part[1].failures()

    def _report(self) -> None:
        """Report progress, and the time that the rest takes."""
        total = len(self.wishes)
        open_now = [baking for _, baking in self._open]
        done = self.done + sum(len(each.chunks) - each.waiting() for each in open_now)
        share = done / max(total, 1)
        first, last = self._expected.span
        overall = first + (last - first) * share
        self._context.report(Step("Baking", "chunk", done, total, overall, self._left(share)))

    def _left(self, share: float) -> TimeLeft:
        """Return the time that the rest takes once a ``share`` is done,
        at the pace measured lately.
        """
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
        """Return the cost of all tasks on these chunks so far, also of those before this round."""
        chunks: dict[str, set[Index]] = {}
        # Batches of one bake may share chunks: count each chunk once.
        for batch, group in groupby(self.wishes, lambda wish: wish[0]):
            demands = [demand for _, demand in group]
            bake, _ = self._context.bake_of(batch, demands)
            chunks.setdefault(bake, set()).update(each.index for each in demands)
        total = Cost()
        for bake, indices in chunks.items():
            total = total.plus(self._context.engine.baker.spent(bake, indices))
        return total


UNREACHED_GOAL = Goal(1e-9)
"""A goal that the first paths do not reach."""

SCHEDULED = Path("/proc/thread-self/schedstat")
"""File in which Linux counts the nanoseconds that a thread ran,
and those for which it was ready but had no core.
"""


def rehearse(
    renderer: Renderer, demand: Demand, goal: Goal, most: float, cancelled: threading.Event
) -> ChunkCost:
    """Bake a chunk's texels to a ``goal`` without keeping their light; return the measured cost.

    After ``most`` seconds, or once ``cancelled`` is set, the cost of the rest is extrapolated by
    paths.
    """
    store = renderer.caches.chunk_store_of(demand.shown)
    spec = store.spec
    texels = spec.prepared.lattice.positions(demand.index, demand.offsets)
    # The first call makes the maps of active cells that the second one finds: the difference is
    # their cost.
    maps = seconds_of_first_light(spec, texels) - seconds_of_first_light(spec, texels)
    chunk = store.load(demand.index).with_texels(demand.offsets)
    rows = chunk.rows_of(demand.offsets)
    light = chunk.light.rows(rows)
    # Measure the tasks of the chunk.
    begun = ready_time()
    processor = time.thread_time()
    tasks, paths = do_tasks(
        light, texels, spec, demand, goal, (time.perf_counter() + most, cancelled)
    )
    # If they ended early, the paths left cost as much as those taken.
    more = 1.0 + Effort.of(relative_error(light, spec), light.samples, goal).left / max(paths, 1)
    seconds = ready_time() - begun
    processor = time.thread_time() - processor
    chunk.light.put(rows, light)
    # Each task also encodes the chunk once, to write it.
    begun = ready_time()
    stored = stored_size(store, chunk)
    seconds += tasks * (ready_time() - begun)
    return ChunkCost(
        len(texels), more * seconds, more * processor, tasks * more, max(maps, 0.0), stored
    )


def ready_time() -> float:
    """Return the seconds that this thread ran or was ready to run;
    on systems that do not count them, the time.
    """
    try:
        ran, waited, *_ = SCHEDULED.read_text(encoding="ascii").split()
    except OSError:
        return time.perf_counter()
    return (int(ran) + int(waited)) * 1e-9


def do_tasks(
    light: Light,
    texels: np.ndarray,
    spec: BakeSpec,
    demand: Demand,
    goal: Goal,
    limit: tuple[float, threading.Event],
) -> tuple[int, int]:
    """Do the tasks of a chunk to its ``light``, in place, as the queue would. Return their number,
    and their paths.

    ``limit`` is a time of the performance counter and an event; either ends it after the task at
    work.
    """
    effort = demand.effort
    tasks = 0
    paths = 0
    while True:
        task = BakeTask(
            spec.prepared.scene.source,
            spec.plan,
            spec.digest,
            StoreUrl(""),
            demand.index,
            demand.offsets,
            demand.footprints,
            next_until(effort),
            goal,
        )
        before = light.samples
        since = time.thread_time()
        sample_texels(light, texels, spec, task)
        cost = cost_of(light.samples, before, time.thread_time() - since)
        result = replace(results_of(light, spec, [task])[0], cost=cost)
        tasks += 1
        paths += cost.paths
        if not result.unfinished or time.perf_counter() > limit[0] or limit[1].is_set():
            return tasks, paths
        # The effort left decides how many samples the next task takes.
        effort = result.effort


def seconds_of_first_light(spec: BakeSpec, texels: np.ndarray) -> float:
    """Return the seconds that the first paths of texels take,
    including maps that are not kept yet.
    """
    begun = ready_time()
    refine(Light.dark(spec.plan, len(texels)), texels, spec, FIRST_LEVEL, UNREACHED_GOAL)
    return ready_time() - begun


def stored_size(store: ChunkStore, chunk: Chunk) -> int:
    """Return the bytes that a chunk's objects would take."""
    pairs = zip(store.layers, chunk.light.parts, strict=True)
    return sum(len(layer.encode(chunk.index, chunk.offsets, part)) for layer, part in pairs)


MOST_TRIED = 48
FEWEST_TRIED = 8
"""Most chunks that are rehearsed, and least number that may suffice."""

SUFFICIENT_RELATIVE_ERROR = 0.04
"""Relative standard error of the mean at which the rehearsed chunks suffice."""

DISPATCH = 0.006
"""Processor seconds that the process which hands out a task spends on it; it needs a core, too."""

WORKER_START_SECONDS = 1.5
"""Seconds that workers take to start and load kernels, beyond the time of the survey."""


def forecast(
    renderer: Renderer,
    demands: Sequence[Demand],
    goal: Goal,
    workers: int,
    budget: float,
    cancelled: threading.Event,
) -> CostEstimate:
    """Estimate the cost of baking the ``demands`` to a ``goal``, within about ``budget`` seconds.

    As many chunks are rehearsed at a time as there are workers, as these slow each other down in
    the same way.
    """
    if not demands:
        return CostEstimate()
    load_kernels(renderer.caches.spec("gi").kinds)
    threads = min(workers, cores())
    chosen = stratified(demands)
    rehearsals = Rehearsals(budget, cancelled)
    with ThreadPoolExecutor(threads, "rehearsal") as pool:
        futures = [pool.submit(rehearsals.run, renderer, chosen, goal) for _ in range(threads)]
        for future in futures:
            future.result()
    texels = sum(len(demand.offsets) for demand in demands)
    # Dispatch costs extra time only if the workers leave no core free.
    if workers >= cores():
        per_task = TASK_OVERHEAD_SECONDS + DISPATCH
    else:
        per_task = TASK_OVERHEAD_SECONDS
    return extrapolated(rehearsals.all, texels, len(rehearsals.all) == len(demands), per_task)


class Rehearsals:
    """The rehearsals of a forecast, within ``budget`` seconds together."""

    def __init__(self, budget: float, cancelled: threading.Event) -> None:
        """Begin without rehearsals. One of them may take a quarter of the budget."""
        self.all: list[ChunkCost] = []
        self._each = budget / 4.0
        self._end = time.monotonic() + budget
        self._cancelled = cancelled
        self._lock = threading.Lock()

    def run(self, renderer: Renderer, demands: Iterator[Demand], goal: Goal) -> None:
        """Rehearse one demand after the other until enough is known.

        Several threads may do so at once.
        """
        while not self._enough() and (demand := self._next(demands)):
            one = rehearse(renderer, demand, goal, self._each, self._cancelled)
            with self._lock:
                self.all.append(one)

    def _next(self, demands: Iterator[Demand]) -> Demand | None:
        """Take the next demand; None if there is none."""
        with self._lock:
            return next(demands, None)

    def _enough(self) -> bool:
        """Return True if the mean cost is known well enough,
        the time is over, or the forecast was cancelled.
        """
        with self._lock:
            known = (
                len(self.all) >= FEWEST_TRIED
                and relative_standard_error(seconds_per_texel(self.all))
                <= SUFFICIENT_RELATIVE_ERROR
            )
        late = bool(self.all) and time.monotonic() > self._end
        return known or late or self._cancelled.is_set()


def stratified(demands: Sequence[Demand]) -> Iterator[Demand]:
    """Return at most MOST_TRIED demands, spread evenly over all texels; all demands if they are
    few.

    So a chunk is chosen with a probability in proportion to its texels.
    """
    if len(demands) <= FEWEST_TRIED:
        return iter(demands)
    ordered = sorted(demands, key=lambda demand: demand.index)
    ends = np.cumsum([len(demand.offsets) for demand in ordered])
    # Points of a low-discrepancy sequence on the texels in order; chunks that are hit again are
    # skipped.
    places = (radical_inverse(n) * ends[-1] for n in range(1, 8 * MOST_TRIED))
    taken = dict.fromkeys(int(np.searchsorted(ends, place, "right")) for place in places)
    return islice((ordered[number] for number in taken), MOST_TRIED)


def radical_inverse(number: int) -> float:
    """Return element ``number`` of van der Corput's sequence to base 2:
    each of its parts is spread evenly over [0, 1).
    """
    return int(f"{number:032b}"[::-1], 2) / 2.0**32
