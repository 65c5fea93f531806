"""Points of a picture, and slices through the volume: what is in one pixel of a view, and beside it."""

from __future__ import annotations

import asyncio
from typing import Any

from fastapi import APIRouter, Request, Response

from isogi_core.plan.scene import Scene
from server.answers import point_schema
from server.api.headers import PreferencesDep, matches, tag_of
from server.api.service import SceneDep, ServiceDep
from server.errors import ParameterError
from server.parameters import documented
from server.pictures import MEDIA_TYPES, compress, grey
from server.point_parameters import AXES, PointParams, PointParamsDep, SliceParams, SliceParamsDep
from server.problems import documented_problems
from server.schemas import PointSchema

router = APIRouter(prefix="/v1/scenes/{scene}", tags=["frames"])
SLICE: dict[int | str, dict[str, Any]] = {
    200: {"description": "The picture, grey.", "content": {MEDIA_TYPES["png"]: {}}},
    304: {"description": "The picture is the one that If-None-Match names."},
}
DRAWN = 1
"""Version of how slices are drawn."""


@router.get("/point", openapi_extra=documented(PointParams), responses=documented_problems(404, 422, 429, 503))
async def read_point(
    request: Request,
    response: Response,
    scene: SceneDep,
    params: PointParamsDep,
    service: ServiceDep,
    preferences: PreferencesDep,
) -> PointSchema:
    """What the picture of the same view shows at a place: position, value, normal, light and the error of that."""
    params, applied = preferences.fill(params)
    pixel, lit = params.pixel, await service.variant(scene, params)
    exposure = lit.default_exposure if params.exposure is None else params.exposure
    response.headers.update(applied | {"Cache-Control": "no-cache", "Vary": "Prefer"})
    return await service.render(request, lit, params, lambda shown: point_schema(lit, shown.frame, pixel, exposure))


@router.get(
    "/slice",
    response_class=Response,
    openapi_extra=documented(SliceParams),
    responses=SLICE | documented_problems(404, 422),
)
async def read_slice(request: Request, scene: SceneDep, params: SliceParamsDep) -> Response:
    """The volume's values on a plane across one of its voxel axes, as a grey picture: one pixel for each voxel.

    Columns go along the first of the other two axes, and rows down the second, whose end is at the top.
    """
    return await asyncio.to_thread(sliced, request, scene, params)


def sliced(request: Request, scene: Scene, params: SliceParams) -> Response:
    """The picture of a plane of a scene's volume, or that it is the one that the client has."""
    volume, axis = scene.volume, AXES.index(params.axis)
    if params.at > volume.size[axis] - 1:
        beyond = f"at={params.at:g} is outside the volume: {params.axis} goes from 0 to {volume.size[axis] - 1}."
        raise ParameterError(beyond, "at")
    window = params.window(volume.core)
    tag = tag_of(DRAWN, volume.digest, axis, params.at, *window)
    headers = {"ETag": tag, "Cache-Control": "no-cache"}
    if matches(request.headers.get("if-none-match"), tag):
        return Response(status_code=304, headers=headers)
    picture = grey(volume.plane(axis, params.at), *window)
    return Response(compress(picture, "png"), 200, headers, MEDIA_TYPES["png"])
