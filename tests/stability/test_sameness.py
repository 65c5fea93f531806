"""Sameness: what may not change one bit of a picture, or one byte of a chunk.

Processes of workers are held against a thread of this one in ``tests/worker/test_kill.py``.
"""

import random
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest

from isogi_core.bake.bake_spec import SPECS
from isogi_core.bake.noise import Goal
from isogi_core.bake.texel_light import FIRST_LEVEL
from isogi_core.cache.scene_caches import Caches
from isogi_core.errors import StoreError
from isogi_core.frame.frame import Frame
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.tiles import Piece, Tiles
from isogi_core.kernels.tracing.active_cells import ActiveCells
from isogi_core.model.view import View
from isogi_core.model.volume import Isovalue
from isogi_core.plan.scene import CHUNK_SIDES, Scene
from isogi_core.prepared.active_cell_maps import ActiveCellMaps
from isogi_core.prepared.prepared_scene import PreparedScene
from isogi_core.runs import Run, serially
from isogi_core.storage.backend import StoreUrl
from isogi_report.speed import bake_chunks, wanted_of
from isogi_worker.tasks import BakeTask, bake
from tests.loaded import load_scene
from tests.stability.scenes import view_of

MEMORY = 1 << 30
SETTINGS: dict[str, Any] = {
    "lattice": 0.4,
    "bounces": 1,
    "lights": [{"type": "sky", "sun_elevation": 40.0}],
    "target_error": 0.3,
}
"""39³ texels under a low sun, in 5³, 3³ or 2³ chunks."""

SHADINGS = ("gi", "vicinity", "lambert_shadow", "phong_shadow", "path_traced")

DoTasks = Callable[[Sequence[BakeTask]], object]
"""Who does the tasks of a bake, and how."""


@dataclass(frozen=True, eq=False)
class Site:
    """A ``scene``, a ``store`` for its light, the ``tiles`` that work on frames, and the ``memory``
    for light.
    """

    scene: Scene
    store: Path
    tiles: Tiles
    memory: int = MEMORY
    make: Callable[[Scene], PreparedScene] = PreparedScene

    def anew(self, **other: Any) -> "Site":
        """Another that begins anew on the same store, with some things ``other``."""
        return replace(self, **other)

    @cached_property
    def renderer(self) -> Renderer:
        """Renders frames with what light there is."""
        return Renderer(Caches(self.make(self.scene), self.store, self.memory), self.tiles)

    def view(self, **settings: Any) -> View:
        """A view of the scene."""
        return view_of(self.scene, 16, **{"samples": 8, **settings})

    def tasks(self, view: View, until: int | None = None) -> list[BakeTask]:
        """What is to be baked until all light of a view is final, or has so many samples."""
        spec = self.renderer.caches.spec(view.shading)
        goal = Goal(self.scene.target_error)
        what = (self.scene.source, spec.plan, spec.digest, StoreUrl.of(self.store))
        most = until or goal.most_samples
        demands = self.renderer.render(view, goal).demands
        return [
            BakeTask(*what, each.index, each.offsets, each.footprints, most, goal)
            for each in demands
        ]

    def bake(self, view: View, do: DoTasks, until: int | None = None) -> None:
        """Have the tasks of a view done, and look at what they left."""
        tasks = self.tasks(view, until)
        assert tasks
        do(tasks)
        for task in tasks:
            self.renderer.caches.of(view.shading).refresh(task.index)

    def frame(self, view: View) -> Frame:
        """The frame of a view whose light is final."""
        if view.shading in SPECS:
            self.bake(view, one_by_one)
        return self.renderer.render(view)

    @property
    def objects(self) -> dict[str, bytes]:
        """Every chunk object of the store, by its key."""
        files = [
            path for path in self.store.rglob("*") if path.is_file() and "/c/" in path.as_posix()
        ]
        return {str(path.relative_to(self.store)): path.read_bytes() for path in files}


@cache
def orbital(**settings: Any) -> Scene:
    """The demo under SETTINGS and others."""
    return load_scene("demo:orbital", **SETTINGS, **settings)


@contextmanager
def site(**settings: Any) -> Iterator[Site]:
    """A site with an empty store."""
    with TemporaryDirectory() as folder, closing(Tiles(2)) as tiles:
        yield Site(orbital(**settings), Path(folder), tiles)


def one_by_one(tasks: Sequence[BakeTask]) -> None:
    """One after the other."""
    for task in tasks:
        bake(task)


def shuffled(tasks: Sequence[BakeTask]) -> None:
    """In any order, two at a time, and each twice."""
    order = [*tasks, *tasks]
    random.Random(1).shuffle(order)
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(bake, order))


@cache
def chunks_baked(do: DoTasks, *steps: int) -> dict[str, bytes]:
    """The chunk objects of a store once a view's light is final, and was baked to so many samples
    first.
    """
    with site() as own:
        for until in (*steps, None):
            own.bake(own.view(), do, until)
        return own.objects


def assert_same(one: Frame, other: Frame) -> None:
    """Assert that no bit of radiance, state or error differs, and that something is shown."""
    assert one.surface
    for name in ("radiance", "state", "error"):
        assert getattr(one, name).tobytes() == getattr(other, name).tobytes(), name


