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
from isogi_core.bake.noise import Effort, Goal, efforts, level, standard_error
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
    locate_texels,
    project_texels,
)
from isogi_core.model.scene_plan import ScenePlan
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
"""The data that a worker opens in place of a scene's files:
copies of them in the store, or memory that the server shares with processes of its machine.
"""


@dataclass(frozen=True)
class Whole:
    """The scene that another was cut from: its ``source``,
    and the ``assets`` that workers open in place of its files.
    """

    source: SceneSource
    assets: Assets | None = None

    def planes(self, cut: SceneSource) -> str:
        """Return the planes by which the scene ``cut`` is cut in addition to those of the whole, as
        the setting ``cut`` of a scene lists them: separated by semicolons.
        """
        # A view adds its planes behind those that the whole is cut by already: leave these out.
        former, all_planes = (str(each.document.get("cut", "")) for each in (self.source, cut))
        if former:
            return all_planes.removeprefix(f"{former};")
        return all_planes


@dataclass(frozen=True, eq=False)
class WholeLight:
    """The light of a whole volume in a store,
    and the part of the volume that ``remains`` in a cut.
    """

    chunks: ChunkStore
    remains: Remains

    def lend(
        self,
        light: Light,
        waiting: np.ndarray,
        places: Sequence[tuple[Index, np.ndarray]],
    ) -> np.ndarray:
        """Copy light of the whole to texels of the cut whose light the cut does not change; return
        the texels that got it, (m,) bool.

        ``light`` is changed in place. Its rows are the texels of ``places``, pairs of a chunk and
        offsets in it, in order. ``waiting`` (m,) bool marks the texels that may take light.
        """
        lattice = self.chunks.spec.prepared.lattice
        kept = np.zeros(len(light), np.bool_)
        bounds = np.cumsum([0, *(len(offsets) for _, offsets in places)]).tolist()
        rows = list[np.ndarray]()
        texels = list[np.ndarray]()
        found = list[Light]()
        # Read the chunks of the whole, and collect the light of waiting texels there.
        for (index, offsets), (first, last) in zip(places, pairwise(bounds), strict=True):
            if waiting[first:last].any():
                chunk = self.chunks.read(index)
            else:
                chunk = None
            if chunk is None:
                continue
            there = np.flatnonzero(waiting[first:last] & np.isin(offsets, chunk.offsets))
            rows.append(first + there)
            texels.append(lattice.positions(index, offsets[there]))
            found.append(chunk.light.rows(chunk.rows_of(offsets[there])))
        if not any(map(len, rows)):
            return kept
        whole = Light.joined(found)
        every = np.concatenate(rows)
        whole.agree_on_void()
        # Take light of more samples only, and only if no path of it met matter that is cut away.
        ahead = np.flatnonzero(whole.samples > light.samples[every])
        stays = ahead[find_kept(np.concatenate(texels)[ahead], self.chunks.spec, self.remains)]
        light.put(every[stays], whole.rows(stays))
        kept[every[stays]] = True
        return kept


def light_of_whole(spec: BakeSpec, planes: str, cut: BakeSpec, store: Store) -> WholeLight | None:
    """Return the light by a ``spec`` of a whole volume for a ``cut`` by ``planes``; None if the cut
    can keep none of it.

    That is so if the kind of light does not allow it, or if the volume of the cut is another one.
    """
    whole = spec.prepared.scene.volume
    left = cut.prepared.scene.volume
    if not keeps(spec) or cut_digest(whole, planes) != left.digest:
        return None
    return WholeLight(ChunkStore(store, spec), Remains.of(whole, voxels_left(whole, planes)))


KERNELS_OF_LAYER = {
    **{"direct": (bake_texels,), "indirect": (bake_texels,), "whole": (bake_texels,)},
    **{"irradiance": (bake_irradiance,), COLOURED_KIND: (bake_coloured_texels,)},
    **{kind: path_kernels(*cell) for cell, kind in PATH_KINDS.items()},
}
"""Entry kernels by the kind of layer that they bake.
Walls, several surfaces and colours have kinds, and kernels, of their own.
"""

PLAIN_LAYER_KINDS = tuple(
    kind for kind in KERNELS_OF_LAYER if kind not in (COLOURED_KIND, *PATH_KINDS.values())
)
"""Kinds of layers of scenes with one surface, without walls, colours and glow."""

