"""Prewarms over HTTP: jobs that yield to people, survive a restart of the server and are
resumed.
"""

from __future__ import annotations

import asyncio
import logging
import math
import os
import threading
import time
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import datetime
from itertools import count
from typing import TypeVar

from isogi_core.bake.noise import Goal
from isogi_core.bake.texel_light import FIRST_LEVEL
from isogi_core.errors import Cancelled, StoreError
from isogi_core.frame.frame import Frame
from isogi_core.frame.rays.picture_plan import Prices
from isogi_core.frame.tiles import Stopwatch
from isogi_core.model.view import View
from isogi_core.plan.scene import Scene
from isogi_server.api.service import PictureRequest, Service
from isogi_server.errors import BusyError
from isogi_server.prewarm.baking import PrewarmContext, Step
from isogi_server.prewarm.order import PrewarmOrder
from isogi_server.prewarm.record import (
    BEAT,
    OPEN_STATES,
    Record,
    RecordDocument,
    Summary,
    recorded_prewarms,
)
from isogi_server.prewarm.work import carry_out, carry_out_dry, wanted
from isogi_server.render.bakes import BACKGROUND_VIEWER
from isogi_server.render.jobs import Job, Result
from isogi_server.views import goal_of
from isogi_worker.bake_requests import Viewer
from isogi_worker.errors import WorkersError
from isogi_worker.progress import TimeLeft

SURVEY_WAIT_SECONDS = 5.0
"""Seconds until the frame of a prewarm is due. Of frames whose clients were served alike, the one
that is due first is drawn first: see ``Rank``.
"""

FRAME_CHECK_SECONDS = 0.1
"""Seconds between two checks for cancellation while a frame is awaited."""

RETRY_SECONDS = 10.0
LONGEST_AWAY = 3600.0
"""Seconds until work that failed because of the store is tried again, and for which it is tried
at most.
"""

NICENESS = 5
"""Niceness of the threads of prewarms and exports, relative to those of frames."""

Report = Callable[[float, str, TimeLeft | None], None]
"""Takes the share of work that is done, a sentence about the present step, and the time left."""

Done = TypeVar("Done")

_visits = count(1)


def begin(
    service: Service,
    scene: Scene,
    order: PrewarmOrder,
    dry: bool = False,
    client: tuple[str, str] = ("", ""),
) -> Job:
    """Start the job that carries out an ``order``, or only forecasts it if ``dry``; ``client`` is
    its owner and address.

    An order that is already being carried out is not started again: its job is returned. A forecast
    bakes nothing, so several of one order may run. Raises BusyError if there are too many jobs.
    """
    prewarm = Prewarm(service, scene, order, dry, client[0])
    if dry:
        title = f"What a prewarm of {scene.id} takes"
    else:
        title = f"A prewarm of {scene.id}"
    key = None if dry else order.digest(scene)
    return service.jobs.begin("prewarm", title, prewarm.work, key, client)


