"""The baking of a prewarm: a few chunks at a time, so that what waits stays short for all that look."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import TYPE_CHECKING

from isogi_core.cache.costs import Cost
from server.prewarm.desk import Step
from server.render import no_light
from worker.errors import WorkersError
from worker.outlook import Outlook

if TYPE_CHECKING:
    from isogi_core.bake.recipe import Index
    from isogi_core.frame.texels import Demand
    from server.errand import Errand
    from server.prewarm.desk import Desk

LOOK = 1.0
"""Seconds between two looks at how far the baking is."""

CHUNKS, OPEN = 64, 3
"""Chunks that are asked for together, at least, and how many such parts at once."""

PRIOR = (0.6, 0.8, 1.0, 1.25, 1.6)
"""Times that baking takes over those forecast, before any is known."""


class Baking:
    """Has ``demands`` baked, those first of which most is seen; all of it is ``expected`` to take so many seconds.

    ``span`` is where in all of the work this begins and ends, as shares of it. It ends at ``end``, by the monotonic
    clock, and is ``late`` then; ``done`` chunks are baked or given up, and ``failures`` says why the latter were.
    """

    def __init__(
        self, desk: Desk, demands: list[Demand], expected: float, span: tuple[float, float], end: float
    ) -> None:
        """Ask for nothing yet."""
        self.demands = sorted(demands, key=lambda demand: -demand.weight)
        self.failures: dict[Index, str] = {}
        self.done, self.late = 0, False
        self._desk, self._end, self._span = desk, end, span
        self._expected = expected
        self._outlook = Outlook(prior=PRIOR)
        self._open: list[Errand] = []
        self._paths, self._changed = desk.studio.paths, time.monotonic()
        self._before = self._cost()
        self.spent = Cost()
        """The paths and the seconds of the processor that these chunks took while it ran."""

    def run(self) -> None:
        """Bake until all is, or the time is over; nothing more is wanted then. Raises WorkersError, and Cancelled."""
        parts = self._parts()
        try:
            while self._filled(parts) and not self.late:
                self._tell()
                self._wait()
                self._settle()
            self._tell()
        finally:
            self._desk.studio.leave(self._desk.viewer)
            now, before = self._cost(), self._before
            self.spent = Cost(now.seconds - before.seconds, now.paths - before.paths)

    def _parts(self) -> Iterator[list[Demand]]:
        size = max(CHUNKS, 2 * self._desk.studio.workers)
        return (self.demands[first : first + size] for first in range(0, len(self.demands), size))

    def _filled(self, parts: Iterator[list[Demand]]) -> bool:
        """Ask for more where there is room; whether anything is asked for."""
        desk = self._desk
        while len(self._open) < OPEN and (part := next(parts, None)):
            self._open.append(desk.studio.errand(desk.bake, part, desk.target, desk.viewer))
        return bool(self._open)

    def _wait(self) -> None:
        """Wait for the oldest part, not long. Raises Cancelled, and WorkersError where nothing comes."""
        desk, now = self._desk, time.monotonic()
        desk.check()
        if desk.studio.unmanned:
            raise WorkersError(desk.studio.unmanned)
        if desk.studio.paths > self._paths:
            self._paths, self._changed = desk.studio.paths, now
        if now - self._changed > desk.patience:
            raise WorkersError(no_light(desk.studio))
        self._open[0].wait(max(min(LOOK, self._end - now), 0.0))
        self.late = time.monotonic() >= self._end

    def _settle(self) -> None:
        """Count what is baked or given up."""
        for errand in [each for each in self._open if not each.waiting()]:
            self._open.remove(errand)
            self.done += len(errand.chunks)
            self.failures |= errand.failures()
        self.late = self.late and bool(self._open)

    def _tell(self) -> None:
        """Say how far it is, and what the rest takes."""
        total = len(self.demands)
        coming = total - self.done - sum(len(errand.chunks) for errand in self._open)
        done = total - coming - sum(errand.waiting() for errand in self._open)
        first, last = self._span
        share = done / max(total, 1)
        left = self._outlook.tell("baking", (1.0 - share) * self._expected)
        self._desk.tell(Step("Baking", "chunk", done, total, first + (last - first) * share, left))

    def _cost(self) -> Cost:
        indices = [demand.index for demand in self.demands]
        return self._desk.studio.spent(self._desk.bake, indices)