OPENING_KERNELS = (fill_macrocells, fill_ranges, mark_bricks, pack_bricks, number_bricks)
"""Entry kernels that open a scene and map its isosurfaces."""


def bake_kernels(kinds: Iterable[str]) -> tuple[Any, ...]:
    """Return the entry kernels that bake layers of these ``kinds``,
    without those that open a scene.
    """
    return (*{kernel for kind in kinds for kernel in KERNELS_OF_LAYER[kind]}, locate_texels)


def kernels_missing(kinds: Iterable[str]) -> bool:
    """Return True if kernels that bake layers
    of these ``kinds`` are not compiled yet on this machine.
    """
    return any(not entry.stored for entry in entries_of(bake_kernels(kinds)))


def load_kernels(kinds: Iterable[str]) -> None:
    """Load the kernels that bake layers of these ``kinds``; compile them if need be."""
    load(bake_kernels(kinds))


@dataclass(frozen=True, eq=False)
class BakeTask:
    """A task: bring the texels at ``offsets`` of a chunk, seen by their ``footprints``, to
    ``until`` samples. Texels need no more once they are good for pictures with the ``goal``.

    - ``source``, ``assets``: the scene; assets are opened in place of its files.
    - ``plan``, ``digest``: the layers to bake, and the name of the light that the server means, as
      the scene's files may have changed since.
    - ``owner``, ``insists``: the baker that claims the chunk while others are at work too; if it
      insists, it takes over a claim of another one.
    - ``shown``: if given, texels are projected onto that isosurface; see ``BakeSpec``.
    - ``whole``: the scene that this one was cut from; texels keep its light if the cut does not
      change it.
    - ``keeps``: True if the server keeps the light. It then comes with the result, and is written
      later by a ``WriteTask``.
    - ``light``: the light of the texels, if the server keeps it and has the chunk.
    """

    source: SceneSource
    plan: ScenePlan
    digest: str
    store_url: StoreUrl
    index: Index
    offsets: np.ndarray
    footprints: np.ndarray
    until: int
    goal: Goal
    assets: Assets | None = None
    owner: str = ""
    insists: bool = False
    shown: Isovalue | None = None
    whole: Whole | None = None
    keeps: bool = False
    light: Chunk | None = None


@dataclass(frozen=True)
class BakeResult:
    """The result of a task.

    - ``unfinished``: number of texels that are not final yet.
    - ``priority``: squared visible error over the paths taken; see ``bake_requests.priority_of``.
    - ``effort``: the work done and left.
    - ``cost``: the cost of this task.
    - ``duplicate``: True if all of its light was there already.
    - ``healed``: True if the chunk was damaged, and is replaced.
    - ``elsewhere``: True if another baker has claimed the chunk; nothing was done.
    - ``kept``: number of texels that kept the light of a whole volume.
    - ``chunk``, ``changed``: the light, if the server keeps it, and the layers that are not
      written. It is all of the chunk, or only the task's texels if the server has sent these.
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
    """Return the store at a URL, opened with this process's own credentials, and kept for later
    tasks.

    It is not made if it is missing, as the server makes it.
    """
    return Store(store_url, make=False)


@lru_cache(maxsize=4)
def claims_of(store_url: StoreUrl) -> Claims:
    """Return the claims in a store, kept for later tasks, as they remember other bakers."""
    return Claims(open_store(store_url))


@lru_cache(maxsize=4)
def prepared_scene(
    source: SceneSource, assets: Assets | None, store_url: StoreUrl
) -> PreparedScene:
    """Return the prepared scene. This process keeps the last four for later tasks.

    A scene that the server shares is mapped from the server's memory, or opened from its files if
    that memory is gone. A scene with other assets is built from these, which the store has. Any
    other scene is opened from its files. Raises StoreError if assets are missing or damaged.
    """
    if isinstance(assets, SharedScene):
        try:
            return receive_scene(assets, most_maps())
        except SharedMemoryError:
            # The server has let go of the memory.
            return opened(source)
    if assets is None:
        return opened(source)
    store = open_store(store_url)
    received, volume = receive_assets(source, assets, store)
    colours = receive_colours(assets, store)
    glow_bits = receive_glow_bits(assets, store)
    scene = build_scene(received, no_progress, volume, colours, glow_bits)
    return PreparedScene(scene, most_maps())


MAP_BYTES_SHARE = 3 / 8
"""Bytes of active-cell maps that a worker keeps of a volume,
as a share of those that it may hold of mapped voxels.
"""


def most_maps() -> int:
    """Return the most bytes of a volume's active-cell maps."""
    return int(MAP_BYTES_SHARE * budget())


