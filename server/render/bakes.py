"""Bakes of a scene as the workers know them, bakes of other texels and sides, background bakes, and patience."""

import threading
import time
import weakref
from collections import OrderedDict
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any

from isogi_core.bake.bake_spec import SPECS
from isogi_core.cache.costs import Costs
from isogi_core.cache.scene_assets import SceneAssets, send_assets
from isogi_core.cache.scene_caches import Caches
from isogi_core.cache.upkeep.prune import trim_projected
from isogi_core.errors import StoreFullError, StoreReadOnlyError
from isogi_core.frame.texel_reading import Stage
from isogi_core.model.volume import Isovalue
from isogi_core.plan.scene import Scene
from isogi_core.prepared.prepared_scene import Index
from isogi_core.storage.store import Store
from worker.bake_requests import Viewer
from worker.baker import Bake, Baker
from worker.errors import WorkersError
from worker.keeping import Whole
from worker.progress import TimeLeft


def bake_name(scene: str, spec: str) -> str:
    """The name of a scene's bake by a spec, among all bakes; the scene's own name for the scene's own spec."""
    return scene if spec == "gi" else f"{scene} ({spec})"


def sent(scene: Scene, store: Store) -> SceneAssets | None:
    """What joined workers read in place of the scene's files; None where the store takes nothing."""
    with suppress(StoreReadOnlyError, StoreFullError):
        return send_assets(scene, store)
    return None


Arrived = Callable[[str, Index, Isovalue | None], None]


def make_bake(
    caches: Caches,
    name: str,
    assets: SceneAssets | None,
    arrived: Arrived,
    shown: Isovalue | None = None,
    whole: Whole | None = None,
) -> Bake:
    """The bake of a spec, by its name; workers that were joined, and lack the scene's files, read the ``assets``.

    Of texels projected onto an isosurface where one is ``shown``, and of a scene that may be cut from a ``whole``.
    Nothing of the ``caches`` is kept: ``arrived`` is called with the spec's name, a chunk that has new light, and the
    isosurface.
    """
    spec, store = replace(caches.spec(name), shown=shown), caches.store
    scene, plan = spec.prepared.scene, replace(spec.plan, left_out=(), notes=())
    layers = frozenset(scene.layer_digest(layer, shown) for layer in plan.layers)
    costs = Costs(store, spec.digest)
    costs.read()
    note = partial(note_light, arrived, name, shown)
    return Bake(scene.source, plan, spec.digest, layers, store.url, note, costs, assets, shown, whole)


def note_light(arrived: Arrived, name: str, shown: Isovalue | None, index: Index) -> None:
    """Tell that a chunk of a bake has new light."""
    arrived(name, index, shown)


BACKGROUND_VIEWER = Viewer("background", patient=True)
"""Background bakes yield to people who wait for a frame."""


class BackgroundBake:
    """Light that is baked while no frame waits: what a ``stage`` demands of one ``bake``, by its name."""

    def __init__(self, baker: Baker, bake: str, stage: Stage, viewer: Viewer = BACKGROUND_VIEWER) -> None:
        """Request it from the ``baker``, for a ``viewer``; ``coming`` are the chunks that were not given up before."""
        self._baker, self._viewer = baker, viewer
        self.bake, self.chunks = bake, [demand.index for demand in stage.demands]
        self.coming = baker.request(bake, stage.demands, stage.target, viewer, stage.enough)

    def waiting(self) -> int:
        """How many of its ``chunks`` are neither baked nor given up. Asked now and then, it stays wanted."""
        return self._baker.open(self.bake, self.chunks, self._viewer)

    def failures(self) -> dict[Index, str]:
        """Why those of its chunks that were given up were."""
        return self._baker.failures(self.bake, self.chunks)

    def wait(self, seconds: float) -> None:
        """Block until all of it is baked or given up, at most ``seconds``."""
        self._baker.wait(self.bake, self.chunks, seconds)

    def time_left(self) -> TimeLeft | None:
        """Seconds until all of it is baked; None where that is unknown."""
        return self._baker.time_left(self.bake, self._viewer, self.chunks)


MAX_BAKES = 32
"""Bakes of projected or finer texels, and of sides, of all scenes, that may be at work: those asked for last."""


