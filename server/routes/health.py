"""Whether the process lives, whether it can render, and what it has counted."""

from fastapi import APIRouter, Request, Response
from prometheus_client import CONTENT_TYPE_LATEST
from pydantic import BaseModel

from server.problems import documented_problems, problem
from server.service import ServiceDep

router = APIRouter(tags=["health"])


class Live(BaseModel):
    """The process answers."""

    alive: bool = True
    version: str


class Ready(BaseModel):
    """Whether frames can be served, and if not, why not; if so, why all the same nothing is baked."""

    ready: bool = True
    reasons: list[str] = []


@router.get("/livez")
async def livez(request: Request) -> Live:
    """Alive: the event loop runs. Touches neither store nor workers."""
    return Live(version=request.app.version)


@router.get("/readyz", response_model=Ready, responses=documented_problems(503))
def readyz(request: Request, service: ServiceDep) -> Response | Ready:
    """Ready: kernels are compiled, the store takes light, workers are alive, no stop is asked; 503 with reasons."""
    stopping = ["isogi is stopping."] if request.app.state.closing.begun else []
    reasons = stopping or service.reasons() or request.app.state.probe.reasons()
    if not reasons:
        return Ready(reasons=service.studio.notes())
    return problem(503, " ".join(reasons), request.url.path, ready=False, reasons=reasons)


@router.get("/metrics", response_class=Response, responses={200: {"content": {"text/plain": {}}}})
def metrics(request: Request) -> Response:
    """What the server has counted since it started, in Prometheus' text format."""
    return Response(request.app.state.metrics.text(), media_type=CONTENT_TYPE_LATEST)
