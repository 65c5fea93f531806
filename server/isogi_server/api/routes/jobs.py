"""Jobs, which go on after their request is answered; prewarms and exports start some."""

from __future__ import annotations

import asyncio
import json
from dataclasses import asdict
from datetime import datetime
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Header, Path, Request, Response
from fastapi.responses import FileResponse
from pydantic import BaseModel

from isogi_core.plan.scene import Scene
from isogi_server.api import export_jobs
from isogi_server.api.dependencies import ExportParamsDep, NoParamsDep
from isogi_server.api.export_jobs import media_type
from isogi_server.api.prewarm_jobs import begin
from isogi_server.api.service import BearerDep, ClientDep, SceneDep, ServiceDep
from isogi_server.errors import ParameterError, UnknownResultError
from isogi_server.parameters import ExportParams, documented, read
from isogi_server.prewarm.order import PrewarmOrder, PrewarmRequest, Views
from isogi_server.prewarm.record import Summary
from isogi_server.problems import documented_problems
from isogi_server.render.jobs import Job, Status
from isogi_server.schemas import TimeLeftSchema
from isogi_server.settings import Settings

RESULTS = "http://www.opengis.net/def/rel/ogc/1.0/results"
"""Relation of a link to the results of a job."""


class JobLink(BaseModel):
    """A link: its relation to the job (``rel``), and the media type and title of its target."""

    href: str
    rel: str
    type: str
    title: str


class JobSchema(BaseModel):
    """One job. ``progress`` is in percent; times are in UTC, null while they are to come.

    ``expires`` is when a job that has ended is forgotten. All jobs are forgotten when the server
    stops; prewarms are resumed when it starts again. ``time_left`` is null if it is unknown.
    """

    jobID: str
    processID: str
    type: str = "process"
    status: Status
    message: str
    progress: int
    created: datetime
    started: datetime | None
    finished: datetime | None
    updated: datetime
    expires: datetime | None
    time_left: TimeLeftSchema | None
    links: list[JobLink]


class JobList(BaseModel):
    """All jobs, the newest first."""

    jobs: list[JobSchema]
    links: list[JobLink]


def job_schema(job: Job) -> JobSchema:
    """Return the document of one job."""
    own = JobLink(href=address(job), rel="self", type="application/json", title=job.title)
    names = (
        "status",
        "message",
        "progress",
        "created",
        "started",
        "finished",
        "updated",
        "expires",
    )
    return JobSchema(
        jobID=job.id,
        processID=job.process,
        **{name: getattr(job, name) for name in names},
        time_left=None if job.time_left is None else TimeLeftSchema(**asdict(job.time_left)),
        links=[own, *(JobLink(rel=RESULTS, **asdict(result)) for result in job.results)],
    )


def address(job: Job) -> str:
    """Return the address of a job."""
    return f"/v1/jobs/{job.id}"


router = APIRouter(prefix="/v1/jobs", tags=["jobs"], dependencies=[NoParamsDep])
JOB_PROBLEMS: dict[int | str, dict[str, Any]] = documented_problems(404, 422, 503)
JobId = Annotated[
    str, Path(description="As in the Location of the answer that the job began with.")
]


@router.get("", responses=documented_problems(422))
async def list_jobs(service: ServiceDep, response: Response) -> JobList:
    """Return all known jobs, the newest first."""
    response.headers["Cache-Control"] = "no-store"
    own = JobLink(href="/v1/jobs", rel="self", type="application/json", title="Jobs")
    return JobList(jobs=[job_schema(job) for job in service.jobs.all()], links=[own])


@router.get("/{job}", responses=JOB_PROBLEMS)
async def read_job(job: JobId, service: ServiceDep, response: Response) -> JobSchema:
    """Return the status of a job, the time left, and, after its end, the addresses of its
    results.
    """
    response.headers["Cache-Control"] = "no-store"
    return job_schema(service.job(job))


@router.get("/{job}/results", responses=JOB_PROBLEMS)
async def read_results(job: JobId, service: ServiceDep, response: Response) -> Summary:
    """Return the summary of a prewarm: its order, the amount of work, its cost, and the quality
    of the light.
    """
    response.headers["Cache-Control"] = "no-store"
    found = service.job(job)
    if not isinstance(found.document, Summary):
        raise UnknownResultError(
            f"The job '{found.id}' has no document here: its links lead to its results."
        )
    return found.document


@router.get("/{job}/file", response_class=FileResponse, responses=JOB_PROBLEMS)
async def read_file(job: JobId, service: ServiceDep) -> FileResponse:
    """Return the file that an export has made. It is kept while its job is known and there is
    room for it.
    """
    file = service.exports.find(service.job(job).id)
    return FileResponse(
        file, media_type=media_type(file), filename=file.name, headers={"Cache-Control": "no-store"}
    )


