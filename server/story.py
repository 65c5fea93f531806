"""The story of a view: how it becomes final, as server-sent events."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncGenerator
from contextlib import aclosing, suppress
from dataclasses import asdict
from typing import Any

from fastapi.sse import format_sse_event

from server.facts import coverage_facts
from server.order import Order, Shown
from server.service import Service
from server.visits import newcomer
from worker.viewers import Viewer

PROGRESS = 1.0
"""Seconds without other events after which the time left is told."""


async def tell(service: Service, order: Order, seen: str) -> AsyncGenerator[bytes, None]:
    """Events of an order until it is final or has failed; nothing where it is final and was ``seen`` so.

    Its light is wanted for as long as somebody listens. Raises BusyError where too many do, and StoreError.
    """
    viewer = newcomer()
    with service.connections.admitted():
        try:
            async with aclosing(pictures(service, order, viewer)) as shows:
                async for shown, new in shows:
                    if not new:
                        yield event("progress", await progress(service, order, shown, viewer))
                    elif shown.frame.provisional and not shown.coming:
                        yield event("failed", coverage(shown) | {"detail": reason(service)}, shown.frame.version)
                    elif shown.frame.version != seen:
                        kind = "refined" if shown.frame.provisional else "final"
                        yield event(kind, coverage(shown), shown.frame.version)
        finally:
            service.leave(viewer)


async def pictures(service: Service, order: Order, viewer: Viewer) -> AsyncGenerator[tuple[Shown, bool], None]:
    """What is shown of an order, and whether it is new; the latest again where nothing new came for a while."""
    async with aclosing(service.refinements(order, viewer)) as refinements:
        shown, coming = None, asyncio.ensure_future(anext(refinements, None))
        try:
            while True:
                done, _ = await asyncio.wait({coming}, timeout=PROGRESS)
                if done and (shown := coming.result()) is None:
                    return
                if done:
                    coming = asyncio.ensure_future(anext(refinements, None))
                if shown:
                    yield shown, bool(done)
        finally:
            coming.cancel()
            while not coming.done():
                with suppress(asyncio.CancelledError):  # a scope that was cancelled says so again and again
                    await asyncio.wait({coming})


def event(kind: str, data: dict[str, Any], version: str | None = None) -> bytes:
    """One event; the ``version`` of what it tells is its id."""
    return format_sse_event(data_str=json.dumps(data), event=kind, id=version)


def coverage(shown: Shown) -> dict[str, Any]:
    """What /coverage tells."""
    return coverage_facts(shown.frame, shown.time_left).model_dump()


async def progress(service: Service, order: Order, shown: Shown, viewer: Viewer) -> dict[str, Any]:
    """The chunks that are still to be baked, and the time that it takes."""
    studio, frame = service.studio, shown.frame
    waiting = await asyncio.to_thread(studio.waiting, order.scene, frame, viewer)
    left = await asyncio.to_thread(studio.time_left, order.scene, frame, order.target)
    return {"waiting": waiting, "time_left": asdict(left) if left else None}


def reason(service: Service) -> str:
    """Why light is not baked."""
    return service.studio.trouble() or "Some light that the view needs cannot be baked: see /readyz."
