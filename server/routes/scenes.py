"""The scenes that this server shows."""

from fastapi import APIRouter

from server.facts import SceneFacts, SceneLink, SceneList, scene_facts
from server.params import NoParamsDep
from server.problems import documented_problems
from server.service import SceneDep, ServiceDep

router = APIRouter(prefix="/v1/scenes", tags=["scenes"], dependencies=[NoParamsDep])


@router.get("", responses=documented_problems(422))
async def list_scenes(service: ServiceDep) -> SceneList:
    """All scenes, each with the address of its document."""
    scenes = service.studio.scenes.values()
    return SceneList(scenes=[SceneLink(id=s.id, name=s.name, href=f"/v1/scenes/{s.id}") for s in scenes])


@router.get("/{scene}", responses=documented_problems(404, 422))
def read_scene(scene: SceneDep) -> SceneFacts:
    """One scene: volume, histogram, defaults and ranges of every knob, and the plan of what is baked."""
    return scene_facts(scene)
