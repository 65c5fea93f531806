"""An engine without worker processes: tasks are baked on a thread of this process."""

import pickle
import threading
from collections.abc import Callable, Collection
from concurrent.futures import ThreadPoolExecutor
from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest

from isogi_core.bake.noise import Goal
from isogi_core.frame.rays.picture_plan import Prices
from isogi_core.frame.tiles import Tiles
from isogi_core.model.view import View
from isogi_core.plan.scene import Scene
from isogi_server.render.engine import RenderEngine
from isogi_server.render.loaded_scene import LoadedScene
from isogi_worker.pool import Done
from isogi_worker.tasks import BakeTask, bake

LONG = 60.0
"""Seconds within which any bake of these tests ends."""


def bake_sent(sent: bytes, done: Done) -> None:
    """Do a task that was sent, and tell what became of it."""
    try:
        result = bake(pickle.loads(sent))
    except BaseException as error:
        done(None, error)
    else:
        done(result, None)


check = LoadedScene.check


PATHS_ALONE = Prices(0.25, 0.0, carries=False).of_present.of_texels
"""Prices at which paths of texels cost less than those of pixels, and tasks nothing."""


def weigh_at(prices: Prices, monkeypatch: pytest.MonkeyPatch) -> None:
    """Have checks weigh the ways to a goal at these ``prices``: small pictures would not pay for
    tasks of texels.
    """

    def _check(self: LoadedScene, view: View, goal: Goal, tiles: Tiles, _: Prices) -> bool:
        return check(self, view, goal, tiles, prices)

    monkeypatch.setattr(LoadedScene, "check", _check)


class InlinePool:
    """A pool of one thread of this process, made as a ``WorkerPool`` is."""

    preparing = ""

    room = 2
    together = 1
    keeps_light = False
    here = True
    workers = 1
    deaths = 0
    trouble = ""

    def __init__(
        self,
        workers: int = 1,
        scheduler: str | None = None,
        kinds: Collection[str] = (),
        stopped: threading.Event | None = None,
    ) -> None:
        """Take what a ``WorkerPool`` takes, and start one thread."""
        self._thread = ThreadPoolExecutor(1)

    def submit(self, task: BakeTask, done: Done) -> None:
        """Bake what arrives when the task is sent; ``done`` is called with the result, or the
        error.

        It is called on the pool's thread, as a pool's promise is: who submits holds the baker's
        lock.
        """
        self._thread.submit(bake_sent, pickle.dumps(task), done)

    def on_workers_changed(self, callback: Callable[[], None]) -> None:
        """Do nothing: the thread neither comes nor goes."""

    def prepare(self, work: Callable[[], object]) -> None:
        """Open nothing ahead: this process has it."""

    def close(self) -> None:
        """End when the task at hand is done."""
        self._thread.shutdown()


class EngineWithoutWorkers(RenderEngine):
    """An engine that starts no workers, and is ready all the same."""

    def start_workers(self) -> None:
        """Nobody comes."""

    def unready(self) -> list[str]:
        """Nothing."""
        return []


def view_of(
    scene: Scene, azimuth: float = 30.0, isovalue: float | None = None, **settings: Any
) -> View:
    """A small view at the scene's own isovalue unless told."""
    camera = scene.camera(azimuth, 20.0, 3.0, 30.0)
    return View(
        scene.isovalue if isovalue is None else isovalue, camera, width=40, height=40, **settings
    )


def chunks_in(store: Path) -> dict[str, str]:
    """The stored chunks by name, and the digest of each; what a kill left half-written is none."""
    files = [
        path for path in store.glob("*/c/**/*") if path.is_file() and path.suffix != ".partial"
    ]
    return {str(path.relative_to(store)): sha256(path.read_bytes()).hexdigest() for path in files}
