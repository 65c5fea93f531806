"""A disk that is full: baking waits for room, frames go on, readiness says so, and light comes once
there is room.
"""

import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from isogi_core.plan.assembly import load_scene
from isogi_server.api.app import create_app
from isogi_server.render.engine import RenderEngine
from isogi_server.settings import Settings
from isogi_worker import pool
from tests.faults.bench import LONG
from tests.live import live
from tests.server.inline import InlinePool
from tests.server.sockets import wait_for

KNOBS: dict[str, Any] = {"width": 40, "height": 40, "azimuth": 20, "elevation": 15, "f": "npy"}


def mounted(*arguments: str) -> bool:
    """Whether a command that mounts was allowed."""
    return subprocess.run(arguments, capture_output=True, check=False).returncode == 0


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of its own with room for a few chunks."""
    disk = tmp_path / "disk"
    disk.mkdir()
    if not mounted("mount", "-t", "tmpfs", "-o", "size=96k", "tmpfs", str(disk)):
        pytest.skip("needs the right to mount a small tmpfs, as root has it")
    try:
        yield disk
    finally:
        subprocess.run(["umount", "--lazy", str(disk)], check=True)


def test_baking_waits_for_room_and_goes_on_by_itself(
    small_disk: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a thread of this process: what a full disk does to a worker process is a fault of
    ``test_points.py``.
    """
    monkeypatch.setattr(pool, "start_pool", InlinePool)
    scene = load_scene(
        "demo:orbital", lattice=0.5, bounces=1, order=2, indirect_order=2, target_error=0.3
    )
    app = create_app(RenderEngine([scene], str(small_disk), workers=1), Settings())
    with live(app, until="/livez") as url:
        place = f"{url}/v1/scenes/{scene.id}/frame"

        def frame(wait: float = 0.0) -> httpx.Response:
            answer = httpx.get(place, params=KNOBS | {"wait_ms": int(1000 * wait)}, timeout=60.0)
            assert answer.status_code == 200, answer.text
            return answer

        assert wait_for(lambda: httpx.get(place, params=KNOBS).status_code == 200, LONG)
        assert wait_for(
            lambda: frame() is not None and "full" in httpx.get(f"{url}/bakez").text, LONG
        )
        assert httpx.get(f"{url}/bakez").status_code == 503
        assert frame(wait=0.5).headers["isogi-provisional"] == "?1"
        assert not list(small_disk.rglob("*.partial"))
        assert mounted("mount", "-o", "remount,size=16m", str(small_disk))
        assert wait_for(lambda: frame(wait=1.0).headers["isogi-provisional"] == "?0", LONG)
        assert wait_for(lambda: httpx.get(f"{url}/bakez").status_code == 200, LONG)
        lines = httpx.get(f"{url}/metrics").text.splitlines()
        assert "isogi_chunks_given_up 0.0" in lines
