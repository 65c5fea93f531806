"""The studio: scenes with their caches, one set of workers, and frames of any of them."""

import logging
import threading
import time
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from isogi_core.bake.look import LOOKS, look_name
from isogi_core.bake.recipe import Index, Recipe
from isogi_core.cache.caches import Caches
from isogi_core.cache.costs import Cost
from isogi_core.cache.parcels import Parcels, send_parcels
from isogi_core.cache.place import Place
from isogi_core.cache.root import Root, Where
from isogi_core.cache.store import default_store
from isogi_core.cache.trimming import trim_sharp
from isogi_core.errors import IsogiError, StoreFullError, StoreReadOnlyError
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
from server.bakes import bake_name, make_bake
from server.errand import ERRAND, Errand
from server.errors import UnknownSceneError
from server.foresight import Foresight
from server.memory import shared
from server.sharp import SharpBakes
from worker.baker import Baker, Listener
from worker.errors import WorkersAwayError, WorkersError
from worker.outlook import TimeLeft
from worker.tally import Tally
from worker.viewers import GUEST, Viewer

if TYPE_CHECKING:
    from worker.pool import WorkerPool

log = logging.getLogger("isogi.server")

READ_ONLY = "The store at {store} can only be read: what is baked there is shown, and nothing more is baked."

UNSEEN = "A store in memory is seen by no worker process: name a folder or an object store."

AGAIN = 2.0
"""Seconds after which a scheduler that was not there when the server began is looked for again."""

MEMORY = 1 << 30
"""Bytes of light, views and maps that a scene may keep in memory."""

SHARP = 4 << 30
"""Bytes of sharp light that a store may keep."""


@dataclass(frozen=True, eq=False)
class Stage:
    """One scene, ready to be rendered."""

    scene: Scene
    renderer: Renderer
    foresight: Foresight
    parcels: Parcels | None = None


