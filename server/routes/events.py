"""How a view becomes final, as server-sent events: for scripts, and for pages that only tell of it."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from contextlib import aclosing
from typing import Annotated, Any

from fastapi import APIRouter, Header, Request, Response
from fastapi.sse import EventSourceResponse

from isogi_core.errors import StoreError
from server.errors import ParameterError, UnknownSceneError
from server.params import ViewParams, ViewParamsDep, documented
from server.problems import documented_problems
from server.service import SceneDep, ServiceDep
from server.story import event, tell

router = APIRouter(prefix="/v1/scenes/{scene}", tags=["frames"])
DESCRIPTION = (
    "Events. refined: what /coverage tells, each time that the frame has become better; progress: chunks that are"
    " still to be baked and the time left, once a second; final or failed: the end. An id names the frame's light: a"
    " client that comes back with it in Last-Event-ID is told what is new alone."
)
ANSWERS: dict[int | str, dict[str, Any]] = {
    200: {"description": DESCRIPTION, "content": {"text/event-stream": {}}},
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
    last_event_id: Annotated[str | None, Header(max_length=80)] = None,
) -> Response:
    """What becomes of a view, as it happens; its light is baked while somebody listens."""
    if "wait_ms" in params.model_fields_set:
        raise ParameterError("wait_ms is for requests, events come by themselves: leave it out.", "wait_ms")
    story = tell(service, service.order(scene, params), last_event_id or "")
    first = await anext(story, None)
    if first is None:
        return Response(status_code=204)
    return EventSourceResponse(resumed(first, story), headers={"Cache-Control": "no-store"})


async def resumed(first: bytes, rest: AsyncGenerator[bytes, None]) -> AsyncGenerator[bytes, None]:
    """The first, and the rest; that it failed where the scene is dismissed meanwhile, or its light cannot be read."""
    yield first
    async with aclosing(rest) as others:
        try:
            async for each in others:
                yield each
        except (UnknownSceneError, StoreError) as error:
            yield event("failed", {"detail": str(error)})
