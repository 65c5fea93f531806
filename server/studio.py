"""The studio: scenes with their caches, one set of workers, and frames of any of them."""

import logging
import threading
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from isogi_core.bake.look import LOOKS, look_name
from isogi_core.bake.maps import STEP
from isogi_core.bake.recipe import Index, Recipe
from isogi_core.cache.caches import Caches
from isogi_core.cache.costs import Costs
from isogi_core.cache.store import default_store
from isogi_core.errors import IsogiError
from isogi_core.frame.frame import Frame
from isogi_core.frame.kernels import frame_kernels
from isogi_core.frame.renderer import Renderer, surface_key
from isogi_core.frame.stopwatch import Stopwatch
from isogi_core.frame.texels import Demand
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels._folder import prune
from isogi_core.kernels._jit import FOLDER
from isogi_core.kernels.warm import warm
from isogi_core.model.scene import Scene
from isogi_core.model.view import View
from isogi_core.plan.planner import complete
from server.errand import Errand
from server.foresight import Foresight
from server.trial import seconds_each
from worker.baker import Bake, Baker
from worker.errors import WorkersError
from worker.outlook import TimeLeft

if TYPE_CHECKING:
    from worker.pool import WorkerPool

log = logging.getLogger("isogi.server")

MEMORY = 512 << 20
"""Bytes of decoded light that a look of a scene may keep in memory."""


@dataclass(frozen=True, eq=False)
class Stage:
    """One scene, ready to be rendered."""

    scene: Scene
    renderer: Renderer
    foresight: Foresight


