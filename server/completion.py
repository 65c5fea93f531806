"""Completion: the light of a view is baked to its end while nobody looks."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from isogi_core.errors import StoreAwayError
from isogi_core.frame.stopwatch import Stopwatch
from server.order import Order
from server.renders import REFINED
from server.service import Service, within
from server.story import PROGRESS, reason
from server.turns import Rank
from server.visits import absentee
from worker.errors import WorkersError

if TYPE_CHECKING:
    from isogi_core.frame.frame import Frame
    from server.errand import Errand
    from server.jobs import Job
    from worker.viewers import Viewer

AWAY = 1.0
"""Seconds after which a store that is away is asked again."""


async def complete(service: Service, order: Order, job: Job) -> Frame:
    """The frame of an order once it is final; the ``job`` is told how far it is.

    What is wanted for it yields to people, and is dropped when this is cancelled. Raises WorkersError where some of
    its light cannot be baked, and StoreError; while the store is away it waits.
    """
    viewer, bake = absentee(), service.studio.bake_of(order.scene, order.view)
    try:
        while True:
            since = service.news.newest(bake)
            try:
                frame = await service.frame(order, Rank.within(REFINED), Stopwatch())
            except StoreAwayError as error:
                job.tell(0.0, str(error))
                await asyncio.sleep(AWAY)
                continue
            if not frame.provisional:
                return frame
            errand = await asyncio.to_thread(lacking, service, order, frame, viewer)
            needed = frame.chunks_needed
            del frame  # it may be large, and the rest long
            if not errand.coming:
                raise WorkersError(reason(service))
            await brought(service, bake, errand, needed, since, job)
    finally:
        service.leave(viewer)


def lacking(service: Service, order: Order, frame: Frame, viewer: Viewer) -> Errand:
    """The errand for what a frame lacks. Blocks."""
    return service.studio.errand(*service.studio.lacking(order.scene, frame), order.target, viewer)


async def brought(service: Service, bake: str, errand: Errand, needed: int, since: int, job: Job) -> None:
    """Returns when all of an errand is baked or given up; the ``job`` is told of it among the chunks ``needed``.

    News of number ``since`` of the ``bake`` that its view reads were known when the errand was begun.
    """
    with service.news.pending(bake, errand.coming, since) as pending:
        while not pending.all.is_set() and (waiting := await asyncio.to_thread(errand.waiting)):
            done, left = needed - waiting, await asyncio.to_thread(errand.time_left)
            job.tell(done / needed, f"{done} of {needed} chunks are baked.", left)
            await within(PROGRESS, pending.all)
