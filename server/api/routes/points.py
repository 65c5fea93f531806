"""Points of a picture: what the surface is like in one pixel of a view."""

from __future__ import annotations

from fastapi import APIRouter, Request, Response

from server.answers import point_schema
from server.api.headers import PreferencesDep
from server.api.service import SceneDep, ServiceDep
from server.parameters import PointParams, PointParamsDep, documented
from server.problems import documented_problems
from server.schemas import PointSchema

router = APIRouter(prefix="/v1/scenes/{scene}", tags=["frames"])


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
    pixel, lit = params.pixel, await service.lit(scene, params.environment)
    exposure = lit.default_exposure if params.exposure is None else params.exposure
    response.headers.update(applied | {"Cache-Control": "no-cache", "Vary": "Prefer"})
    return await service.render(request, lit, params, lambda shown: point_schema(lit, shown.frame, pixel, exposure))
