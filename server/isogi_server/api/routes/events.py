"""The refinement of a view as server-sent events, for scripts and for pages without a stream."""

from __future__ import annotations

import asyncio
import hashlib
import json
from collections.abc import AsyncGenerator, Hashable
from contextlib import aclosing, suppress
from dataclasses import asdict
from typing import Annotated, Any

from fastapi import APIRouter, Header, Request, Response
from fastapi.sse import EventSourceResponse, format_sse_event

from isogi_core.errors import StoreError
from isogi_core.frame.frame import Frame
from isogi_server.answers import coverage_schema
from isogi_server.api.dependencies import ViewParamsDep
from isogi_server.api.service import (
    PREVIEW,
    ClientDep,
    PictureRequest,
    SceneDep,
    Service,
    ServiceDep,
    Shown,
)
from isogi_server.errors import BusyError, ParameterError, UnknownSceneError
from isogi_server.parameters import ViewParams, documented
from isogi_server.problems import documented_problems
from isogi_server.render.time_left import Unfinished
from isogi_server.render.viewers import stream_viewer
from isogi_server.schemas import TimeLeftSchema
from isogi_worker.bake_requests import Viewer

router = APIRouter(prefix="/v1/scenes/{scene}", tags=["frames"])
EVENTS_DESCRIPTION = (
    "Events. refined: what /coverage answers, each time that the frame has become better; "
    "progress: chunks that are"
    " still to be baked and the time left, once a second; final or failed: the end. An id "
    "names the frame's light and state: a"
    " client that comes back with it in Last-Event-ID gets only what is new."
)
ANSWERS: dict[int | str, dict[str, Any]] = {
    200: {"description": EVENTS_DESCRIPTION, "content": {"text/event-stream": {}}},
    204: {"description": "The frame is final, and Last-Event-ID says that the client knows."},
}


@router.get(
    "/events",
    response_class=Response,
    openapi_extra=documented(ViewParams),
    responses=ANSWERS | documented_problems(404, 422, 429, 503),
)
async def read_events(
    request: Request,
    scene: SceneDep,
    params: ViewParamsDep,
    service: ServiceDep,
    client: ClientDep,
    last_event_id: Annotated[str | None, Header(max_length=80)] = None,
) -> Response:
    """Return events about the refinement of a view. Its light is baked while a client listens."""
    if "wait_ms" in params.model_fields_set:
        raise ParameterError(
            "wait_ms is for requests, events come by themselves: leave it out.", "wait_ms"
        )
    viewer = stream_viewer(request)
    scene = await service.variant(scene, params, client)
    events = events_of(
        service, service.picture_of(scene, params), last_event_id or "", viewer, client
    )
    # Wait for the first event: errors before it become an HTTP status, and a final picture that the
    # client has seen becomes 204.
    first = await anext(events, None)
    if first is None:
        return Response(status_code=204)
    return EventSourceResponse(resumed(first, events), headers={"Cache-Control": "no-store"})


async def resumed(first: bytes, rest: AsyncGenerator[bytes, None]) -> AsyncGenerator[bytes, None]:
    """Yield the ``first`` event and the others; end with ``failed`` if the scene is dismissed,
    its light cannot be read, or another client needs the place.
    """
    yield first
    async with aclosing(rest) as others:
        try:
            async for each in others:
                yield each
        except (BusyError, UnknownSceneError, StoreError) as error:
            yield event("failed", {"detail": str(error)})


TIME_LEFT_SECONDS = 1.0
"""Seconds without other events after which a progress event is sent."""


async def events_of(
    service: Service, picture: PictureRequest, seen: str, viewer: Viewer, client: Hashable
) -> AsyncGenerator[bytes, None]:
    """Yield events of a picture until it is final or has failed. The first is left out if its id
    is ``seen``, unless it tells of a failure; no event comes if it tells that the picture is
    final.

    Its light is baked while the ``client`` listens. Raises BusyError if too many clients do, and
    StoreError.
    """
    with service.connections.admitted(client) as place:
        try:
            lacks = None
            async with aclosing(answers(service, picture, viewer)) as shown_so_far:
                async for shown in shown_so_far:
                    place.check()
                    if shown is None:
                        if lacks is not None:
                            yield event("progress", await progress(service, lacks, viewer))
                        continue
                    lacks = await asyncio.to_thread(
                        service.engine.unfinished, picture.scene, shown.frame, picture.goal
                    )
                    kind, facts = event_of(service, shown, viewer)
                    name = id_of(kind, shown.frame.version)
                    # Keep no picture here, so that its megabytes are free while light is baked:
                    # ``answers`` drops it when it is asked for the next one.
                    shown.place.leave()
                    del shown
                    known = kind != "failed" and name == seen
                    # Pictures after the first one have new light or a new error, also those with
                    # its id.
                    seen = ""
                    if not known:
                        yield event(kind, facts, name)
        finally:
            service.leave(viewer)


