"""Whether the process lives, and whether it can render."""

from fastapi import APIRouter, Request, Response
from pydantic import BaseModel

from server.problems import documented_problems, problem
from server.service import ServiceDep

router = APIRouter(tags=["health"])


class Live(BaseModel):
    """The process answers."""

    alive: bool = True
    version: str


class Ready(BaseModel):
    """Whether frames can be served, and if not, why not."""

    ready: bool = True
    reasons: list[str] = []


@router.get("/livez")
async def livez(request: Request) -> Live:
    """Alive: the event loop runs. Touches neither store nor workers."""
    return Live(version=request.app.version)


@router.get("/readyz", response_model=Ready, responses=documented_problems(503))
def readyz(request: Request, service: ServiceDep) -> Response | Ready:
    """Ready: kernels are compiled, the store answers, workers are alive; 503 with the reasons if not."""
    reasons = service.reasons()
    if not reasons:
        return Ready()
    return problem(503, " ".join(reasons), request.url.path, ready=False, reasons=reasons)
