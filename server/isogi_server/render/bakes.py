"""Bakes as the workers know them: those of scenes, of projected and finer texels, of surfaces'
sides, and in the background.
"""

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
from isogi_worker.bake_requests import Viewer
from isogi_worker.baker import Bake, Baker
from isogi_worker.progress import TimeLeft
from isogi_worker.tasks import Assets, Whole


def bake_name(scene: str, spec: str) -> str:
    """Return the name of a scene's bake by a spec, unique among all bakes: the name of the
    scene for the spec "gi".
    """
    if spec == "gi":
        return scene
    return f"{scene} ({spec})"


ShareAssets = Callable[[PreparedScene], Assets | None]
"""Returns the assets that workers open in place of a scene's files; None if they read these
files.
"""


def share_nothing(prepared: PreparedScene) -> None:
    """Have workers read the scene's files."""


def share_by_store(store: Store) -> ShareAssets:
    """Return a function that sends copies of a scene's files to the ``store`` for workers on
    other machines; if the store takes nothing, these must have the files.
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
    """Make the bake of a spec, by its ``name``, from the ``caches`` of a scene; workers open the
    ``assets`` in place of the scene's files.

    Its texels are projected onto the isosurface that is ``shown``, if one is. The scene may be cut
    from a ``whole``. The bake holds no reference to the ``caches``: ``arrived`` is called with the
    name of the spec, the chunk that has new light, and the isosurface.
    """
    spec = replace(caches.spec(name), shown=shown)
    store = caches.store
    scene = spec.prepared.scene
    # Notes for people would only make the tasks longer.
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
"""The viewer of background bakes, which yield to people who wait for a frame."""


class BackgroundBake:
    """Light of the chunks that a stage of a picture demands, baked while no frame waits for it."""

    def __init__(
        self, baker: Baker, bake: str, stage: Stage, viewer: Viewer = BACKGROUND_VIEWER
    ) -> None:
        """Request the light that a ``stage`` demands from the ``baker``, for a ``viewer``. ``bake``
        is the name by which the baker knows the bake.

        ``coming`` are those of the demanded ``chunks`` that will be baked, or were baked since the
        view was drawn: no chunk that was given up, and none of a bake that was dropped.
        """
        self._baker = baker
        self._viewer = viewer
        self.bake = bake
        self.chunks = [demand.index for demand in stage.demands]
        self.coming = baker.request(bake, stage.demands, stage.goal, viewer)

    def waiting(self) -> int:
        """Return the number of its ``chunks`` that are neither baked nor given up. Call it now
        and then, as the request expires otherwise.
        """
        return self._baker.open(self.bake, self.chunks, self._viewer)

    def failures(self) -> dict[Index, str]:
        """Return the chunks that were given up, and the reasons."""
        return self._baker.failures(self.bake, self.chunks)

    def wait(self, seconds: float) -> None:
        """Block until all of it is baked or given up, at most ``seconds``."""
        self._baker.wait(self.bake, self.chunks, seconds)

    def time_left(self) -> TimeLeft | None:
        """Return the time until all of it is baked; None if that is unknown."""
        return self._baker.time_left(self.bake, self._viewer, self.chunks)


MAX_BAKES = 32
"""Bakes of projected texels, finer texels and sides that may be at work for all scenes
together: the ones asked for last.
"""

MAX_LIT = 1024
"""Isovalues of scenes that are remembered to have light of walls. One that was forgotten costs a
look through the store when it is next lit.
"""


class SideBakes:
    """The bakes of projected texels, of finer texels and of surfaces' sides. Safe to use from
    many threads.
    """

    def __init__(self, baker: Baker, store: Store, most: int) -> None:
        """Add bakes to ``baker`` as they are asked for. Each new isosurface of projected texels
        has a thread trim the ``store`` to ``most`` bytes of them.
        """
        self._baker = baker
        self._store = store
        self._most = most
        self._names: OrderedDict[str, str] = OrderedDict()
        self._leaving: dict[str, str] = {}
        self._readers = weakref.WeakValueDictionary[str, Caches]()
        self._lit: OrderedDict[tuple[str, float], None] = OrderedDict()
        self._lock = threading.Condition()
        self._trimmer: threading.Thread | None = None

    def name(
        self, scene: str, shown: Isovalue | None, fineness: int, make: Callable[[], Bake]
    ) -> str:
        """Return the name of a bake of a scene's texels, and add the bake, by ``make``, if it is
        new.

        Its texels are finer than the scene's by ``fineness`` steps, and projected onto the
        isosurface ``shown``, if that is given.
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
        # Hold the caches weakly: a scene may be dropped while its bake goes on.
        self._readers[name] = caches

        def arrived(spec: str, index: Index, shown: Isovalue | None) -> None:
            if (held := self._readers.get(name)) is not None:
                held.refresh(spec, index, shown)

        def make() -> Bake:
            return make_bake(caches, spec, share(caches.prepared), arrived, stage.shown)

        return self._named(name, bake_name(scene, spec), stage.shown, make)

    def _named(self, name: str, base: str, shown: Isovalue | None, make: Callable[[], Bake]) -> str:
        """Add the bake of this ``name`` if it is new, and drop those asked for longest ago if there
        are more than MAX_BAKES. Views that read it also read the bake ``base`` of the scene, by
        whose name its updates are reported.

        A new isosurface of projected texels takes space in the store, so it is trimmed.
        """
        with self._lock:
            # A former bake of this name is dropped before the next one is added.
            self._lock.wait_for(lambda: name not in self._leaving)
            new = name not in self._names
            if new:
                self._baker.add(name, make())
            self._names[name] = base
            self._names.move_to_end(name)
            old = self._leave(list(self._names)[: max(len(self._names) - MAX_BAKES, 0)])
        self._forget(old)
        if new and shown is not None:
            self._trim()
        return name

    def lit(self, scene: str, isovalue: float) -> None:
        """Note that the walls of a scene have light for an isovalue, and trim the store if that
        is new.
        """
        with self._lock:
            new = (scene, isovalue) not in self._lit
            self._lit[scene, isovalue] = None
            self._lit.move_to_end((scene, isovalue))
            if len(self._lit) > MAX_LIT:
                self._lit.popitem(last=False)
        if new:
            self._trim()

    def _trim(self) -> None:
        """Start a thread that trims the store, unless one is at it."""
        with self._lock:
            if self._trimmer is None or not self._trimmer.is_alive():
                trimmed = self._store, self._most
                self._trimmer = threading.Thread(
                    target=trim_projected, args=trimmed, name="trimming", daemon=True
                )
                self._trimmer.start()

    def settle(self) -> None:
        """Return when nothing is being trimmed."""
        if self._trimmer is not None:
            self._trimmer.join()

    def scene(self, bake: str) -> str:
        """Return the name of the scene's bake that views read together with a ``bake`` of this
        class; any other bake's name is returned as it is.
        """
        return self._names.get(bake) or self._leaving.get(bake, bake)

    def forget(self, scene: str) -> None:
        """Drop all bakes of a scene that this object has added."""
        with self._lock:
            every = {bake_name(scene, spec) for spec in SPECS}
            gone = self._leave([name for name, base in self._names.items() if base in every])
            for each in [each for each in self._lit if each[0] == scene]:
                del self._lit[each]
        self._forget(gone)

    def _leave(self, names: list[str]) -> list[str]:
        """Note that the bakes of these ``names`` are about to be dropped, and return the names.
        The caller holds the lock.
        """
        for name in names:
            self._leaving[name] = self._names[name]
            del self._names[name]
        return names

    def _forget(self, names: list[str]) -> None:
        """Drop bakes, without the lock, as the baker calls listeners: these still find the scene
        of each name, so that requests that wait for its light hear that it does not come.
        """
        for name in names:
            try:
                self._baker.forget(name)
            finally:
                with self._lock:
                    del self._leaving[name]
                    self._lock.notify_all()
