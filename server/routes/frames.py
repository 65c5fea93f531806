"""Frames of a scene, and how far their light is baked."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

from fastapi import APIRouter, Request, Response

from server.facts import Coverage, coverage_facts
from server.headers import entity_tag, frame_headers, matches, server_timing
from server.params import FrameParams, FrameParamsDep, ViewParams, ViewParamsDep, documented
from server.pictures import MEDIA_TYPES, encode, format_for
from server.problems import documented_problems
from server.service import SceneDep, ServiceDep

if TYPE_CHECKING:
    from isogi_core.frame.frame import Frame

router = APIRouter(prefix="/v1/scenes/{scene}", tags=["frames"])
ANSWERS: dict[int | str, dict[str, Any]] = {
    200: {"description": "The picture.", "content": {kind: {} for kind in MEDIA_TYPES.values()}},
    304: {"description": "The picture is the one that If-None-Match names."},
}


@router.get(
    "/frame",
    response_class=Response,
    openapi_extra=documented(FrameParams),
    responses=ANSWERS | documented_problems(404, 406, 422, 429, 503),
)
async def read_frame(request: Request, scene: SceneDep, params: FrameParamsDep, service: ServiceDep) -> Response:
    """A picture at once, with what is baked so far; the headers say how good it is."""
    form = format_for(params, request.headers.get("accept"))
    exposure = scene.default_exposure if params.exposure is None else params.exposure

    def answer(frame: Frame) -> Response:
        tag = entity_tag(frame, form, exposure, params.overlay, params.max_error)
        headers = frame_headers(frame, tag)
        if matches(request.headers.get("if-none-match"), tag):
            return Response(status_code=304, headers=headers | {"Server-Timing": server_timing(frame.seconds)})
        started = time.perf_counter()
        body = encode(frame, form, exposure, params.overlay == "provisional")
        seconds = {**frame.seconds, "encode": time.perf_counter() - started}
        return Response(body, 200, headers | {"Server-Timing": server_timing(seconds)}, MEDIA_TYPES[form])

    return await service.render(request, scene, params, answer)


@router.get(
    "/coverage",
    openapi_extra=documented(ViewParams),
    responses=documented_problems(404, 422, 429, 503),
)
async def read_coverage(request: Request, scene: SceneDep, params: ViewParamsDep, service: ServiceDep) -> Coverage:
    """How far the same view is baked: chunks, pixels by state, and the estimated error."""
    return await service.render(request, scene, params, coverage_facts)
