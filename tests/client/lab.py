"""A live server with a token, whose light is baked on a thread, and whose answers fail as a test
plans it.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from isogi_core.plan.assembly import load_scene
from isogi_server.api.app import create_app
from isogi_server.problems import problem
from isogi_server.settings import Settings
from isogi_worker.baker import Baker
from isogi_worker.pool import WorkerPool
from tests.live import live
from tests.server.inline import EngineWithoutWorkers, InlinePool

TOKEN = "a token of the tests"


@dataclass(eq=False)
class Faults:
    """What is going to fail: so many ``refusals`` (503), and so many event streams ``cut`` after
    their first event.

    ``asked`` are the requests that came, each its path and its headers.
    """

    refusals: int = 0
    cut: int = 0
    asked: list[tuple[str, dict[bytes, bytes]]] = field(default_factory=list)


class Faulty:
    """ASGI middleware that has answers fail."""

    def __init__(self, app: ASGIApp, faults: Faults) -> None:
        self.app = app
        self.faults = faults

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http" or not scope["path"].startswith("/v1"):
            await self.app(scope, receive, send)
            return
        self.faults.asked.append((scope["path"], dict(scope["headers"])))
        if self.faults.refusals:
            self.faults.refusals -= 1
            await problem(503, "Not yet.", scope["path"])(scope, receive, send)
        elif self.faults.cut and scope["path"].endswith("/events"):
            self.faults.cut -= 1
            await self.app(scope, receive, Torn(send))
        else:
            await self.app(scope, receive, send)


class Torn:
    """Sends the head and the first event, and breaks the connection then."""

    def __init__(self, send: Send) -> None:
        self.send = send
        self.bodies = 0

    async def __call__(self, message: Message) -> None:
        if message["type"] == "http.response.body":
            self.bodies += 1
        if self.bodies > 1:
            raise ConnectionResetError("torn by the test")
        await self.send(message)


@dataclass(eq=False)
class Lab:
    """The server's ``url``, its ``faults``, and the ``baker`` of its light."""

    url: str
    faults: Faults
    baker: Baker


class Broken:
    """A pool whose tasks all fail."""

    room = 2
    together = 1
    keeps_light = False
    workers = 1
    trouble = ""

    def submit(self, task: Any, done: Any) -> None:
        done(None, RuntimeError("The texels are cursed."))

    def close(self) -> None:
        pass


@contextmanager
def lab_of(scene: Path, store: Path, bakes: bool = True, port: int = 0) -> Iterator[Lab]:
    """Such a server of a scene, which ``bakes`` or has nobody to."""
    baker = Baker()
    faults = Faults()
    pool = InlinePool()
    app = create_app(
        EngineWithoutWorkers([load_scene(scene)], str(store), baker=baker),
        Settings(token=TOKEN, hand_out_voxels=True),
    )
    app.add_middleware(Faulty, faults=faults)
    if bakes:
        baker.use_pool(cast(WorkerPool, pool))
    try:
        with live(app, port=port) as url:
            yield Lab(url, faults, baker)
    finally:
        pool.close()
