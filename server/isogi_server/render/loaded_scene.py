"""Loaded scenes: the renderer of each, and the scenes that are kept in memory."""

import gc
import logging
import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from isogi_core.allocation import give_memory_back
from isogi_core.bake.noise import Goal
from isogi_core.cache.scene_caches import Caches
from isogi_core.errors import NoRoomError
from isogi_core.frame.frame import Frame
from isogi_core.frame.rays.picture_plan import Prices
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.texel_shading import StandIn
from isogi_core.frame.tiles import Stopwatch, Tiles
from isogi_core.lru_cache import LruCache
from isogi_core.model.scene_plan import MAX_SAMPLES
from isogi_core.model.view import View
from isogi_core.plan.planner import complete
from isogi_core.plan.scene import Scene
from isogi_core.plan.variants import finer, has_finer
from isogi_core.plan.volumes.masks import voxels_left
from isogi_core.prepared.prepared_scene import PreparedScene
from isogi_core.storage.store import Store
from isogi_server.render.bakes import ShareAssets, share_nothing
from isogi_worker.tasks import Assets, Whole

log = logging.getLogger("isogi.render")

SCENE_BYTES = 1 << 20
"""Bytes that a loaded scene takes in addition to what it keeps: tables, pools and threads;
measured with a volume of a few voxels.
"""

FINER = 5
"""Factor by which a scene with finer texels has less memory: few views ask for it, and views
that find no room are shown without.
"""


