"""Tasks: more light for texels of one chunk, baked in a worker process."""

import asyncio
import json
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import compress, pairwise
from typing import Any, Self
from weakref import WeakValueDictionary

import numpy as np

from isogi_core.bake.bake_spec import BakeSpec
from isogi_core.bake.noise import Effort, efforts, level, standard_error
from isogi_core.bake.refine import (
    Located,
    Remains,
    find_kept,
    keeps,
    locate,
    next_samples,
    refine,
    some_located,
)
from isogi_core.bake.texel_light import FIRST_LEVEL, Light
from isogi_core.cache.chunk_record import Chunk
from isogi_core.cache.chunk_store import ChunkStore
from isogi_core.cache.costs import Cost
from isogi_core.cache.inventory import Claims
from isogi_core.cache.scene_assets import (
    SceneAssets,
    receive_assets,
    receive_colours,
    receive_glow_bits,
)
from isogi_core.errors import SceneError, SharedMemoryError, StoreAwayError
from isogi_core.files.mappings import budget
from isogi_core.files.scene_file import MATERIAL_NUMBERS, VOXEL_SETTINGS, SceneSource
from isogi_core.kernels._jit import entries_of, load
from isogi_core.kernels.tracing.active_cells import (
    fill_ranges,
    mark_bricks,
    number_bricks,
    pack_bricks,
)
from isogi_core.kernels.tracing.macrocells import fill_macrocells
from isogi_core.kernels.transport.entries import path_kernels
from isogi_core.kernels.transport.transfer import (
    bake_coloured_texels,
    bake_irradiance,
    bake_texels,
    find_strays,
    locate_texels,
    project_texels,
)
from isogi_core.model.scene_plan import MAX_SAMPLES, ScenePlan
from isogi_core.model.value_survey import no_progress
from isogi_core.model.volume import Isovalue
from isogi_core.plan.assembly import build_scene
from isogi_core.plan.scene import COLOURED_KIND, PATH_KINDS
from isogi_core.plan.volumes.masks import cut_digest, voxels_left
from isogi_core.prepared.prepared_scene import Index, PreparedScene
from isogi_core.prepared.shared_scenes import SharedScene, receive_scene
from isogi_core.storage.backend import StoreUrl
from isogi_core.storage.store import Store

Assets = SceneAssets | SharedScene
"""What a worker opens in place of a scene's files: copies of them in the store, or what the server
shares with processes of its machine.
"""


@dataclass(frozen=True)
class Whole:
    """The scene that one was cut from: its ``source``, and the ``assets`` that workers open in
    place of its files.
    """

    source: SceneSource
    assets: Assets | None = None

    def planes(self, cut: SceneSource) -> str:
        """What a ``cut`` of it takes away, as its document has that besides what the whole is cut
        by itself.
        """
        own, both = (str(each.document.get("cut", "")) for each in (self.source, cut))
        if own:
            return both.removeprefix(f"{own};")
        return both


@dataclass(frozen=True, eq=False)
class WholeLight:
    """The light of a whole volume in a store, ``chunks``, and what ``remains`` of it where it is
    cut.
    """

    chunks: ChunkStore
    remains: Remains

    def lend(
        self,
        light: Light,
        waiting: np.ndarray,
        places: Sequence[tuple[Index, np.ndarray]],
        walks: bool,
    ) -> np.ndarray:
        """Give texels that are ``waiting`` (m,) bool the light that they keep; which have it now,
        (m,) bool.

        Without ``walks`` those alone of which this is known without walking paths. ``places`` are
        chunks and offsets in them, whose texels have the rows of ``light``, in place, one chunk's
        after the other's.
        """
        lattice = self.chunks.spec.prepared.lattice
        kept = np.zeros(len(light), np.bool_)
        bounds = np.cumsum([0, *(len(offsets) for _, offsets in places)]).tolist()
        rows = list[np.ndarray]()
        texels = list[np.ndarray]()
        found = list[Light]()
        for (index, offsets), (first, last) in zip(places, pairwise(bounds), strict=True):
            if waiting[first:last].any():
                chunk = self.chunks.read(index)
            else:
                chunk = None
            if chunk is None:
                continue
            own = np.flatnonzero(waiting[first:last] & np.isin(offsets, chunk.offsets))
            rows.append(first + own)
            texels.append(lattice.positions(index, offsets[own]))
            found.append(chunk.light.rows(chunk.rows_of(offsets[own])))
        if not any(map(len, rows)):
            return kept
        whole = Light.joined(found)
        every = np.concatenate(rows)
        whole.agree_on_void()
        ahead = np.flatnonzero(whole.samples > light.samples[every])
        own = np.concatenate(texels)[ahead]
        stays = ahead[find_kept(whole.rows(ahead), own, self.chunks.spec, self.remains, walks)]
        light.put(every[stays], whole.rows(stays))
        kept[every[stays]] = True
        return kept