class SideBakes:
    """The bakes of projected or finer texels, and of surfaces' sides, that a ``baker`` knows. Safe to use from many
    threads.
    """

    def __init__(self, baker: Baker, store: Store, most: int) -> None:
        """None yet. When one is added, a thread trims the ``store`` to ``most`` bytes of projected texels."""
        self._baker, self._store, self._most = baker, store, most
        self._names: OrderedDict[str, str] = OrderedDict()
        self._readers = weakref.WeakValueDictionary[str, Caches]()
        self._lit: set[tuple[str, float]] = set()
        self._lock = threading.Lock()
        self._trimming = threading.Lock()
        self._trimmer: threading.Thread | None = None

    def name(self, scene: str, shown: Isovalue | None, fineness: int, make: Callable[[], Bake]) -> str:
        """The name of a bake of a scene's texels, made where it is new.

        They are finer than its own by ``fineness`` steps, and projected onto the isosurface ``shown``, where one is.
        """
        return self._named(f"{scene} (texels finer by {fineness}, projected at {shown!r})", scene, shown, make)

    def side(self, scene: str, spec: str, stage: Stage, send: bool) -> str:
        """The name of the bake of a ``stage``, by a ``spec``, of one of the sides of a scene's surfaces; made where it
        is new. Its assets are put into the store where they are to be ``sent``. The caches that asked last are told of
        its light: those before them may have been let go.
        """
        if stage.caches is None:
            raise ValueError("A stage of the scene's own light has a bake already.")
        caches, own = stage.caches, stage.caches.prepared.scene
        name = f"{scene} (light {caches.spec(spec).digest}, projected at {stage.shown!r})"
        self._readers[name] = caches

        def arrived(spec: str, index: Index, shown: Isovalue | None) -> None:
            if (held := self._readers.get(name)) is not None:
                held.refresh(spec, index, shown)

        def make() -> Bake:
            return make_bake(caches, spec, sent(own, self._store) if send else None, arrived, stage.shown)

        return self._named(name, bake_name(scene, spec), stage.shown, make)

    def _named(self, name: str, own: str, shown: Isovalue | None, make: Callable[[], Bake]) -> str:
        """Add the bake of this ``name`` where it is new; views read the bake ``own`` besides."""
        with self._lock:
            new = name not in self._names
            if new:
                self._baker.add(name, make())
            self._names[name] = own
            self._names.move_to_end(name)
            old = [self._names.popitem(last=False)[0] for _ in range(len(self._names) - MAX_BAKES)]
        for each in old:
            self._baker.forget(each)
        if new and shown is not None:
            self._trim()
        return name

    def lit(self, scene: str, isovalue: float) -> None:
        """Note that the walls of a scene have light for an isovalue."""
        if (scene, isovalue) not in self._lit:
            self._lit.add((scene, isovalue))
            self._trim()

    def _trim(self) -> None:
        """Have a thread trim the store: there is light for one isovalue more."""
        self._trimmer = threading.Thread(target=self._trim_once, name="trimming", daemon=True)
        self._trimmer.start()

    def settle(self) -> None:
        """Returns when nothing is being trimmed."""
        if self._trimmer is not None:
            self._trimmer.join()

    def scene(self, bake: str) -> str:
        """The name of the bake that views read besides one of projected or finer texels; any other is its own."""
        return self._names.get(bake, bake)

    def forget(self, scene: str) -> None:
        """Bake no more projected or finer texels of a scene."""
        with self._lock:
            every = {bake_name(scene, spec) for spec in SPECS}
            gone = [name for name, own in self._names.items() if own in every]
            for name in gone:
                del self._names[name]
        for name in gone:
            self._baker.forget(name)

    def _trim_once(self) -> None:
        """Trim, unless that is being done."""
        if self._trimming.acquire(blocking=False):
            try:
                trim_projected(self._store, self._most)
            finally:
                self._trimming.release()


STALLED_SECONDS = 120.0
"""Seconds without anything new after which the workers are taken for broken."""


class Patience:
    """How long to wait for light: so many ``seconds`` without anything new, while workers can bake."""

    def __init__(self, seconds: float = STALLED_SECONDS, clock: Callable[[], float] = time.monotonic) -> None:
        """Begin now."""
        self._seconds, self._clock = seconds, clock
        self._since, self._seen = clock(), None

    def check(self, progress: Any, preparing: str, reasons: Iterable[str]) -> None:
        """Go on where ``progress`` is another value than before, or workers are ``preparing``: they start or compile.

        Raises WorkersError, with the ``reasons`` that are known, once the patience has ended.
        """
        now = self._clock()
        if preparing or progress != self._seen:
            self._since, self._seen = now, progress
        elif now - self._since > self._seconds:
            why = " ".join(reasons) or "The workers bake nothing new."
            raise WorkersError(f"No light came for {self._seconds:g} seconds. {why}")