OPEN: WeakValueDictionary[str, PreparedScene] = WeakValueDictionary()
"""The scenes that this process has open,
by their volumes and all settings that change how rays meet these.
"""

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
"""Settings of a scene, besides the numbers of a material,
that nothing derived from its voxels depends on.
"""


def opened(source: SceneSource) -> PreparedScene:
    """Open a scene from its files.

    If a scene that differs only in settings that do not change its voxels is open, the new one
    shares the voxels, and all that is derived from them.
    """
    # Two scenes share voxels if all other settings are equal.
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
        # Another scene of the same volume is open: take voxels, colours and glow from there, and
        # build only the rest.
        bare = {
            name: value for name, value in source.document.items() if name not in VOXEL_SETTINGS
        }
        scene = known.scene
        shared = scene.volume, scene.surfaces.colours, scene.lighting.glowing.bits
        prepared = known.beside(build_scene(replace(source, document=bare), no_progress, *shared))
    OPEN[key] = prepared
    return prepared


def open_spec(
    source: SceneSource,
    plan: ScenePlan,
    digest: str,
    store_url: StoreUrl,
    assets: Assets | None = None,
    shown: Isovalue | None = None,
) -> tuple[BakeSpec, ChunkStore]:
    """Return a bake's spec and chunk store, with its kernels loaded; both are kept for later tasks.

    Raises SceneError if the scene's files are not those of ``digest``.
    """
    # The cache tells calls with and without arguments of the same values apart.
    return _kept_spec(source, plan, digest, store_url, assets, shown)


@lru_cache(maxsize=16)
def _kept_spec(
    source: SceneSource,
    plan: ScenePlan,
    digest: str,
    store_url: StoreUrl,
    assets: Assets | None,
    shown: Isovalue | None,
) -> tuple[BakeSpec, ChunkStore]:
    found = BakeSpec(prepared_scene(source, assets, store_url), plan, shown)
    # The files may have changed since this process opened them: read them once more.
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
    """Return the light of the ``whole``, the scene before its volume was cut, of which the bake of
    the cut scene keeps the light that the cut does not change; None if there is none.

    It is kept for later tasks. The other arguments describe the bake of the cut scene.
    """
    spec = BakeSpec(prepared_scene(whole.source, whole.assets, store_url), plan)
    cut, _ = open_spec(source, plan, digest, store_url, assets)
    return light_of_whole(spec, whole.planes(source), cut, open_store(store_url))


def attempt(work: Callable[[], object]) -> None:
    """Do some ``work`` ahead of its time, and ignore failure:
    it fails again when it is due, and is reported then.
    """
    with suppress(Exception):
        work()


Outcome = BakeResult | Exception
"""The outcome of a task."""


def bake_all(tasks: Sequence[BakeTask]) -> list[Outcome]:
    """Do tasks of one bake and goal together, so that the paths of their texels fill whole waves.

    A wave is the paths that a kernel advances together, up to WAVE_PATHS. If the tasks fail
    together, do each alone, so that a fault of one chunk harms no other. A chunk that was written
    before the failure gets the same light again: see ``bake_chunks``.
    """
    try:
        return [*bake_together(tasks)]
    except StoreAwayError as error:
        # Each task alone would find the store away, too.
        return [error for _ in tasks]
    except Exception:
        return [outcome_of(task) for task in tasks]


def outcome_of(task: BakeTask) -> Outcome:
    """Do a task alone; return its result, or the error that it raised."""
    try:
        return bake(task)
    except Exception as error:
        return error


def bake(task: BakeTask) -> BakeResult:
    """Do a single task, unless another baker has claimed its chunk.

    Raises StoreAwayError if the store is away.
    """
    (result,) = bake_together([task])
    return result


