"""The scenes that this server shows."""

from fastapi import APIRouter

from server.facts import SceneFacts, SceneLink, SceneList, scene_facts
from server.params import NoParamsDep
from server.problems import documented_problems
from server.routes.volumes import href, limits
from server.service import SceneDep, ServiceDep

router = APIRouter(prefix="/v1/scenes", tags=["scenes"], dependencies=[NoParamsDep])


@router.get("", responses=documented_problems(422))
async def list_scenes(service: ServiceDep) -> SceneList:
    """All scenes, each with the address of its document."""
    links = [SceneLink(id=s.id, name=s.name, href=f"/v1/scenes/{s.id}") for s in service.studio.scenes.values()]
    for link in links:
        link.volume = href(link.id) if link.id in service.uploads.shelf.volumes else None
    return SceneList(scenes=links, uploads=limits(service.uploads))


@router.get("/{scene}", responses=documented_problems(404, 422))
def read_scene(scene: SceneDep, service: ServiceDep) -> SceneFacts:
    """One scene: volume, histogram, defaults and ranges of every knob, and the plan of what is baked."""
    facts, notes = scene_facts(scene), service.studio.notes()
    facts.read_only = bool(notes)
    facts.plan.notes += notes
    return facts
