"""The assembly of the HTTP service."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from importlib.metadata import version
from typing import TYPE_CHECKING

from fastapi import FastAPI
from starlette.middleware import Middleware
from starlette.middleware.cors import CORSMiddleware
from starlette.staticfiles import StaticFiles

from server import problems
from server.guards.bodies import SmallBodies
from server.guards.guests import Closing, Guests
from server.guards.headers import SafeHeaders
from server.guards.heads import HeadAsGet
from server.guards.hosts import KnownHosts
from server.guards.origins import KnownOrigins
from server.guards.requests import Requests
from server.guards.tokens import TokenBearers
from server.metrics import BakingCollector, JobsCollector, Metrics
from server.prewarm.resumption import resume
from server.probe import StoreProbe
from server.routes import events, frames, health, jobs, pages, prewarms, scenes, skies, stream, volumes
from server.service import Service
from server.settings import Settings

if TYPE_CHECKING:
    from server.studio import Studio

DESCRIPTION = "Pictures of isosurfaces with global illumination, served at once and refined while you look."
GUARDED = problems.documented_problems(401, 403, 413, 421)
"""What guards answer for any route."""

SHARED = ("Authorization", "If-None-Match", "Last-Event-ID", "Prefer", "X-Request-ID")
"""Request headers that pages of other origins may set, where any may ask."""

TOLD = (
    *("Isogi-Provisional", "Isogi-Coverage", "Isogi-Error", "Isogi-Chunks", "Isogi-Sharp", "Isogi-Time-Left"),
    *("ETag", "Location", "Preference-Applied", "Retry-After", "Server-Timing", "X-Request-ID"),
)
"""Response headers that these may read."""


def create_app(studio: Studio, settings: Settings) -> FastAPI:
    """The service around ``studio``, which it starts beside the event loop and closes at the end."""
    metrics, closing = Metrics(), Closing()
    service = Service(studio, settings)
    metrics.registry.register(BakingCollector(studio))
    metrics.registry.register(JobsCollector(service.jobs))
    app = FastAPI(
        title="isogi",
        version=version("isogi"),
        description=DESCRIPTION,
        docs_url=None,
        redoc_url=None,
        lifespan=lifespan,
        middleware=guards(settings, metrics, closing),
    )
    app.state.service, app.state.settings = service, settings
    app.state.metrics, app.state.closing, app.state.probe = metrics, closing, StoreProbe(studio.root)
    problems.install(app)
    for room in (pages, health, scenes, skies, frames, events, stream, prewarms, jobs, volumes):
        app.include_router(room.router, responses=GUARDED)
    app.mount("/web", StaticFiles(directory=pages.WEB), name="web")
    return app


def guards(settings: Settings, metrics: Metrics, closing: Closing) -> list[Middleware]:
    """What a request passes, from the outside in."""
    origins = settings.allowed_origins
    shared = Middleware(
        CORSMiddleware,
        allow_origins=origins,
        allow_methods=("GET", "POST", "DELETE"),
        allow_headers=SHARED,
        expose_headers=TOLD,
    )
    token = settings.token
    return [
        Middleware(Requests, metrics=metrics),
        Middleware(SafeHeaders),
        Middleware(Guests, closing=closing),
        Middleware(KnownHosts, hosts=settings.hosts()),
        Middleware(KnownOrigins, origins=origins),
        *([shared] if origins else []),
        *([Middleware(TokenBearers, token=token.get_secret_value())] if token is not None else []),
        Middleware(SmallBodies, limit=settings.max_body_bytes, upload=settings.max_upload_mb << 20),
        Middleware(HeadAsGet),
    ]


@asynccontextmanager
async def lifespan(app: FastAPI) -> AsyncIterator[None]:
    """Starts the service's studio without waiting for it; closes it at the end."""
    service: Service = app.state.service
    with app.state.metrics.counting_errors():
        start, resumption = asyncio.create_task(service.start()), asyncio.create_task(resume(service))
        yield
        resumption.cancel()
        service.studio.stop()
        await start
        await service.close()
