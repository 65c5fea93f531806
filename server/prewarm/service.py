"""Prewarms over HTTP: each is a job, which works beside the event loop, yields to people and outlives the server."""

from __future__ import annotations

import asyncio
import math
import os
import threading
import time
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import count
from typing import TYPE_CHECKING

from isogi_core.errors import Cancelled, IsogiError, StoreError
from isogi_core.frame.stopwatch import Stopwatch
from server.jobs import Job, Result, Status
from server.order import Order
from server.prewarm.desk import Desk, Step
from server.prewarm.order import PrewarmOrder
from server.prewarm.record import Record
from server.prewarm.summary import Summary
from server.turns import Rank
from worker.errors import WorkersError
from worker.viewers import Viewer

if TYPE_CHECKING:
    from isogi_core.frame.frame import Frame
    from isogi_core.model.scene import Scene
    from isogi_core.model.view import View
    from server.service import Service

LATER = 5.0
"""Seconds that the frame of a survey waits for a thread before it goes first."""

CHECK = 0.1
"""Seconds between two looks, while a frame is waited for, at whether it is still wanted."""

AGAIN, LONGEST_AWAY = 10.0, 3600.0
"""Seconds until what failed for the store is tried again, and for which it is."""

NICENESS = 5
"""How far the thread of a prewarm stands behind those of frames."""

_visits = count(1)


def begin(service: Service, scene: Scene, order: PrewarmOrder, dry: bool = False) -> Job:
    """The job that carries out an order, or, where it is ``dry``, tells what it would take. Raises BusyError.

    The same order once more is the same job until that has ended.
    """
    prewarm = Prewarm(service, scene, order, dry)
    if dry:
        return service.jobs.begin("prewarm", f"What a prewarm of {scene.id} takes", prewarm.work)
    return service.jobs.begin("prewarm", f"A prewarm of {scene.id}", prewarm.work, order.digest(scene))


@dataclass(eq=False)
class Prewarm:
    """One order on its way: what is between the event loop, where the job lives, and the thread that works."""

    service: Service
    scene: Scene
    order: PrewarmOrder
    dry: bool
    cancelled: threading.Event = field(default_factory=threading.Event)
    begun: float = field(default_factory=time.monotonic)

    async def work(self, job: Job) -> Iterable[Result]:
        """Do all of it on a thread of its own; returns when that has ended, also when this is cancelled."""
        loop, record = asyncio.get_running_loop(), self._record()
        with ThreadPoolExecutor(1, "prewarm") as thread:
            working = loop.run_in_executor(thread, self._run, loop, job, record)
            try:
                job.document = summary = await asyncio.shield(working)
            except asyncio.CancelledError:
                self.cancelled.set()
                await asyncio.wait({working})
                working.exception()
                raise
        if summary.failures:
            raise WorkersError(str(summary))
        return [Result(f"/v1/jobs/{job.id}/results", "application/json", "The summary")]

    def _record(self) -> Record | None:
        return None if self.dry else Record(self.service.studio.root, self.scene, self.order, "server")

    def _run(self, loop: asyncio.AbstractEventLoop, job: Job, record: Record | None) -> Summary:
        """What the thread does."""
        stand_back()

        def tell(step: Step) -> None:
            loop.call_soon_threadsafe(job.tell, step.share, str(step), step.left)
            if record is not None:
                record.tell(step)

        def look(view: View) -> Frame:
            return self._looked(loop, view)

        target = self.order.target_error or self.scene.target_error
        deadline = math.inf if self.order.deadline is None else self.begun + self.order.deadline
        viewer = Viewer(("prewarm", next(_visits)), patient=True)
        place = (self.service.studio, self.scene, target, viewer, look, tell, deadline)
        desk = Desk(*place, cancelled=self.cancelled, begun=self.begun)
        return self._dry(desk) if record is None else self._recorded(desk, record)

    def _dry(self, desk: Desk) -> Summary:
        from server.prewarm.work import carry_out_dry, wanted  # noqa: PLC0415 (kernels)

        return carry_out_dry(desk, wanted(desk, self.order, self.service.settings))

    def _recorded(self, desk: Desk, record: Record) -> Summary:
        """Carry it out, and keep a record of it; what a stopping server leaves is taken up by the next."""
        record.keep(status=Status.RUNNING)
        try:
            summary = self._carried_out(desk, record)
        except Cancelled:
            if not self.service.jobs.closed:
                record.keep(status=Status.DISMISSED, message="This was dismissed.")
            raise
        except IsogiError as error:
            with suppress(StoreError):
                record.keep(status=Status.FAILED, message=str(error))
            raise
        return record.close(summary)

    def _carried_out(self, desk: Desk, record: Record) -> Summary:
        """Carry it out; what fails for the store is begun again a little later, for what is baked stays."""
        from server.prewarm.work import carry_out, wanted  # noqa: PLC0415 (kernels)

        given_up = math.inf
        while True:
            try:
                what = wanted(desk, self.order, self.service.settings)
                return carry_out(desk, what, lambda ahead: record.keep(ahead=ahead))
            except StoreError as error:
                given_up = min(given_up, time.monotonic() + LONGEST_AWAY)
                if time.monotonic() > given_up:
                    raise
                desk.tell(Step(f"Waiting for the store ({error})", "time", 0, 1, 0.0))
                self.cancelled.wait(AGAIN)
                desk.check()

    def _looked(self, loop: asyncio.AbstractEventLoop, view: View) -> Frame:
        """The frame of a view, asked of the event loop by the thread. Raises Cancelled soon once it is."""
        coming = asyncio.run_coroutine_threadsafe(self._frame(view), loop)
        try:
            while True:
                with suppress(TimeoutError):
                    return coming.result(CHECK)
                if self.cancelled.is_set():
                    raise Cancelled("This prewarm was stopped.")
        finally:
            coming.cancel()

    async def _frame(self, view: View) -> Frame:
        """The frame of a view; where somebody else waits for frames, there is as much time for these."""
        begun, target = time.monotonic(), self.order.target_error or self.scene.target_error
        frame = await self.service.frame(Order(self.scene.id, view, target), Rank.within(LATER), Stopwatch())
        if self.service.attended:
            await asyncio.sleep(time.monotonic() - begun)
        return frame


def stand_back() -> None:
    """Set this thread behind others, where threads have a niceness of their own (Linux)."""
    with suppress(AttributeError, OSError):
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICENESS)