def light_of_whole(spec: BakeSpec, planes: str, cut: BakeSpec, store: Store) -> WholeLight | None:
    """The light by a ``spec`` of a whole volume, of which a ``cut`` by some ``planes`` may keep
    some; None where none can.
    """
    whole = spec.prepared.scene.volume
    left = cut.prepared.scene.volume
    if not keeps(spec) or cut_digest(whole, planes) != left.digest:
        return None
    load((find_strays,))
    return WholeLight(ChunkStore(store, spec), Remains.of(whole, voxels_left(whole, planes)))


KERNELS_OF_LAYER = {
    **{"direct": (bake_texels,), "indirect": (bake_texels,), "whole": (bake_texels,)},
    **{"irradiance": (bake_irradiance,), COLOURED_KIND: (bake_coloured_texels,)},
    **{kind: path_kernels(*cell) for cell, kind in PATH_KINDS.items()},
}
"""Entry kernels by the kind of layer that they bake; among walls or surfaces and on colours they
are others.
"""

PLAIN_LAYER_KINDS = tuple(
    kind for kind in KERNELS_OF_LAYER if kind not in (COLOURED_KIND, *PATH_KINDS.values())
)
"""The kinds of layers of scenes with one surface, without walls, colours and glow."""

OPENING_KERNELS = (fill_macrocells, fill_ranges, mark_bricks, pack_bricks, number_bricks)
"""Entry kernels that open a scene and map its isosurfaces."""


def bake_kernels(kinds: Iterable[str]) -> tuple[Any, ...]:
    """The entry kernels for baking layers of these ``kinds``, and those of rooms, besides those
    that open a scene.
    """
    return (*{kernel for kind in kinds for kernel in KERNELS_OF_LAYER[kind]}, locate_texels)


def kernels_missing(kinds: Iterable[str]) -> bool:
    """Whether kernels that bake layers of these ``kinds`` are not compiled yet on this machine."""
    return any(not entry.stored for entry in entries_of(bake_kernels(kinds)))


def load_kernels(kinds: Iterable[str]) -> None:
    """Compile or load the kernels that bake layers of these ``kinds``."""
    load(bake_kernels(kinds))


@dataclass(frozen=True, eq=False)
class BakeTask:
    """Bring the texels at ``offsets`` of a chunk, which are seen by their ``footprints``, to
    ``until`` samples.

    Texels need no more once they are good for pictures of the relative error ``target``, or have
    ``enough`` samples. ``plan`` is what is baked. ``digest`` names the light that the server means,
    as the scene's files may have changed since. Where there are ``assets``, these are opened in
    place of the scene's files. ``owner`` names the baker, which claims the chunk while others are
    at work too; where it ``insists``, whoever claimed it before. Texels lie on the isosurface that
    is ``shown``, where one is: see ``BakeSpec``. Where the scene was cut from a ``whole``, they
    keep what light of that the cut leaves as it is.

    Where the server ``keeps`` the light, it comes with the result and is written later, by a
    ``WriteTask``. The server then sends the ``light`` that it has of these texels, if it has the
    chunk.
    """

    source: SceneSource
    plan: ScenePlan
    digest: str
    store_url: StoreUrl
    index: Index
    offsets: np.ndarray
    footprints: np.ndarray
    until: int
    target: float
    assets: Assets | None = None
    owner: str = ""
    insists: bool = False
    shown: Isovalue | None = None
    whole: Whole | None = None
    enough: int = MAX_SAMPLES
    keeps: bool = False
    light: Chunk | None = None


