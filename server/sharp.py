"""Sharp bakes: one for each isovalue that a view rests at, taken on when its sharp light is first asked for."""

import threading
from collections import OrderedDict
from collections.abc import Callable

from worker.baker import Bake, Baker

MOST = 32
"""Isovalues, of all scenes, whose sharp light may be baked at a time: those asked for last."""


class SharpBakes:
    """The sharp bakes that a ``baker`` knows. Safe to use from many threads."""

    def __init__(self, baker: Baker, trim: Callable[[], object]) -> None:
        """None yet; ``trim`` is called, from a thread of its own, when one is taken on: light of others may go."""
        self._baker = baker
        self._trim = trim
        self._names: OrderedDict[str, str] = OrderedDict()
        self._lock = threading.Lock()
        self._trimming = threading.Lock()
        self._trimmer: threading.Thread | None = None

    def name(self, scene: str, shown: float, make: Callable[[], Bake]) -> str:
        """The name of the bake of a scene's texels on the isosurface ``shown``, made where it is new."""
        name = f"{scene} (sharp at {shown!r})"
        with self._lock:
            new = name not in self._names
            if new:
                self._baker.add(name, make())
            self._names[name] = scene
            self._names.move_to_end(name)
            old = [self._names.popitem(last=False)[0] for _ in range(len(self._names) - MOST)]
        for each in old:
            self._baker.forget(each)
        if new:
            self._trimmer = threading.Thread(target=self._trim_once, name="trimming", daemon=True)
            self._trimmer.start()
        return name

    def settle(self) -> None:
        """Returns when nothing is being trimmed."""
        if self._trimmer is not None:
            self._trimmer.join()

    def scene(self, bake: str) -> str:
        """The name of the bake that views read besides a sharp one; any other is its own."""
        return self._names.get(bake, bake)

    def forget(self, scene: str) -> None:
        """Bake no more sharp light of a scene."""
        with self._lock:
            gone = [name for name, own in self._names.items() if own == scene]
            for name in gone:
                del self._names[name]
        for name in gone:
            self._baker.forget(name)

    def _trim_once(self) -> None:
        """Trim, unless that is being done."""
        if self._trimming.acquire(blocking=False):
            try:
                self._trim()
            finally:
                self._trimming.release()
