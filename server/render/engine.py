"""The render engine: loaded scenes, one set of workers, and frames of any scene."""

import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Hashable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial

from isogi_core.bake.bake_spec import SPECS, spec_name
from isogi_core.bake.texel_light import FIRST_LEVEL
from isogi_core.cache.chunk_store import default_store
from isogi_core.cache.costs import Cost
from isogi_core.errors import StoreFullError, StoreReadOnlyError
from isogi_core.frame.frame import Frame
from isogi_core.frame.gbuffer import surface_key
from isogi_core.frame.rays.picture_plan import AWAITED, HEAVIER, Prices
from isogi_core.frame.renderer import Renderer, unlit_frame
from isogi_core.frame.texel_reading import Stage
from isogi_core.frame.tiles import Stopwatch, Tiles
from isogi_core.frame.view_checks import PathsLeft, ViewChecks
from isogi_core.model.view import View
from isogi_core.model.volume import Isovalue
from isogi_core.plan.scene import Scene
from isogi_core.prepared.prepared_scene import Index
from isogi_core.prepared.shared_scenes import SharedScenes
from isogi_core.storage.backend import StoreUrl
from isogi_core.storage.store import Store, StoreLike
from server.errors import UnknownSceneError
from server.render.bakes import (
    BACKGROUND_VIEWER,
    CHECK,
    BackgroundBake,
    PictureChecks,
    SideBakes,
    bake_name,
    lend_by_store,
    make_bake,
)
from server.render.loaded_scene import LoadedScene, LoadedScenes, load_scene_parts
from server.render.scene_variant import SceneVariant
from server.render.workforce import (
    SceneKernels,
    Workforce,
    root_of,
    scheduler_of,
    shared,
    whereabouts,
)
from server.settings import Settings
from worker.bake_requests import GUEST_VIEWER, Viewer
from worker.baker import Baker, Listener
from worker.progress import (
    ASSUMED_WORK_RATIOS,
    UNREHEARSED_SPREAD,
    Promises,
    TimeEstimator,
    TimeLeft,
    log_normal_ratios,
)

NOTHING_LEFT = PathsLeft()


@dataclass(frozen=True, eq=False)
class Unfinished:
    """What a picture lacks, without the picture itself: megabytes, which nobody needs for the time
    that it takes.

    It is of a ``view`` of a ``scene`` that was asked for with a ``max_error``, and is to reach a
    ``target``. It lacks ``chunks`` of a ``bake``, and ``later`` stages, and has ``read`` chunks of
    texels finer by ``fineness`` steps, None where it reads none. Its pixels are ``foreseen`` to
    take paths until something measures it, and it was drawn in so many ``seconds``, by stage.
    """

    scene: str
    view: View
    max_error: float | None
    target: float
    final: bool
    refinable: bool
    seconds: Mapping[str, float]
    bake: str = ""
    chunks: tuple[Index, ...] = ()
    later: tuple[Stage, ...] = ()
    read: tuple[Index, ...] | None = None
    fineness: int = 0
    foreseen: PathsLeft = NOTHING_LEFT


WAITING_STAGES = ("queue", "bake", "check", "demand")
"""Stages of a frame in which it is not drawn."""


def time_of_paths(
    left: PathsLeft, spent: Cost, threads: int, drawing: Mapping[str, float]
) -> TimeLeft:
    """The time for the paths that are ``left``, on so many ``threads``, and for ``drawing`` by its
    stages' seconds.

    Before the first path of a pixel one takes a share of a texel's, for all of which so much was
    ``spent``.
    """
    each = spent.seconds / max(spent.paths, 1) / threads
    once = sum(seconds for stage, seconds in drawing.items() if stage not in WAITING_STAGES)
    work = left.texels * each + left.pixels * (left.pace or each / HEAVIER) + left.times * once
    return TimeLeft.of(
        work, ASSUMED_WORK_RATIOS if left.pace is None else log_normal_ratios(UNREHEARSED_SPREAD)
    )


REMEMBERED = 4096
"""Variants whose change is known after they made way: those made last."""

READ_ONLY = (
    "The store at {store} can only be read: what is baked there is shown, and nothing "
    "more is baked."
)

SCENES_MEMORY_BYTES = 1 << 30
"""Bytes of light, views and maps that all scenes together may keep in memory."""

PROJECTED_TEXEL_BYTES = 4 << 30
"""Bytes of projected texels that a store may keep."""


