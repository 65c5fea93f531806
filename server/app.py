"""The assembly of the HTTP service."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from importlib.metadata import version
from typing import TYPE_CHECKING

from fastapi import FastAPI
from starlette.staticfiles import StaticFiles

from server import problems
from server.headers import HeadAsGet, KnownHosts, SafeHeaders
from server.routes import frames, health, pages, scenes
from server.service import Service
from server.settings import Settings

if TYPE_CHECKING:
    from server.studio import Studio

DESCRIPTION = "Pictures of isosurfaces with global illumination, served at once and refined while you look."


def create_app(studio: Studio, settings: Settings) -> FastAPI:
    """The service around ``studio``, which it starts beside the event loop and closes at the end."""
    service = Service(studio, settings)
    app = FastAPI(
        title="isogi",
        version=version("isogi"),
        description=DESCRIPTION,
        docs_url=None,
        redoc_url=None,
        lifespan=lifespan,
    )
    app.state.service = service
    problems.install(app)
    app.add_middleware(KnownHosts, hosts=settings.hosts())
    app.add_middleware(HeadAsGet)
    app.add_middleware(SafeHeaders)
    for room in (pages, health, scenes, frames):
        app.include_router(room.router)
    app.mount("/web", StaticFiles(directory=pages.WEB), name="web")
    return app


@asynccontextmanager
async def lifespan(app: FastAPI) -> AsyncIterator[None]:
    """Starts the service's studio without waiting for it; closes it at the end."""
    service: Service = app.state.service
    start = asyncio.create_task(service.start())
    yield
    service.studio.stop()
    await start
    await service.close()
