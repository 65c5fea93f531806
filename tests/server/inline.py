"""A studio without worker processes: tasks are baked on a thread of this process."""

from collections.abc import Collection
from hashlib import sha256
from pathlib import Path
from typing import Any

from benchmarks.stability.desk import Desk
from isogi_core.model.scene import Scene
from isogi_core.model.view import View

LONG = 60.0
"""Seconds within which any bake of these tests ends."""


class InlinePool(Desk):
    """A desk that is hired as a ``WorkerPool`` is."""

    def __init__(self, workers: int, scheduler: str | None = None, kinds: Collection[str] = ()) -> None:
        super().__init__()


def view_of(scene: Scene, azimuth: float = 30.0, isovalue: float | None = None, **settings: Any) -> View:
    """A small view at the scene's own isovalue unless told."""
    camera = scene.camera(azimuth, 20.0, 3.0, 30.0)
    return View(scene.isovalue if isovalue is None else isovalue, camera, width=40, height=40, **settings)


def chunks_in(store: Path) -> dict[str, str]:
    """The stored chunks by name, and the digest of each."""
    files = [path for path in store.glob("*/c/**/*") if path.is_file()]
    return {str(path.relative_to(store)): sha256(path.read_bytes()).hexdigest() for path in files}
