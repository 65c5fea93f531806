"""Scenes are loaded on threads: what the event loop does by itself, everybody waits for."""

import asyncio
import json
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx
import pytest
from websockets.sync.client import connect

from isogi_core.bake.noise import Goal
from isogi_core.plan.scene import Scene
from isogi_server.api.service import PictureRequest, RenderThreads, Service
from isogi_server.render.loaded_scene import LoadedScene, LoadedScenes
from isogi_worker.baker import Baker
from tests.server.idle import idle_server

AT = LoadedScenes.at
SIZE = "width=24&height=24&shading=lambert"
PATHS = (
    *(
        "",
        "/fit?azimuth=10",
        "/size?isovalue=0.5",
        f"/frame?{SIZE}",
        f"/coverage?{SIZE}",
        f"/point?{SIZE}&x=12&y=12",
    ),
    *(f"/frame?{SIZE}&cut=x>12", "/slice?axis=z&at=3", "/sky", f"/card?{SIZE}", "/card/volume/0-1"),
    *("/card/chunks?width=24&height=24", "/fit?azimuth=20&environment=studio"),
)


def test_workers_make_way_off_the_event_loop(
    small_scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To start the thread that lowers their priority takes until it runs, which is long where cores
    are busy.
    """
    made = threading.Event()
    on_loop = list[bool]()

    def watched(baker: Baker) -> None:
        with suppress(RuntimeError):
            on_loop.append(bool(asyncio.get_running_loop()))
        made.set()

    monkeypatch.setattr(Baker, "make_way", watched)
    with (
        idle_server(small_scene, tmp_path) as idle,
        connect(f"{idle.url.replace('http', 'ws', 1)}/v1/scenes/small/stream") as stream,
    ):
        view = {"width": 24, "height": 24, "shading": "lambert"}
        stream.send(json.dumps({"id": 1, "view": view, "moving": True}))
        assert made.wait(30.0)
    assert not on_loop


async def test_checks_of_jobs_leave_threads_to_others() -> None:
    """However many jobs have their pictures checked, and however long a step takes."""
    release = threading.Event()
    begun = list[object]()

    def check(*what: object) -> bool:
        begun.append(what)
        return release.wait(30.0)

    asyncio.get_running_loop().set_default_executor(ThreadPoolExecutor(2))
    service: Any = SimpleNamespace(engine=SimpleNamespace(check=check), threads=RenderThreads(1))
    pictures: Any = [PictureRequest("a", number, Goal(0.1)) for number in range(8)]  # type: ignore[arg-type]
    checks = [asyncio.create_task(Service.check(service, each)) for each in pictures]
    await asyncio.sleep(0.1)
    async with asyncio.timeout(5.0):
        assert await asyncio.to_thread(lambda: len(begun)) == 1
    checks[0].cancel()
    release.set()
    await asyncio.gather(*checks, return_exceptions=True)
    service.threads.close()
    assert len(begun) == 8
    assert begun[0][-1].is_set()  # type: ignore[index]


def test_no_route_loads_a_scene_on_the_event_loop(
    small_scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    on_loop = list[str]()

    def watched(loaded: LoadedScenes, scene: Scene) -> LoadedScene:
        try:
            asyncio.get_running_loop()
            on_loop.append(path)
        except RuntimeError:
            pass
        return AT(loaded, scene)

    path = ""
    with idle_server(small_scene, tmp_path, hand_out_voxels=True) as idle:
        monkeypatch.setattr(LoadedScenes, "at", watched)
        found = set()
        for path in PATHS:
            found.add(httpx.get(f"{idle.url}/v1/scenes/small{path}", timeout=60).status_code // 100)
    assert not on_loop
    assert 2 in found and 5 not in found
