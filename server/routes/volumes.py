"""Volumes that clients have uploaded."""

from typing import Any

from fastapi import APIRouter, Request, Response

from server.facts import UploadFacts, UploadLimits, UploadList
from server.params import NoParamsDep, UploadParams, UploadParamsDep, documented
from server.problems import documented_problems
from server.service import ServiceDep
from server.uploads.canonical import Kept
from server.uploads.uploads import Uploads

router = APIRouter(prefix="/v1/volumes", tags=["volumes"])
BODY = {"required": True, "content": {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}}}
TAKEN: dict[int | str, dict[str, Any]] = {
    200: {"description": "The same volume was uploaded before.", "model": UploadFacts},
    201: {
        "description": "The volume is on the disk, and shown.",
        "headers": {"Location": {"description": "The volume's address.", "schema": {"type": "string"}}},
    },
}


@router.post(
    "",
    status_code=201,
    openapi_extra=documented(UploadParams) | {"requestBody": BODY},
    responses=TAKEN | documented_problems(408, 422, 429, 503, 507),
)
async def upload(request: Request, response: Response, params: UploadParamsDep, service: ServiceDep) -> UploadFacts:
    """Take the body, an NRRD file with its data in it, as a volume, and show it as a scene of the same id."""
    kept, new = await service.uploads.take(request, params.name)
    response.status_code = 201 if new else 200
    response.headers["Location"] = href(kept.id)
    return facts(kept)


@router.get("", dependencies=[NoParamsDep], responses=documented_problems(422))
async def list_volumes(service: ServiceDep) -> UploadList:
    """All uploaded volumes."""
    uploads = service.uploads
    return UploadList(volumes=[facts(kept) for kept in uploads.shelf.volumes.values()], uploads=limits(uploads))


@router.get("/{volume}", dependencies=[NoParamsDep], responses=documented_problems(404, 422))
async def read_volume(volume: str, service: ServiceDep) -> UploadFacts:
    """One uploaded volume."""
    return facts(service.uploads.find(volume))


@router.delete("/{volume}", status_code=204, dependencies=[NoParamsDep], responses=documented_problems(404, 422, 503))
async def delete_volume(volume: str, service: ServiceDep) -> None:
    """Show a volume no more and delete its file; light that was baked for it stays in the store."""
    await service.uploads.remove(volume)


def facts(kept: Kept) -> UploadFacts:
    """The document of one volume."""
    scene = f"/v1/scenes/{kept.id}"
    return UploadFacts(id=kept.id, name=kept.name, href=href(kept.id), scene=scene, size=kept.size, bytes=kept.bytes)


def limits(uploads: Uploads) -> UploadLimits | None:
    """What may be uploaded; None where nothing may."""
    if not uploads.on:
        return None
    return UploadLimits(limit_bytes=uploads.limit, quota_bytes=uploads.quota, free_bytes=uploads.free)


def href(number: str) -> str:
    """The address of the volume with this id."""
    return f"/v1/volumes/{number}"
