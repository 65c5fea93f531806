"""The loaded scenes of an engine: each is loaded when it is looked at, and makes way when others are."""

import gc
import threading
import time
from collections.abc import Callable, Iterable

from isogi_core.allocation import give_memory_back
from isogi_core.lru_cache import LruCache
from isogi_core.plan.scene import Scene
from server.render.loaded_scene import LoadedScene

IDLE = 900.0
"""Seconds after which a scene is dropped that nobody has looked at."""

TIDY = 30.0
"""Seconds between two looks for scenes that nobody looks at any more, and for garbage: 0.07 s under 64 clients."""


class LoadedScenes:
    """Scenes that keep so much memory together; those looked at last stay. Safe to use from many threads.

    One that is dropped while it is drawn is drawn to its end.
    """

    def __init__(
        self, load: Callable[[Scene], LoadedScene], most: int, clock: Callable[[], float] = time.monotonic
    ) -> None:
        """None yet; ``load`` makes one, and all together keep ``most`` bytes, or one alone."""
        self._load, self._clock = load, clock
        self._kept: LruCache[str] = LruCache(most)
        self._looked: dict[str, float] = {}
        self._lock = threading.Lock()

    def at(self, scene: Scene) -> LoadedScene:
        """A scene, loaded now where it is not. Raises StoreError."""
        loaded: LoadedScene = self._kept.get(scene.id, lambda: self._load(scene))
        with self._lock:
            self._looked[scene.id] = self._clock()
        return loaded

    def held(self, scene: str) -> LoadedScene | None:
        """A scene where it is loaded."""
        return self._kept.held(scene)

    def latest(self, scenes: Iterable[str]) -> LoadedScene | None:
        """The one of some ``scenes`` that was looked at last, where any is loaded."""
        with self._lock:
            looked = [scene for scene in scenes if scene in self._looked]
            last = max(looked, key=self._looked.__getitem__, default=None)
        return None if last is None else self.held(last)

    @property
    def looked(self) -> float:
        """When somebody looked at any of them last; 0 where nobody ever has."""
        with self._lock:
            return max(self._looked.values(), default=0.0)

    def settle(self) -> None:
        """Drop those looked at longest ago until the rest fits: they grow as they are looked at."""
        if len(self._looked) > 1:
            self._kept.settle()
            self._note()

    def drop_idle(self) -> None:
        """Drop those that nobody has looked at for long, and give their memory back to the system."""
        idle = [scene for scene, looked in list(self._looked.items()) if self._clock() - looked > IDLE]
        for scene in idle:
            self.drop(scene)
        if idle:
            give_memory_back()

    def tidy(self, stopped: threading.Event) -> None:
        """Drop those that are idle, and, after frames, what errors hold in circles, until ``stopped``."""
        looked = 0.0
        while not stopped.wait(TIDY):
            self.drop_idle()
            if looked != (looked := self.looked):
                gc.collect()
                give_memory_back()

    def drop(self, scene: str) -> None:
        """Drop a scene, if it is loaded."""
        if (loaded := self._kept.held(scene)) is not None:
            self._kept.drop(scene)
            loaded.close()
        self._note()

    def close(self) -> None:
        """Drop all."""
        for scene in list(self._looked):
            self.drop(scene)

    def _note(self) -> None:
        """Forget when those were looked at that are not loaded any more."""
        with self._lock:
            self._looked = {scene: at for scene, at in self._looked.items() if self._kept.held(scene) is not None}