@dataclass(frozen=True)
class BakeResult:
    """The result of a task.

    ``unfinished`` texels are not final yet. ``priority`` is that of their next path, a mean over
    the paths taken, and ``effort`` the work done and left. ``cost`` is the task's own. The task is
    a ``duplicate`` where all its light was there already, and has ``healed`` the chunk where that
    was damaged. So many texels ``kept`` the light of a whole volume. With another baker at the
    chunk (``elsewhere``) nothing was done. ``chunk`` is its light where the server keeps that, in
    which the layers that ``changed`` are not written: all of it, or of the task's texels where the
    server has sent these.
    """

    unfinished: int
    priority: float
    effort: Effort
    cost: Cost
    duplicate: bool = False
    healed: bool = False
    elsewhere: bool = False
    kept: int = 0
    chunk: Chunk | None = None
    changed: tuple[bool, ...] = ()


BAKED_ELSEWHERE = BakeResult(0, 0.0, Effort(0, 0.0, 0.0), Cost(), elsewhere=True)


@lru_cache(maxsize=4)
def open_store(store_url: StoreUrl) -> Store:
    """The store at a URL, opened once a process with the process's own credentials. The server has
    made it.
    """
    return Store(store_url, make=False)


@lru_cache(maxsize=4)
def claims_of(store_url: StoreUrl) -> Claims:
    """The claims in a store, kept once a process."""
    return Claims(open_store(store_url))


@lru_cache(maxsize=4)
def prepared_scene(
    source: SceneSource, assets: Assets | None, store_url: StoreUrl
) -> PreparedScene:
    """The prepared scene, opened once a process for all of its bakes: as the server shares it, from
    its files, or its assets in the store.
    """
    if isinstance(assets, SharedScene):
        with suppress(SharedMemoryError):  # the server has let go of the scene: its files are read
            return receive_scene(assets, most_maps())
        return opened(source)
    if assets is None:
        return opened(source)
    received, volume = receive_assets(source, assets, open_store(store_url))
    store = open_store(store_url)
    known = receive_colours(assets, store), receive_glow_bits(assets, store)
    return PreparedScene(build_scene(received, no_progress, volume, *known), most_maps())


MAP_BYTES_SHARE = 3 / 8
"""Bytes of active-cell maps that a worker keeps of a volume, over those that it may hold of mapped
voxels.
"""


def most_maps() -> int:
    """Most bytes of a volume's active-cell maps."""
    return int(MAP_BYTES_SHARE * budget())


OPEN: WeakValueDictionary[str, PreparedScene] = WeakValueDictionary()
"""The scenes that this process has open, by their volumes and how rays meet these."""

VOXEL_INDEPENDENT_SETTINGS = (
    "lights",
    "environment",
    "lattice",
    "albedo",
    "albedos",
    "transmission",
    "surfaces",
    "clear",
    "material",
)
"""Settings of a scene, besides a material's numbers, that nothing depends on which is worked out of
its voxels.
"""


def opened(source: SceneSource) -> PreparedScene:
    """A scene opened from its files; another of the same volume that is open shares what it has
    worked out of it.
    """
    rest = {
        key: value
        for key, value in source.document.items()
        if key not in (*VOXEL_INDEPENDENT_SETTINGS, *MATERIAL_NUMBERS)
    }
    key = json.dumps([str(source.base), rest], sort_keys=True, default=str)
    known = OPEN.get(key)
    if known is None:
        prepared = PreparedScene(build_scene(source), most_maps())
    else:
        bare = {
            name: value for name, value in source.document.items() if name not in VOXEL_SETTINGS
        }
        scene = known.scene
        shared = scene.volume, scene.surfaces.colours, scene.lighting.glowing.bits
        prepared = known.beside(build_scene(replace(source, document=bare), no_progress, *shared))
    OPEN[key] = prepared
    return prepared


