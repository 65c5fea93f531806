"""Prewarms over HTTP: jobs that yield to people, outlive the server and are taken up again."""

from __future__ import annotations

import asyncio
import logging
import math
import os
import threading
import time
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import datetime
from itertools import count
from typing import TypeVar

from isogi_core.bake.texel_light import FIRST_LEVEL
from isogi_core.errors import Cancelled, StoreError
from isogi_core.frame.frame import Frame
from isogi_core.frame.rays.picture_plan import Prices
from isogi_core.frame.tiles import Stopwatch
from isogi_core.model.view import View
from isogi_core.plan.scene import Scene
from server.api.service import PictureRequest, Service
from server.errors import BusyError
from server.prewarm.baking import PrewarmContext, Step
from server.prewarm.order import PrewarmOrder
from server.prewarm.record import (
    BEAT,
    OPEN_STATES,
    Record,
    RecordDocument,
    Summary,
    recorded_prewarms,
)
from server.prewarm.work import carry_out, carry_out_dry, wanted
from server.render.bakes import BACKGROUND_VIEWER
from server.render.jobs import Job, Result
from worker.bake_requests import Viewer
from worker.errors import WorkersError
from worker.progress import TimeLeft

SURVEY_WAIT_SECONDS = 5.0
"""Seconds that the frame of a survey waits for a thread before it goes first."""

FRAME_CHECK_SECONDS = 0.1
"""Seconds between two checks of a frame that is waited for."""

RETRY_SECONDS = 10.0
LONGEST_AWAY = 3600.0
"""Seconds until what failed for the store is tried again, and for which it is."""

NICENESS = 5
"""How far the thread of a prewarm stands behind those of frames."""

Report = Callable[[float, str, TimeLeft | None], None]
"""Takes how large a share of work is done, what is done now, and the time that the rest takes."""

Done = TypeVar("Done")

_visits = count(1)


def begin(
    service: Service,
    scene: Scene,
    order: PrewarmOrder,
    dry: bool = False,
    client: tuple[str, str] = ("", ""),
) -> Job:
    """The job of a ``client``, its owner's name first, that carries out an order, or forecasts it
    where ``dry``.

    Raises BusyError. The same order once more is the same job until that has ended.
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
    """One order on its way: what is between the event loop, where the job lives, and the thread
    that works.

    One that is not ``recorded`` is not taken up by the next server. Texels of whole isosurfaces are
    to have as many samples as ``rung`` at least, those that are not good enough with fewer.
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
        """Do all of it for a job. Raises WorkersError where some light could not be baked."""
        job.document = await self.carry_out(job.report)
        return [Result(f"/v1/jobs/{job.id}/results", "application/json", "The summary")]

    async def carry_out(self, report: Report) -> Summary:
        """Do all of it on a thread of its own; returns when that has ended, also when this is
        cancelled.

        Raises WorkersError where some light could not be baked.
        """
        loop = asyncio.get_running_loop()
        record = self._record()
        with ThreadPoolExecutor(1, "prewarm") as thread:
            working = loop.run_in_executor(thread, self._run, loop, report, record)
            summary = await to_its_end(working, self.cancelled)
        if summary.failures:
            raise WorkersError(str(summary))
        return summary

    def _record(self) -> Record | None:
        store = self.service.engine.store
        given = (self.scene, self.order)
        if self.dry or not self.recorded:
            return None
        return Record(store, *given, "server", self.owner)

    def _run(self, loop: asyncio.AbstractEventLoop, tell: Report, record: Record | None) -> Summary:
        """What the thread does."""
        stand_back()

        def report(step: Step) -> None:
            loop.call_soon_threadsafe(tell, step.share, str(step), step.left)

        def frame_of(view: View) -> Frame:
            return self._frame_of(loop, PictureRequest(self.scene.id, view, target))

        def refine(view: View, prices: Prices, over: threading.Event) -> bool:
            return self._refine(view, target, prices, over)

        target = self.order.target_error or self.scene.target_error
        if self.order.deadline is None:
            deadline = math.inf
        else:
            deadline = self.begun + self.order.deadline
        viewer = Viewer(("prewarm", next(_visits)), patient=True)
        place = (
            self.service.engine,
            self.scene,
            target,
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
        """Carry it out, and keep a record of it; what a stopping server leaves is taken up by the
        next.
        """
        with record.kept(context, "This was dismissed.", lambda: self.service.jobs.closed):
            summary = self._carried_out(context, lambda ahead: record.keep(ahead=ahead))
        return record.close(summary)

    def _carried_out(
        self, context: PrewarmContext, begun: Callable[[Summary], None] = lambda _: None
    ) -> Summary:
        """Carry it out; what fails for the store is begun again a little later, for what is baked
        stays.
        """
        given_up = math.inf
        while True:
            try:
                what = wanted(context, self.order, self.service.settings)
                return carry_out(context, what, begun)
            except StoreError as error:
                given_up = min(given_up, time.monotonic() + LONGEST_AWAY)
                if time.monotonic() > given_up:
                    raise
                context.report(Step(f"Waiting for the store ({error})", "time", 0, 1, 0.0))
                self.cancelled.wait(RETRY_SECONDS)
                context.check()

    def _refine(self, view: View, target: float, prices: Prices, over: threading.Event) -> bool:
        """Check the picture of a view, one step further, and leave as much time to clients that
        wait for frames. Raises Cancelled once time is ``over``.
        """
        begun = time.monotonic()
        more = self.service.engine.check(self.scene.id, view, target, self.cancelled, prices, over)
        if self.service.attended:
            self.cancelled.wait(time.monotonic() - begun)
        return more

    def _frame_of(self, loop: asyncio.AbstractEventLoop, picture: PictureRequest) -> Frame:
        """The frame of a picture, asked of the event loop by the thread. Raises Cancelled soon once
        it is.
        """
        coming = asyncio.run_coroutine_threadsafe(self._frame(picture), loop)
        try:
            while True:
                with suppress(TimeoutError):
                    return coming.result(FRAME_CHECK_SECONDS)
                if self.cancelled.is_set():
                    raise Cancelled("This prewarm was stopped.")
        finally:
            coming.cancel()

    async def _frame(self, picture: PictureRequest) -> Frame:
        """The frame of a picture; where clients wait for frames, they have as much time as it
        took.
        """
        begun = time.monotonic()
        rank = self.service.rank(BACKGROUND_VIEWER, SURVEY_WAIT_SECONDS)
        frame = await self.service.frame(picture, rank, Stopwatch())
        if self.service.attended:
            await asyncio.sleep(time.monotonic() - begun)
        return frame


async def to_its_end(working: asyncio.Future[Done], cancelled: threading.Event) -> Done:
    """What a thread's work comes to. Where this is cancelled, the thread is asked to stop, and
    waited for.
    """
    try:
        return await asyncio.shield(working)
    except asyncio.CancelledError:
        cancelled.set()
        await asyncio.wait({working})
        working.exception()
        raise


def stand_back() -> None:
    """Set this thread behind others, where threads have a niceness of their own (Linux)."""
    with suppress(AttributeError, OSError):
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICENESS)


