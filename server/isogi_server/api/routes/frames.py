"""Frames of a scene, their coverage, and pictures that a job delivers later."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from functools import partial
from typing import Any
from urllib.parse import urlencode

from fastapi import APIRouter, Request, Response
from starlette.responses import StreamingResponse
from starlette.types import Message, Send

from isogi_core.errors import StoreAwayError
from isogi_core.frame.frame import Frame
from isogi_core.frame.tiles import Stopwatch
from isogi_server.answers import camera_schema, coverage_schema
from isogi_server.api.dependencies import FitParamsDep, FrameParamsDep, ViewParamsDep
from isogi_server.api.headers import (
    STAGES,
    PreferencesDep,
    entity_tag,
    frame_headers,
    matches,
    server_timing,
)
from isogi_server.api.lifespan import within
from isogi_server.api.routes.jobs import JobSchema, address, job_schema
from isogi_server.api.service import BearerDep, PictureRequest, SceneDep, Service, ServiceDep, Shown
from isogi_server.bearers import client_of
from isogi_server.errors import StalledError
from isogi_server.parameters import FitParams, FrameParams, ViewParams, documented
from isogi_server.pictures import MEDIA_TYPES, encode, format_for, npy_bytes, npy_parts, smoothed
from isogi_server.problems import documented_problems
from isogi_server.render.bakes import BackgroundBake
from isogi_server.render.jobs import Job, Result
from isogi_server.render.scheduling import REFINEMENT_PATIENCE, REQUEST_PATIENCE, Room
from isogi_server.render.viewers import background_viewer, request_viewer, stream_viewer
from isogi_server.schemas import CameraSchema, Coverage
from isogi_worker.bake_requests import Viewer
from isogi_worker.errors import WorkersError

SLOWEST_PART = 5.0
"""Seconds for which a client may take nothing of its answer while other answers wait."""

router = APIRouter(prefix="/v1/scenes/{scene}", tags=["frames"])
APPLIED = {"Preference-Applied": {"description": "The preferences that were applied."}}
HEADERS = APPLIED | {
    "Isogi-Time-Left": {
        "description": "Seconds until all is final, if known: low=12.0, likely=20.0, high=41.0."
    },
    "Server-Timing": {"description": "; ".join(f"{name}: {what}" for name, what in STAGES.items())},
}
ANSWERS: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "The picture.",
        "content": {kind: {} for kind in MEDIA_TYPES.values()},
        "headers": HEADERS,
    },
    202: {
        "description": (
            "The picture is not final, and respond-async is preferred: a job that bakes it."
        ),
        "model": JobSchema,
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
    request: Request,
    scene: SceneDep,
    params: FrameParamsDep,
    service: ServiceDep,
    preferences: PreferencesDep,
    bearer: BearerDep,
) -> Response:
    """Return a picture at once, with the light baked so far. The headers say how good it is."""
    form = format_for(params, request.headers.get("accept"))
    scene = await service.variant(scene, params, client_of(request.scope))
    if params.exposure is None:
        exposure = scene.default_exposure
    else:
        exposure = params.exposure
    # A client that prefers a job waits for the time that it prefers, and gets the job if the
    # picture is not final then.
    params, applied = preferences.fill(smoothed(params, form))
    later = preferences.respond_async and bearer.may("bake")

    def answer(shown: Shown) -> Response | None:
        """Return the response with a picture; None if a job is to bake it. Runs on a thread of
        the queue, as it may encode the picture.
        """
        frame = shown.frame
        watch = shown.watch
        if later and not frame.final:
            return None
        # The tag follows from the light alone: no picture is encoded that the client has already.
        tag = entity_tag(frame, form, exposure, params)
        headers = frame_headers(frame, shown.time_left, tag, params.version) | applied
        if matches(request.headers.get("if-none-match"), tag):
            return Response(
                status_code=304, headers=headers | {"Server-Timing": server_timing(watch)}
            )
        if form == "npy":
            return InTurn(service, viewer, frame, headers | {"Server-Timing": server_timing(watch)})
        with watch.stage("encode"):
            body = encode(frame, form, exposure, params)
        return Response(
            body, 200, headers | {"Server-Timing": server_timing(watch)}, MEDIA_TYPES[form]
        )

    if later:
        viewer = stream_viewer(request)
    else:
        viewer = request_viewer(request)
    # A request that may become a job has a separate viewer. Its requests for light are dropped, as
    # the job repeats them.
    if (now := await service.render(request, scene, params, answer, viewer)) is not None:
        return now
    service.leave(viewer)
    picture = service.picture_of(scene, params)
    return defer(
        service,
        picture,
        params,
        request.query_params.multi_items(),
        (form, exposure),
        client_of(request.scope),
    )


class InTurn(StreamingResponse):
    """A frame as npy, made while it is sent: made as a whole, a large one would take its memory
    several times.

    Only a few large frames are sent at once, so that slow clients do not keep ever more of them in
    memory. A frame that waits for its turn is in memory, too, but gives up after a while. If a
    client takes nothing for long while others wait, its answer is cut short.
    """

    def __init__(
        self, service: Service, viewer: Viewer, frame: Frame, headers: dict[str, str]
    ) -> None:
        """Answer a ``viewer`` with a ``frame``."""
        whole = headers | {"Content-Length": str(npy_bytes(frame))}
        super().__init__(npy_parts(frame), 200, whole, MEDIA_TYPES["npy"])
        self._service = service
        self._viewer = viewer
        self._room = service.threads.sending(frame.view)

    async def stream_response(self, send: Send) -> None:
        """Send the headers and the frame once it is its turn; a small frame at once. Raises
        BusyError, with nothing sent yet, if its turn does not come within ``queue_seconds``.
        """
        if self._room is None:
            await super().stream_response(send)
            return
        longest = self._service.settings.patience.queue_seconds
        rank = self._service.rank(self._viewer, REQUEST_PATIENCE, longest)
        place = await self._room.enter(rank)
        try:
            await super().stream_response(partial(self._send_part, send, self._room))
        except StalledError:
            pass  # The answer is cut short, and uvicorn closes the connection.
        finally:
            place.leave()

    async def _send_part(self, send: Send, room: Room, message: Message) -> None:
        """Send a part of the answer by ``send``. While the client has not taken it, look every
        SLOWEST_PART seconds for other answers that wait for the ``room``. Raises StalledError if
        there are any.
        """
        sending = asyncio.ensure_future(send(message))
        try:
            # Each wait returns the set of what is done: empty, or with the sending.
            while not (await asyncio.wait({sending}, timeout=SLOWEST_PART))[0]:
                if room.crowded:
                    raise StalledError
            await sending
        finally:
            sending.cancel()


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
    """Return how far the same view is baked: chunks, pixels by state, the estimated error, and
    the time until it is final.
    """
    params, applied = preferences.fill(params)
    scene = await service.variant(scene, params, client_of(request.scope))
    response.headers.update(applied | {"Cache-Control": "no-cache", "Vary": "Prefer"})
    return await service.render(
        request, scene, params, lambda shown: coverage_schema(shown.frame, shown.time_left)
    )


@router.get(
    "/fit", openapi_extra=documented(FitParams), responses=documented_problems(404, 422, 429, 503)
)
async def read_fit(
    request: Request, scene: SceneDep, params: FitParamsDep, service: ServiceDep
) -> CameraSchema:
    """Return the camera that shows the whole surface as large as the picture allows."""
    first = scene.settings.first
    if first.fov is not None and "fov" not in params.model_fields_set:
        params = params.model_copy(update={"fov": first.fov})
    picture = service.picture_of(scene, params.view)
    view = picture.view
    angles = (params.azimuth, params.elevation)

    def work() -> CameraSchema:
        return camera_schema(service.engine.renderer(scene.id), view, *angles, params.projection)

    return await service.compute(request, work)


REPLACED = ("f", "version", "wait_ms")
"""Parameters that are replaced or left out in the address of a job's picture."""


