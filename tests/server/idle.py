"""A server that never bakes, and what is wanted of it."""

import asyncio
import time
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from isogi_core.plan.assembly import load_scene
from isogi_server.api.app import create_app
from isogi_server.api.service import Service
from isogi_server.render.engine import RenderEngine
from isogi_worker.bake_requests import Key
from isogi_worker.baker import Baker
from isogi_worker.queue import BakeQueue
from tests.live import live
from tests.server.sockets import settings_of


class Idle:
    """A server whose light is never baked, for it has no workers: what is wanted stays so until it
    is dropped.
    """

    def __init__(self, url: str, queue: BakeQueue, engine: RenderEngine, service: Service) -> None:
        self.url = url
        self.queue = queue
        self.engine = engine
        self.service = service

    @property
    def wanted(self) -> set[tuple[Key, Hashable]]:
        """Chunks, and by whom they are wanted."""
        wants = list(self.queue.requests.values())
        return {(request.key, client) for request in wants for client in list(request.interests)}

    async def until(self, condition: Callable[[], bool], seconds: float) -> float:
        """Seconds until the condition holds."""
        begun = time.monotonic()
        while not condition():
            assert time.monotonic() < begun + seconds
            await asyncio.sleep(0.01)
        return time.monotonic() - begun


def baker_and_queue() -> tuple[Baker, BakeQueue]:
    """A baker, and the queue that it makes for itself."""
    queues: list[BakeQueue] = []

    def make(*given: Any) -> BakeQueue:
        queues.append(BakeQueue(*given))
        return queues[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("isogi_worker.baker.BakeQueue", make)
        return Baker(), queues[0]


@contextmanager
def idle_server(scene: Path, store: Path, **settings: Any) -> Iterator[Idle]:
    """Such a server of a scene, once it answers."""
    baker, queue = baker_and_queue()
    loaded = load_scene(scene)
    engine = RenderEngine([loaded], str(store), baker=baker)
    engine.start_workers = lambda: None  # type: ignore[method-assign]
    until = f"/v1/scenes/{loaded.id}/coverage?width=8&height=8&shading=lambert"
    app = create_app(engine, settings_of(**settings))
    with live(app, until) as url:
        yield Idle(url, queue, engine, app.state.service)
