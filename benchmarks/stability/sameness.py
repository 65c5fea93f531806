"""Cases of sameness: what may not change one bit of a picture."""

from collections.abc import Sequence
from functools import cache, cached_property
from threading import Event

import numpy as np

from benchmarks.stability.case import Outcome, Size, case
from benchmarks.stability.site import MEMORY, Do, Site, by_workers, shuffled, site, straight
from isogi_core.bake.precision import FIRST_RUNG
from isogi_core.bake.recipe import Recipe
from isogi_core.errors import StoreError
from isogi_core.frame.frame import Frame
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.tiles import Piece, Tiles
from isogi_core.kernels.bricks import Bricks, brick_ranges, make_bricks
from isogi_core.model.scene import CHUNKS
from isogi_core.model.view import View
from isogi_core.report.bake import NEVER
from server.measure import bake_chunk

GROUP = "sameness"
SHADINGS = ("gi", "vicinity", "lambert_shadow", "phong_shadow", "path_traced")


def apart(one: Frame, other: Frame) -> int:
    """Pixels of which any bit differs: of their radiance, state or error."""
    pairs = [(getattr(one, name), getattr(other, name)) for name in ("radiance", "state", "error")]
    bits = [np.ascontiguousarray(a).view(np.uint8) != np.ascontiguousarray(b).view(np.uint8) for a, b in pairs]
    return int(np.logical_or.reduce([each.reshape(one.state.size, -1).any(axis=1) for each in bits]).sum())


def most_apart(frames: Sequence[Frame]) -> Outcome:
    """Pixels of which the frames differ from the first of them, most of all."""
    return Outcome(max(apart(frames[0], each) for each in frames[1:]), f"in {len(frames)} frames")


def in_chunks(size: Size, chunk: int) -> tuple[Frame, np.ndarray]:
    """A frame, and samples and light of all texels (z, y, x, …), baked in chunks of some size."""
    with site(size, chunk=chunk) as own:
        frame = own.frame(own.view(size))
        lattice, store = own.renderer.recipe.lattice, own.renderer.caches.of("gi").store
        texels = np.zeros((*lattice.shape, 1 + store.look.channels * store.look.order**2))
        for read in filter(None, map(store.read, np.ndindex(lattice.chunks))):
            at = tuple(lattice.positions(read.index, read.offsets).T)
            texels[at] = np.column_stack([read.light.samples, read.light.transfer.reshape(len(read.offsets), -1)])
        return frame, texels


@case(GROUP, "chunks of 8, 16 and 32", "pictures and texels do not depend on the size of chunks", 0, "pixels, texels")
def chunk_sizes(size: Size) -> Outcome:
    """Bake one view in chunks of each size."""
    frames, texels = zip(*(in_chunks(size, chunk) for chunk in CHUNKS), strict=True)
    other = max(int((each != texels[0]).any(axis=-1).sum()) for each in texels[1:])
    baked = np.count_nonzero(texels[0][..., 0])
    return Outcome(most_apart(frames).worst + other, f"of {frames[0].state.size} pixels and {baked} texels")


