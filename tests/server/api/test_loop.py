"""Scenes are loaded on threads: what the event loop does by itself, everybody waits for."""

import asyncio
from pathlib import Path

import httpx
import pytest

from server.render.engine import RenderEngine
from server.render.loaded_scene import LoadedScene
from tests.server.idle import idle_server

FIND = RenderEngine._find
SIZE = "width=24&height=24&shading=lambert"
PATHS = (
    *("", "/fit?azimuth=10", "/size?isovalue=0.5", f"/frame?{SIZE}", f"/coverage?{SIZE}", f"/point?{SIZE}&x=12&y=12"),
    *(f"/frame?{SIZE}&cut=x>12", "/slice?axis=z&at=3", "/sky", f"/card?{SIZE}", "/card/volume/0-1"),
    *("/card/chunks?width=24&height=24", "/fit?azimuth=20&environment=studio"),
)


def test_no_route_loads_a_scene_on_the_event_loop(
    small_scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    on_loop = list[str]()

    def watched(engine: RenderEngine, scene: str) -> LoadedScene:
        try:
            asyncio.get_running_loop()
            on_loop.append(path)
        except RuntimeError:
            pass
        return FIND(engine, scene)

    path = ""
    with idle_server(small_scene, tmp_path, hand_out_voxels=True) as idle:
        monkeypatch.setattr(RenderEngine, "_find", watched)
        found = set()
        for path in PATHS:
            found.add(httpx.get(f"{idle.url}/v1/scenes/small{path}", timeout=60).status_code // 100)
    assert not on_loop
    assert 2 in found and 5 not in found