def defer(
    service: Service,
    picture: PictureRequest,
    params: FrameParams,
    query: list[tuple[str, str]],
    output: tuple[str, float],
    client: tuple[str, str] = ("", ""),
) -> Response:
    """Answer 202, and start a job of the ``client`` that has the light of a picture baked. Raises
    BusyError.

    ``query`` are the parameters as they were given; ``output`` is the format and the exposure of
    the picture.
    """
    (form, exposure) = output
    own = service.engine.variant(picture.scene).base

    async def work(job: Job) -> Iterable[Result]:
        frame = await complete(service, picture, job)
        tag = entity_tag(frame, form, exposure, params)
        # The address asks for the version that was baked, which caches keep for ever.
        named = [
            *(pair for pair in query if pair[0] not in REPLACED),
            ("f", form),
            ("version", tag.strip('"')),
        ]
        href = f"/v1/scenes/{own}/frame?{urlencode(named)}"
        return [Result(href, MEDIA_TYPES[form], "The picture")]

    job = service.jobs.begin("frame", f"A frame of {own}", work, client=client)
    headers = {
        "Location": address(job),
        "Preference-Applied": "respond-async",
        "Cache-Control": "no-store",
    }
    return Response(
        job_schema(job).model_dump_json(),
        202,
        headers | {"Vary": "Accept, Prefer"},
        media_type="application/json",
    )


