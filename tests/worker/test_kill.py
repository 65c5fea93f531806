import os
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path

import httpx
import psutil
import pytest

from isogi_core.bake.bake_spec import spec_for
from isogi_core.cache.chunk_store import ChunkStore
from isogi_core.frame.frame import Frame
from isogi_core.model.view import View
from isogi_core.plan.assembly import load_scene
from isogi_core.plan.scene import Scene
from isogi_core.prepared.prepared_scene import PreparedScene
from isogi_server.render.engine import RenderEngine
from isogi_worker import pool
from isogi_worker.fork_server import WORKER_PROCESS_NAME
from tests.baking import bake_each_texel
from tests.server.inline import InlinePool
from tests.server.sockets import wait_for

pytestmark = pytest.mark.kill
ROOT = Path(__file__).parent.parent.parent
LONG = 120.0


@pytest.fixture(scope="module")
def scene() -> Scene:
    """One with projected texels beside the others."""
    return load_scene("demo:orbital", lattice=0.5, bounces=2, target_error=0.25, projected=True)


@pytest.fixture(scope="module")
def views(scene: Scene) -> list[View]:
    """Three views that share chunks and texels."""
    looks = (20.0, 0.03), (140.0, 0.03), (20.0, 0.05)
    return [
        View(isovalue, scene.camera(azimuth, 15.0, 3.0, 30.0), width=48, height=48)
        for azimuth, isovalue in looks
    ]


def light_in(store: Path) -> dict[str, str]:
    """SHA-256 of each object in a store, by its key, but for what baking took."""
    files = [path for path in store.rglob("*") if path.is_file() and path.suffix != ".partial"]
    keys = {path: str(path.relative_to(store)) for path in files}
    light = {path: key for path, key in keys.items() if not key.startswith(("costs/", "used/"))}
    return {key: sha256(path.read_bytes()).hexdigest() for path, key in light.items()}


def worker_pids() -> set[int]:
    """The workers of this process, whoever in it they work for."""
    found = set()
    for child in psutil.Process().children(recursive=True):
        with suppress(psutil.Error):  # it ends at this moment
            if child.name() == WORKER_PROCESS_NAME:
                found |= {child.pid}
            else:
                found |= set()
    return found


def bake_views(
    engine: RenderEngine, store: Path, views: Sequence[View], killings: Sequence["Killing"] = ()
) -> list[Frame]:
    """Final frames of the views, one after the other; meanwhile the ``killings`` are done in
    turn.
    """
    others = worker_pids()
    (scene,) = engine.scenes.values()
    with closing(engine):
        engine.start()
        killer = threading.Thread(
            target=lambda: [killing.do(store, others) for killing in killings]
        )
        killer.start()
        frames = [bake_each_texel(engine, scene.id, view) for view in views]
        killer.join()
    assert not any(frame.provisional for frame in frames)
    return frames


@dataclass
class Killing:
    """A worker is killed when ``chunks`` are in the store; ``light`` is what was there then."""

    chunks: int
    light: dict[str, str] = field(default_factory=dict)

    def do(self, store: Path, others: set[int]) -> None:
        while len(list(store.glob("*/c/*/*/*/0"))) < self.chunks or not worker_pids() - others:
            time.sleep(0.02)
        self.light = light_in(store)
        os.kill(min(worker_pids() - others), signal.SIGKILL)


def test_killed_workers_cost_time_and_nothing_else(
    tmp_path: Path, scene: Scene, views: list[View]
) -> None:
    """More workers, another order of the views, and deaths on the way leave the bytes of one
    thread, undisturbed.
    """
    alone = tmp_path / "alone"
    disturbed = tmp_path / "disturbed"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pool, "start_pool", InlinePool)
        expected = bake_views(RenderEngine([scene], alone, workers=1), alone, views)
    light = light_in(alone)
    levels = (None, *(scene.volume.normalise_isovalue(view.isovalue) for view in views))
    layers = [scene.layer_digest(layer, level) for layer in scene.plan.layers for level in levels]
    assert len(light) > 20 and all(any(f"{layer}/c/" in key for key in light) for layer in layers)
    killings = [Killing(chunks) for chunks in (2, 8)]
    frames = bake_views(
        RenderEngine([scene], disturbed, workers=2), disturbed, views[::-1], killings
    )
    assert all(killing.light != light for killing in killings) and light_in(disturbed) == light
    assert [each.radiance.tobytes() for each in frames[::-1]] == [
        each.radiance.tobytes() for each in expected
    ]


@contextmanager
def serving(store: Path) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """``isogi serve`` as a process, and the URL that it tells."""
    command = [
        sys.executable,
        "-m",
        "server",
        "serve",
        "demo:orbital",
        "--port",
        "0",
        "--workers",
        "1",
    ]
    process = subprocess.Popen(
        [*command, "--store", str(store)], cwd=ROOT, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    lines: queue.Queue[str] = queue.Queue()
    reader = threading.Thread(target=lambda: [lines.put(line) for line in process.stdout or ()])
    reader.start()
    try:
        yield process, lines.get(timeout=LONG).split()[-1].rstrip("/")
    finally:
        process.kill()
        process.wait()
        reader.join()
        process.stdout.close()


def test_no_worker_outlives_its_server(tmp_path: Path) -> None:
    """One that is killed; one that is told to stop ends in
    ``tests/server/api/guards/test_stop.py``.
    """
    with serving(tmp_path) as (process, url):
        assert wait_for(lambda: httpx.get(f"{url}/bakez").status_code == 200, LONG)
        assert (
            httpx.get(
                f"{url}/v1/scenes/orbital/frame?width=256&height=256", timeout=LONG
            ).status_code
            == 200
        )
        family = psutil.Process(process.pid).children(recursive=True)
        assert sum(child.name() == WORKER_PROCESS_NAME for child in family) >= 1
        assert wait_for(lambda: len(list(tmp_path.glob("*/c/*/*/*/0"))) > 2, LONG)
        process.kill()
        assert process.wait(LONG) == -signal.SIGKILL
        assert psutil.wait_procs(family, timeout=LONG)[1] == []
    layers = ChunkStore(tmp_path, spec_for(PreparedScene(load_scene("demo:orbital")), "gi")).layers
    assert len(layers) == 2
    for layer in layers:
        found = [tuple(map(int, path.parts[-4:-1])) for path in Path(layer.path).glob("c/*/*/*/0")]
        assert found
        for z, y, x in found:
            assert len(layer.decode((z, y, x), layer.read((z, y, x)) or b"")[0]) > 0
