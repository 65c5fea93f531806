"""A server whose worker fails when a test says so, and what it bakes."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from isogi_core.bake.noise import Goal
from isogi_core.frame.demand import Demand
from isogi_core.model.scene_plan import MAX_SAMPLES
from isogi_core.model.view import View
from isogi_core.plan.scene import Scene
from isogi_core.storage.backend import StoreUrl
from isogi_core.storage.store import Store
from isogi_server.render.engine import RenderEngine
from isogi_worker.tasks import BakeTask, bake

LONG = 240.0


@dataclass(frozen=True, eq=False)
class Bench:
    """A ``engine`` with one worker behind a ``url``, its ``store``, and the folder whose files arm
    failpoints.
    """

    engine: RenderEngine
    scene: Scene
    url: str
    store: Path
    armed: Path
    isovalues: Iterator[float]

    def view(self) -> View:
        """A view of an isosurface that nobody saw before: most of its texels are yet to be
        baked.
        """
        camera = self.scene.camera(20.0, 15.0, 3.0, 30.0)
        return View(next(self.isovalues), camera, width=40, height=40)

    def demands(self, view: View) -> tuple[Demand, ...]:
        """The light that a view lacks."""
        return self.engine.survey(self.scene.id, view, Goal(self.scene.target_error)).demands

    def arm(self, point: str, fault: str, more: str = "once") -> Path:
        """Have a fault at a point."""
        file = self.armed / f"{point}.{fault}.{more}"
        file.touch()
        return file


def bake_here(bench: Bench, demands: tuple[Demand, ...], store: Path) -> None:
    """Bake what is demanded in this process, undisturbed, into another store."""
    spec = bench.engine.renderer(bench.scene.id).caches.spec("gi")
    Store(store).open()
    for demand in demands:
        what = (bench.scene.source, spec.plan, spec.digest, StoreUrl(str(store)), demand.index)
        goal = Goal(bench.scene.target_error)
        bake(BakeTask(*what, demand.offsets, demand.footprints, MAX_SAMPLES, goal))


def objects_in(store: Path) -> dict[str, bytes]:
    """The objects of all chunks, by their keys."""
    return {
        path.relative_to(store).as_posix(): path.read_bytes() for path in store.glob("*/c/*/*/*/0")
    }