@router.delete("/{job}", responses=JOB_PROBLEMS)
async def dismiss_job(job: JobId, service: ServiceDep, bearer: BearerDep) -> JobSchema:
    """End a job: nothing more is baked for it. A job that has ended is forgotten at once."""
    return job_schema(await service.dismiss(job, bearer))


prewarm_router = APIRouter(prefix="/v1/scenes/{scene}", tags=["jobs"], dependencies=[NoParamsDep])
EXAMPLES = {
    "all sides": {"value": {"isovalues": ["60:120:5"], "views": 24, "target_error": 0.02}},
    "an orbit": {
        "value": {"isovalues": [70], "orbits": [{"count": 36, "elevation": 20}], "deadline": 3600}
    },
    "whole isosurfaces": {
        "value": {"isovalues": ["60:120"], "all_directions": True, "dry_run": True}
    },
}


def inlined(schema: Any, definitions: dict[str, Any]) -> Any:
    """Replace references in a schema by their targets, as the document that it becomes a part
    of lacks the definitions.
    """
    if isinstance(schema, list):
        return [inlined(each, definitions) for each in schema]
    if not isinstance(schema, dict):
        return schema
    if "$ref" in schema:
        return inlined(definitions[schema["$ref"].rpartition("/")[2]], definitions)
    return {name: inlined(each, definitions) for name, each in schema.items() if name != "$defs"}


ASKED = PrewarmRequest.model_json_schema()
SCHEMA = inlined(ASKED, ASKED["$defs"])
BODY = {
    "required": False,
    "content": {"application/json": {"schema": SCHEMA, "examples": EXAMPLES}},
}


def accepted(description: str) -> dict[int | str, dict[str, Any]]:
    """Return the document of an answer with a job."""
    location = {"description": "The job.", "schema": {"type": "string"}}
    return {202: {"description": description, "headers": {"Location": location}}}


async def order_in(request: Request) -> PrewarmRequest:
    """Return the order in a request's body; all defaults if the body is empty. Raises
    ParameterError if it is invalid.
    """
    body = await request.body()
    try:
        asked = json.loads(body) if body else {}
    except (ValueError, RecursionError):
        raise ParameterError("The body is no JSON.") from None
    if not isinstance(asked, dict):
        raise ParameterError(
            'The body must be a JSON object, such as {"isovalues": [70], "views": 12}.'
        )
    return await asyncio.to_thread(read, PrewarmRequest, asked.items())


@prewarm_router.post(
    "/prewarm",
    status_code=202,
    openapi_extra={"requestBody": BODY},
    responses=accepted("The job. The same order once more is the same job until that has ended.")
    | documented_problems(404, 422, 429, 503),
)
async def prewarm(
    scene: SceneDep,
    asked: Annotated[PrewarmRequest, Depends(order_in)],
    service: ServiceDep,
    response: Response,
    client: ClientDep,
) -> JobSchema:
    """Bake light ahead, or forecast (dry_run) its amount and time.

    A prewarm yields to people, goes on when the server starts again, and is dismissed by DELETE.
    """
    service.startup.check()
    await asyncio.to_thread(check, scene, asked.order, service.settings)
    job = begin(service, scene, asked.order, asked.dry_run, client)
    response.headers.update({"Location": address(job), "Cache-Control": "no-store"})
    return job_schema(job)


export_router = APIRouter(prefix="/v1/scenes/{scene}", tags=["jobs"])
LONGEST_KEY = 256
KEY_DESCRIPTION = (
    "Any text that no other request of this client has. A request that is repeated with it, as its "
    "answer was lost, begins no second job."
)


@export_router.post(
    "/export",
    status_code=202,
    openapi_extra=documented(ExportParams),
    responses=accepted("The job. The same request with the same Idempotency-Key is the same job.")
    | documented_problems(403, 404, 422, 429, 503),
)
async def export(
    scene: SceneDep,
    params: ExportParamsDep,
    service: ServiceDep,
    response: Response,
    client: ClientDep,
    idempotency_key: Annotated[
        str | None, Header(max_length=LONGEST_KEY, description=KEY_DESCRIPTION)
    ] = None,
) -> JobSchema:
    """Bake a whole isosurface and make a file with its light, to be fetched at
    `/v1/jobs/{job}/file` after the job has ended.
    """
    service.startup.check()
    scene = await service.variant(scene, params, client)
    job = export_jobs.begin(service, scene, params, client, idempotency_key)
    response.headers.update({"Location": address(job), "Cache-Control": "no-store"})
    return job_schema(job)


def check(scene: Scene, order: PrewarmOrder, settings: Settings) -> None:
    """Raise ViewError if an order asks for isovalues or views that are not allowed."""
    order.isovalues_of(scene)
    Views(order, scene, settings)
