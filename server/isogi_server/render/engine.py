"""The render engine: loads scenes, draws frames of them, and has workers bake the light that
frames lack.
"""

import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial, reduce

from isogi_core.bake.bake_spec import SPECS, spec_name
from isogi_core.bake.noise import Goal
from isogi_core.cache.chunk_store import default_store
from isogi_core.cache.costs import Cost
from isogi_core.errors import StoreFullError, StoreReadOnlyError
from isogi_core.frame.frame import Frame
from isogi_core.frame.gbuffer import surface_key
from isogi_core.frame.rays.picture_plan import AWAITED, HEAVIER, Prices
from isogi_core.frame.renderer import Renderer, unlit_frame
from isogi_core.frame.texel_reading import Stage
from isogi_core.frame.tiles import Stopwatch, Tiles
from isogi_core.frame.view_checks import WorkLeft
from isogi_core.model.view import View
from isogi_core.model.volume import Isovalue
from isogi_core.plan.scene import Scene
from isogi_core.prepared.prepared_scene import Index
from isogi_core.prepared.shared_scenes import SharedScenes
from isogi_core.storage.backend import StoreUrl
from isogi_core.storage.store import Store, StoreLike
from isogi_server.errors import UnknownSceneError
from isogi_server.render.bakes import (
    BACKGROUND_VIEWER,
    BackgroundBake,
    SideBakes,
    bake_name,
    make_bake,
    share_by_store,
)
from isogi_server.render.engine_workers import EngineWorkers, scheduler_of
from isogi_server.render.idle_bakes import IDLE_VIEWER, IdleBakes
from isogi_server.render.loaded_scene import LoadedScene, LoadedScenes, load_scene_parts, shared
from isogi_server.render.picture_checks import CHECK, LIGHT_PATIENCE_SECONDS, Picture, PictureChecks
from isogi_server.render.scene_kernels import SceneKernels
from isogi_server.render.scene_variant import SceneVariant
from isogi_server.render.stores import root_of, whereabouts
from isogi_server.render.time_left import Unfinished, time_of_parts
from isogi_server.settings import Settings
from isogi_worker.bake_requests import GUEST_VIEWER, Viewer
from isogi_worker.baker import Baker, Listener
from isogi_worker.progress import (
    Promises,
    TimeLeft,
)

REMEMBERED = 4096
"""Variants whose changes are remembered, so that they can be made again after they were dismissed:
the ones made last.
"""

READ_ONLY = (
    "The store at {store} can only be read: what is baked there is shown, and nothing "
    "more is baked."
)

SCENES_MEMORY_BYTES = 1 << 30
"""Bytes of light, views and maps that all scenes together may keep in memory."""

PROJECTED_TEXEL_BYTES = 4 << 30
"""Bytes of projected texels that a store may keep."""


