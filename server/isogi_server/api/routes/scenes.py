"""The scenes of this server, pictures of their light, and volumes and environments that clients
upload.
"""

from __future__ import annotations

import asyncio
from typing import Any

from fastapi import APIRouter, Request, Response

from isogi_core.files.formats.archive import MAX_MEMBERS
from isogi_core.frame.panorama import PANORAMA_FORMAT, paint_panorama
from isogi_core.model.lights import ENVIRONMENTS
from isogi_core.plan.scene import Scene
from isogi_server.answers import scene_schema
from isogi_server.api.dependencies import (
    NoParamsDep,
    SkyParamsDep,
    UploadParamsDep,
    VariantParamsDep,
)
from isogi_server.api.headers import FOR_EVER, matches, tag_of
from isogi_server.api.service import BearerDep, ClientDep, SceneDep, Service, ServiceDep
from isogi_server.parameters import SkyParams, UploadParams, VariantParams, documented
from isogi_server.pictures import MEDIA_TYPES, compress
from isogi_server.problems import documented_problems
from isogi_server.schemas import (
    EnvironmentList,
    EnvironmentSchema,
    SceneLink,
    SceneList,
    SceneSchema,
    UploadLimits,
    UploadList,
    UploadSchema,
)
from isogi_server.uploads.folder import ENVIRONMENT_KIND, VOLUME_KIND, Upload
from isogi_server.uploads.uploads import Uploads

router = APIRouter(prefix="/v1/scenes", tags=["scenes"])


@router.get("", dependencies=[NoParamsDep], responses=documented_problems(422))
async def list_scenes(service: ServiceDep) -> SceneList:
    """Return all scenes, each with the address of its document."""
    links = [
        SceneLink(id=s.id, name=s.name, href=f"/v1/scenes/{s.id}")
        for s in service.engine.own_scenes
    ]
    for link in links:
        kept = service.uploads.folder.uploads.get(link.id)
        link.volume = href(kept) if kept else None
    return SceneList(scenes=links, uploads=limits(service.uploads))


@router.get(
    "/{scene}",
    openapi_extra=documented(VariantParams),
    responses=documented_problems(404, 422, 429, 503),
)
async def read_scene(
    scene: SceneDep, params: VariantParamsDep, service: ServiceDep, client: ClientDep
) -> SceneSchema:
    """Return one scene: volume, histogram, defaults and ranges of all parameters, and the plan
    of its light.
    """
    lit = await service.variant(scene, params, client)
    return await asyncio.to_thread(scene_facts, scene, lit, params.environment, service)


def scene_facts(scene: Scene, lit: Scene, environment: str | None, service: Service) -> SceneSchema:
    """Return the document of a scene that is ``lit`` in an ``environment``, if one is named."""
    facts = scene_schema(service.planned(lit))
    notes = service.engine.notes()
    facts.id = scene.id
    facts.environment = environment
    facts.environments = environments(service.uploads)
    facts.read_only = service.engine.store.read_only
    facts.plan.notes += notes
    return facts


sky_router = APIRouter(prefix="/v1/scenes/{scene}", tags=["scenes"])
ANSWERS: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "The picture, latitude and longitude.",
        "content": {MEDIA_TYPES[form]: {} for form in ("png", "jpeg", "webp")},
    },
    304: {"description": "The picture is the one that If-None-Match names."},
}


@sky_router.get(
    "/sky",
    response_class=Response,
    openapi_extra=documented(SkyParams),
    responses=ANSWERS | documented_problems(404, 422),
)
async def read_sky(
    request: Request,
    scene: SceneDep,
    params: SkyParamsDep,
    service: ServiceDep,
    client: ClientDep,
) -> Response:
    """Return a picture of the scene's unturned light from all around, with its own exposure; black
    if there is no such light.

    The top row is +z, column 0 starts at azimuth 0, and azimuth grows with the column. Directional
    lights are marked by discs; lamps within the scene are not shown.
    """
    lit = await service.variant(scene, params, client)
    return await asyncio.to_thread(painted, request, lit, params)


def painted(request: Request, scene: Scene, params: SkyParams) -> Response:
    """Return the picture of a scene's light, or 304 if the client has it."""
    orientation = scene.volume.orientation
    # Light that cannot be rotated belongs to the volume, and is shown in its orientation.
    if orientation.turned and not scene.lighting.rotating:
        turn = orientation.matrix
    else:
        turn = None
    tag = tag_of(
        PANORAMA_FORMAT,
        scene.lighting.environment.digest,
        scene.lighting.lamps.digest,
        None if turn is None else turn.tolist(),
        params.width,
        params.f,
    )
    headers = {
        "ETag": tag,
        "Cache-Control": FOR_EVER if params.version == tag.strip('"') else "no-cache",
    }
    if matches(request.headers.get("if-none-match"), tag):
        return Response(status_code=304, headers=headers)
    picture = paint_panorama(scene.lighting.environment, scene.lighting.lamps, params.width, turn)
    return Response(compress(picture, params.f), 200, headers, MEDIA_TYPES[params.f])