def event_of(service: Service, shown: Shown, viewer: Viewer) -> tuple[str, dict[str, Any]]:
    """Return the kind of the event that reports a picture to a ``viewer``, and its data."""
    if shown.frame.final:
        return "final", coverage(shown)
    if shown.coming:
        return "refined", coverage(shown)
    # Not final, and nothing is coming: the light was given up.
    return "failed", coverage(shown) | {"detail": reason(service, shown.frame, viewer)}


async def answers(
    service: Service, picture: PictureRequest, viewer: Viewer
) -> AsyncGenerator[Shown | None, None]:
    """Yield each answer to a picture request, and None after TIME_LEFT_SECONDS seconds without a
    new one.

    A picture takes megabytes. The one that was yielded is kept here until the caller asks for the
    next one, and is let go while that is made.
    """
    async with aclosing(service.refinements(picture, viewer)) as refinements:
        coming = asyncio.ensure_future(anext(refinements, None))
        try:
            while True:
                done, _ = await asyncio.wait({coming}, timeout=TIME_LEFT_SECONDS)
                if not done:
                    yield None
                    continue
                # Besides ``coming``, the set would hold the picture until the next one has come.
                done.clear()
                if coming.result() is None:
                    return
                yield coming.result()
                coming = asyncio.ensure_future(anext(refinements, None))
        finally:
            # Wait until the generator has really ended, so that ``aclosing`` can close it.
            coming.cancel()
            while not coming.done():
                # A cancelled scope of anyio, in which the answer is sent, cancels each wait again.
                with suppress(asyncio.CancelledError):
                    await asyncio.wait({coming})


def id_of(kind: str, version: str) -> str:
    """Return the id of an event of this kind on a frame of this version.

    Measuring alone can make a picture final, at the version that "refined" has told before: the id
    names both. It is a digest, as versions grow with the walls, and the header is limited.
    """
    return hashlib.blake2b(f"{kind} {version}".encode(), digest_size=16).hexdigest()


def event(kind: str, data: dict[str, Any], name: str | None = None) -> bytes:
    """Encode an event with the id ``name``."""
    return format_sse_event(data_str=json.dumps(data), event=kind, id=name)


def coverage(shown: Shown) -> dict[str, Any]:
    """Return the document that /coverage answers."""
    return coverage_schema(shown.frame, shown.time_left).model_dump()


async def progress(service: Service, lacks: Unfinished, viewer: Viewer) -> dict[str, Any]:
    """Return the number of chunks that are still to be baked, and the time left. Asking for the
    number renews the ``viewer``'s requests, which expire otherwise.
    """
    waiting = await asyncio.to_thread(service.engine.waiting, lacks, viewer)
    left = await asyncio.to_thread(service.engine.time_without, lacks)
    known = None if left is None else TimeLeftSchema(**asdict(left)).model_dump()
    return {"waiting": waiting, "time_left": known, "overdue": bool(left and left.overdue)}


def reason(service: Service, frame: Frame, viewer: Viewer) -> str:
    """Return the reason why a frame is not final though no more light is coming."""
    # From the most specific reason to the general one. A frame in the shading PREVIEW, which a view
    # with other shading asked for, stands in for light that does not fit the memory.
    if frame.given_up:
        error = f"The total error is {frame.total.likely:.3g} after all paths that pixels may take"
        return f"{error}: ask for a larger max_error."
    if frame.view.shading == PREVIEW:
        return (
            "The light of this view does not fit the memory: look closer, or give the "
            "server more --memory-mb."
        )
    if not viewer.bakes:
        return "Your token allows to look, and not to have light baked: ask for one that does."
    if frame.view.shading != "path_traced":
        return service.reason()
    error = f"the estimated error is {frame.noise:.3g}"
    return (
        f"All samples are taken ({frame.view.samples} per pixel) and {error}: ask for more samples."
    )