class Memory(NamedTuple):
    """Bytes that a scene may keep of decoded ``light``, of ``views`` (G-buffers and texels of
    pixels) and of active-cell ``maps``.
    """

    light: int
    views: int
    maps: int

    @property
    def finer(self) -> "Memory":
        """Return the memory of the same scene with finer texels. Steps of 1/5 add up to at most
        a quarter more.
        """
        return Memory(self.light // FINER, self.views // FINER, self.maps)


def shared(total: int) -> Memory:
    """Split ``total`` bytes: half for light, and a quarter each for views and maps."""
    quarter = total // 4
    return Memory(total - 2 * quarter, quarter, quarter)


@dataclass(eq=False)
class LoadedScene:
    """A scene that is ready to be rendered.

    ``assets``, made by ``share``, are opened by workers in place of the scene's files. Its texels
    are finer than the scene file says by ``fineness`` steps; views whose control pixels ask for
    finer ones are drawn by ``finer``, which shares the ``tiles`` of this scene and has a smaller
    memory of its own. The scene may be cut from a ``whole``.
    """

    scene: Scene
    renderer: Renderer
    memory: Memory
    share: ShareAssets
    assets: Assets | None = None
    fineness: int = 0
    whole: Whole | None = None
    _finer: "LoadedScene | None" = None
    _lock: threading.Lock = field(default_factory=threading.Lock)

    @property
    def finer(self) -> "LoadedScene":
        """Return the scene with finer texels, loaded when first asked for. Raises StoreError."""
        with self._lock:
            if self._finer is None:
                # Voxels and maps are shared; texels, light and views have memory of their own.
                prepared = self.renderer.prepared.beside(finer(self.scene))
                memory = self.memory.finer
                caches = Caches(prepared, self.renderer.caches.store, memory.light)
                self._finer = loaded(
                    caches, self.renderer.tiles, memory, self.share, self.fineness + 1
                )
            return self._finer

    def level(self, fineness: int) -> "LoadedScene":
        """Return the scene with texels ``fineness`` steps finer than the scene file says,
        loaded if need be. Raises StoreError.
        """
        if fineness == self.fineness:
            return self
        return self.finer.level(fineness)

    def held(self, fineness: int) -> "LoadedScene | None":
        """Return the scene with texels ``fineness`` steps finer if it is loaded, else None."""
        if fineness == self.fineness:
            return self
        return self._finer and self._finer.held(fineness)

    def render(
        self, view: View, goal: Goal, cancelled: threading.Event | None, watch: Stopwatch
    ) -> Frame:
        """Return the frame of a view with the light baked so far. Raises as Renderer does.

        If the check of the picture asks for finer texels, the frame is drawn by them once all their
        light is there, or once control pixels have measured it. Until then it is drawn by the
        texels of this scene, and its ``quality.finer`` is the frame that is coming.
        """
        # A frame that asks for all samples measures these texels, not finer ones.
        if goal.samples < MAX_SAMPLES:
            coming = self._render_finer(view, goal, cancelled, watch)
        else:
            coming = None
        # A finer frame that was measured is also shown while its texels get more samples, although
        # it is provisional again then.
        if coming is not None and (coming.measured is not None or not coming.provisional):
            return coming
        frame = self.renderer.render(view, goal, cancelled, watch)
        # A frame that needs no change is returned as it is: what was computed of it stays.
        if coming is None and not self.fineness:
            return frame
        # The frame that is coming may itself wait for one of even finer texels.
        finest = None if coming is None else coming.quality.finer or coming
        return replace(frame, quality=replace(frame.quality, fineness=self.fineness, finer=finest))

    def _render_finer(
        self, view: View, goal: Goal, cancelled: threading.Event | None, watch: Stopwatch
    ) -> Frame | None:
        """Return the frame by finer texels; None if the view's picture does not ask for them,
        or if the memory cannot hold them.
        """
        if not self.renderer.surface.checks.asks_finer(view, goal):
            return None
        try:
            return self.finer.render(view, goal, cancelled, watch)
        except NoRoomError as error:
            log.info("a view is shown without finer texels: %s", error)
            self.renderer.surface.checks.decline_finer(view, goal)
            return None

    def check(self, view: View, goal: Goal, tiles: Tiles, prices: Prices) -> bool:
        """Take one step of the check of a view's picture; return False if there was none to
        take. Raises as Renderer does.
        """
        if self.renderer.surface.checks.asks_finer(view, goal):
            # Finer texels were chosen as they are cheaper than paths of pixels.
            return self.finer.check(view, goal, tiles, prices.of_texels)
        return self.renderer.refine(
            view, goal, tiles, prices if has_finer(self.scene) else prices.of_present
        )

    @property
    def nbytes(self) -> int:
        """Return the bytes that it takes, finer texels included."""
        return SCENE_BYTES + self.renderer.nbytes + (self._finer.nbytes if self._finer else 0)


def load_scene_parts(
    scene: Scene,
    store: Store,
    tiles: Tiles,
    memory: Memory,
    share: ShareAssets = share_nothing,
    sibling: LoadedScene | None = None,
    whole: LoadedScene | None = None,
) -> LoadedScene:
    """Prepare a scene and open its layers in a ``store``; workers open the assets that ``share``
    returns. Raises StoreError.

    ``sibling`` is a loaded scene of the same volume, whose maps it shares. The light of a ``whole``
    scene stands in for missing light of one that is cut from it, or of another time step.
    """
    if sibling:
        prepared = sibling.renderer.prepared.beside(scene)
    else:
        prepared = PreparedScene(scene, memory.maps)
    caches = Caches(prepared, store, memory.light)
    stand_in = cut_from = None
    # The stand-in serves the voxels that a cut leaves; all of them if the moment differs, for then
    # nothing is cut.
    if whole is not None:
        cut = None
        if scene.volume.moment == whole.scene.volume.moment:
            cut = scene.source.document.get("cut")
        if cut:
            left = voxels_left(whole.scene.volume, str(cut))
            cut_from = Whole(whole.scene.source, whole.assets)
        else:
            x, y, z = scene.volume.size
            left = (range(x), range(y), range(z))
        stand_in = StandIn(whole.renderer.caches, left)
    return loaded(
        caches,
        tiles,
        memory,
        share,
        stand_in=stand_in,
        whole=cut_from,
    )


def loaded(
    caches: Caches,
    tiles: Tiles,
    memory: Memory,
    share: ShareAssets,
    fineness: int = 0,
    stand_in: StandIn | None = None,
    whole: Whole | None = None,
) -> LoadedScene:
    """Open the layers of the scene of some ``caches``, and compute all that its first frame
    needs. Raises StoreError.
    """
    prepared = caches.prepared
    scene = caches.prepared.scene
    # Each of these is computed when it is first read: read them now, not in the first frame.
    (
        prepared.field,
        prepared.maps,
        scene.projection,
        scene.default_exposure,
        caches.chunk_store("gi"),
    )
    # A layer without light in the store gives way to a larger one (say, of a higher order) that has
    # light there, which need not be baked. The plan is to show the layers that are in use.
    planned = replace(
        scene, plan=complete(caches.spec("gi").plan, scene.inputs, scene.settings.overrides)
    )
    renderer = Renderer(caches, tiles, memory.views, stand_in=stand_in)
    assets = share(prepared)
    return LoadedScene(planned, renderer, memory, share, assets, fineness, whole)


IDLE_SCENE_SECONDS = 900.0
"""Seconds without a frame after which a scene is dropped."""

TIDY_SECONDS = 30.0
"""Seconds between two runs that drop idle scenes and collect garbage; a run takes 0.07 s under
64 clients.
"""


class LoadedScenes:
    """The scenes in memory, up to a number of bytes together; the ones used last are kept. Safe to
    use from many threads.

    A scene that is dropped while a frame of it is drawn is drawn to the end.
    """

    def __init__(
        self,
        load: Callable[[Scene], LoadedScene],
        most: int,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Load scenes by ``load`` when they are asked for. All together keep ``most`` bytes;
        one alone may keep more.
        """
        self._load = load
        self._clock = clock
        self._kept: LruCache[str] = LruCache(most)
        self._looked: dict[str, float] = {}
        self._lock = threading.Lock()

    def at(self, scene: Scene) -> LoadedScene:
        """Return a scene, loaded if it is not yet. Raises StoreError."""
        loaded: LoadedScene = self._kept.get(scene.id, lambda: self._load(scene))
        with self._lock:
            self._looked[scene.id] = self._clock()
        return loaded

    def held(self, scene: str) -> LoadedScene | None:
        """Return a scene if it is loaded, else None."""
        return self._kept.held(scene)

    def latest(self, scenes: Iterable[str]) -> LoadedScene | None:
        """Return the one of some ``scenes`` that was used last, if any is loaded."""
        with self._lock:
            looked = [scene for scene in scenes if scene in self._looked]
            last = max(looked, key=self._looked.__getitem__, default=None)
        return None if last is None else self.held(last)

    @property
    def looked(self) -> float:
        """Return the time of the last use of any scene; 0 if none was used."""
        with self._lock:
            return max(self._looked.values(), default=0.0)

    def settle(self) -> None:
        """Drop the scenes used longest ago until the rest fits: scenes grow as frames of them
        are drawn.
        """
        if len(self._looked) > 1:
            self._kept.settle()
            self._note()

    def drop_idle(self) -> None:
        """Drop scenes that have not been used for IDLE_SCENE_SECONDS, and give their memory
        back to the system.
        """
        idle = [
            scene
            for scene, looked in list(self._looked.items())
            if self._clock() - looked > IDLE_SCENE_SECONDS
        ]
        for scene in idle:
            self.drop(scene)
        # Freed memory stays with the allocator otherwise.
        if idle:
            give_memory_back()

    def tidy(self, stopped: threading.Event) -> None:
        """Drop idle scenes, and collect garbage if frames were drawn, every TIDY_SECONDS until
        ``stopped`` is set.
        """
        looked = 0.0
        while not stopped.wait(TIDY_SECONDS):
            self.drop_idle()
            # Errors hold large arrays in reference cycles, which only the garbage collector frees.
            if looked != (looked := self.looked):
                gc.collect()
                give_memory_back()

    def drop(self, scene: str) -> None:
        """Drop a scene if it is loaded."""
        self._kept.drop(scene)
        self._note()

    def close(self) -> None:
        """Drop all scenes."""
        for scene in list(self._looked):
            self.drop(scene)

    def _note(self) -> None:
        """Forget the times of use of scenes that are not loaded any more."""
        with self._lock:
            self._looked = {
                scene: at
                for scene, at in self._looked.items()
                if self._kept.held(scene) is not None
            }
