"""Bakes of a scene as the workers know them, bakes of other texels and sides, background bakes."""

from __future__ import annotations

import threading
import weakref
from collections import OrderedDict
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace

from isogi_core.bake.bake_spec import SPECS
from isogi_core.cache.costs import Costs
from isogi_core.cache.fresh_light import fresh_light
from isogi_core.cache.scene_assets import SceneAssets, send_assets
from isogi_core.cache.scene_caches import Caches
from isogi_core.cache.upkeep import trim_projected
from isogi_core.errors import StoreFullError, StoreReadOnlyError
from isogi_core.frame.texel_reading import Stage
from isogi_core.model.volume import Isovalue
from isogi_core.prepared.prepared_scene import Index, PreparedScene
from isogi_core.storage.store import Store
from worker.bake_requests import Viewer
from worker.baker import Bake, Baker
from worker.progress import TimeLeft
from worker.tasks import Assets, Whole


def bake_name(scene: str, spec: str) -> str:
    """The name of a scene's bake by a spec, among all bakes; the scene's own name for the scene's
    own spec.
    """
    if spec == "gi":
        return scene
    return f"{scene} ({spec})"


ShareAssets = Callable[[PreparedScene], Assets | None]
"""Gives what workers open in place of a scene's files; None if they read these."""


def share_nothing(prepared: PreparedScene) -> None:
    """Have workers read the scene's files."""


def share_by_store(store: Store) -> ShareAssets:
    """Have joined workers read copies of the scene's files in the ``store``, unless it takes
    nothing.
    """

    def sent(prepared: PreparedScene) -> SceneAssets | None:
        with suppress(StoreReadOnlyError, StoreFullError):
            return send_assets(prepared.scene, store)
        return None

    return sent


Arrived = Callable[[str, Index, Isovalue | None], None]


def make_bake(
    caches: Caches,
    name: str,
    assets: Assets | None,
    arrived: Arrived,
    shown: Isovalue | None = None,
    whole: Whole | None = None,
) -> Bake:
    """The bake of a spec, by its name; workers open the ``assets`` in place of the scene's files.

    Of texels projected onto an isosurface where one is ``shown``, and of a scene that may be cut
    from a ``whole``. Nothing of the ``caches`` is kept: ``arrived`` is called with the spec's name,
    a chunk that has new light, and the isosurface.
    """
    spec = replace(caches.spec(name), shown=shown)
    store = caches.store
    scene = spec.prepared.scene
    plan = replace(spec.plan, left_out=(), notes=())
    layers = frozenset(scene.layer_digest(layer, shown) for layer in plan.layers)
    costs = Costs(store, spec.digest)
    costs.read()

    def note(index: Index) -> None:
        arrived(name, index, shown)

    light = fresh_light(store, spec.digest)
    how = (assets, shown, whole, light)
    return Bake(scene.source, plan, spec.digest, layers, store.url, note, costs, *how)


BACKGROUND_VIEWER = Viewer("background", patient=True)
"""Background bakes yield to people who wait for a frame."""


class BackgroundBake:
    """Light that is baked while no frame waits: what a ``stage`` demands of one ``bake``, by its
    name.
    """

    def __init__(
        self, baker: Baker, bake: str, stage: Stage, viewer: Viewer = BACKGROUND_VIEWER
    ) -> None:
        """Request it from the ``baker``, for a ``viewer``; ``coming`` are the chunks that were not
        given up before.
        """
        self._baker = baker
        self._viewer = viewer
        self.bake = bake
        self.chunks = [demand.index for demand in stage.demands]
        self.coming = baker.request(bake, stage.demands, stage.target, viewer, stage.enough)

    def waiting(self) -> int:
        """How many of its ``chunks`` are neither baked nor given up. Asked now and then, it stays
        wanted.
        """
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
"""Bakes of projected or finer texels, and of sides, of all scenes, that may be at work: those asked
for last.
"""


class SideBakes:
    """The bakes of projected or finer texels, and of surfaces' sides, that a ``baker`` knows. Safe
    to use from many threads.
    """

    def __init__(self, baker: Baker, store: Store, most: int) -> None:
        """None yet. When one is added, a thread trims the ``store`` to ``most`` bytes of projected
        texels.
        """
        self._baker = baker
        self._store = store
        self._most = most
        self._names: OrderedDict[str, str] = OrderedDict()
        self._readers = weakref.WeakValueDictionary[str, Caches]()
        self._lit: set[tuple[str, float]] = set()
        self._lock = threading.Lock()
        self._trimmer: threading.Thread | None = None

    def name(
        self, scene: str, shown: Isovalue | None, fineness: int, make: Callable[[], Bake]
    ) -> str:
        """The name of a bake of a scene's texels, made where it is new.

        They are finer than its own by ``fineness`` steps, and projected onto the isosurface
        ``shown``, where one is.
        """
        return self._named(
            f"{scene} (texels finer by {fineness}, projected at {shown!r})", scene, shown, make
        )

    def side(self, scene: str, spec: str, stage: Stage, share: ShareAssets) -> str:
        """Return the name of the bake of a ``stage`` by a ``spec`` for one side of a scene's
        surfaces, and add the bake if it is new.

        Workers open the assets that ``share`` gives. New light is reported to the caches that asked
        last, as earlier ones may have been dropped. Raises ValueError if the stage has no caches:
        its bake is the scene's.
        """
        if stage.caches is None:
            raise ValueError("A stage of the scene's own light has a bake already.")
        caches = stage.caches
        name = f"{scene} (light {caches.spec(spec).digest}, projected at {stage.shown!r})"
        self._readers[name] = caches

        def arrived(spec: str, index: Index, shown: Isovalue | None) -> None:
            if (held := self._readers.get(name)) is not None:
                held.refresh(spec, index, shown)

        def make() -> Bake:
            return make_bake(caches, spec, share(caches.prepared), arrived, stage.shown)

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
        """Have a thread trim the store, unless one does: there is light for one isovalue more."""
        with self._lock:
            if self._trimmer is None or not self._trimmer.is_alive():
                trimmed = self._store, self._most
                self._trimmer = threading.Thread(
                    target=trim_projected, args=trimmed, name="trimming", daemon=True
                )
                self._trimmer.start()

    def settle(self) -> None:
        """Returns when nothing is being trimmed."""
        if self._trimmer is not None:
            self._trimmer.join()

    def scene(self, bake: str) -> str:
        """The name of the bake that views read besides one of projected or finer texels; any other
        is its own.
        """
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
