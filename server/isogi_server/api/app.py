"""The assembly of the HTTP service."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from importlib.metadata import version

from fastapi import FastAPI
from starlette.middleware import Middleware
from starlette.middleware.cors import CORSMiddleware

from isogi_server import problems
from isogi_server.api.access import KnownHosts, KnownOrigins, TokenBearers
from isogi_server.api.lifespan import Closing, GracefulShutdown
from isogi_server.api.prewarm_jobs import resume
from isogi_server.api.requests import HeadAsGet, Requests, SafeHeaders, SmallBodies
from isogi_server.api.routes import card, events, frames, jobs, pages, points, scenes
from isogi_server.api.service import Service
from isogi_server.api.stream import router as stream_router
from isogi_server.render.engine import RenderEngine
from isogi_server.render.metrics import (
    BakingCollector,
    JobsCollector,
    Metrics,
    ServerCollector,
    StoreCollector,
)
from isogi_server.render.stores import StoreProbe
from isogi_server.settings import Settings

API_DESCRIPTION = (
    "Pictures of isosurfaces with global illumination, served at once and refined while you look."
)
GUARDED = problems.documented_problems(401, 403, 413, 421)
"""Problems that middleware may answer for any route."""

ROUTERS = (
    pages.router,
    pages.health_router,
    scenes.router,
    scenes.sky_router,
    frames.router,
    points.router,
    events.router,
    card.router,
    stream_router,
    jobs.prewarm_router,
    jobs.export_router,
    jobs.router,
    scenes.volume_router,
    scenes.environment_router,
)

ALLOWED_HEADERS = ("Authorization", "If-None-Match", "Last-Event-ID", "Prefer", "X-Request-ID")
"""Request headers that pages of allowed origins may set."""

EXPOSED = (
    *("Isogi-Provisional", "Isogi-Coverage", "Isogi-Error", "Isogi-Chunks"),
    *("Isogi-Overdue", "Isogi-Projected", "Isogi-Refined", "Isogi-Surface", "Isogi-Time-Left"),
    *("ETag", "Location", "Preference-Applied", "Retry-After", "Server-Timing", "X-Request-ID"),
)
"""Response headers that pages of allowed origins may read."""


def create_app(engine: RenderEngine, settings: Settings) -> FastAPI:
    """Assemble the HTTP service around an ``engine``, which starts and closes with the app."""
    metrics = Metrics()
    closing = Closing()
    service = Service(engine, settings)
    metrics.registry.register(BakingCollector(engine))
    metrics.registry.register(JobsCollector(service.jobs))
    metrics.registry.register(StoreCollector(engine.store.calls))
    # The bytes that are free change with each upload: functions find them when metrics are read.
    uploads = service.uploads
    metrics.registry.register(ServerCollector(lambda: uploads.quota, lambda: uploads.free))
    app = FastAPI(
        title="isogi",
        version=version("isogi"),
        description=API_DESCRIPTION,
        docs_url=None,
        redoc_url=None,
        lifespan=lifespan,
        middleware=middleware(settings, metrics, closing),
    )
    # Routes and middleware find these by ``request.app.state``.
    app.state.service = service
    app.state.settings = settings
    app.state.metrics = metrics
    app.state.closing = closing
    app.state.probe = StoreProbe(engine.store)
    problems.install(app)
    for router in ROUTERS:
        app.include_router(router, responses=GUARDED)
    return app


def middleware(settings: Settings, metrics: Metrics, closing: Closing) -> list[Middleware]:
    """Return the middleware, from the outermost to the innermost."""
    origins = settings.allowed_origins
    shared = Middleware(
        CORSMiddleware,
        allow_origins=origins,
        allow_methods=("GET", "POST", "DELETE"),
        allow_headers=ALLOWED_HEADERS,
        expose_headers=EXPOSED,
    )
    bearers = settings.bearers
    # Refusals get ids and safe headers too, so these come first; shutdown comes before access, so
    # that it counts all requests.
    return [
        Middleware(Requests, metrics=metrics),
        Middleware(SafeHeaders),
        Middleware(GracefulShutdown, closing=closing),
        Middleware(KnownHosts, hosts=settings.hosts()),
        Middleware(KnownOrigins, origins=origins),
        *([shared] if origins else []),
        *([Middleware(TokenBearers, bearers=bearers)] if bearers else []),
        Middleware(
            SmallBodies, limit=settings.patience.body_bytes, upload=settings.max_upload_mb << 20
        ),
        Middleware(HeadAsGet),
    ]


@asynccontextmanager
async def lifespan(app: FastAPI) -> AsyncIterator[None]:
    """Start the engine in the background, so that the socket answers at once; close it at the
    end.
    """
    service: Service = app.state.service
    with app.state.metrics.counting_errors():
        start = asyncio.create_task(service.start())
        resumption = asyncio.create_task(resume(service))
        yield
        # Stop compiling first: the start may still wait for it.
        resumption.cancel()
        service.engine.stop()
        await start
        await service.close()
