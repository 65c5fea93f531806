"""Measurements: points of a picture, slices of the volume, and the size of the surface."""

from __future__ import annotations

import asyncio
import gzip
from typing import Any

from fastapi import APIRouter, Request, Response

from isogi_core.plan.scene import Scene
from isogi_server.answers import point_schema, size_schema
from isogi_server.api.dependencies import PointParamsDep, SizeParamsDep, SliceParamsDep
from isogi_server.api.headers import PreferencesDep, matches, tag_of, takes_gzip
from isogi_server.api.service import SceneDep, ServiceDep, Shown
from isogi_server.bearers import client_of
from isogi_server.errors import ForbiddenError, ParameterError
from isogi_server.parameters import (
    AXIS_NAMES,
    PointParams,
    SizeParams,
    SliceParams,
    VariantParams,
    documented,
)
from isogi_server.pictures import MEDIA_TYPES, compress, grey, values_npy
from isogi_server.problems import documented_problems
from isogi_server.schemas import PointSchema, SizeSchema

router = APIRouter(prefix="/v1/scenes/{scene}", tags=["frames"])
SLICE: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "The picture, grey; or the values.",
        "content": {MEDIA_TYPES["png"]: {}, MEDIA_TYPES["npy"]: {}},
    },
    304: {"description": "The slice is the one that If-None-Match names."},
}
VALUES_WITHHELD = (
    "This server hands out no voxels: ask for a picture of the slice, f=png, or have "
    "hand_out_voxels set."
)
DRAWN = 1
"""Version of the drawing of slices, a part of their ETag."""

VALUE_TOLERANCE = 1e-6
"""Error of values that are sent, relative to their range: smaller errors are invisible in
pictures and contours.
"""

GZIP_LEVEL = 1
"""Level of gzip: at this level a slice of 256 × 256 bytes takes a millisecond."""


@router.get(
    "/point",
    openapi_extra=documented(PointParams),
    responses=documented_problems(404, 422, 429, 503),
)
async def read_point(
    request: Request,
    response: Response,
    scene: SceneDep,
    params: PointParamsDep,
    service: ServiceDep,
    preferences: PreferencesDep,
) -> PointSchema:
    """Return the surface point at a place of the picture: position, value, normal, light, and its
    error.

    If the picture was not drawn lately, one ray is cast: the error is then that of the pixel, and
    light is requested for it alone.
    """
    params, applied = preferences.fill(params)
    pixel = params.pixel
    variant = await service.variant(scene, params, client_of(request.scope))
    if params.exposure is None:
        exposure = variant.default_exposure
    else:
        exposure = params.exposure
    response.headers.update(applied | {"Cache-Control": "no-cache", "Vary": "Prefer"})

    def finish(shown: Shown) -> PointSchema:
        # If the picture was not drawn lately, the view is cut to one pixel, which is at (0, 0).
        place = pixel if shown.frame.view.columns is None else (0, 0)
        return point_schema(variant, shown.frame, place, exposure)

    return await service.render(request, variant, params, finish, pixel=pixel)


@router.get(
    "/size", openapi_extra=documented(SizeParams), responses=documented_problems(404, 422, 429, 503)
)
async def read_size(
    request: Request, scene: SceneDep, params: SizeParamsDep, service: ServiceDep
) -> SizeSchema:
    """Return the area of the whole surface and the volume that it encloses, in the volume's unit,
    with their errors.

    Faces of a cut belong to the surface; pinned surfaces do not, and windows change nothing.
    """
    shown = await service.variant(scene, params, client_of(request.scope))
    picture = service.picture_of(shown, params.view)

    def work() -> SizeSchema:
        return size_schema(service.engine.renderer(shown.id), picture.view.isovalue)

    return await service.compute(request, work)


@router.get(
    "/slice",
    response_class=Response,
    openapi_extra=documented(SliceParams),
    responses=SLICE | documented_problems(403, 404, 422),
)
async def read_slice(
    request: Request, scene: SceneDep, params: SliceParamsDep, service: ServiceDep
) -> Response:
    """Return the volume's values on a plane across one of its voxel axes, as a grey picture with
    one pixel per voxel.

    Columns go along the first of the other two axes, and rows down the second, whose end is at the
    top. `f=npy` returns the values in the volume's units: integers exactly, others as float32 if
    that is exact enough, else as float64; compressed if the request accepts gzip.
    """
    if params.f == "npy" and not service.settings.hands_out_voxels:
        raise ForbiddenError(VALUES_WITHHELD)
    step = VariantParams.model_validate(
        params.model_dump(include={"time", "smooth"}, exclude_none=True)
    )
    shown = await service.variant(scene, step, client_of(request.scope))
    return await asyncio.to_thread(sliced, request, shown, params)


def sliced(request: Request, scene: Scene, params: SliceParams) -> Response:
    """Return the slice of a scene's volume, or 304 if the client has it."""
    volume = scene.volume
    axis = AXIS_NAMES.index(params.axis)
    if params.at > volume.size[axis] - 1:
        beyond = (
            f"at={params.at:g} is outside the volume: {params.axis} goes from 0 to "
            f"{volume.size[axis] - 1}."
        )
        raise ParameterError(beyond, "at")
    window = params.window(volume.core) if params.is_picture else ()
    packed = not params.is_picture and takes_gzip(request.headers.get("accept-encoding", ""))
    tag = tag_of(DRAWN, volume.digest, axis, params.at, *window, packed)
    headers = {"ETag": tag, "Cache-Control": "no-cache", "Vary": "Accept-Encoding"}
    if matches(request.headers.get("if-none-match"), tag):
        return Response(status_code=304, headers=headers)
    plane = volume.plane(axis, params.at)
    if params.is_picture:
        return Response(compress(grey(plane, *window), "png"), 200, headers, MEDIA_TYPES["png"])
    # Values that are sent may be off by a millionth of their range, computed without overflow.
    values = values_npy(plane, VALUE_TOLERANCE * volume.core[1] - VALUE_TOLERANCE * volume.core[0])
    if packed:
        values = gzip.compress(values, GZIP_LEVEL)
        headers = headers | {"Content-Encoding": "gzip"}
    return Response(values, 200, headers, MEDIA_TYPES["npy"])
