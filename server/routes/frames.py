"""Frames of a scene, and how far their light is baked."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from fastapi import APIRouter, Request, Response
from starlette.responses import StreamingResponse

from server.deferral import defer
from server.facts import Coverage, coverage_facts
from server.headers import STAGES, entity_tag, frame_headers, matches, server_timing
from server.order import Shown
from server.params import FrameParams, FrameParamsDep, ViewParams, ViewParamsDep, documented
from server.pictures import MEDIA_TYPES, encode, format_for, npy_bytes, npy_parts
from server.prefer import PreferencesDep
from server.problems import documented_problems
from server.service import SceneDep, ServiceDep
from server.statuses import JobFacts
from server.visits import guest, newcomer

if TYPE_CHECKING:
    from isogi_core.frame.frame import Frame

router = APIRouter(prefix="/v1/scenes/{scene}", tags=["frames"])
APPLIED = {"Preference-Applied": {"description": "What of the Prefer header was heeded."}}
HEADERS = APPLIED | {
    "Isogi-Time-Left": {"description": "Seconds until all is final, where known: low=12.0, likely=20.0, high=41.0."},
    "Server-Timing": {"description": "; ".join(f"{name}: {what}" for name, what in STAGES.items())},
}
ANSWERS: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "The picture.",
        "content": {kind: {} for kind in MEDIA_TYPES.values()},
        "headers": HEADERS,
    },
    202: {
        "description": "The picture is not final, and respond-async is preferred: a job that bakes it.",
        "model": JobFacts,
        "headers": APPLIED | {"Location": {"description": "The job."}},
    },
    304: {"description": "The picture is the one that If-None-Match names."},
}


@router.get(
    "/frame",
    response_class=Response,
    openapi_extra=documented(FrameParams),
    responses=ANSWERS | documented_problems(404, 406, 422, 429, 503),
)
async def read_frame(
    request: Request, scene: SceneDep, params: FrameParamsDep, service: ServiceDep, preferences: PreferencesDep
) -> Response:
    """A picture at once, with what is baked so far; the headers say how good it is."""
    form = format_for(params, request.headers.get("accept"))
    exposure = scene.default_exposure if params.exposure is None else params.exposure
    params, applied = preferences.fill(params)
    later = preferences.respond_async

    def answer(shown: Shown) -> Response | None:
        frame, watch = shown.frame, shown.watch
        if frame.provisional and later:
            return None
        tag = entity_tag(frame, form, exposure, params.overlay, params.max_error)
        headers = frame_headers(frame, shown.time_left, tag, params.version) | applied
        if matches(request.headers.get("if-none-match"), tag):
            return Response(status_code=304, headers=headers | {"Server-Timing": server_timing(watch)})
        if form == "npy":
            return in_parts(frame, headers | {"Server-Timing": server_timing(watch)})
        with watch.stage("encode"):
            body = encode(frame, form, exposure, params.overlay)
        return Response(body, 200, headers | {"Server-Timing": server_timing(watch)}, MEDIA_TYPES[form])

    viewer = newcomer() if later else guest(request)
    if (now := await service.render(request, scene, params, answer, viewer)) is not None:
        return now
    service.leave(viewer)
    order = service.order(scene, params)
    return defer(service, order, params, request.query_params.multi_items(), (form, exposure))


def in_parts(frame: Frame, headers: dict[str, str]) -> Response:
    """A frame as npy, made while it is sent: a large one would take its memory several times over."""
    whole = headers | {"Content-Length": str(npy_bytes(frame))}
    return StreamingResponse(npy_parts(frame), 200, whole, MEDIA_TYPES["npy"])


@router.get(
    "/coverage",
    openapi_extra=documented(ViewParams),
    responses=documented_problems(404, 422, 429, 503),
)
async def read_coverage(
    request: Request,
    response: Response,
    scene: SceneDep,
    params: ViewParamsDep,
    service: ServiceDep,
    preferences: PreferencesDep,
) -> Coverage:
    """How far the same view is baked: chunks, pixels by state, the estimated error, and the time until it is final."""
    params, applied = preferences.fill(params)
    response.headers.update(applied | {"Cache-Control": "no-cache", "Vary": "Prefer"})
    return await service.render(request, scene, params, lambda shown: coverage_facts(shown.frame, shown.time_left))