@dataclass(eq=False)
class Prewarm:
    """An order that is carried out on a separate thread, for a job that lives on the event loop.

    If ``recorded``, a server that restarts resumes it. ``rung`` is the least number of samples for
    texels of whole isosurfaces that are not good enough with fewer.
    """

    service: Service
    scene: Scene
    order: PrewarmOrder
    dry: bool = False
    owner: str = ""
    recorded: bool = True
    rung: int = FIRST_LEVEL
    cancelled: threading.Event = field(default_factory=threading.Event)
    begun: float = field(default_factory=time.monotonic)

    async def work(self, job: Job) -> Iterable[Result]:
        """Carry out the order for a job, and set its document. Raises WorkersError if some
        light could not be baked.
        """
        job.document = await self.carry_out(job.report)
        return [Result(f"/v1/jobs/{job.id}/results", "application/json", "The summary")]

    async def carry_out(self, report: Report) -> Summary:
        """Carry out the order on a thread; return when the thread has ended, even if cancelled.

        Raises WorkersError if some light could not be baked.
        """
        loop = asyncio.get_running_loop()
        record = self._record()
        with ThreadPoolExecutor(1, "prewarm") as thread:
            working = loop.run_in_executor(thread, self._run, loop, report, record)
            summary = await finish_thread(working, self.cancelled)
        if summary.failures:
            raise WorkersError(str(summary))
        return summary

    def _record(self) -> Record | None:
        """Return a new record of this order; None for a forecast, or if it is not recorded."""
        store = self.service.engine.store
        given = (self.scene, self.order)
        if self.dry or not self.recorded:
            return None
        return Record(store, *given, "server", self.owner)

    def _run(self, loop: asyncio.AbstractEventLoop, tell: Report, record: Record | None) -> Summary:
        """Carry out the order, or forecast it. Runs on the prewarm's thread."""
        lower_priority()
        # The job and the queue of frames belong to the event loop, so that reports and frames go
        # there. Checks of pictures run on threads of the engine, and need no loop.

        def report(step: Step) -> None:
            loop.call_soon_threadsafe(tell, step.share, str(step), step.left)

        def frame_of(view: View) -> Frame:
            return self._frame_of(loop, PictureRequest(self.scene.id, view, goal))

        def refine(view: View, prices: Prices, over: threading.Event) -> bool:
            return self._refine(view, goal, prices, over)

        goal = goal_of(self.scene, self.order.target_error)
        # The deadline of an order is a time from its beginning. That of a resumed order is shorter
        # by the time that it took before: see ``RecordDocument.rest``.
        if self.order.deadline is None:
            deadline = math.inf
        else:
            deadline = self.begun + self.order.deadline
        # Each prewarm is a client for itself, so that several share the workers evenly, and it
        # yields to all visitors.
        viewer = Viewer(("prewarm", next(_visits)), patient=True)
        place = (
            self.service.engine,
            self.scene,
            goal,
            viewer,
            frame_of,
            refine,
            report,
            deadline,
        )
        context = PrewarmContext(*place, cancelled=self.cancelled, begun=self.begun, rung=self.rung)
        if self.dry:
            return carry_out_dry(context, wanted(context, self.order, self.service.settings))
        if record is None:
            return self._carried_out(context)
        return self._recorded(context, record)

    def _recorded(self, context: PrewarmContext, record: Record) -> Summary:
        """Carry out the order and keep a record of it. If the server stops, the record stays
        open, and the next server resumes it.
        """
        with record.recording(context, "This was dismissed.", lambda: self.service.jobs.closed):
            summary = self._carried_out(context, lambda ahead: record.keep(ahead=ahead))
        return record.close(summary)

    def _carried_out(
        self, context: PrewarmContext, begun: Callable[[Summary], None] = lambda _: None
    ) -> Summary:
        """Carry out the order. If the store fails, try again after RETRY_SECONDS, for at most
        LONGEST_AWAY: light that is baked stays.
        """
        given_up = math.inf
        while True:
            try:
                what = wanted(context, self.order, self.service.settings)
                return carry_out(context, what, begun)
            except StoreError as error:
                # Count from the first failure: later ones do not extend the time.
                given_up = min(given_up, time.monotonic() + LONGEST_AWAY)
                if time.monotonic() > given_up:
                    raise
                context.report(Step(f"Waiting for the store ({error})", "time", 0, 1, 0.0))
                self.cancelled.wait(RETRY_SECONDS)
                context.check()

    def _refine(self, view: View, goal: Goal, prices: Prices, over: threading.Event) -> bool:
        """Take one step of a picture's check; then idle as long as it took if clients wait for
        frames or have streams open, so that they get half of the processors' time. Raises Cancelled
        if ``over`` is set.
        """
        begun = time.monotonic()
        more = self.service.engine.check(self.scene.id, view, goal, self.cancelled, prices, over)
        if self.service.attended:
            self.cancelled.wait(time.monotonic() - begun)
        return more

    def _frame_of(self, loop: asyncio.AbstractEventLoop, picture: PictureRequest) -> Frame:
        """Have the event loop draw a picture for this thread. Raises Cancelled soon after the
        order is cancelled.
        """
        coming = asyncio.run_coroutine_threadsafe(self._frame(picture), loop)
        # Look for cancellation between waits, as the frame may take long.
        try:
            while not wait([coming], FRAME_CHECK_SECONDS).done:
                if self.cancelled.is_set():
                    raise Cancelled("This prewarm was stopped.")
            return coming.result()
        finally:
            coming.cancel()

    async def _frame(self, picture: PictureRequest) -> Frame:
        """Return the frame of a picture; then idle as long as it took if clients wait for frames
        or have streams open.
        """
        begun = time.monotonic()
        # All prewarms are one client for the threads that draw. For the workers each is a separate
        # one: see ``_run``.
        rank = self.service.rank(BACKGROUND_VIEWER, SURVEY_WAIT_SECONDS)
        frame = await self.service.frame(picture, rank, Stopwatch())
        if self.service.attended:
            await asyncio.sleep(time.monotonic() - begun)
        return frame


