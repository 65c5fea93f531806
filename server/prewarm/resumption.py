"""Resumption: a server that starts takes up the prewarms that one over the same store was stopped at."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable
from datetime import datetime
from typing import TYPE_CHECKING

from isogi_core.errors import StoreError
from server.errors import BusyError
from server.prewarm.record import BEAT, OPEN, Paper, papers
from server.prewarm.service import begin

if TYPE_CHECKING:
    from server.service import Service

log = logging.getLogger("isogi.server")


LEASE = 20.0
"""Seconds without a sign of life after which nobody works on a prewarm any more."""


class Silence:
    """For how long nothing was heard of each prewarm: by the clock of who listens, for calendars differ and jump."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """Nothing was heard yet."""
        self._clock = clock
        self._heard: dict[str, tuple[datetime, float]] = {}

    def of(self, paper: Paper) -> float:
        """Seconds for which a prewarm's paper has been as it is, since it was first seen so."""
        if self._heard.get(paper.id, (None, 0.0))[0] != paper.updated:
            self._heard[paper.id] = paper.updated, self._clock()
        return self._clock() - self._heard[paper.id][1]


async def resume(service: Service) -> None:
    """Begin what was not ended, once the service stands; what another server works on, when that falls silent."""
    await service.settled.wait()
    silence = Silence()
    held = [] if service.failure else await taken_up(service, silence)
    service.resumed.set()
    while held:
        await asyncio.sleep(BEAT)
        held = await taken_up(service, silence)


async def taken_up(service: Service, silence: Silence) -> list[Paper]:
    """Begin what nobody works on; what is left then: somebody else works on it, or there are enough jobs."""
    try:
        found = await asyncio.to_thread(lambda: [each for each in papers(service.studio.root) if ours(service, each)])
    except StoreError as error:
        log.warning("Prewarms that were stopped are not taken up: %s", error)
        return []
    free = {paper.id for paper in found if silence.of(paper) > LEASE or paper.left}
    return [paper for paper in found if not (paper.id in free and begun(service, paper))]


def ours(service: Service, paper: Paper) -> bool:
    """Whether a server was asked for it, its end is to come, and its scene is shown here with the same light."""
    scene = service.studio.scenes.get(paper.scene)
    same = scene is not None and scene.digest == paper.scene_digest
    return same and paper.by == "server" and paper.status in OPEN and service.jobs.running(paper.id) is None


def begun(service: Service, paper: Paper) -> bool:
    """Begin a prewarm again, under its former id and until its former deadline; whether there was room for it."""
    try:
        begin(service, service.studio.scenes[paper.scene], paper.rest)
    except BusyError:
        return False
    return True