log = logging.getLogger("isogi.server")


LEASE = 20.0
"""Seconds without a new record after which no process works on a prewarm any more."""


class Silence:
    """For how long the record of each prewarm has not changed, by this process's clock: calendars
    differ and jump.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """No record was seen yet."""
        self._clock = clock
        self._heard: dict[str, tuple[datetime, float]] = {}

    def of(self, document: RecordDocument) -> float:
        """Seconds for which a prewarm's document has been as it is, since it was first seen so."""
        if self._heard.get(document.id, (None, 0.0))[0] != document.updated:
            self._heard[document.id] = document.updated, self._clock()
        return self._clock() - self._heard[document.id][1]


async def resume(service: Service) -> None:
    """Begin prewarms that did not end, once the service stands; those of another server, when its
    records stop.
    """
    await service.startup.lit.wait()
    silence = Silence()
    if service.startup.failure:
        held = []
    else:
        held = await taken_up(service, silence)
    service.resumed.set()
    while held:
        await asyncio.sleep(BEAT)
        held = await taken_up(service, silence)


async def taken_up(service: Service, silence: Silence) -> list[RecordDocument]:
    """Begin the prewarms that no process works on; the others: another server has them, or there
    are enough jobs.
    """
    try:
        found = await asyncio.to_thread(
            lambda: [
                each for each in recorded_prewarms(service.engine.store) if ours(service, each)
            ]
        )
    except StoreError as error:
        log.warning("Prewarms that were stopped are not taken up: %s", error)
        return []
    free = {document.id for document in found if silence.of(document) > LEASE or document.left}
    return [
        document for document in found if not (document.id in free and begun(service, document))
    ]


def ours(service: Service, document: RecordDocument) -> bool:
    """Whether a prewarm belongs to a server, has not ended, and its scene is shown here with the
    same light.
    """
    scene = service.engine.scenes.get(document.scene)
    same = scene is not None and scene.digest == document.scene_digest
    return (
        same
        and document.by == "server"
        and document.status in OPEN_STATES
        and service.jobs.running(document.id) is None
    )


def begun(service: Service, document: RecordDocument) -> bool:
    """Begin a prewarm again, under its former id and until its former deadline; whether there was
    room for it.
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