@lru_cache(maxsize=16)
def open_spec(
    source: SceneSource,
    plan: ScenePlan,
    digest: str,
    store_url: StoreUrl,
    assets: Assets | None = None,
    shown: Isovalue | None = None,
) -> tuple[BakeSpec, ChunkStore]:
    """A bake's spec and chunk store, opened once a process; its kernels are loaded too.

    Raises SceneError where the scene's files are not those of ``digest``.
    """
    found = BakeSpec(prepared_scene(source, assets, store_url), plan, shown)
    if found.digest != digest:
        prepared_scene.cache_clear()
        OPEN.clear()
        found = BakeSpec(prepared_scene(source, assets, store_url), plan, shown)
    if found.digest != digest:
        raise SceneError(
            f"The files of the scene '{source.name}' have changed since the server began: "
            "restart it."
        )
    load_kernels(found.kinds)
    if shown is not None:
        load((project_texels,))
    return found, ChunkStore(open_store(store_url), found)


@lru_cache(maxsize=8)
def open_whole(
    whole: Whole,
    source: SceneSource,
    plan: ScenePlan,
    digest: str,
    store_url: StoreUrl,
    assets: Assets | None,
) -> WholeLight | None:
    """The light of the whole that a bake's scene was cut from, opened once a process; None where it
    keeps none.
    """
    spec = BakeSpec(prepared_scene(whole.source, whole.assets, store_url), plan)
    cut, _ = open_spec(source, plan, digest, store_url, assets)
    return light_of_whole(spec, whole.planes(source), cut, open_store(store_url))


def attempt(work: Callable[[], object]) -> None:
    """Do some work ahead of its time: where it fails, it will fail again when it is due, and be
    reported then.
    """
    with suppress(Exception):
        work()


Outcome = BakeResult | Exception
"""What became of a task."""


def bake_all(tasks: Sequence[BakeTask]) -> list[Outcome]:
    """Do tasks of one bake and target together, each as ``bake`` does it, so that their texels'
    paths fill waves.

    Where that fails each is done alone: what is wrong with one chunk harms no other.
    """
    try:
        return [*bake_together(tasks)]
    except StoreAwayError as error:
        return [error for _ in tasks]
    except Exception:
        return [outcome_of(task) for task in tasks]


def outcome_of(task: BakeTask) -> Outcome:
    """What becomes of a task that is done alone."""
    try:
        return bake(task)
    except Exception as error:
        return error


def bake(task: BakeTask) -> BakeResult:
    """Do a task, unless another baker has claimed its chunk. Raises StoreAwayError where the store
    is away.
    """
    (result,) = bake_together([task])
    return result


def bake_together(tasks: Sequence[BakeTask]) -> list[BakeResult]:
    """Do tasks of one bake and target, but those whose chunks other bakers have claimed."""
    first = tasks[0]
    spec, chunk_store = open_spec(
        first.source, first.plan, first.digest, first.store_url, first.assets, first.shown
    )
    claims = claims_of(first.store_url)
    digest = chunk_store.layers[0].digest
    with ExitStack() as held:
        names = [".".join(map(str, (digest, *task.index))) for task in tasks]
        ours = [
            held.enter_context(claims.on(name, task.owner, task.insists))
            for name, task in zip(names, tasks, strict=True)
        ]
        done = iter(bake_chunks([*compress(tasks, ours)], spec, chunk_store, claims))
        return [next(done) if own else BAKED_ELSEWHERE for own in ours]


@dataclass(frozen=True, eq=False)
class Work:
    """A task on its way: its ``chunk``, the ``rows`` of its texels there, and their ``light``.

    ``known`` are the samples of the chunk's parts as they were read, ``healed`` is whether it was
    damaged.
    """

    chunk: Chunk
    rows: np.ndarray
    light: Light
    known: list[np.ndarray]
    healed: bool

    @classmethod
    def begin(cls, task: BakeTask, chunk_store: ChunkStore) -> Self:
        """Read the chunk of a task, unless its light has come with it."""
        damaged = chunk_store.damaged
        chunk = (task.light or chunk_store.load(task.index)).with_texels(task.offsets)
        known = [part.samples.copy() for part in chunk.light.parts]
        chunk.light.agree_on_void()
        rows = chunk.rows_of(task.offsets)
        return cls(chunk, rows, chunk.light.rows(rows), known, chunk_store.damaged > damaged)

    def end(self, light: Light) -> tuple[bool, ...]:
        """Put new ``light`` of its texels into the chunk; which layers have any that is new."""
        self.chunk.light.put(self.rows, light)
        pairs = zip(self.chunk.light.parts, self.known, strict=True)
        return tuple(not np.array_equal(part.samples, old) for part, old in pairs)


