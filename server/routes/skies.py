"""The light around a scene, as a picture."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, Request, Response

from server.headers import FOR_EVER, matches, tag_of
from server.params import SkyParams, SkyParamsDep, documented
from server.pictures import MEDIA_TYPES, compress
from server.problems import documented_problems
from server.service import SceneDep

router = APIRouter(prefix="/v1/scenes/{scene}", tags=["scenes"])
ANSWERS: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "The picture, latitude and longitude.",
        "content": {MEDIA_TYPES[form]: {} for form in ("png", "jpeg", "webp")},
    },
    304: {"description": "The picture is the one that If-None-Match names."},
}


@router.get(
    "/sky",
    response_class=Response,
    openapi_extra=documented(SkyParams),
    responses=ANSWERS | documented_problems(404, 422),
)
def read_sky(request: Request, scene: SceneDep, params: SkyParamsDep) -> Response:
    """The scene's unturned light from all around, with an exposure of its own; black where there is none.

    The top row is +z, column 0 starts at azimuth 0, and azimuth grows with the column. Directional lights are marked
    by discs; lamps that stand in the scene are not shown.
    """
    from isogi_core.frame.panorama import FORMAT, paint_panorama  # noqa: PLC0415 (kernels)

    tag = tag_of(FORMAT, scene.environment.digest, scene.lamps.digest, params.width, params.f)
    headers = {"ETag": tag, "Cache-Control": FOR_EVER if params.version == tag.strip('"') else "no-cache"}
    if matches(request.headers.get("if-none-match"), tag):
        return Response(status_code=304, headers=headers)
    picture = paint_panorama(scene.environment, scene.lamps, params.width)
    return Response(compress(picture, params.f), 200, headers, MEDIA_TYPES[params.f])