def bake_together(tasks: Sequence[BakeTask]) -> list[BakeResult]:
    """Do tasks of one bake and goal, except those whose chunks other bakers have claimed; return
    a result for each, BAKED_ELSEWHERE for the excepted ones.
    """
    first = tasks[0]
    spec, chunk_store = open_spec(
        first.source, first.plan, first.digest, first.store_url, first.assets, first.shown
    )
    claims = claims_of(first.store_url)
    digest = chunk_store.layers[0].digest
    with ExitStack() as held:
        # Claim each chunk until its light is written or handed back, and bake those that are free.
        # Claims are named by the first layer, so that bakes of other plans that have it in common
        # notice them, too.
        names = [".".join(map(str, (digest, *task.index))) for task in tasks]
        ours = [
            held.enter_context(claims.on(name, task.owner, task.insists))
            for name, task in zip(names, tasks, strict=True)
        ]
        done = iter(bake_chunks([*compress(tasks, ours)], spec, chunk_store, claims))
        return [next(done) if free else BAKED_ELSEWHERE for free in ours]


@dataclass(frozen=True, eq=False)
class Work:
    """A task at work: its ``chunk``, the ``rows`` of its texels there, and their ``light``.

    ``known`` are the samples of each layer as they were read, and ``healed`` is True if the chunk
    was damaged.
    """

    chunk: Chunk
    rows: np.ndarray
    light: Light
    known: list[np.ndarray]
    healed: bool

    @classmethod
    def begin(cls, task: BakeTask, chunk_store: ChunkStore) -> Self:
        """Begin a task: read its chunk from the store, unless the server has sent the light along.

        Texels of the task that the chunk lacks are added without light. Raises StoreError.
        """
        # The store counts damaged objects: if the count grows, this chunk has one.
        damaged = chunk_store.damaged
        chunk = (task.light or chunk_store.load(task.index)).with_texels(task.offsets)
        # Copy the samples before void texels are made so in all layers: ``end`` then finds that the
        # layers to which this adds void texels have changed, and must be written.
        known = [part.samples.copy() for part in chunk.light.parts]
        chunk.light.agree_on_void()
        rows = chunk.rows_of(task.offsets)
        return cls(chunk, rows, chunk.light.rows(rows), known, chunk_store.damaged > damaged)

    def end(self, light: Light) -> tuple[bool, ...]:
        """Put new ``light`` of the texels into the chunk; return the layers that have changed."""
        self.chunk.light.put(self.rows, light)
        pairs = zip(self.chunk.light.parts, self.known, strict=True)
        return tuple(not np.array_equal(part.samples, old) for part, old in pairs)


def bake_chunks(
    tasks: Sequence[BakeTask], spec: BakeSpec, chunk_store: ChunkStore, claims: Claims
) -> list[BakeResult]:
    """Do tasks: read their chunks, add samples to all texels together, and write each chunk as one
    object a layer.

    If the server keeps the light, the chunk is handed back instead.

    The result depends only on the texels and their sample counts. So a task that is done twice,
    again after a kill, or together with others leaves the same bytes. The cost of the tasks,
    reading and writing included, is divided among them in proportion to paths.
    """
    if not tasks:
        return []
    begun = time.process_time()
    # Read the chunks, and join the light of all texels.
    works = [Work.begin(task, chunk_store) for task in tasks]
    light = Light.joined([work.light for work in works])
    before = light.samples
    texels = np.concatenate(
        [spec.prepared.lattice.positions(task.index, task.offsets) for task in tasks]
    )
    # Texels of a cut may keep light of the whole; this light cost no paths.
    kept = keep_light(light, spec, tasks)
    before[kept] = light.samples[kept]
    sample_texels(light, texels, spec, *tasks)
    # Put the light back into the chunks, and write those that the server does not keep.
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
    # Divide the time among tasks by the paths they took, or by texels if none took any.
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
    """A ``chunk`` to write, and the layers that have ``changed``."""

    chunk: Chunk
    changed: tuple[bool, ...]


@dataclass(frozen=True, eq=False)
class WriteTask:
    """A task: write the light of ``chunks`` of one bake.

    The other fields are as in a ``BakeTask``.
    """

    source: SceneSource
    plan: ScenePlan
    digest: str
    store_url: StoreUrl
    assets: Assets | None
    shown: Isovalue | None
    chunks: tuple[Unwritten, ...]


Written = bool | Exception
"""The outcome of writing a chunk:
True if another writer was found at it, False if not, or an error.
"""


def write_all(task: WriteTask) -> list[Written]:
    """Write each chunk of a task as one object a layer."""
    _, chunk_store = open_spec(
        task.source, task.plan, task.digest, task.store_url, task.assets, task.shown
    )
    claims = claims_of(task.store_url)
    return [written(each, chunk_store, claims) for each in task.chunks]


