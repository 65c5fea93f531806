"""An app on a real socket, in a thread of this process."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import httpx
from fastapi import FastAPI

from isogi_core.plan.assembly import load_scene

if TYPE_CHECKING:
    from isogi_worker.pool import WorkerPool


@contextmanager
def live(app: FastAPI, until: str = "/bakez", port: int = 0) -> Iterator[str]:
    """The base URL of the app, once it answers 200 at ``until``; its ``port`` is a free one by
    default.
    """
    from isogi_server.cli.serve import Server, address, listen

    listener = listen("127.0.0.1", port)
    server = Server(app)
    thread = threading.Thread(target=server.run, args=([listener],))
    thread.start()
    url = address(listener).rstrip("/")
    try:
        wait_for(f"{url}{until}", thread)
        yield url
    finally:
        server.should_exit = True
        thread.join()
        listener.close()


@contextmanager
def serving(scene: Path, store: Path, **settings: Any) -> Iterator[str]:
    """The base URL of an isogi that is ready, with a scene and a store; it bakes on a thread of
    this process.
    """
    from isogi_server.api.app import create_app
    from isogi_server.settings import Settings
    from isogi_worker.baker import Baker
    from tests.server.inline import EngineWithoutWorkers, InlinePool

    baker = Baker()
    pool = InlinePool()
    baker.use_pool(cast("WorkerPool", pool))
    try:
        engine = EngineWithoutWorkers([load_scene(scene)], str(store), baker=baker)
        with live(create_app(engine, Settings(**settings))) as url:
            yield url
    finally:
        pool.close()


@contextmanager
def serving_with_a_worker(scene: Path, store: Path) -> Iterator[str]:
    """The same, baked by a worker process, as a server of its own has it; it takes three seconds of
    the processor.
    """
    from isogi_server.api.app import create_app
    from isogi_server.render.engine import RenderEngine
    from isogi_server.settings import Settings

    with live(
        create_app(RenderEngine([load_scene(scene)], str(store), workers=1), Settings())
    ) as url:
        yield url


def wait_for(address: str, thread: threading.Thread, seconds: float = 900) -> None:
    """Ask until the answer is 200."""
    deadline = time.monotonic() + seconds
    answer = httpx.get(address, timeout=30)
    while answer.status_code != 200:
        assert thread.is_alive(), "the server ended while it started"
        assert time.monotonic() < deadline, answer.text
        time.sleep(0.2)
        answer = httpx.get(address, timeout=30)