def bake_chunks(
    tasks: Sequence[BakeTask], spec: BakeSpec, chunk_store: ChunkStore, claims: Claims
) -> list[BakeResult]:
    """Read the chunks of tasks, add samples to all of them together, write each back as one object,
    or hand it to the server where that keeps it.

    The outcome depends on the texels and their sample counts alone, so a task that is done twice,
    done again after a kill, or done beside others, leaves the same bytes. What it took, to read and
    write as well, is shared by paths.
    """
    if not tasks:
        return []
    begun = time.process_time()
    works = [Work.begin(task, chunk_store) for task in tasks]
    light = Light.joined([work.light for work in works])
    before = light.samples
    texels = np.concatenate(
        [spec.prepared.lattice.positions(task.index, task.offsets) for task in tasks]
    )
    kept = keep_light(light, texels, spec, tasks)
    before[kept] = light.samples[kept]
    sample_texels(light, texels, spec, *tasks)
    bounds = np.cumsum([0, *(len(task.offsets) for task in tasks)]).tolist()
    rows = [slice(a, b) for a, b in pairwise(bounds)]
    news = [
        work.end(light.rows(np.arange(len(light))[own]))
        for work, own in zip(works, rows, strict=True)
    ]
    for task, work, changed in zip(tasks, works, news, strict=True):
        if not task.keeps:
            save(Unwritten(work.chunk, changed), chunk_store, claims)
    results = results_of(light, spec, tasks)
    seconds = time.process_time() - begun
    samples = light.samples
    taken = np.maximum(samples, 0) - np.maximum(before, 0)
    if taken.any():
        shares = taken
    else:
        shares = np.ones(len(light))
    each = seconds / max(shares.sum(), 1)
    return [
        replace(
            result,
            cost=cost_of(samples[own], before[own], float(each * shares[own].sum())),
            duplicate=not any(changed),
            healed=work.healed,
            kept=int(kept[own].sum()),
            chunk=work.chunk if task.keeps else None,
            changed=changed,
        )
        for task, result, work, changed, own in zip(tasks, results, works, news, rows, strict=True)
    ]


@dataclass(frozen=True, eq=False)
class Unwritten:
    """A ``chunk`` that is to be written, as far as its layers have ``changed``."""

    chunk: Chunk
    changed: tuple[bool, ...]


@dataclass(frozen=True, eq=False)
class WriteTask:
    """Write the light of ``chunks`` of one bake, which the other fields name as in a
    ``BakeTask``.
    """

    source: SceneSource
    plan: ScenePlan
    digest: str
    store_url: StoreUrl
    assets: Assets | None
    shown: Isovalue | None
    chunks: tuple[Unwritten, ...]


Written = bool | Exception
"""What became of a chunk that was to be written: whether another writer was met, or an error."""


def write_all(task: WriteTask) -> list[Written]:
    """Write each chunk of a task as one object a layer."""
    _, chunk_store = open_spec(
        task.source, task.plan, task.digest, task.store_url, task.assets, task.shown
    )
    claims = claims_of(task.store_url)
    return [written(each, chunk_store, claims) for each in task.chunks]


def written(each: Unwritten, chunk_store: ChunkStore, claims: Claims) -> Written:
    """What becomes of one chunk that is to be written."""
    try:
        return save(each, chunk_store, claims)
    except Exception as error:
        return error


def save(each: Unwritten, chunk_store: ChunkStore, claims: Claims) -> bool:
    """Write a chunk; whether another writer was met at it. Raises StoreError."""
    met = chunk_store.save(each.chunk, each.changed)
    if met:
        claims.note_contention()
    return met