@pytest.mark.parametrize(
    ("do", "steps"),
    [
        pytest.param(shuffled, (), id="in any order, two at a time, each twice"),
        pytest.param(shuffled, (FIRST_LEVEL, 2 * FIRST_LEVEL), id="in steps"),
    ],
)
def test_chunks_are_the_same_bytes_however_they_are_baked(
    do: DoTasks, steps: tuple[int, ...]
) -> None:
    right = chunks_baked(one_by_one)
    assert right
    assert chunks_baked(do, *steps) == right


def in_chunks(chunk: int) -> tuple[Frame, np.ndarray]:
    """A frame, and samples and light of all texels (z, y, x, …), baked in chunks of some size."""
    with site(chunk=chunk) as own:
        frame = own.frame(own.view())
        lattice = own.renderer.prepared.lattice
        store = own.renderer.caches.of("gi").chunk_store
        texels = np.zeros((*lattice.shape, 1 + store.spec.channels * store.spec.order**2))
        for found in filter(None, map(store.read, np.ndindex(lattice.chunks))):
            at = tuple(lattice.positions(found.index, found.offsets).T)
            texels[at] = np.column_stack(
                [found.light.samples, found.light.transfer.reshape(len(found.offsets), -1)]
            )
        return frame, texels


def test_pictures_and_texels_do_not_depend_on_the_size_of_chunks() -> None:
    (frame, texels), *others = map(in_chunks, CHUNK_SIDES)
    assert np.count_nonzero(texels[..., 0]) > 100
    for other, light in others:
        assert_same(frame, other)
        np.testing.assert_array_equal(light, texels)


class SmallTiles(Tiles):
    """Tiles of a seventh of the size."""

    def run(self, piece: Piece, total: int, size: int) -> None:
        """Call ``piece`` for smaller ranges."""
        super().run(piece, total, size // 7 + 1)


@pytest.mark.parametrize("shading", SHADINGS)
def test_pictures_do_not_depend_on_tiles_and_threads(shading: str) -> None:
    with site() as own:
        view = own.view(shading=shading)
        frame = own.frame(view)
        for tiles in (Tiles(1), Tiles(3), Tiles(5), SmallTiles(1)):
            with closing(tiles):
                assert_same(frame, own.anew(tiles=tiles).renderer.render(view))


class EveryCell(ActiveCellMaps):
    """Maps in which every cell is marked."""

    def at(self, isovalue: Isovalue, run: Run = serially) -> ActiveCells:
        """The same for any isovalue."""
        return self.covering(np.empty(0), run)

    def covering(self, isovalues: np.ndarray, run: Run = serially) -> ActiveCells:
        """The same for all of them."""
        return super().covering(np.array([-np.inf, np.inf]), run)


class Unskipped(PreparedScene):
    """A prepared scene whose maps have every cell marked: nothing is ever skipped."""

    @cached_property
    def maps(self) -> ActiveCellMaps:
        """Maps of every cell."""
        return EveryCell(self.scene.volume.voxels, self.most)


@pytest.mark.parametrize("shading", SHADINGS)
def test_pictures_do_not_depend_on_the_empty_space_skipped(shading: str) -> None:
    with site() as own, site() as other:
        view = own.view(shading=shading)
        whole = other.anew(make=Unskipped)
        assert_same(*(baked_here(each.renderer, view, FIRST_LEVEL) for each in (own, whole)))


def baked_here(renderer: Renderer, view: View, samples: int) -> Frame:
    """The frame of a view whose light is baked by the renderer's own recipe, with so many samples
    each texel.
    """
    goal = Goal.checked(1e-9)
    if wanted := wanted_of(renderer.render(view, goal)):
        bake_chunks(renderer, view.shading, wanted, samples)
    return renderer.render(view, goal)


def test_a_bake_that_was_stopped_goes_on_to_the_same_picture() -> None:
    """Stopped after half of its tasks, twice, with a new renderer each time."""
    with site() as whole, site() as broken:
        view = whole.view()
        for _ in range(2):
            broken.anew().bake(view, lambda tasks: one_by_one(tasks[::2]))
        right = whole.frame(view)
        assert_same(right, broken.anew().frame(view))
        assert_same(right, broken.anew().renderer.render(view))


def test_views_in_turn_are_the_same_in_just_enough_memory() -> None:
    """In the least memory, to a factor of 1.5, that holds the light of either."""
    with site() as own:
        views = [own.view(azimuth=azimuth) for azimuth in (40.0, 220.0)]
        plenty = [own.frame(view) for view in views]
        limit = 1 << 14
        while (few := rendered(own.anew(memory=limit), views * 2)) is None:
            limit = limit * 3 // 2
        for frame, other in zip(plenty * 2, few, strict=True):
            assert_same(frame, other)
        assert 1 << 14 < limit < MEMORY


def rendered(own: Site, views: Sequence[View]) -> list[Frame] | None:
    """Frames of the views, one after the other; None where the memory cannot hold one."""
    try:
        return [own.renderer.render(view) for view in views]
    except StoreError:
        return None