class RenderEngine:
    """Renders frames of its ``scenes``, and has a ``baker`` bake the light that they lack. Safe
    to use from many threads.
    """

    def __init__(
        self,
        scenes: Sequence[Scene],
        store: StoreLike | None = None,
        workers: int = 1,
        scheduler: str | None = None,
        memory: int = SCENES_MEMORY_BYTES,
        baker: Baker | None = None,
        projected: int = PROJECTED_TEXEL_BYTES,
    ) -> None:
        """Create an engine; nothing is loaded before ``start``.

        ``store`` is a folder, a URL or an open store for the light, by default the default store.
        Light is baked by ``workers`` processes, or by the workers of a ``scheduler``; tests may
        give a ``baker``. ``memory`` are the bytes that all scenes may keep, ``projected`` the bytes
        of projected texels in the store.
        """
        self.scenes = {scene.id: scene for scene in scenes}
        if isinstance(store, Store):
            self.store = store
        else:
            self.store = Store(whereabouts(StoreUrl.of(store or default_store())))
        # Each scene may keep this much; LoadedScenes drops scenes if all together keep more.
        self._memory = shared(memory)
        self._loaded = LoadedScenes(self._load, memory)
        self._bakes: dict[str, str] = {}
        self._variants: OrderedDict[str, SceneVariant] = OrderedDict()
        self._changing = threading.RLock()
        self._tiles = Tiles()
        self.baker = baker or Baker(workers=None if scheduler else workers)
        self.workers = EngineWorkers(self.baker, self.store.url, workers, scheduler)
        # Workers of this machine open shared memory; those of a cluster read copies in the store.
        if self.workers.joins:
            self._share = share_by_store(self.store)
        else:
            self._share = SharedScenes().share
        self._side_bakes = SideBakes(self.baker, self.store, projected)
        self._checks = PictureChecks(self.check, self._checked)
        self._idle = IdleBakes(self._bake_lacking, self.baker.leave)
        # Checks of pictures have separate threads, so that frames do not queue behind them.
        self._checking = Tiles()
        self._promises = Promises()
        self._listeners: list[Listener] = []
        self.again: Callable[[str], Scene | None] = lambda _: None
        """Makes the variant with an id again after it was dismissed, and admits it; returns None if
        the id is no variant's. Set by ``Variants``; an engine without them makes none.
        """
        self._stopped = threading.Event()
        self.kernels = SceneKernels(lambda: list(self.scenes.values()), self._stopped)

    def start(self, with_workers: bool = True) -> None:
        """Call ``open`` and then ``light``. Raises StoreError."""
        self.open(with_workers)
        self.light(with_workers)

    def open(self, with_workers: bool = True) -> None:
        """Open the store and load the scenes, so that pictures without light can be drawn. Raises
        StoreError.

        If ``with_workers``, the workers start meanwhile, or in ``light`` if kernels are still to be
        compiled. Without workers nothing is baked.
        """
        self.workers.after_kernels = self.kernels.progress is not None
        if with_workers and not self.workers.after_kernels:
            self.start_workers()
        self.kernels.first()
        if self._stopped.is_set():
            return
        # A store that is only read, or full, is found out now; its light is shown all the same.
        with suppress(StoreReadOnlyError, StoreFullError):
            self.store.check_writable()
        for scene in list(self.scenes.values()):
            self._loaded.at(scene)
        threading.Thread(
            target=self._loaded.tidy, args=[self._stopped], name="tidying", daemon=True
        ).start()

    def light(self, with_workers: bool = True) -> None:
        """Wait until the kernels of lit pictures and of bakes are compiled, and load the
        former; then start the workers if ``with_workers``.
        """
        self.kernels.light()
        if with_workers and not self._stopped.is_set():
            self.start_workers()

    def stop(self) -> None:
        """Have ``start`` return early if it runs in another thread; the engine cannot be used
        then.
        """
        self._stopped.set()

    def start_workers(self) -> None:
        """Start the workers in a thread, unless that was done before."""
        self.workers.start(self.kernels.kinds)

    def admit(self, scene: Scene, variant: SceneVariant | None = None) -> None:
        """Add a scene, or a ``variant`` of one, to a started engine. It is loaded when a frame
        of it is first drawn.
        """
        self.kernels.admit(scene)
        with self._changing:
            if variant is not None:
                self._variants[scene.id] = variant
                self._variants.move_to_end(scene.id)
            # Forget the variants that were made longest ago. Assign a new dict, as other threads
            # may iterate over the former one.
            while len(self._variants) > REMEMBERED:
                self._variants.popitem(last=False)
            self.scenes = {**self.scenes, scene.id: scene}

    def variant(self, scene: str) -> SceneVariant:
        """Return the variant that a scene is; one without changes if it is none."""
        return self._variants.get(scene) or SceneVariant(scene)

    @property
    def own_scenes(self) -> list[Scene]:
        """Return the scenes that are not variants."""
        return [each for each in self.scenes.values() if each.id not in self._variants]

    def planned(self, scene: str) -> Scene:
        """Return a scene, loaded if need be, with the plan of the light that its store has.
        Raises StoreError and UnknownSceneError.
        """
        return self._find(scene).scene

    def dismiss(self, scene: str) -> None:
        """Remove a scene and its variants: nothing more of them is baked. Frames that are being
        drawn are completed.

        Their light remains in the store.
        """
        variants = [name for name in self.scenes if self.variant(name).base == scene]
        for each in dict.fromkeys([scene, *variants]):
            self._dismiss(each)

    def _dismiss(self, scene: str) -> None:
        """Remove one scene, its bakes and its place in memory."""
        with self._changing:
            self.scenes = {name: each for name, each in self.scenes.items() if name != scene}
            known = [
                bake for spec in SPECS if self._bakes.pop(bake := bake_name(scene, spec), None)
            ]
        for bake in known:
            self.baker.forget(bake)
        self._side_bakes.forget(scene)
        self._loaded.drop(scene)

    def frame(
        self,
        scene: str,
        view: View,
        *,
        goal: Goal | None = None,
        wait: float = 0.0,
        cancelled: threading.Event | None = None,
        watch: Stopwatch | None = None,
    ) -> Frame:
        """Return the frame of a view. If it is not final, have light baked and pictures checked for
        at most ``wait`` seconds.

        By default the ``goal`` of the picture is the scene's error, to be checked. ``watch``
        measures the time of all stages. Raises ViewError, StoreError, and Cancelled once
        ``cancelled`` is set.
        """
        watch = watch or Stopwatch()
        deadline = time.monotonic() + wait
        goal = goal or self._usual_goal(scene)
        frame = self.survey(scene, view, goal, cancelled, watch)
        # Improve the frame and draw it again, until nothing more is coming or the time is up.
        while frame.checkable or self._coming(scene, frame, goal, watch):
            if (left := deadline - time.monotonic()) <= 0.0:
                break
            with watch.stage("check" if frame.checkable else "bake"):
                if frame.checkable:
                    self.check(scene, view, goal, cancelled)
                else:
                    bake, stage = self.lacking(scene, frame)
                    self.baker.wait(bake, [demand.index for demand in stage.demands], left)
            frame = self.survey(scene, view, goal, cancelled, watch)
        return frame

    def survey(
        self,
        scene: str,
        view: View,
        goal: Goal,
        cancelled: threading.Event | None = None,
        watch: Stopwatch | None = None,
    ) -> Frame:
        """Return the frame of a view with the light that is baked so far, without requesting more.
        See ``Renderer.render`` for the ``goal``.

        Raises as ``frame`` does, and UnknownSceneError if the scene was dismissed.
        """
        try:
            return self._find(scene).render(view, goal, cancelled, watch or Stopwatch())
        finally:
            # Frames grow their scene: make room afterwards, when the frame holds what it needs.
            self._loaded.settle()

    def unlit_frame(
        self, scene: str, view: View, goal: Goal, cancelled: threading.Event
    ) -> Frame | None:
        """Return the white, provisional frame of a new view that has no light yet, sooner than
        it could be drawn; None for other views. See ``renderer.unlit_frame``.
        """
        return unlit_frame(self._find(scene).renderer, view, goal, cancelled)

    def sees(self, scene: str, view: View) -> bool:
        """Return True if the G-buffer of a view is kept, so that its picture needs no rays."""
        loaded = self._loaded.held(scene)
        return loaded is not None and loaded.renderer.sees(view)

    def check(
        self,
        scene: str,
        view: View,
        goal: Goal,
        cancelled: threading.Event | None = None,
        prices: Prices = AWAITED,
        over: threading.Event | None = None,
    ) -> bool:
        """Take one step of the check of a picture: measure its total error, or bring it nearer to
        the ``goal``. Return False if no step was left.

        ``prices`` weigh the costs of possible steps. Raises as ``frame`` does, and Cancelled if
        ``cancelled`` is set, as nobody wants the picture any more, or ``over``, as the caller has
        no time left for the step.
        """
        tiles = self._checking
        for event in filter(None, (cancelled, over)):
            tiles = tiles.cancelled_by(event)
        # No light can be baked for a store that is only read: what there is is shown.
        if self.store.only_read():
            prices = prices.of_texels
        with self._idle.awaited():
            return self._find(scene).check(view, goal, tiles, prices)

    def _bake_lacking(self, picture: Picture) -> BackgroundBake | None:
        """Request the first light that texels of a ``picture`` lack, of one stage, for IDLE_VIEWER:
        first of those that the view reads while it moves, then of all. Return None if they lack
        none that can be baked, or if the store is only read. Raises NoRoomError, and as ``frame``
        does.
        """
        if self.store.only_read():
            return None
        moving = replace(picture.view, moving=True)
        for view in (moving, picture.view):
            # A goal without ``samples`` asks for MAX_SAMPLES: a view at rest is then not checked,
            # so that it reads texels in any case, and those of the scene, never finer ones.
            frame = self.survey(picture.scene, view, Goal(picture.goal.error))
            for stage in frame.stages:
                unlit = tuple(demand for demand in stage.demands if demand.effort.unlit)
                if unlit:
                    first = replace(stage, demands=unlit, goal=Goal.checked(picture.goal.error))
                    bake = self.bake_at(picture.scene, spec_name(view.shading), first)
                    begun = self.bake(bake, first, IDLE_VIEWER)
                    # If all of it was given up, other stages and the view at rest have their turn.
                    if begun.coming:
                        return begun
        return None

    def want(self, scene: str, frame: Frame, goal: Goal, viewer: Viewer) -> frozenset[Index]:
        """Request everything that a ``frame`` needs next for its ``goal``, for a ``viewer``: a
        check of its picture, light of texels, or both.

        A check is requested if the frame is refinable. Light of texels is requested unless the
        frame is checkable, or the store is only read. A checkable frame needs none now: its texels
        have all the light that they are to have until the check asks for more, or paths of pixels
        light it, or the check has to decide first between texels and paths. Both are requested if
        walls lag, or the present light is to be measured, and the frame is not checkable.

        Return the chunks that will be baked or were baked since the frame was drawn, and CHECK if a
        check was requested.
        """
        checking = frozenset({CHECK} if frame.refinable else ())
        # Idle baking, which is for final pictures by paths alone, stops while another picture needs
        # the processors.
        if frame.view.moving or not frame.final:
            self._idle.disturb()
        elif frame.goes_without_texels:
            self._idle.add(Picture(scene, frame.view, goal))
        if checking:
            # Give the rest of the light some time to come before a picture with a part of it is
            # measured. No more light comes if the store is only read.
            more_light_comes = frame.unmeasured and not self.store.only_read()
            delay = LIGHT_PATIENCE_SECONDS if more_light_comes else 0.0
            self._checks.request(scene, frame.view, goal, viewer, delay)
        else:
            self._checks.leave(viewer)
        if frame.checkable or self.store.only_read():
            return checking
        # Load the scene if it was dropped from memory: loading adds its bakes to the baker.
        self._find(scene)
        bake, stage = self.lacking(scene, frame)
        return checking | self.baker.request(bake, stage.demands, stage.goal, viewer)

    def lacking(self, scene: str, frame: Frame) -> tuple[str, Stage]:
        """Return the bake that a ``frame`` needs light of next, and the stage of it: see
        ``Frame.stages``.

        If a frame with finer texels is coming in its place, that one's needs count. The stage is
        empty for a path-traced frame, which needs no texels.
        """
        shown = frame.quality.finer or frame
        stage = next(iter(shown.stages), Stage((), Goal(self.planned(scene).target_error)))
        spec = spec_name(shown.view.shading)
        return self.bake_at(scene, spec, stage, shown.quality.fineness), stage

    def bake_at(self, scene: str, spec: str, stage: Stage, fineness: int = 0) -> str:
        """Return the name of the bake that bakes a ``stage`` of the light of a scene by a ``spec``
        ("gi" or "vicinity"), with texels finer by ``fineness`` steps; add the bake if it is new.
        """
        # Light of one side of a surface has a separate bake.
        if stage.caches is not None and scene in self.scenes:
            return self._side_bakes.side(scene, spec, stage, self._share)
        # Light of texels that are neither finer nor projected belongs to the bake of the scene. So
        # does any of a dismissed scene: its bakes are forgotten, so nothing is baked for it.
        if scene not in self.scenes or (stage.shown is None and not fineness):
            return bake_name(scene, spec)
        # Each isosurface of projected texels, and each grid of finer texels, has a separate bake.
        # They are of the spec "gi" alone: vicinity shading projects no texels and asks for no finer
        # ones.
        loaded = self._find(scene).level(fineness)
        arrived = partial(self._arrived, scene, fineness)
        make = partial(make_bake, loaded.renderer.caches, "gi", loaded.assets, arrived, stage.shown)
        return self._side_bakes.name(scene, stage.shown, fineness, make)

    def unfinished(self, scene: str, frame: Frame, goal: Goal | None = None) -> Unfinished:
        """Return everything that a ``frame`` lacks until it is final.

        ``goal`` must be the one that it was drawn for, by default the error of its scene. If a
        finer frame is to replace it, ``bake``, ``chunks`` and ``later`` are that one's, all others
        those of the frame that is shown. The bake is added if it is new.
        """
        goal = goal or self._usual_goal(scene)
        picture = (scene, frame.view, goal)
        lacks = Unfinished(*picture, frame.final, frame.refinable, frame.seconds)
        if frame.final:
            return lacks
        bake, stage = self.lacking(scene, frame)
        fineness = frame.quality.fineness
        parts = self._find(scene).level(fineness).renderer.work_left(frame, goal)
        return replace(
            lacks,
            bake=bake,
            chunks=tuple(demand.index for demand in stage.demands),
            later=(frame.quality.finer or frame).stages[1:],
            parts=tuple((part, self._read_by(scene, frame, part)) for part in parts),
        )

    def _read_by(self, scene: str, frame: Frame, part: WorkLeft) -> tuple[str, ...]:
        """Return the names of the bakes that the texels of a ``part`` of a ``frame`` read; of the
        scene's light, the one that the frame needs next. They are added if they are new.
        """
        spec = spec_name(frame.view.shading)
        stages = {stage.caches: stage for stage in reversed(frame.stages)}
        none = Stage((), Goal(self.planned(scene).target_error))
        return tuple(
            self.bake_at(
                scene, spec, stages.get(each, replace(none, caches=each)), frame.quality.fineness
            )
            for each in part.light
        )

    def waiting(self, lacks: Unfinished, viewer: Viewer) -> int:
        """Return the number of chunks that a picture ``lacks`` and that are still to be baked;
        renew the interest of the ``viewer`` in them.
        """
        return self.baker.open(lacks.bake, list(lacks.chunks), viewer)

    def leave(self, viewer: Viewer) -> None:
        """Drop the requests and the picture check of a ``viewer`` that has gone."""
        self._checks.leave(viewer)
        self.baker.leave(viewer)

    def listen(self, listener: Listener) -> None:
        """Call ``listener`` with the bake, the chunk and a flag for more whenever a chunk has new
        light or its task failed; see ``bake_of``.

        Projected and finer texels are reported under the bake of the scene, and the check of a
        picture as the chunk CHECK.
        """
        self._listeners.append(listener)
        self.baker.listen(
            lambda bake, index, more: listener(self._side_bakes.scene(bake), index, more)
        )

    def time_left(self, scene: str, frame: Frame, goal: Goal | None = None) -> TimeLeft | None:
        """Estimate the seconds until a ``frame`` reaches a ``goal``, by default the error of its
        scene. None if that is unknown, if nothing more is done for the view, or if there are no
        workers.
        """
        return self.time_without(self.unfinished(scene, frame, goal))

    def time_without(self, lacks: Unfinished) -> TimeLeft | None:
        """Estimate the seconds until a picture has all that it ``lacks``; None as ``time_left``."""
        picture = (lacks.scene, lacks.view, lacks.goal)
        if lacks.final:
            self._promises.end(picture)
            return TimeLeft(0.0, 0.0, 0.0)
        # Texels are baked first, by the workers; after them paths of control pixels and of pixels'
        # light are traced in this process.
        if not (lacks.chunks or lacks.refinable):
            return None
        # Texels of this stage and of all later ones.
        subject = (lacks.scene, surface_key(lacks.view), lacks.goal)
        chunks = list(lacks.chunks)
        baking = self.baker.time_left(lacks.bake, subject, chunks, lacks.later, lacks.scene)
        if baking is None:
            return None
        baking = baking.plus(self._time_of_parts(lacks))
        # Report a time that does not jump. Some steps, as of shine, are not foreseen: count on with
        # the time that was reported before them.
        if baking.high > 0.0:
            return self._promises.kept(picture, baking)
        return self._promises.now(picture)

    def _time_of_parts(self, lacks: Unfinished) -> TimeLeft:
        """Estimate the time for the paths of all parts of a picture, and to draw it meanwhile."""
        costs = [self._spent(part, bakes) for part, bakes in lacks.parts]
        # Texels that keep irradiance trace the same paths as pixels do.
        if self.planned(lacks.scene).plan.representation == "irradiance":
            heavier = 1.0
        else:
            heavier = HEAVIER
        left = [part.paths for part, _ in lacks.parts]
        return time_of_parts(left, costs, self._checking.threads, lacks.seconds, heavier)

    def _spent(self, part: WorkLeft, bakes: tuple[str, ...]) -> Cost:
        """Return the cost so far of the light that a ``part`` reads from its ``bakes``."""
        return reduce(Cost.plus, (self.baker.spent(bake, part.chunks) for bake in bakes), Cost())

    def bake(self, bake: str, stage: Stage, viewer: Viewer = BACKGROUND_VIEWER) -> BackgroundBake:
        """Have the light that a ``stage`` demands of a ``bake`` baked for a ``viewer``; nothing
        is demanded if the store is only read.
        """
        if self.store.only_read():
            wanted = replace(stage, demands=())
        else:
            wanted = stage
        return BackgroundBake(self.baker, bake, wanted, viewer)

    def renderer(self, scene: str, fineness: int = 0) -> Renderer:
        """Return the renderer of a scene with texels finer by ``fineness`` steps, loaded if
        need be. Raises UnknownSceneError if the scene was dismissed.
        """
        return self._find(scene).level(fineness).renderer

    def bake_of(self, scene: str, view: View) -> str:
        """Return the name of the bake that a view of a scene reads."""
        return bake_name(scene, spec_name(view.shading))

    def trouble(self) -> str:
        """Return the reason why light will not be baked: the store is only read, there are no
        workers, or a chunk was given up. Empty if all is well.
        """
        if self.store.read_only:
            return READ_ONLY.format(store=self.store.url)
        return self.workers.missing or self.baker.trouble()

    def unready(self) -> list[str]:
        """Return the reasons why frames would not become final: none if all is well, or if the
        store is only read on purpose.
        """
        if self.store.read_only:
            return []
        why = self.trouble() or self.baker.paused() or self.workers.trouble
        return [why] if why else []

    def notes(self) -> list[str]:
        """Return sentences for a person that are no trouble: kernels are being compiled, or the
        store is only read.
        """
        only_read = self.trouble() if self.store.read_only else ""
        return [note for note in (self.kernels.compiling, only_read) if note]

    def close(self) -> None:
        """Stop checks, baking and workers, and drop all scenes. Chunks that were being baked
        are baked again when they are next wanted.
        """
        self._stopped.set()
        self._checks.close()
        self._idle.close()
        self.baker.stop()
        self.workers.close()
        self._loaded.close()
        self._tiles.close()
        self._checking.close()

    def _checked(self, scene: str, view: View, more: bool) -> None:
        """Tell listeners that a picture was checked one step further. If the check is over,
        trim the store, as light of walls is kept for each isovalue.
        """
        named = self.scenes.get(scene)
        if not more and named is not None and named.lighting.room.any:
            self._side_bakes.lit(scene, view.isovalue)
        for listener in self._listeners:
            listener(self.bake_of(scene, view), CHECK, more)

    def _coming(self, scene: str, frame: Frame, goal: Goal, watch: Stopwatch) -> bool:
        """Request the light that a frame lacks; return True if any of it will be baked."""
        with watch.stage("demand"):
            return bool(
                self.lacking(scene, frame)[1].demands
                and self.want(scene, frame, goal, GUEST_VIEWER) - {CHECK}
            )

    def _usual_goal(self, scene: str) -> Goal:
        """Return the goal of pictures without one: the scene's error. Raises as ``_find``."""
        return Goal.checked(self._find(scene).scene.target_error)

    def _find(self, scene: str) -> LoadedScene:
        """Return a scene, loaded if need be; a variant that was dismissed is made again. Raises
        StoreError, the errors of ``again``, and UnknownSceneError if the scene is gone, or is a
        variant of one that is gone.
        """
        named = self.scenes.get(scene) or self.again(scene)
        if named is not None:
            loaded = self._loaded.at(named)
            # Keep nothing in memory of a scene that was dismissed while it was loaded.
            if scene not in self.scenes:
                self._loaded.drop(scene)
            # Frames of a variant that was dismissed meanwhile are completed if its scene is there.
            if self.variant(scene).base in self.scenes:
                return loaded
        raise UnknownSceneError(f"The scene '{self.variant(scene).base}' is not shown any more.")

    def _load(self, scene: Scene) -> LoadedScene:
        """Load a scene and add its bakes to the baker. Raises StoreError."""
        # Share maps with a loaded scene of the same volume.
        same_volume = [name for name, each in self.scenes.items() if each.volume is scene.volume]
        sibling = next(filter(None, map(self._loaded.held, same_volume)), None)
        # Until a variant has light, that of the scene which it was cut from stands in, or that of a
        # similar variant.
        variant = self.variant(scene.id)
        stand_ins = [name for name in self.scenes if self.variant(name).may_stand_in_for(variant)]
        if variant.cut is not None:
            whole = self._loaded.held(variant.whole.id)
        else:
            whole = self._loaded.latest(stand_ins)
        loaded = load_scene_parts(
            scene,
            self.store,
            self._tiles,
            self._memory,
            share=self._share,
            sibling=sibling,
            whole=whole,
        )
        # Replace the bakes of this scene that have changed, and keep the others with their queues.
        # ``scenes`` is replaced, not changed, as other threads may iterate over it.
        make = partial(make_bake, loaded.renderer.caches, assets=loaded.assets, whole=loaded.whole)
        arrived = partial(self._arrived, scene.id, 0)
        bakes = [(bake_name(scene.id, spec), make(spec, arrived=arrived)) for spec in SPECS]
        with self._changing:
            if scene.id in self.scenes:
                new = {name: bake for name, bake in bakes if self._bakes.get(name) != bake.digest}
                self._bakes |= {name: bake.digest for name, bake in new.items()}
                for name, bake in new.items():
                    self.baker.add(name, bake)
                if bake_name(scene.id, "gi") in new:
                    self.baker.prepare(bake_name(scene.id, "gi"))
                self.scenes = {**self.scenes, scene.id: loaded.scene}
        return loaded

    def _arrived(
        self, scene: str, fineness: int, spec: str, index: Index, shown: Isovalue | None
    ) -> None:
        """Have a loaded scene read a chunk of its texels again: it has new light."""
        loaded = self._loaded.held(scene)
        level = None if loaded is None else loaded.held(fineness)
        if level is not None:
            level.renderer.caches.refresh(spec, index, shown)


def engine_for(scene: Scene, settings: Settings, with_workers: bool = True) -> RenderEngine:
    """Make an engine for a ``scene`` by a command's ``settings``. Nothing is loaded before it is
    started, with or without workers.

    If it will be started without workers, pass False for ``with_workers``. The engine then ignores
    the scheduler of the settings, so that it does not copy the scene's files to the store for
    workers of that scheduler.
    """
    scheduler = scheduler_of(settings) if with_workers else None
    memory = settings.memory_mb << 20
    projected = settings.projected_mb << 20
    return RenderEngine(
        [scene], root_of(settings), settings.workers, scheduler, memory, projected=projected
    )