class Small(Tiles):
    """Tiles of a seventh of the size."""

    def run(self, piece: Piece, total: int, size: int, cancelled: Event | None = None) -> None:
        """Call ``piece`` for smaller ranges."""
        super().run(piece, total, size // 7 + 1, cancelled)


@case(GROUP, "tiles and threads", "pictures do not depend on the size of tiles, nor on who works on them", 0, "pixels")
def tiles(size: Size) -> Outcome:
    """Render every shading on 1, 2, 3 and 5 threads, and in small tiles."""
    worst, count = 0.0, 0
    with site(size) as own:
        for shading in SHADINGS:
            view, others = own.view(size, shading=shading), (Tiles(1), Tiles(3), Tiles(5), Small(1))
            frames = [own.frame(view), *(own.like(tiles=each).renderer.render(view) for each in others)]
            worst, count = max(worst, most_apart(frames).worst), count + len(frames)
    return Outcome(worst, f"in {count} frames")


@case(GROUP, "order of a bake", "chunks are the same bytes in whatever order and steps they are baked", 0, "chunks")
def bake_order(size: Size) -> Outcome:
    """Bake a view straight on, in any order and twice, and in steps."""
    return unlike([baked(size, straight), baked(size, shuffled), baked(size, shuffled, FIRST_RUNG, 4 * FIRST_RUNG)])


@cache
def baked(size: Size, do: Do, *steps: int) -> dict[str, bytes]:
    """The chunk objects of a store once a view's light is final, and was baked to so many samples first."""
    with site(size) as own:
        for until in (*steps, None):
            own.bake(own.view(size), do, until)
        return own.objects


def unlike(stores: Sequence[dict[str, bytes]]) -> Outcome:
    """Chunk objects that differ from the first store's."""
    first, *others = stores
    wrong = max(sum(first.get(key) != other.get(key) for key in {*first, *other}) for other in others)
    return Outcome(wrong, f"of {len(first)} in {len(stores)} stores")


@case(GROUP, "workers", "chunks are the same bytes from one worker process or more", 0, "chunks")
def workers(size: Size) -> Outcome:
    """Bake a view in this process, and by two worker processes; for the report by one to four."""
    counts = (2,) if size is Size.QUICK else (1, 2, 4)
    return unlike([baked(size, do) for do in (straight, *map(by_workers, counts))])


class Unskipped(Recipe):
    """A recipe whose maps have every cell marked: nothing is ever skipped."""

    @cached_property
    def everything(self) -> Bricks:
        """The map of all isovalues."""
        voxels = self.scene.volume.voxels
        return make_bricks(voxels, brick_ranges(voxels), -np.inf, np.inf)

    def bricks(self, lowest: float, highest: float, cancelled: Event | None = None) -> Bricks:
        """The same for any isovalue."""
        return self.everything


@case(GROUP, "empty space", "pictures do not depend on what empty space is skipped", 0, "pixels")
def empty_space(size: Size) -> Outcome:
    """Bake and render every shading with empty space skipped, and with every cell looked into."""
    worst, samples = 0, size.pick(FIRST_RUNG, 4 * FIRST_RUNG)
    for shading in SHADINGS:
        with site(size) as own, site(size) as other:
            view, every = own.view(size, shading=shading), other.like(make=Unskipped)
            worst = max(worst, apart(*(baked_here(each.renderer, view, samples) for each in (own, every))))
    return Outcome(worst, f"in {len(SHADINGS)} shadings")


def baked_here(renderer: Renderer, view: View, samples: int) -> Frame:
    """The frame of a view whose light is baked by the renderer's own recipe, with so many samples each texel."""
    for demand in renderer.render(view, NEVER).demands:
        bake_chunk(renderer, view.shading, demand, samples)
    return renderer.render(view, NEVER)


@case(GROUP, "restart", "a bake that was stopped goes on in the store to the same picture", 0, "pixels")
def restart(size: Size) -> Outcome:
    """Stop a bake after half of its tasks, twice, and go on with a new renderer each time."""
    with site(size) as whole, site(size) as broken:
        view = whole.view(size)
        for _ in range(2):
            broken.like().bake(view, lambda tasks: straight(tasks[::2]))
        last = [broken.like().frame(view), broken.like().renderer.render(view)]
        return most_apart([whole.frame(view), *last])


@case(GROUP, "memory for light", "views in turn are the same pictures in just enough memory and in plenty", 0, "pixels")
def memory(size: Size) -> Outcome:
    """Render two views in turn in the least memory, to a factor of 1.5, that holds either."""
    with site(size) as own:
        views = [own.view(size, azimuth=azimuth) for azimuth in (40.0, 220.0)] * 2
        plenty, limit = [own.frame(view) for view in views], 1 << 14
        while (few := rendered(own.like(memory=limit), views)) is None:
            limit = limit * 3 // 2
        worst = max(map(apart, plenty, few))
    return Outcome(worst, f"in {limit / 2**20:.2g} MiB and {MEMORY >> 20} MiB")


def rendered(own: Site, views: Sequence[View]) -> list[Frame] | None:
    """Frames of the views, one after the other; None where the memory cannot hold one."""
    try:
        return [own.renderer.render(view) for view in views]
    except StoreError:
        return None
