"""Viewers, for whom light is baked, and work that ends when its client disconnects."""

import asyncio
import itertools
from collections.abc import Awaitable, Coroutine
from typing import Any, TypeVar

from fastapi import Request
from starlette.requests import HTTPConnection

from isogi_core.errors import Cancelled
from isogi_server.bearers import bearer_of, client_of
from isogi_worker.bake_requests import Viewer

Result = TypeVar("Result")

_visits = itertools.count(1)


def request_viewer(request: Request) -> Viewer:
    """Return the viewer of one request. All requests with one token from one address are one
    client, which has one share of the workers.
    """
    bakes = bearer_of(request.scope).may("bake")
    return Viewer(client_of(request.scope), next(_visits), bakes=bakes)


def stream_viewer(connection: HTTPConnection) -> Viewer:
    """Return the viewer of a stream: a separate client that looks at one view at a time."""
    visit = next(_visits)
    return Viewer(visit, visit, single=True, bakes=bearer_of(connection.scope).may("bake"))


def background_viewer() -> Viewer:
    """Return a viewer for background work: a separate client that yields to all others."""
    visit = next(_visits)
    return Viewer(visit, visit, single=True, patient=True)


async def run_while_connected(request: Request, answer: Coroutine[Any, Any, Result]) -> Result:
    """Return the answer to a request. If its client disconnects first, cancel the answer and
    raise Cancelled.
    """
    return await run_until(answer, disconnected(request))


async def run_until(work: Awaitable[Result], end: Awaitable[object]) -> Result:
    """Return the result of some ``work``, or raise its error. If ``end`` is done first, cancel
    the work and raise Cancelled.
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
        # An error in a future would hold itself until garbage is collected.
        del working, ending


async def disconnected(request: Request) -> None:
    """Return when the client has disconnected."""
    while (await request.receive())["type"] != "http.disconnect":
        pass
