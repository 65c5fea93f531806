"""Prewarms: light baked ahead, as jobs."""

from __future__ import annotations

import asyncio
import json
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Request, Response

from isogi_core.model.scene import Scene
from server.errors import ParameterError, StartingError
from server.params import NoParamsDep, read
from server.prewarm.order import PrewarmOrder, PrewarmRequest, Views
from server.prewarm.service import begin
from server.problems import documented_problems
from server.service import SceneDep, ServiceDep
from server.settings import Settings
from server.statuses import JobFacts, address, job_facts

router = APIRouter(prefix="/v1/scenes/{scene}", tags=["jobs"], dependencies=[NoParamsDep])
EXAMPLES = {
    "all sides": {"value": {"isovalues": ["60:120:5"], "views": 24, "target_error": 0.02}},
    "an orbit": {"value": {"isovalues": [70], "orbits": [{"count": 36, "elevation": 20}], "deadline": 3600}},
    "whole isosurfaces": {"value": {"isovalues": ["60:120"], "all_directions": True, "dry_run": True}},
}


def inlined(schema: Any, definitions: dict[str, Any]) -> Any:
    """A schema with what it refers to in its place: the document that it becomes a part of has no such definitions."""
    if isinstance(schema, list):
        return [inlined(each, definitions) for each in schema]
    if not isinstance(schema, dict):
        return schema
    if "$ref" in schema:
        return inlined(definitions[schema["$ref"].rpartition("/")[2]], definitions)
    return {name: inlined(each, definitions) for name, each in schema.items() if name != "$defs"}


ASKED = PrewarmRequest.model_json_schema()
SCHEMA = inlined(ASKED, ASKED["$defs"])
BODY = {"required": False, "content": {"application/json": {"schema": SCHEMA, "examples": EXAMPLES}}}
ANSWERS: dict[int | str, dict[str, Any]] = {
    202: {
        "description": "The job. The same order once more is the same job until that has ended.",
        "headers": {"Location": {"description": "The job.", "schema": {"type": "string"}}},
    }
}


async def order_in(request: Request) -> PrewarmRequest:
    """The document in a request's body, all defaults where there is none; ParameterError where it is wrong."""
    body = await request.body()
    try:
        told = json.loads(body) if body else {}
    except (ValueError, RecursionError):
        raise ParameterError("The body is no JSON.") from None
    if not isinstance(told, dict):
        raise ParameterError('The body must be a JSON object, such as {"isovalues": [70], "views": 12}.')
    return await asyncio.to_thread(read, PrewarmRequest, told.items())


@router.post(
    "/prewarm",
    status_code=202,
    openapi_extra={"requestBody": BODY},
    responses=ANSWERS | documented_problems(404, 422, 429, 503),
)
async def prewarm(
    scene: SceneDep, told: Annotated[PrewarmRequest, Depends(order_in)], service: ServiceDep, response: Response
) -> JobFacts:
    """Have light baked ahead, or told (dry_run) how much that is and how long it takes.

    It yields to people, goes on when the server starts anew, and is dismissed by DELETE.
    """
    if not service.settled.is_set() or service.failure:
        raise StartingError(service.reasons()[0])
    await asyncio.to_thread(check, scene, told.order, service.settings)
    job = begin(service, scene, told.order, told.dry_run)
    response.headers.update({"Location": address(job), "Cache-Control": "no-store"})
    return job_facts(job)


def check(scene: Scene, order: PrewarmOrder, settings: Settings) -> None:
    """Raises ViewError where an order asks for what is not allowed."""
    order.isovalues_of(scene)
    Views(order, scene, settings)
