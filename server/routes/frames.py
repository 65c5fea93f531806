"""Frames of a scene, and how far their light is baked."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, Request, Response

from server.facts import Coverage, coverage_facts
from server.headers import STAGES, entity_tag, frame_headers, matches, server_timing
from server.params import FrameParams, FrameParamsDep, ViewParams, ViewParamsDep, documented
from server.pictures import MEDIA_TYPES, encode, format_for
from server.problems import documented_problems
from server.service import SceneDep, ServiceDep, Shown

router = APIRouter(prefix="/v1/scenes/{scene}", tags=["frames"])
HEADERS = {
    "Isogi-Time-Left": {"description": "Seconds until all is final, where known: low=12.0, likely=20.0, high=41.0."},
    "Server-Timing": {"description": "; ".join(f"{name}: {what}" for name, what in STAGES.items())},
}
ANSWERS: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "The picture.",
        "content": {kind: {} for kind in MEDIA_TYPES.values()},
        "headers": HEADERS,
    },
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

    def answer(shown: Shown) -> Response:
        frame, watch = shown.frame, shown.watch
        tag = entity_tag(frame, form, exposure, params.overlay, params.max_error)
        headers = frame_headers(frame, shown.time_left, tag)
        if matches(request.headers.get("if-none-match"), tag):
            return Response(status_code=304, headers=headers | {"Server-Timing": server_timing(watch)})
        with watch.stage("encode"):
            body = encode(frame, form, exposure, params.overlay == "provisional")
        return Response(body, 200, headers | {"Server-Timing": server_timing(watch)}, MEDIA_TYPES[form])

    return await service.render(request, scene, params, answer)


@router.get(
    "/coverage",
    openapi_extra=documented(ViewParams),
    responses=documented_problems(404, 422, 429, 503),
)
async def read_coverage(request: Request, scene: SceneDep, params: ViewParamsDep, service: ServiceDep) -> Coverage:
    """How far the same view is baked: chunks, pixels by state, the estimated error, and the time until it is final."""
    return await service.render(request, scene, params, lambda shown: coverage_facts(shown.frame, shown.time_left))