def keep_light(
    light: Light, texels: np.ndarray, spec: BakeSpec, tasks: Sequence[BakeTask]
) -> np.ndarray:
    """Give texels of tasks of one bake the light that a cut leaves as it is, in place; which have
    it now, (m,) bool.

    Those whose isosurface is not in what is taken away have it at once. Each other takes the first
    samples for the cut itself, which show what that lets in, and walks old paths later.
    """
    first = tasks[0]
    own = first.source, first.plan, first.digest, first.store_url, first.assets
    if first.whole:
        lender = open_whole(first.whole, *own)
    else:
        lender = None
    if lender is None:
        return np.zeros(len(light), np.bool_)
    places = [(task.index, task.offsets) for task in tasks]
    kept = lender.lend(
        light, next_samples(light, spec, first.target, first.enough) == 0, places, walks=False
    )
    sample_texels(
        light, texels, spec, *(replace(task, until=min(task.until, FIRST_LEVEL)) for task in tasks)
    )
    going_on = np.repeat(
        [task.until > FIRST_LEVEL for task in tasks], [len(task.offsets) for task in tasks]
    )
    waiting = going_on & (next_samples(light, spec, first.target, first.enough) == FIRST_LEVEL)
    return kept | lender.lend(light, waiting, places, walks=True)


def sample_texels(light: Light, texels: np.ndarray, spec: BakeSpec, *tasks: BakeTask) -> None:
    """Sample the ``texels`` (m, 3; z, y, x) of tasks of one target, one task's after the other's,
    as far as they go.

    Level by level; ``light`` is in place. How far a texel goes depends on its own task alone.
    """
    target = tasks[0].target
    enough = tasks[0].enough
    until = np.repeat([task.until for task in tasks], [len(task.offsets) for task in tasks])
    waiting = next_samples(light, spec, target, enough)
    located: Located | None = None
    while (climbing := (waiting >= 0) & (waiting < until)).any():
        lowest = int(waiting[climbing].min())
        rows = np.flatnonzero(climbing & (waiting == lowest))
        part = light.rows(rows)
        located = located or locate(texels, spec.prepared, spec.shown)
        refine(part, texels[rows], spec, lowest + 1, target, some_located(located, rows))
        light.put(rows, part)
        waiting[rows] = next_samples(part, spec, target, enough)


def cost_of(samples: np.ndarray, before: np.ndarray, seconds: float) -> Cost:
    """The cost of texels that had so many samples ``before``; parts that are sampled together share
    their paths.
    """
    taken = np.maximum(samples, 0) - np.maximum(before, 0)
    paths = int(taken.sum())
    lit = int(((before == 0) & (samples > 0)).sum())
    return Cost(seconds, paths, lit, seconds * FIRST_LEVEL * lit / max(paths, 1))


def results_of(light: Light, spec: BakeSpec, tasks: Sequence[BakeTask]) -> list[BakeResult]:
    """The results of tasks of one target: what their ``light``, one's after the other's, still
    lacks of that.

    What they cost is still to be reported.
    """
    target = tasks[0].target
    enough = tasks[0].enough
    count = len(tasks)
    numbers = np.repeat(np.arange(count), [len(task.offsets) for task in tasks])
    error = standard_error(light, spec)
    waiting = next_samples(light, spec, target, enough) >= 0
    visible = np.concatenate([task.footprints for task in tasks]) * error**2
    lacking, seen, taken = (
        np.bincount(numbers[waiting], some, count)
        for some in (None, visible[waiting], light.samples[waiting])
    )
    work = efforts(numbers, count, error / level(light, spec), light.samples, target, enough)
    priorities = (seen / np.maximum(taken, 1)).tolist()
    return [
        BakeResult(texels, priority, Effort(*each), Cost())
        for texels, priority, each in zip(lacking.tolist(), priorities, work.tolist(), strict=True)
    ]


async def dask_setup(worker: Any) -> None:
    """Load the kernels of all bakes in a ``worker`` started with ``--preload worker.tasks``, before
    it joins.
    """
    await asyncio.to_thread(load_kernels, PLAIN_LAYER_KINDS)