class Studio:
    """Renders frames of its scenes and has the workers bake what they lack. Safe to use from many threads."""

    def __init__(
        self,
        scenes: Sequence[Scene],
        store: str | None = None,
        workers: int = 1,
        scheduler: str | None = None,
        memory: int = MEMORY,
        baker: Baker | None = None,
    ) -> None:
        """Take on ``scenes``; ``store`` is a folder or URL for light, ``scheduler`` a cluster to join.

        ``baker`` is whom light is asked of, one for so many workers by default.
        """
        self.scenes = {scene.id: scene for scene in scenes}
        self.store = str(store or default_store())
        self._workers = workers
        self._scheduler = scheduler
        self._memory = memory
        self._tiles = Tiles()
        self._baker = baker or Baker(workers=None if scheduler else workers)
        self._pool: WorkerPool | None = None
        self._stages: dict[str, Stage] = {}
        self._hiring: threading.Thread | None = None
        self._stopped = threading.Event()
        self._trouble: IsogiError | None = None

    def start(self, hire: bool = True) -> None:
        """Have the workers come while the stores are opened and the kernels of frames loaded, or compiled once.

        Without workers to ``hire`` nothing is baked. Raises StoreError.
        """
        if hire:
            self.hire()
        warm(frame_kernels(self.scenes.values()), self._stopped)
        if self._stopped.is_set():
            return
        for scene in list(self.scenes.values()):
            self._stages[scene.id] = self._open(scene)
        prune(FOLDER)

    def stop(self) -> None:
        """Have ``start``, if it is at work in another thread, return without a studio that can be used."""
        self._stopped.set()

    def hire(self) -> None:
        """Have the workers come, beside whatever else there is to do."""
        if self._hiring is None:
            self._hiring = threading.Thread(target=self._hire, name="hiring", daemon=True)
            self._hiring.start()

    def frame(
        self,
        scene: str,
        view: View,
        *,
        max_error: float | None = None,
        wait: float = 0.0,
        cancelled: threading.Event | None = None,
        watch: Stopwatch | None = None,
    ) -> Frame:
        """The frame of a view with the light that there is, after at most ``wait`` seconds of baking more.

        ``max_error`` is the relative error at which light is final, the scene's target by default; ``watch`` takes
        the time of all stages. Raises ViewError, StoreError, and Cancelled once ``cancelled`` is set.
        """
        watch = watch or Stopwatch()
        stage = self._stages[scene]
        deadline = time.monotonic() + wait
        target = max_error or stage.scene.target_error
        frame = self._render(stage, view, target, cancelled, watch)
        bake = bake_name(scene, look_name(view.shading))
        while self._wanted(bake, frame, target, watch):
            left = deadline - time.monotonic()
            if left <= 0.0:
                break
            with watch.stage("bake"):
                self._baker.wait(bake, [demand.index for demand in frame.demands], left)
            frame = self._render(stage, view, target, cancelled, watch)
        return frame

    def survey(self, scene: str, view: View, target: float) -> Frame:
        """The frame of a view with the light that there is; none that it lacks is asked for."""
        return self._render(self._stages[scene], view, target, None, Stopwatch())

    def time_left(self, scene: str, frame: Frame, max_error: float | None = None) -> TimeLeft | None:
        """Seconds until the view of a ``frame`` is final; None where that is unknown, or nobody works on it."""
        bake, target = bake_name(scene, look_name(frame.view.shading)), max_error or self.scenes[scene].target_error
        subject = (bake, surface_key(frame.view), target)
        left = self._baker.time_left(bake, subject, [demand.index for demand in frame.demands])
        if not frame.provisional:
            return TimeLeft(0.0, 0.0, 0.0)
        return left if left is not None and left.high > 0.0 else None

    def errand(self, scene: str, demands: Iterable[Demand], target: float) -> Errand:
        """Have what ``demands`` want of a scene's own light baked to a ``target`` error."""
        return Errand(self._baker, bake_name(scene, "gi"), demands, target)

    def seconds_each(self, scene: str, demands: Sequence[Demand], target: float) -> float:
        """Processor seconds that a demanded texel of a scene takes to a ``target`` error, by a trial on a few."""
        return seconds_each(self._stages[scene].renderer, demands, target)

    @property
    def paths(self) -> int:
        """Paths that were baked, of all scenes."""
        return self._baker.paths

    def trouble(self) -> str:
        """Why light is not baked: the workers cannot be had, or gave a chunk up; empty when all is well."""
        return str(self._trouble) if self._trouble is not None else self._baker.trouble()

    def unready(self) -> list[str]:
        """Reasons why frames would not become final; none when all is well."""
        if self.trouble():
            return [self.trouble()]
        if self._pool is None:
            return ["The workers are starting."]
        return [] if self._pool.connected else ["The workers cannot be reached at the moment."]

    def close(self) -> None:
        """Stop the workers; what they were at is baked again when it is next asked for."""
        self._baker.stop()
        if self._hiring is not None:
            self._hiring.join()
        if self._pool is not None:
            self._pool.close()
        for stage in self._stages.values():
            stage.foresight.close()
        self._tiles.close()

    def _wanted(self, bake: str, frame: Frame, target: float, watch: Stopwatch) -> bool:
        """Ask for the light that a frame lacks; whether any of it is going to be baked."""
        with watch.stage("demand"):
            return bool(frame.demands) and self._baker.want(bake, frame.demands, target)

    def _render(
        self, stage: Stage, view: View, target: float, cancelled: threading.Event | None, watch: Stopwatch
    ) -> Frame:
        with stage.foresight.frame(stage.scene.volume.normalise_isovalue(view.isovalue)):
            return stage.renderer.render(view, target, cancelled, watch)

    def _open(self, scene: Scene) -> Stage:
        recipe = Recipe(scene, self._tiles.run)
        caches = Caches(recipe, self.store, self._memory)
        recipe.field, recipe.maps, caches.store("gi")  # worked out now, not in the first frame
        self.scenes[scene.id] = replace(scene, plan=complete(caches.look("gi").plan, scene.needs, scene.told))
        lowest, highest = sorted(map(scene.volume.normalise_isovalue, scene.isovalues))
        foresight = Foresight(lambda v, cancelled: recipe.bricks(v, v, cancelled), STEP, (lowest, highest))
        for look in LOOKS:
            self._baker.add(bake_name(scene.id, look), self._bake(caches, look))
        return Stage(scene, Renderer(caches, self._tiles), foresight)

    def _bake(self, caches: Caches, name: str) -> Bake:
        """The bake of a look, by its name."""
        look = caches.look(name)
        scene, plan = look.recipe.scene, replace(look.plan, left_out=(), notes=())
        layers = frozenset(scene.layer_digest(layer) for layer in plan.layers)
        arrived = partial(refresh, caches, name)
        costs = Costs(self.store, look.digest)
        costs.read()
        return Bake(scene.source, plan, look.digest, layers, absolute(self.store), arrived, costs)

    def _hire(self) -> None:
        try:
            from worker.pool import WorkerPool  # noqa: PLC0415 (a fifth of a second, beside other work)

            kinds = {layer.kind for scene in self.scenes.values() for layer in scene.plan.layers}
            self._pool = WorkerPool(self._workers, self._scheduler, kinds)
            self._baker.employ(self._pool)
        except IsogiError as error:
            self._trouble = error
            log.error("%s", error)
        except Exception as error:
            self._trouble = WorkersError(f"Cannot start the workers: {error}")
            log.exception("%s", self._trouble)


def bake_name(scene: str, look: str) -> str:
    """The name of a look of a scene among all bakes; the scene's own where it is its own."""
    return scene if look == "gi" else f"{scene} ({look})"


def refresh(caches: Caches, look: str, index: Index) -> None:
    """Say that the store has new light of a chunk in a look."""
    caches.of(look).refresh(index)


def absolute(store: str) -> str:
    """A store's folder as an absolute path, a URL as it is: workers may stand elsewhere."""
    return store if "://" in store else str(Path(store).resolve())