async def finish_thread(working: asyncio.Future[Done], cancelled: threading.Event) -> Done:
    """Return the result of a thread's work. If cancelled, ask the thread to stop, and wait for
    its end.
    """
    try:
        return await asyncio.shield(working)
    except asyncio.CancelledError:
        cancelled.set()
        await asyncio.wait({working})
        working.exception()
        raise


def lower_priority() -> None:
    """Lower the priority of this thread, on systems with a niceness for each thread (Linux)."""
    with suppress(AttributeError, OSError):
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICENESS)


log = logging.getLogger("isogi.server")


LEASE = 20.0
"""Seconds without a change of its record after which a prewarm counts as abandoned."""


class RecordAges:
    """Measures how long the record of each prewarm has not changed, by this process's clock:
    clocks of machines differ and jump.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """Create without any record seen."""
        self._clock = clock
        self._seen: dict[str, tuple[datetime, float]] = {}

    def of(self, document: RecordDocument) -> float:
        """Return the seconds since a prewarm's document was first seen in its present state."""
        if self._seen.get(document.id, (None, 0.0))[0] != document.updated:
            self._seen[document.id] = document.updated, self._clock()
        return self._clock() - self._seen[document.id][1]


async def resume(service: Service) -> None:
    """Start prewarms that an earlier server left open, once this one has started; those of
    another server if its records stop changing.
    """
    await service.startup.lit.wait()
    ages = RecordAges()
    held: list[RecordDocument] | None = []
    if not service.startup.failure:
        held = await resume_abandoned(service, ages)
    # From now on an unknown job is unknown, and not still to come.
    service.resumed.set()
    while held is None or held:
        await asyncio.sleep(BEAT)
        held = await resume_abandoned(service, ages)


async def resume_abandoned(service: Service, ages: RecordAges) -> list[RecordDocument] | None:
    """Start the prewarms that no process works on; return the others, which another server has,
    or for which there was no room. None if the store did not answer: ask again.
    """
    try:
        found = await asyncio.to_thread(
            lambda: [
                each
                for each in recorded_prewarms(service.engine.store)
                if is_resumable(service, each)
            ]
        )
    except StoreError as error:
        log.warning("Stopped prewarms are not resumed yet: %s", error)
        return None
    # A prewarm is free if its process has ended, or has not written its record for a LEASE.
    free = {document.id for document in found if ages.of(document) > LEASE or document.left}
    return [
        document for document in found if not (document.id in free and resumed(service, document))
    ]


def is_resumable(service: Service, document: RecordDocument) -> bool:
    """Return True if a prewarm was started by a server, is open, and its scene is shown here
    with the same light.
    """
    scene = service.engine.scenes.get(document.scene)
    same = scene is not None and scene.digest == document.scene_digest
    return (
        same
        and document.by == "server"
        and document.status in OPEN_STATES
        and service.jobs.running(document.id) is None
    )


def resumed(service: Service, document: RecordDocument) -> bool:
    """Start a prewarm again under its former id, for the rest of its time; return False if
    there are too many jobs.
    """
    try:
        begin(
            service,
            service.engine.scenes[document.scene],
            document.rest,
            client=(document.owner, ""),
        )
    except BusyError:
        return False
    return True
