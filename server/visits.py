"""Visits: who asks over HTTP, and that work for them ends when they leave."""

import asyncio
import itertools
from collections.abc import Coroutine
from typing import Any, TypeVar

from fastapi import Request

from isogi_core.errors import Cancelled
from worker.viewers import Viewer

Result = TypeVar("Result")

_visits = itertools.count(1)


def guest(request: Request) -> Viewer:
    """The viewer of one request: all requests of an address are one client's."""
    return Viewer(request.client.host if request.client else "", next(_visits))


def newcomer() -> Viewer:
    """The viewer of a connection that stays: a client of its own, which looks at one view at a time."""
    visit = next(_visits)
    return Viewer(visit, visit, single=True)


def absentee() -> Viewer:
    """The viewer of work that goes on while nobody looks: a client of its own, which yields to all that do."""
    visit = next(_visits)
    return Viewer(visit, visit, single=True, patient=True)


async def attended(request: Request, answer: Coroutine[Any, Any, Result]) -> Result:
    """The answer to a request, which is cancelled when its client leaves: Cancelled is raised then."""
    working, leaving = asyncio.create_task(answer), asyncio.create_task(gone(request))
    try:
        await asyncio.wait({working, leaving}, return_when=asyncio.FIRST_COMPLETED)
        if not working.done():
            raise Cancelled("Nobody waits for this frame any more.")
        return await working
    finally:
        working.cancel()
        leaving.cancel()


async def gone(request: Request) -> None:
    """Returns when the client has disconnected."""
    while (await request.receive())["type"] != "http.disconnect":
        pass
