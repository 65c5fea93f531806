"""What one prewarm works with, and its baking, a few chunks at a time."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import groupby, islice

from isogi_core.cache.costs import Cost
from isogi_core.errors import Cancelled
from isogi_core.frame.frame import Frame
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.view_texels import Demand
from isogi_core.model.view import View
from isogi_core.plan.scene import Scene
from isogi_core.prepared.prepared_scene import Index
from server.render.bakes import BackgroundBake, Patience
from server.render.engine import RenderEngine
from worker.bake_requests import Viewer
from worker.errors import WorkersError
from worker.progress import Pace, TimeEstimator, TimeLeft


@dataclass(frozen=True)
class Step:
    """How far a prewarm is: ``done`` of ``total`` ``unit``s of ``what`` it does now, and the time that the rest takes.

    ``share`` is that of all its work.
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


@dataclass(eq=False)
class PrewarmContext:
    """What a prewarm of one ``scene`` to a ``target`` error works with, for a ``viewer``.

    ``frame_of`` makes the frame of a view with the light baked so far, ``report`` takes each step, and ``cancelled``
    stops it. Baking ends at ``deadline``, and the workers are taken for broken after ``patience`` seconds without
    anything new.
    """

    engine: RenderEngine
    scene: Scene
    target: float
    viewer: Viewer
    frame_of: Callable[[View], Frame]
    report: Callable[[Step], None]
    deadline: float = math.inf
    patience: float = math.inf
    cancelled: threading.Event = field(default_factory=threading.Event)
    begun: float = field(default_factory=time.monotonic)

    @property
    def renderer(self) -> Renderer:
        """The renderer of the scene."""
        return self.engine.renderer(self.scene.id)

    def bake_of(self, demand: Demand) -> str:
        """The name of the bake that a demand is of."""
        return self.engine.bake_onto(self.scene.id, demand.shown)

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


LOOK = 1.0
"""Seconds between two reports of how far the baking is."""

CHUNKS, OPEN = 64, 3
"""Chunks that are asked for together, at least, and how many such parts at once."""

PRIOR = (0.6, 0.8, 1.0, 1.25, 1.6)
"""Times that baking takes over those forecast, before any is known."""


def onto(demand: Demand) -> tuple[bool, float]:
    """Orders demands by the isosurface that their texels are projected onto, those that are not first."""
    return demand.shown is not None, float(demand.shown or 0.0)


class Baking:
    """Has ``demands`` baked, those first of which most is seen; all of it is ``expected`` to take so many seconds.

    Projected texels come last, isosurface by isosurface.

    ``span`` is where in all of the work this begins and ends, as shares of it. It ends at ``end``, by the monotonic
    clock; ``done`` chunks are baked or given up by then, and ``failures`` says why the latter were.
    """

    def __init__(
        self, context: PrewarmContext, demands: list[Demand], expected: float, span: tuple[float, float], end: float
    ) -> None:
        """Ask for nothing yet."""
        self.demands = sorted(demands, key=lambda demand: (*onto(demand), -demand.weight))
        self.failures: dict[Index, str] = {}
        self.done = 0
        self._context, self._end, self._span = context, end, span
        self._expected = expected
        self._estimator, self._pace = TimeEstimator(prior=PRIOR), Pace(time.monotonic)
        self._worked = 0.0
        self._open: list[BackgroundBake] = []
        self._patience = Patience(context.patience)
        self._before = self._cost()

    @property
    def late(self) -> bool:
        """Whether the time is over, and not all chunks are baked or given up."""
        return self.done < len(self.demands) and time.monotonic() >= self._end

    @property
    def spent(self) -> Cost:
        """The paths and the seconds of the processor that these chunks took meanwhile."""
        now, before = self._cost(), self._before
        return Cost(now.seconds - before.seconds, now.paths - before.paths)

    def run(self) -> None:
        """Bake until all is, or the time is over; nothing more is wanted then. Raises WorkersError, and Cancelled."""
        parts = self._parts()
        try:
            while not self.late and self._filled(parts):
                self._report()
                self._wait()
                self._settle()
            self._report()
        finally:
            self._context.engine.leave(self._context.viewer)

    def _parts(self) -> Iterator[list[Demand]]:
        size = max(CHUNKS, 2 * self._context.engine.workers)
        for _, group in groupby(self.demands, onto):
            while part := list(islice(group, size)):
                yield part

    def _filled(self, parts: Iterator[list[Demand]]) -> bool:
        """Ask for more where there is room; whether anything is asked for."""
        context = self._context
        while len(self._open) < OPEN and (part := next(parts, None)):
            self._open.append(context.engine.bake(context.bake_of(part[0]), part, context.target, context.viewer))
        return bool(self._open)

    def _wait(self) -> None:
        """Wait for the oldest part, not long. Raises Cancelled, and WorkersError where nothing comes."""
        context, now = self._context, time.monotonic()
        context.check()
        engine = context.engine
        if engine.workforce.missing:
            raise WorkersError(engine.workforce.missing)
        self._patience.check(engine.paths, engine.workforce.preparing, engine.unready())
        self._open[0].wait(max(min(LOOK, self._end - now), 0.0))

    def _settle(self) -> None:
        """Count what is baked or given up."""
        for part in [each for each in self._open if not each.waiting()]:
            self._open.remove(part)
            self.done += len(part.chunks)
            self.failures |= part.failures()

    def _report(self) -> None:
        """Say how far it is, and what the rest takes."""
        total = len(self.demands)
        coming = total - self.done - sum(len(part.chunks) for part in self._open)
        done = total - coming - sum(part.waiting() for part in self._open)
        first, last = self._span
        share = done / max(total, 1)
        self._context.report(Step("Baking", "chunk", done, total, first + (last - first) * share, self._left(share)))

    def _left(self, share: float) -> TimeLeft:
        """The time that the rest takes once a ``share`` is done, at the pace of late."""
        worked = share * self._expected
        self._pace.working(1)
        self._pace.spent(worked - self._worked)
        self._worked = worked
        return self._estimator.estimate("baking", self._expected - worked, worked).times(self._pace.value)

    def _cost(self) -> Cost:
        context, total = self._context, Cost()
        for _, group in groupby(self.demands, onto):
            first, *others = group
            spent = context.engine.spent(context.bake_of(first), [each.index for each in (first, *others)])
            total = total.plus(spent)
        return total
