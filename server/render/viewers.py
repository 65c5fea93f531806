"""Viewers: for whom light is baked, and work that ends when its client leaves."""

import asyncio
import itertools
from collections.abc import Awaitable, Coroutine
from typing import Any, TypeVar

from fastapi import Request
from starlette.requests import HTTPConnection

from isogi_core.errors import Cancelled
from server.bearers import bearer_of, client_of
from worker.bake_requests import Viewer

Result = TypeVar("Result")

_visits = itertools.count(1)


def request_viewer(request: Request) -> Viewer:
    """The viewer of one request: all requests of a bearer at an address are one client's."""
    bakes = bearer_of(request.scope).may("bake")
    return Viewer(client_of(request.scope), next(_visits), bakes=bakes)


def stream_viewer(connection: HTTPConnection) -> Viewer:
    """The viewer of a stream: a client of its own, which looks at one view at a time."""
    visit = next(_visits)
    return Viewer(visit, visit, single=True, bakes=bearer_of(connection.scope).may("bake"))


def background_viewer() -> Viewer:
    """The viewer of work in the background: a client of its own, which yields to all others."""
    visit = next(_visits)
    return Viewer(visit, visit, single=True, patient=True)


async def run_while_connected(request: Request, answer: Coroutine[Any, Any, Result]) -> Result:
    """The answer to a request. Once its client has left, the answer is cancelled and Cancelled
    raised.
    """
    return await run_until(answer, disconnected(request))


async def run_until(work: Awaitable[Result], end: Awaitable[object]) -> Result:
    """What some work comes to, or raises; where the ``end`` comes first, it is cancelled and
    Cancelled raised.
    """
    working = asyncio.ensure_future(work)
    ending = asyncio.ensure_future(end)
    try:
        await asyncio.wait({working, ending}, return_when=asyncio.FIRST_COMPLETED)
        if not working.done():
            raise Cancelled("Nobody waits for this any more.")
        return await working
    finally:
        working.cancel()
        ending.cancel()
        del working, ending  # an error in them would hold itself until garbage is looked for


async def disconnected(request: Request) -> None:
    """Returns when the client has disconnected."""
    while (await request.receive())["type"] != "http.disconnect":
        pass