class RenderEngine:
    """Renders frames of its scenes and has a ``baker`` bake what they lack. Safe to use from many
    threads.
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
        """Take on ``scenes``; ``store`` is a folder, URL or root for light, ``scheduler`` a cluster
        to join.

        ``baker`` bakes the light, one for so many workers by default; the store may keep so many
        bytes of ``projected`` texels.
        """
        self.scenes = {scene.id: scene for scene in scenes}
        if isinstance(store, Store):
            self.store = store
        else:
            self.store = Store(whereabouts(StoreUrl.of(store or default_store())))
        self._memory = shared(memory)
        self._loaded = LoadedScenes(self._load, memory)
        self._bakes: dict[str, str] = {}
        self._variants: OrderedDict[str, SceneVariant] = OrderedDict()
        self._changing = threading.RLock()
        self._tiles = Tiles()
        self.baker = baker or Baker(workers=None if scheduler else workers)
        self.workforce = Workforce(self.baker, self.store.url, workers, scheduler)
        if self.workforce.joins:
            self._lend = lend_by_store(self.store)
        else:
            self._lend = SharedScenes().share
        self._beside = SideBakes(self.baker, self.store, projected)
        self._checks = PictureChecks(self.check, self._checked)
        self._checking = Tiles()
        self._promises = Promises()
        self._estimator = TimeEstimator()
        self._estimating = threading.Lock()
        self._listeners: list[Listener] = []
        self.again: Callable[[str], Scene | None] = lambda _: None
        self._stopped = threading.Event()
        self.kernels = SceneKernels(lambda: list(self.scenes.values()), self._stopped)

    def start(self, hire: bool = True) -> None:
        """``open`` the engine, and have all that pictures with ``light`` call. Raises
        StoreError.
        """
        self.open(hire)
        self.light(hire)

    def open(self, hire: bool = True) -> None:
        """Open stores and scenes: pictures without light can be drawn then. Raises StoreError.

        Workers to ``hire`` come meanwhile, or after kernels are compiled; without them nothing is
        baked.
        """
        self.workforce.late = self.kernels.progress is not None
        if hire and not self.workforce.late:
            self.hire()
        self.kernels.first()
        if self._stopped.is_set():
            return
        with suppress(StoreReadOnlyError, StoreFullError):
            self.store.check_writable()
        for scene in list(self.scenes.values()):
            self._loaded.at(scene)
        threading.Thread(
            target=self._loaded.tidy, args=[self._stopped], name="tidying", daemon=True
        ).start()

    def light(self, hire: bool = True) -> None:
        """Have kernels of light here, compiled while pictures without light are drawn; then workers
        to ``hire``.
        """
        self.kernels.light()
        if hire and not self._stopped.is_set():
            self.hire()

    def stop(self) -> None:
        """Have ``start``, if it is at work in another thread, return without an engine that can be
        used.
        """
        self._stopped.set()

    def hire(self) -> None:
        """Have the workers come, beside whatever else there is to do."""
        self.workforce.hire(self.kernels.kinds)

    def admit(self, scene: Scene, variant: SceneVariant | None = None) -> None:
        """Show one more scene, or a ``variant`` of one, once the engine has started; it is loaded
        when it is first looked at.
        """
        self.kernels.admit(scene)
        with self._changing:
            if variant is not None:
                self._variants[scene.id] = variant
                self._variants.move_to_end(scene.id)
            while len(self._variants) > REMEMBERED:
                self._variants.popitem(last=False)
            self.scenes = {**self.scenes, scene.id: scene}

    def variant(self, scene: str) -> SceneVariant:
        """Which variant a scene is; one without changes where it is none."""
        return self._variants.get(scene) or SceneVariant(scene)

    @property
    def own_scenes(self) -> list[Scene]:
        """The scenes that are no variants."""
        return [each for each in self.scenes.values() if each.id not in self._variants]

    def planned(self, scene: str) -> Scene:
        """A scene with the plan of the light that its store has. Raises StoreError and
        UnknownSceneError.
        """
        return self._find(scene).scene

    def dismiss(self, scene: str) -> None:
        """Show a scene no more, nor its variants: frames that are drawn come to their end, and
        nothing more is baked.

        Their light stays in the store.
        """
        for each in [
            scene,
            *(name for name in self.scenes if name != scene and self.variant(name).base == scene),
        ]:
            self._dismiss(each)

    def _dismiss(self, scene: str) -> None:
        """Show one scene no more."""
        with self._changing:
            self.scenes = {name: each for name, each in self.scenes.items() if name != scene}
            known = [
                bake for spec in SPECS if self._bakes.pop(bake := bake_name(scene, spec), None)
            ]
        for bake in known:
            self.baker.forget(bake)
        self._beside.forget(scene)
        self._loaded.drop(scene)

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
        """The frame of a view with the light baked so far, after at most ``wait`` seconds of baking
        more.

        ``max_error`` is the relative error at which light is final, the scene's target by default;
        ``watch`` takes the time of all stages. Raises ViewError, StoreError, and Cancelled once
        ``cancelled`` is set.
        """
        watch = watch or Stopwatch()
        deadline = time.monotonic() + wait
        target = max_error or self._find(scene).scene.target_error
        frame = self.survey(scene, view, target, cancelled, watch)
        while frame.checkable or self._coming(scene, frame, target, watch):
            if (left := deadline - time.monotonic()) <= 0.0:
                break
            with watch.stage("check" if frame.checkable else "bake"):
                if frame.checkable:
                    self.check(scene, view, target, cancelled)
                else:
                    bake, stage = self.lacking(scene, frame)
                    self.baker.wait(bake, [demand.index for demand in stage.demands], left)
            frame = self.survey(scene, view, target, cancelled, watch)
        return frame

    def survey(
        self,
        scene: str,
        view: View,
        target: float,
        cancelled: threading.Event | None = None,
        watch: Stopwatch | None = None,
        enough: int = FIRST_LEVEL,
    ) -> Frame:
        """The frame of a view with the light baked so far; none that it lacks is requested: see
        ``Renderer.render``.

        Raises as ``frame`` does, and UnknownSceneError where the scene was dismissed.
        """
        try:
            return self._find(scene).render(view, target, cancelled, watch or Stopwatch(), enough)
        finally:
            self._loaded.settle()

    def unlit_frame(
        self, scene: str, view: View, target: float, cancelled: threading.Event
    ) -> Frame | None:
        """The frame of a new view with none of its light, before it is drawn; see
        ``frame.unlit_view``.
        """
        return unlit_frame(self._find(scene).renderer, view, target, cancelled)

    def sees(self, scene: str, view: View) -> bool:
        """Whether what the rays of a view met is kept, so that its picture casts none."""
        loaded = self._loaded.held(scene)
        return loaded is not None and loaded.renderer.sees(view)

    def check(
        self,
        scene: str,
        view: View,
        target: float,
        cancelled: threading.Event | None = None,
        prices: Prices = AWAITED,
        over: threading.Event | None = None,
    ) -> bool:
        """Check a picture, one step further; whether there was one to take. Raises as ``frame``
        does, and Cancelled once time is ``over``, too.
        """
        tiles = self._checking
        for event in filter(None, (cancelled, over)):
            tiles = tiles.cancelled_by(event)
        return self._find(scene).check(view, target, tiles, prices)

    def want(self, scene: str, frame: Frame, target: float, viewer: Viewer) -> frozenset[Index]:
        """Request the light that a ``frame`` lacks, for a ``viewer``; the chunks that are going to
        be baked.

        The picture of one that lacks none is checked, and walls that lag are lit beside texels:
        CHECK stands for both.
        """
        beside = frozenset({CHECK} if frame.refinable else ())
        if beside:
            self._checks.request(scene, frame.view, target, viewer)
        else:
            self._checks.leave(viewer)
        if frame.checkable or self.store.only_read():
            return beside
        self._find(scene)
        bake, stage = self.lacking(scene, frame)
        return beside | self.baker.request(bake, stage.demands, stage.target, viewer, stage.enough)

    def lacking(self, scene: str, frame: Frame) -> tuple[str, Stage]:
        """The bake that a ``frame`` lacks light of next, and what of it: see ``Frame.stages``.

        Of one in whose place a finer one is coming, what that lacks. A path-traced frame lacks
        none, however far it is from its target.
        """
        frame = frame.quality.finer or frame
        stage = next(iter(frame.stages), Stage((), self.planned(scene).target_error))
        return self.bake_at(
            scene, spec_name(frame.view.shading), stage, frame.quality.fineness
        ), stage

    def bake_at(self, scene: str, spec: str, stage: Stage, fineness: int = 0) -> str:
        """The name of the bake, by a ``spec``, that a ``stage`` is of, with texels finer by
        ``fineness`` steps.
        """
        if stage.caches is not None and scene in self.scenes:
            return self._beside.side(scene, spec, stage, self._lend)
        if scene not in self.scenes or (stage.shown is None and not fineness):
            return bake_name(scene, spec)
        loaded = self._find(scene).level(fineness)
        arrived = partial(self._arrived, scene, fineness)
        make = partial(make_bake, loaded.renderer.caches, "gi", loaded.assets, arrived, stage.shown)
        return self._beside.name(scene, stage.shown, fineness, make)

    def unfinished(self, scene: str, frame: Frame, max_error: float | None = None) -> Unfinished:
        """What a ``frame`` still lacks until it reaches an error, its scene's target by default."""
        target = max_error or self._find(scene).scene.target_error
        picture = (scene, frame.view, max_error, target)
        lacks = Unfinished(*picture, frame.final, frame.refinable, frame.seconds)
        if frame.final:
            return lacks
        bake, stage = self.lacking(scene, frame)
        lacking = frame.quality.lacking
        return replace(
            lacks,
            bake=bake,
            chunks=tuple(demand.index for demand in stage.demands),
            later=(frame.quality.finer or frame).stages[1:],
            read=lacking.texels.chunks if lacking else None,
            fineness=frame.quality.fineness,
            foreseen=ViewChecks.foreseen(frame, target),
        )

    def waiting(self, lacks: Unfinished, viewer: Viewer) -> int:
        """How many chunks that a picture ``lacks`` are still to be baked; what the ``viewer`` wants
        stays wanted.
        """
        return self.baker.open(lacks.bake, list(lacks.chunks), viewer)

    def leave(self, viewer: Viewer) -> None:
        """Have nothing more baked, and no picture checked, for a ``viewer`` that has gone."""
        self._checks.leave(viewer)
        self.baker.leave(viewer)

    def listen(self, listener: Listener) -> None:
        """Call ``listener`` for every chunk of a bake that has new light, or whose task failed; see
        ``bake_of``.

        Projected and finer texels are reported as the scene's own, and the check of a picture as
        CHECK.
        """
        self._listeners.append(listener)
        self.baker.listen(lambda bake, index, more: listener(self._beside.scene(bake), index, more))

    def time_left(
        self, scene: str, frame: Frame, max_error: float | None = None
    ) -> TimeLeft | None:
        """Seconds until the view of a ``frame`` is final; None where that is unknown, nothing more
        is done for it, or no worker is at it.
        """
        return self.time_without(self.unfinished(scene, frame, max_error))

    def time_without(self, lacks: Unfinished) -> TimeLeft | None:
        """Seconds until a picture has what it ``lacks``; None as ``time_left`` says."""
        picture = (lacks.scene, lacks.view, lacks.max_error)
        if lacks.final:
            with self._estimating:
                self._estimator.end(picture, time.monotonic())
            return TimeLeft(0.0, 0.0, 0.0)
        if not (lacks.chunks or lacks.refinable):
            return None
        subject = (lacks.scene, surface_key(lacks.view), lacks.target)
        baking = self.baker.time_left(lacks.bake, subject, list(lacks.chunks), lacks.later)
        if baking is None:
            return None
        checks = self._find(lacks.scene).level(lacks.fineness).renderer.checks
        left = checks.known_left(lacks.view, lacks.target) or lacks.foreseen
        if lacks.read is not None:
            spent = self.baker.spent(lacks.bake, lacks.read)
            baking = baking.plus(time_of_paths(left, spent, self._checking.threads, lacks.seconds))
        if baking.high > 0.0:
            return self._promises.kept(picture, self._learnt(picture, baking))
        return None

    def _learnt(self, picture: Hashable, left: TimeLeft) -> TimeLeft:
        """An estimate of what is ``left`` of a ``picture``, corrected by how those of other
        pictures came true: which steps are still to come is not known beforehand.
        """
        with self._estimating:
            learnt = self._estimator.estimate(picture, left.likely, time.monotonic())
        if left.likely > 0.0:
            return left.scaled_to(learnt.likely)
        return left

    def bake(self, bake: str, stage: Stage, viewer: Viewer = BACKGROUND_VIEWER) -> BackgroundBake:
        """Have what a ``stage`` demands of a ``bake`` baked for a ``viewer``; nothing where the
        store is only read.
        """
        if self.store.only_read():
            wanted = replace(stage, demands=())
        else:
            wanted = stage
        return BackgroundBake(self.baker, bake, wanted, viewer)

    def renderer(self, scene: str, fineness: int = 0) -> Renderer:
        """The renderer of a scene, its texels finer by ``fineness`` steps; UnknownSceneError where
        it was dismissed.
        """
        return self._find(scene).level(fineness).renderer

    def bake_of(self, scene: str, view: View) -> str:
        """The name of the bake that a view of a scene reads."""
        return bake_name(scene, spec_name(view.shading))

    def trouble(self) -> str:
        """Why light will not be baked: the store is only read, there are no workers, or a chunk was
        given up.

        Empty when all is well.
        """
        if self.store.read_only:
            return READ_ONLY.format(store=self.store.url)
        return self.workforce.missing or self.baker.trouble()

    def unready(self) -> list[str]:
        """Reasons why frames would not become final; none when all is well, or nothing is baked on
        purpose.
        """
        if self.store.read_only:
            return []
        why = self.trouble() or self.baker.paused() or self.workforce.trouble
        return [why] if why else []

    def notes(self) -> list[str]:
        """What a person should know though all goes as it should: what is compiled, or that the
        store is only read.
        """
        return [
            note
            for note in (self.kernels.compiling, self.trouble() if self.store.read_only else "")
            if note
        ]

    def close(self) -> None:
        """Stop the workers; what they were at is baked again when it is next wanted."""
        self._stopped.set()
        self._checks.close()
        self.baker.stop()
        self.workforce.close()
        self._loaded.close()
        self._tiles.close()
        self._checking.close()

    def _checked(self, scene: str, view: View, more: bool) -> None:
        """Say that a picture was checked one step further; what walls keep for its isovalue may be
        too much.
        """
        named = self.scenes.get(scene)
        if not more and named is not None and named.lighting.room.any:
            self._beside.lit(scene, view.isovalue)
        for listener in self._listeners:
            listener(self.bake_of(scene, view), CHECK, more)

    def _coming(self, scene: str, frame: Frame, target: float, watch: Stopwatch) -> bool:
        """Request the light that a frame lacks; whether any of it is going to be baked."""
        with watch.stage("demand"):
            return bool(
                self.lacking(scene, frame)[1].demands
                and self.want(scene, frame, target, GUEST_VIEWER) - {CHECK}
            )

    def _find(self, scene: str) -> LoadedScene:
        """A scene, loaded if need be; a variant that made way, ``again``. Raises StoreError,
        UnknownSceneError.
        """
        named = self.scenes.get(scene) or self.again(scene)
        if named is not None:
            loaded = self._loaded.at(named)
            if scene not in self.scenes:
                self._loaded.drop(scene)
            if (
                self.variant(scene).base in self.scenes
            ):  # a variant that made way meanwhile is drawn to its end
                return loaded
        raise UnknownSceneError(f"The scene '{self.variant(scene).base}' is not shown any more.")

    def _load(self, scene: Scene) -> LoadedScene:
        """Load a scene; the former scenes may be iterated over meanwhile. Raises StoreError."""
        kin = [name for name, each in self.scenes.items() if each.volume is scene.volume]
        beside = next(filter(None, map(self._loaded.held, kin)), None)
        variant = self.variant(scene.id)
        lenders = [name for name in self.scenes if self.variant(name).may_lend(variant)]
        if variant.cut is not None:
            whole = self._loaded.held(variant.whole.id)
        else:
            whole = self._loaded.latest(lenders)
        loaded = load_scene_parts(
            scene,
            self.store,
            self._tiles,
            self._memory,
            lend=self._lend,
            beside=beside,
            whole=whole,
        )
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
        """Have a scene, where it is loaded, read a chunk of its texels again: it has new light."""
        if (loaded := self._loaded.held(scene)) is not None and (
            level := loaded.held(fineness)
        ) is not None:
            level.renderer.caches.refresh(spec, index, shown)


def engine_for(scene: Scene, settings: Settings, hire: bool = True) -> RenderEngine:
    """An engine of a ``scene`` under a command's settings; it joins a cluster only where it is to
    ``hire`` workers.
    """
    scheduler = scheduler_of(settings) if hire else None
    memory = settings.memory_mb << 20
    projected = settings.projected_mb << 20
    return RenderEngine(
        [scene], root_of(settings), settings.workers, scheduler, memory, projected=projected
    )