JOB_REPORT_SECONDS = 1.0
"""Seconds between two reports of a job's progress."""

AWAY = 1.0
"""Seconds after which a store that cannot be reached is tried again."""


async def complete(service: Service, picture: PictureRequest, job: Job) -> Frame:
    """Return the frame of a picture once it is final or lacks no more light. A path-traced picture
    lacks none, and is returned as it is drawn first.

    The ``job`` reports progress. The bake yields to people; if light is still requested when this
    ends, as by cancelling, the request is dropped. While the store cannot be reached, this waits.
    Raises WorkersError if some light cannot be baked, and StoreError.
    """
    viewer = background_viewer()
    # Finer and projected texels, and those of one side of a surface, have separate bakes. Their
    # light is reported under the bake that the view reads: see ``RenderEngine.listen``.
    reported_bake = service.engine.bake_of(picture.scene, picture.view)
    try:
        while True:
            since = service.updates.newest(reported_bake)
            try:
                frame = await service.frame(
                    picture, service.rank(viewer, REFINEMENT_PATIENCE), Stopwatch()
                )
            except StoreAwayError as error:
                job.report(0.0, str(error))
                await asyncio.sleep(AWAY)
                continue
            if frame.final:
                return frame
            # All texels are baked, or none are to be: measure and refine the picture, step by step.
            if frame.checkable:
                if frame.undecided or frame.goes_without_texels:
                    job.report(0.0, "Paths are traced from the pixels of the picture.")
                else:
                    job.report(1.0, "All light is baked; control pixels measure the picture.")
                await service.check(picture)
                continue
            # Have the next stage of light baked, and draw the picture again.
            lacking_bake, stage = await asyncio.to_thread(
                service.engine.lacking, picture.scene, frame
            )
            if not stage.demands:
                return frame
            baking = await asyncio.to_thread(service.engine.bake, lacking_bake, stage, viewer)
            needed = frame.chunks_needed
            del frame, stage  # Free megabytes while light is baked.
            if not baking.coming:
                raise WorkersError(service.reason())
            await follow(service, reported_bake, baking, needed, since, job)
    finally:
        service.leave(viewer)


async def follow(
    service: Service, bake: str, baking: BackgroundBake, needed: int, since: int, job: Job
) -> None:
    """Return when a background bake is done. The ``job`` reports the share of the ``needed`` chunks
    that are baked.

    New light of the ``baking`` is reported under the name ``bake``, by updates with numbers above
    ``since``.
    """
    with service.updates.pending(bake, baking.coming, since) as pending:
        while not pending.all.is_set() and (waiting := await asyncio.to_thread(baking.waiting)):
            # Ask for the chunks now and then, as the request expires otherwise.
            done = needed - waiting
            left = await asyncio.to_thread(baking.time_left)
            job.report(done / needed, f"{done} of {needed} chunks are baked.", left)
            await within(JOB_REPORT_SECONDS, pending.all)