volume_router = APIRouter(prefix="/v1/volumes", tags=["volumes"])
UPLOAD_BODY = {
    "required": True,
    "content": {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}},
}
TAKEN: dict[int | str, dict[str, Any]] = {
    200: {"description": "The same volume was uploaded before.", "model": UploadSchema},
    201: {
        "description": "The volume is on the disk, and shown.",
        "headers": {
            "Location": {"description": "The volume's address.", "schema": {"type": "string"}}
        },
    },
}


@volume_router.post(
    "",
    status_code=201,
    openapi_extra=documented(UploadParams) | {"requestBody": UPLOAD_BODY},
    responses=TAKEN | documented_problems(408, 422, 429, 503, 507),
)
async def upload(
    request: Request, response: Response, params: UploadParamsDep, service: ServiceDep
) -> UploadSchema:
    """Take the body, a file that contains its data, as a volume, and show it as a scene of the
    same id.
    """
    return facts(await taken(request, response, params, service, VOLUME_KIND))


async def taken(
    request: Request, response: Response, params: UploadParams, service: Service, kind: str
) -> Upload:
    """Take the body of a request as an upload of this ``kind``. The ``response`` says if it is
    new, and its address.
    """
    kept, new = await service.uploads.take(request, params.name, kind)
    response.status_code = 201 if new else 200
    response.headers["Location"] = href(kept)
    return kept


@volume_router.get("", dependencies=[NoParamsDep], responses=documented_problems(422))
async def list_volumes(service: ServiceDep) -> UploadList:
    """Return all uploaded volumes."""
    uploads = service.uploads
    return UploadList(
        volumes=[facts(kept) for kept in uploads.folder.volumes], uploads=limits(uploads)
    )


@volume_router.get("/{volume}", dependencies=[NoParamsDep], responses=documented_problems(404, 422))
async def read_volume(volume: str, service: ServiceDep) -> UploadSchema:
    """Return one uploaded volume."""
    return facts(service.uploads.find(volume))


@volume_router.delete(
    "/{volume}",
    status_code=204,
    dependencies=[NoParamsDep],
    responses=documented_problems(404, 422, 503),
)
async def delete_volume(volume: str, service: ServiceDep, bearer: BearerDep) -> None:
    """Remove a volume's scene and delete its file; light that was baked for it remains in the
    store.
    """
    await service.uploads.remove(volume, bearer)


environment_router = APIRouter(prefix="/v1/environments", tags=["environments"])
TAKEN_LIGHT: dict[int | str, dict[str, Any]] = {
    200: {"description": "The same probe was uploaded before.", "model": EnvironmentSchema},
    201: {
        "description": "The probe is on the disk, and views may name it.",
        "headers": {
            "Location": {"description": "The environment's address.", "schema": {"type": "string"}}
        },
    },
}


@environment_router.post(
    "",
    status_code=201,
    openapi_extra=documented(UploadParams) | {"requestBody": UPLOAD_BODY},
    responses=TAKEN_LIGHT | documented_problems(408, 422, 429, 503, 507),
)
async def upload_environment(
    request: Request, response: Response, params: UploadParamsDep, service: ServiceDep
) -> EnvironmentSchema:
    """Take the body, a lat-long picture (.hdr or .exr), as light in which every scene may be
    shown.
    """
    return uploaded_light(await taken(request, response, params, service, ENVIRONMENT_KIND))


@environment_router.get("", dependencies=[NoParamsDep], responses=documented_problems(422))
async def list_environments(service: ServiceDep) -> EnvironmentList:
    """Return light in which scenes may be shown instead of their own: given by formulas, and
    uploaded.
    """
    return EnvironmentList(
        environments=environments(service.uploads), uploads=limits(service.uploads)
    )


@environment_router.delete(
    "/{environment}",
    status_code=204,
    dependencies=[NoParamsDep],
    responses=documented_problems(404, 422, 503),
)
async def delete_environment(environment: str, service: ServiceDep, bearer: BearerDep) -> None:
    """Delete an uploaded environment; light that was baked in it remains in the store."""
    await service.uploads.remove(environment, bearer, ENVIRONMENT_KIND)


def environments(uploads: Uploads) -> list[EnvironmentSchema]:
    """Return the documents of all environments that views may name."""
    own = [EnvironmentSchema(id=number, name=name) for number, name in ENVIRONMENTS.items()]
    return own + [uploaded_light(kept) for kept in uploads.folder.environments]


def uploaded_light(kept: Upload) -> EnvironmentSchema:
    """Return the document of an uploaded environment."""
    return EnvironmentSchema(id=kept.id, name=kept.name, href=href(kept))


def facts(kept: Upload) -> UploadSchema:
    """Return the document of an uploaded volume."""
    scene = f"/v1/scenes/{kept.id}"
    x, y, z = kept.size
    size = x, y, z
    return UploadSchema(
        id=kept.id, name=kept.name, href=href(kept), scene=scene, size=size, bytes=kept.bytes
    )


def limits(uploads: Uploads) -> UploadLimits | None:
    """Return the limits of uploads; None if this server takes none."""
    if not uploads.on:
        return None
    return UploadLimits(
        limit_bytes=uploads.limit,
        limit_files=MAX_MEMBERS,
        quota_bytes=uploads.quota,
        free_bytes=uploads.free,
    )


def href(kept: Upload) -> str:
    """Return the address of an upload."""
    return f"/v1/{kept.kind}s/{kept.id}"