class Studio:
    """Renders frames of its scenes and has the workers bake what they lack. Safe to use from many threads."""

    def __init__(
        self,
        scenes: Sequence[Scene],
        store: Where | None = None,
        workers: int = 1,
        scheduler: str | None = None,
        memory: int = MEMORY,
        baker: Baker | None = None,
        sharp: int = SHARP,
    ) -> None:
        """Take on ``scenes``; ``store`` is a folder, URL or root for light, ``scheduler`` a cluster to join.

        ``baker`` is whom light is asked of, one for so many workers by default; the store may keep so many bytes of
        ``sharp`` light.
        """
        self.scenes = {scene.id: scene for scene in scenes}
        self.root = store if isinstance(store, Root) else Root(whereabouts(Place.of(store or default_store())))
        self._workers = workers
        self._scheduler = scheduler
        self._memory = shared(memory)
        self._tiles = Tiles()
        self._baker = baker or Baker(workers=None if scheduler else workers)
        self._pool: WorkerPool | None = None
        self._stages: dict[str, Stage] = {}
        self._sharp = SharpBakes(self._baker, lambda: trim_sharp(self.root, sharp))
        self._hiring: threading.Thread | None = None
        self._stopped = threading.Event()
        self._trouble: IsogiError | None = None

    def start(self, hire: bool = True) -> None:
        """Have the workers come while the stores are opened and the kernels of frames loaded, or compiled once.

        Without workers to ``hire`` nothing is baked, nor in a store that can only be read. Raises StoreError.
        """
        if hire:
            self.hire()
        warm(frame_kernels(self.scenes.values()), self._stopped)
        if self._stopped.is_set():
            return
        with suppress(StoreReadOnlyError, StoreFullError):
            self.root.prove()
        for scene in list(self.scenes.values()):
            self._show(self._open(scene))
        prune(FOLDER)

    def stop(self) -> None:
        """Have ``start``, if it is at work in another thread, return without a studio that can be used."""
        self._stopped.set()

    def hire(self) -> None:
        """Have the workers come, beside whatever else there is to do."""
        if self._hiring is None:
            self._hiring = threading.Thread(target=self._hire, name="hiring", daemon=True)
            self._hiring.start()

    def admit(self, scene: Scene) -> None:
        """Show one more scene, once the studio has started. Raises StoreError."""
        warm(frame_kernels([scene]), self._stopped)
        self._show(self._open(scene))

    def dismiss(self, scene: str) -> None:
        """Show a scene no more: frames that are drawn come to their end, and nothing more is baked for it.

        Its light stays in the store.
        """
        stage = self._stages.pop(scene)
        self.scenes = {name: each for name, each in self.scenes.items() if name != scene}
        for look in LOOKS:
            self._baker.forget(bake_name(scene, look))
        self._sharp.forget(scene)
        stage.foresight.close()

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
        stage = self._stage(scene)
        deadline = time.monotonic() + wait
        target = max_error or stage.scene.target_error
        frame = self._render(stage, view, target, cancelled, watch)
        while self._coming(scene, frame, target, watch):
            left = deadline - time.monotonic()
            if left <= 0.0:
                break
            with watch.stage("bake"):
                self._baker.wait(*self._chunks(scene, frame), left)
            frame = self._render(stage, view, target, cancelled, watch)
        return frame

    def survey(
        self,
        scene: str,
        view: View,
        target: float,
        cancelled: threading.Event | None = None,
        watch: Stopwatch | None = None,
    ) -> Frame:
        """The frame of a view with the light that there is; none that it lacks is asked for.

        Raises as ``frame`` does, and UnknownSceneError where the scene was dismissed.
        """
        return self._render(self._stage(scene), view, target, cancelled, watch or Stopwatch())

    def want(self, scene: str, frame: Frame, target: float, viewer: Viewer) -> frozenset[Index]:
        """Ask for the light that a ``frame`` lacks, for a ``viewer``; the chunks that are going to be baked."""
        if self.root.only_read():
            return frozenset()
        bake, demands = self.lacking(scene, frame)
        return self._baker.want(bake, demands, target, viewer)

    def lacking(self, scene: str, frame: Frame) -> tuple[str, tuple[Demand, ...]]:
        """The bake that a ``frame`` lacks light of, and what of it: sharp light once all else is final."""
        bake, stage = self.bake_of(scene, frame.view), self._stages.get(scene)
        if stage is None or frame.demands or frame.sharpness is None or not frame.sharpness.demands:
            return bake, frame.demands
        caches, shown = stage.renderer.caches, frame.gbuffer.isovalue
        sharp = self._sharp.name(scene, shown, lambda: make_bake(caches, "gi", stage.parcels, shown))
        return sharp, frame.sharpness.demands

    def _chunks(self, scene: str, frame: Frame) -> tuple[str, list[Index]]:
        """The bake that a ``frame`` lacks light of, and the chunks of it."""
        bake, demands = self.lacking(scene, frame)
        return bake, [demand.index for demand in demands]

    def waiting(self, scene: str, frame: Frame, viewer: Viewer) -> int:
        """How many chunks that a ``frame`` lacks are still to be baked; a ``viewer`` who looks is not forgotten."""
        return self._baker.open(*self._chunks(scene, frame), viewer)

    def make_way(self) -> None:
        """Have the workers make way for a view that moves."""
        self._baker.make_way()

    def leave(self, viewer: Viewer) -> None:
        """Have nothing more baked for a ``viewer`` that has gone."""
        self._baker.leave(viewer)

    def listen(self, listener: Listener) -> None:
        """Tell ``listener`` of every chunk of a bake that has new light, or whose task failed; see ``bake_of``.

        Of sharp light it is told as of the scene's own.
        """
        self._baker.listen(lambda bake, index, more: listener(self._sharp.scene(bake), index, more))

    def time_left(self, scene: str, frame: Frame, max_error: float | None = None) -> TimeLeft | None:
        """Seconds until the view of a ``frame`` is final; None where that is unknown, or nobody works on it."""
        target = max_error or self._stage(scene).scene.target_error
        bake, chunks = self._chunks(scene, frame)
        left = self._baker.time_left(bake, (bake, surface_key(frame.view), target), chunks)
        if not frame.provisional:
            return TimeLeft(0.0, 0.0, 0.0)
        return left if left is not None and left.high > 0.0 else None

    def errand(self, bake: str, demands: Iterable[Demand], target: float, viewer: Viewer = ERRAND) -> Errand:
        """Have what ``demands`` want of a ``bake`` (see ``bake_of``) baked to a ``target`` error, for a ``viewer``."""
        return Errand(self._baker, bake, () if self.root.only_read() else demands, target, viewer)

    def spent(self, bake: str, indices: Iterable[Index]) -> Cost:
        """What tasks at these chunks of a bake took so far."""
        return self._baker.spent(bake, indices)

    def renderer(self, scene: str) -> Renderer:
        """Who renders a scene; UnknownSceneError where it was dismissed."""
        return self._stage(scene).renderer

    @property
    def workers(self) -> int:
        """How many workers there are, or are to come."""
        return self._baker.workers

    @property
    def manned(self) -> bool:
        """Whether there are workers."""
        return self._baker.manned

    def await_workers(self, seconds: float) -> bool:
        """Whether those that are to come have, or cannot, after so many seconds at most."""
        if self._hiring is not None:
            self._hiring.join(seconds)
        return self._hiring is None or not self._hiring.is_alive()

    @property
    def unmanned(self) -> str:
        """Why there are no workers; empty where they are here, or may still come."""
        return "" if self._trouble is None else str(self._trouble)

    def bake_of(self, scene: str, view: View) -> str:
        """The name of the bake that a view of a scene reads."""
        return bake_name(scene, look_name(view.shading))

    @property
    def paths(self) -> int:
        """Paths that were baked, of all scenes."""
        return self._baker.paths

    def trouble(self) -> str:
        """Why light will not be baked: the store is only read, there are no workers, or a chunk was given up.

        Empty when all is well.
        """
        if self.root.read_only:
            return READ_ONLY.format(store=self.root.place)
        return str(self._trouble) if self._trouble is not None else self._baker.trouble()

    def tally(self) -> Tally:
        """What baking has to do, has done, and has lost."""
        return self._baker.tally()

    def unready(self) -> list[str]:
        """Reasons why frames would not become final; none when all is well, or nothing is baked on purpose."""
        if self.root.read_only:
            return []
        if why := self.trouble() or self._baker.paused():
            return [why]
        if self._pool is None:
            return ["The workers are starting."]
        return [self._pool.trouble] if self._pool.trouble else []

    def notes(self) -> list[str]:
        """What a person should know though all goes as it should: that the store is only read."""
        return [self.trouble()] if self.root.read_only else []

    def close(self) -> None:
        """Stop the workers; what they were at is baked again when it is next asked for."""
        self._stopped.set()
        self._baker.stop()
        if self._hiring is not None:
            self._hiring.join()
        if self._pool is not None:
            self._pool.close()
        for stage in list(self._stages.values()):
            stage.foresight.close()
        self._tiles.close()

    def _coming(self, scene: str, frame: Frame, target: float, watch: Stopwatch) -> bool:
        """Ask for the light that a frame lacks; whether any of it is going to be baked."""
        with watch.stage("demand"):
            return bool(self.lacking(scene, frame)[1] and self.want(scene, frame, target, GUEST))

    def _render(
        self, stage: Stage, view: View, target: float, cancelled: threading.Event | None, watch: Stopwatch
    ) -> Frame:
        with stage.foresight.frame(stage.scene.volume.normalise_isovalue(view.isovalue)):
            return stage.renderer.render(view, target, cancelled, watch)

    def _stage(self, scene: str) -> Stage:
        """The stage of a scene; UnknownSceneError where it was dismissed."""
        stage = self._stages.get(scene)
        if stage is None:
            raise UnknownSceneError(f"The scene '{scene}' is not shown any more.")
        return stage

    def _show(self, stage: Stage) -> None:
        """Have a scene found, now that its stage stands; who walks through the former scenes may go on."""
        self._stages[stage.scene.id] = stage
        self.scenes = {**self.scenes, stage.scene.id: stage.scene}

    def _open(self, scene: Scene) -> Stage:
        recipe = Recipe(scene, self._tiles.run, self._memory.maps)
        caches = Caches(recipe, self.root, self._memory.light)
        recipe.field, recipe.maps, caches.store("gi")  # worked out now, not in the first frame
        shown = replace(scene, plan=complete(caches.look("gi").plan, scene.needs, scene.told))
        lowest, highest = sorted(map(scene.volume.normalise_isovalue, scene.isovalues))
        levels = recipe.maps.levels
        foresight = Foresight(lambda v, cancelled: recipe.bricks(v, v, cancelled), levels, (lowest, highest))
        parcels = self._send(scene)
        for look in LOOKS:
            self._baker.add(bake_name(scene.id, look), make_bake(caches, look, parcels))
        return Stage(shown, Renderer(caches, self._tiles, self._memory.views), foresight, parcels)

    def _send(self, scene: Scene) -> Parcels | None:
        """What workers that were joined read in place of the scene's files; none into a store that takes nothing."""
        with suppress(StoreReadOnlyError, StoreFullError):
            return send_parcels(scene, self.root) if self._scheduler else None
        return None

    def _hire(self) -> None:
        """Have the workers come; a scheduler that is not there yet is waited for."""
        while not self._stopped.is_set():
            try:
                self._employ()
                self._trouble = None
                return
            except IsogiError as error:
                self._trouble = error
                log.error("%s", error)
            except Exception as error:
                self._trouble = WorkersError(f"Cannot start the workers: {error}")
                log.exception("%s", self._trouble)
            if not isinstance(self._trouble, WorkersAwayError):
                return
            self._stopped.wait(AGAIN)

    def _employ(self) -> None:
        if self.root.place.scheme == "memory":
            raise WorkersError(UNSEEN)
        from worker.pool import WorkerPool  # noqa: PLC0415 (a fifth of a second, beside other work)

        kinds = {layer.kind for scene in self.scenes.values() for layer in scene.plan.layers}
        self._pool = WorkerPool(self._workers, self._scheduler, kinds)
        self._pool.attend(self._baker.stir)
        self._baker.employ(self._pool)


def whereabouts(place: Place) -> Place:
    """A place whose folder is an absolute path, a URL as it is: workers may stand elsewhere."""
    return place if "://" in place.url else replace(place, url=str(Path(place.url).resolve()))