def written(each: Unwritten, chunk_store: ChunkStore, claims: Claims) -> Written:
    """Write a chunk, and return the outcome."""
    try:
        return save(each, chunk_store, claims)
    except Exception as error:
        return error


def save(each: Unwritten, chunk_store: ChunkStore, claims: Claims) -> bool:
    """Write a chunk; return True if another writer was found at it. Raises StoreError."""
    met = chunk_store.save(each.chunk, each.changed)
    if met:
        claims.note_contention()
    return met


def keep_light(light: Light, spec: BakeSpec, tasks: Sequence[BakeTask]) -> np.ndarray:
    """Give texels without light, of tasks of one bake, the light of the whole that a cut does not
    change, in place; return these, (m,) bool.
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
    waiting = next_samples(light, spec, first.goal) == 0
    return lender.lend(light, waiting, places)


def sample_texels(light: Light, texels: np.ndarray, spec: BakeSpec, *tasks: BakeTask) -> None:
    """Add samples to the ``texels`` (m, 3; z, y, x) of tasks of one goal, level by level;
    ``light`` is changed in place.

    The rows are those of one task after the other. The number of samples that a texel gets depends
    on its task only, and not on the other tasks.
    """
    goal = tasks[0].goal
    until = np.repeat([task.until for task in tasks], [len(task.offsets) for task in tasks])
    waiting = next_samples(light, spec, goal)
    located: Located | None = None
    while (climbing := (waiting >= 0) & (waiting < until)).any():
        # All texels at the lowest level climb together; then ask again which ones are good enough.
        lowest = int(waiting[climbing].min())
        rows = np.flatnonzero(climbing & (waiting == lowest))
        part = light.rows(rows)
        located = located or locate(texels, spec.prepared, spec.shown)
        refine(part, texels[rows], spec, lowest + 1, goal, some_located(located, rows))
        light.put(rows, part)
        waiting[rows] = next_samples(part, spec, goal)


def cost_of(samples: np.ndarray, before: np.ndarray, seconds: float) -> Cost:
    """Return the cost of a task that took ``seconds`` of a processor, and brought its texels from
    ``before`` to ``samples``, (m,) int each, negative for void texels.

    A sample of a texel counts as one path, for however many layers. A texel that had no samples and
    has some now got first light by FIRST_LEVEL paths. The seconds of first light are the share of
    ``seconds`` that these paths have in all paths. As a rule a task brings either first light or
    other light, so that its share is 1 or 0: see ``bake_requests.next_until``.
    """
    taken = np.maximum(samples, 0) - np.maximum(before, 0)
    paths = int(taken.sum())
    lit = int(((before == 0) & (samples > 0)).sum())
    return Cost(seconds, paths, lit, seconds * FIRST_LEVEL * lit / max(paths, 1))


def results_of(light: Light, spec: BakeSpec, tasks: Sequence[BakeTask]) -> list[BakeResult]:
    """Return the results of tasks of one goal: how many texels of each are not final, how urgent
    more light is, and the samples that it will take.

    The rows of ``light`` are the texels of one task after the other. The cost is filled in later.
    """
    goal = tasks[0].goal
    count = len(tasks)
    numbers = np.repeat(np.arange(count), [len(task.offsets) for task in tasks])
    # Over the texels of each task that are not final, count them, and sum up their squared errors,
    # weighted by how much of each texel is seen, and their samples.
    error = standard_error(light, spec)
    waiting = next_samples(light, spec, goal) >= 0
    visible = np.concatenate([task.footprints for task in tasks]) * error**2
    lacking, seen, taken = (
        np.bincount(numbers[waiting], weights, count)
        for weights in (None, visible[waiting], light.samples[waiting])
    )
    # Predict the samples left: errors of goals are relative, so divide by the level of luminance.
    work = efforts(numbers, count, error / level(light, spec), light.samples, goal)
    # The squared error falls with a power of the number of samples, so the next sample reduces it
    # in proportion to squared error over samples.
    priorities = (seen / np.maximum(taken, 1)).tolist()
    return [
        BakeResult(texels, priority, Effort(*each), Cost())
        for texels, priority, each in zip(lacking.tolist(), priorities, work.tolist(), strict=True)
    ]


async def dask_setup(worker: Any) -> None:
    """Load the kernels of all bakes in a ``worker`` started
    with ``--preload isogi_worker.tasks``, before it joins.
    """
    await asyncio.to_thread(load_kernels, PLAIN_LAYER_KINDS)
