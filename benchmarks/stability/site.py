"""Sites: a scene, a store and who bakes what its views lack, for cases of what may make no difference."""

import random
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from queue import Queue
from tempfile import TemporaryDirectory
from typing import Any

from benchmarks.stability.case import Size
from benchmarks.stability.stage import view_of
from isogi_core.bake.look import LOOKS
from isogi_core.bake.maps import Run
from isogi_core.bake.recipe import Recipe
from isogi_core.cache.caches import Caches
from isogi_core.cache.place import Place
from isogi_core.frame.frame import Frame
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.tiles import Tiles
from isogi_core.model.plan import most_samples
from isogi_core.model.scene import Scene, load_scene
from isogi_core.model.view import View
from worker.pool import WorkerPool
from worker.tasks import BakeTask, bake

MEMORY = 1 << 30
SETTINGS: dict[str, Any] = {"lattice": 0.4, "bounces": 2, "lights": [{"type": "sky", "sun_elevation": 40.0}]}
"""39³ texels under a low sun, in 5³, 3³ or 2³ chunks."""

Do = Callable[[Sequence[BakeTask]], object]
"""Who does the tasks of a bake, and how."""


@dataclass(frozen=True, eq=False)
class Site:
    """A ``scene``, a ``store`` for its light, the ``tiles`` that work on frames, and the ``memory`` for light."""

    scene: Scene
    store: Path
    tiles: Tiles
    memory: int = MEMORY
    make: Callable[[Scene, Run], Recipe] = Recipe

    def like(self, **other: Any) -> "Site":
        """Another that begins anew on the same store, with some things ``other``."""
        return replace(self, **other)

    @cached_property
    def renderer(self) -> Renderer:
        """Renders frames with what light there is."""
        return Renderer(Caches(self.make(self.scene, self.tiles.run), self.store, self.memory), self.tiles)

    def view(self, size: Size, **settings: Any) -> View:
        """A view of the scene, larger in the report."""
        return view_of(self.scene, size.pick(40, 128), **{"samples": 8, **settings})

    def tasks(self, view: View, until: int | None = None) -> list[BakeTask]:
        """What is to be baked until all light of a view is final, or has so many samples."""
        look, target = self.renderer.caches.look(view.shading), self.scene.target_error
        what = (self.scene.source, look.plan, look.digest, Place.of(self.store))
        most = until or most_samples(target)
        demands = self.renderer.render(view).demands
        return [BakeTask(*what, each.index, each.offsets, each.footprints, most, 0.0, target) for each in demands]

    def bake(self, view: View, do: Do, until: int | None = None) -> None:
        """Have the tasks of a view done, and look at what they left."""
        tasks = self.tasks(view, until)
        do(tasks)
        for task in tasks:
            self.renderer.caches.of(view.shading).refresh(task.index)

    def frame(self, view: View, do: Do | None = None) -> Frame:
        """The frame of a view whose light is final."""
        if view.shading in LOOKS:
            self.bake(view, do or straight)
        return self.renderer.render(view)

    @property
    def objects(self) -> dict[str, bytes]:
        """Every chunk object of the store, by its key."""
        files = [path for path in self.store.rglob("*") if path.is_file() and "/c/" in path.as_posix()]
        return {str(path.relative_to(self.store)): path.read_bytes() for path in files}


@contextmanager
def site(size: Size, threads: int = 2, **settings: Any) -> Iterator[Site]:
    """A site with an empty store."""
    scene = load_scene("demo:orbital", **{"target_error": (0.3, 0.05)[size > Size.QUICK], **SETTINGS, **settings})
    with TemporaryDirectory() as folder:
        yield Site(scene, Path(folder), Tiles(threads))


def straight(tasks: Sequence[BakeTask]) -> None:
    """One after the other."""
    for task in tasks:
        bake(task)


def shuffled(tasks: Sequence[BakeTask]) -> None:
    """In any order, two at a time, and each twice."""
    order = [*tasks, *tasks]
    random.Random(1).shuffle(order)
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(bake, order))


def by_workers(count: int) -> Do:
    """Have so many worker processes do the tasks."""

    def do(tasks: Sequence[BakeTask]) -> None:
        pool, ended = WorkerPool(count), Queue[BaseException | None]()
        for task in tasks:
            pool.submit(task, lambda _, error: ended.put(error))
        errors = [ended.get() for _ in tasks]
        pool.close()
        for error in filter(None, errors):
            raise error

    return do
