"""A task: more light for texels of one chunk. What a worker process runs."""

import asyncio
import time
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from isogi_core.bake.effort import Effort
from isogi_core.bake.light import Light
from isogi_core.bake.look import Look
from isogi_core.bake.noise import relative_error, standard_error
from isogi_core.bake.precision import FIRST_RUNG
from isogi_core.bake.recipe import Index, Recipe
from isogi_core.bake.refine import next_samples, refine
from isogi_core.cache.claims import Claims
from isogi_core.cache.costs import Cost
from isogi_core.cache.parcels import Parcels, receive_parcels
from isogi_core.cache.place import Place
from isogi_core.cache.root import Root
from isogi_core.cache.store import ChunkStore
from isogi_core.errors import SceneError
from isogi_core.kernels.irradiance import bake_irradiance
from isogi_core.kernels.moves import move_texels
from isogi_core.kernels.transfer import bake_texels, locate_texels
from isogi_core.kernels.warm import entries_of, load
from isogi_core.model.plan import ScenePlan
from isogi_core.model.scene import build_scene
from isogi_core.model.source import SceneSource

PATHS = {"direct": bake_texels, "indirect": bake_texels, "whole": bake_texels, "irradiance": bake_irradiance}
"""The entry kernel that bakes layers of a kind."""

KINDS = tuple(PATHS)
"""The kinds of layers that can be baked."""


@dataclass(frozen=True, eq=False)
class BakeTask:
    """Bring the texels at ``offsets`` of a chunk to ``until`` samples each, or until the next path is worth too little.

    That is less than ``least``, see ``worths``, where they are seen by their ``footprints``; and they are final at the
    relative error ``target``. ``plan`` says what is baked; ``digest`` names the light that the server means: the
    files may have changed since. Where there are ``parcels``, these are read in place of the scene's files. ``owner``
    has it done, and claims the chunk where others are at work too; where it ``insists``, whoever claimed it before.
    Texels lie on the isosurface that is ``shown``, where one is: see ``Look``.
    """

    source: SceneSource
    plan: ScenePlan
    digest: str
    store: Place
    index: Index
    offsets: np.ndarray
    footprints: np.ndarray
    until: int
    least: float
    target: float
    parcels: Parcels | None = None
    owner: str = ""
    insists: bool = False
    shown: float | None = None


@dataclass(frozen=True)
class BakeResult:
    """What a task left and took.

    ``unfinished`` texels are not final yet; ``worth`` is that of their next path, a mean over the paths they took, and
    ``effort`` what they took and will. ``cost`` is what the task itself took. It is a ``duplicate`` where all was there
    already, and has ``healed`` the chunk where that was damaged. With somebody ``elsewhere`` at the chunk nothing was
    done.
    """

    unfinished: int
    worth: float
    effort: Effort
    cost: Cost
    duplicate: bool = False
    healed: bool = False
    elsewhere: bool = False


ELSEWHERE = BakeResult(0, 0.0, Effort(0, 0.0, 0.0), Cost(), elsewhere=True)


@lru_cache(maxsize=4)
def root_of(store: Place) -> Root:
    """The root of a store, opened once a process with the process's own credentials. It was made by the server."""
    return Root(store, make=False)


@lru_cache(maxsize=4)
def claims_of(store: Place) -> Claims:
    """The claims in a store, as this process knows them."""
    return Claims(root_of(store))


@lru_cache(maxsize=4)
def recipe_of(source: SceneSource, parcels: Parcels | None, store: Place) -> Recipe:
    """The scene, opened once a process for all of its looks: from its files, or from its parcels in the store."""
    if parcels is None:
        return Recipe(build_scene(source))
    received, volume = receive_parcels(source, parcels, root_of(store))
    return Recipe(build_scene(received, volume=volume))


@lru_cache(maxsize=16)
def opened(
    source: SceneSource,
    plan: ScenePlan,
    digest: str,
    store: Place,
    parcels: Parcels | None = None,
    shown: float | None = None,
) -> tuple[Look, ChunkStore]:
    """A look and its store, opened once a process, and the kernels that its bake takes.

    SceneError where the scene's files are not those of ``digest``.
    """
    found = Look(recipe_of(source, parcels, store), plan, shown)
    if found.digest != digest:
        recipe_of.cache_clear()
        found = Look(recipe_of(source, parcels, store), plan, shown)
    if found.digest != digest:
        raise SceneError(f"The files of the scene '{source.name}' have changed since the server began: restart it.")
    load_kernels({layer.kind for layer in plan.layers})
    if shown is not None:
        load((move_texels,))
    return found, ChunkStore(root_of(store), found)


def bake(task: BakeTask) -> BakeResult:
    """Do a task, unless somebody else is at its chunk. Raises StoreAwayError where it may be done later."""
    look, store = opened(task.source, task.plan, task.digest, task.store, task.parcels, task.shown)
    claims, name = claims_of(task.store), ".".join(map(str, (store.layers[0].digest, *task.index)))
    with claims.on(name, task.owner, task.insists) as ours:
        return filled(task, look, store, claims) if ours else ELSEWHERE


def filled(task: BakeTask, look: Look, store: ChunkStore, claims: Claims) -> BakeResult:
    """Read the chunk of a task, add samples, write it back as one object.

    The outcome depends on the texels and their sample counts alone, so a task that is done twice,
    or done again after a kill, leaves the same bytes.
    """
    damaged = store.damaged
    chunk = store.load(task.index).with_texels(task.offsets)
    known = [part.samples.copy() for part in chunk.light.parts]
    chunk.light.agree_on_void()
    rows = chunk.rows_of(task.offsets)
    light, before = chunk.light.rows(rows), chunk.light.samples[rows]
    begun = time.process_time()
    climb(light, look.recipe.lattice.positions(task.index, task.offsets), look, task)
    seconds = time.process_time() - begun
    chunk.light.put(rows, light)
    pairs = zip(chunk.light.parts, known, strict=True)
    changed = [not np.array_equal(part.samples, old) for part, old in pairs]
    if store.save(chunk, changed):
        claims.meet()
    result = result_of(light, look, task, cost_of(light.samples, before, seconds))
    return replace(result, duplicate=not any(changed), healed=store.damaged > damaged)


def climb(light: Light, texels: np.ndarray, look: Look, task: BakeTask) -> None:
    """Do a task to the ``light`` of its ``texels`` (m, 3; z, y, x), in place: rung by rung where it is worth it."""
    waiting, worth = next_samples(light, look, task.target), worths(light, look, task.footprints)
    while (worthy := (waiting >= 0) & (waiting < task.until) & (worth >= task.least)).any():
        rung = int(waiting[worthy].min())
        rows = np.flatnonzero(worthy & (waiting == rung))
        part = light.rows(rows)
        refine(part, texels[rows], look, rung + 1, task.target)
        light.put(rows, part)
        waiting[rows] = next_samples(part, look, task.target)
        worth = worths(light, look, task.footprints)


def worths(light: Light, look: Look, footprints: np.ndarray) -> np.ndarray:
    """What the next path of each texel is worth: its visible variance over the paths it took; (texels,) float64.

    Variance falls with a power of the samples, so that the next path takes off as much, times that power. Texels
    whose next path is worth the same add least to a frame's error for all paths together; texels of the same error
    do not: the noisy and the hardly seen ones would have taken too many. A few paths that agree by chance tell of no
    variance at all: half of what is counted is the mean over the chunk's texels.
    """
    variance = standard_error(light, look) ** 2
    usual = variance[light.samples > 0].mean() if (light.samples > 0).any() else 0.0
    seen = footprints * (variance + usual) / 2.0
    return np.asarray(np.where(light.samples > 0, seen / np.maximum(light.samples, 1), np.inf))


def cost_of(samples: np.ndarray, before: np.ndarray, seconds: float) -> Cost:
    """The cost of texels that had so many samples ``before``; parts that climb together are of the same paths."""
    taken = np.maximum(samples, 0) - np.maximum(before, 0)
    paths, lit = int(taken.sum()), int(((before == 0) & (samples > 0)).sum())
    return Cost(seconds, paths, lit, seconds * FIRST_RUNG * lit / max(paths, 1))


def result_of(light: Light, look: Look, task: BakeTask, cost: Cost) -> BakeResult:
    """What ``light`` still lacks of a task's target, and what was spent on it."""
    waiting = next_samples(light, look, task.target) >= 0
    seen = task.footprints[waiting] @ standard_error(light, look)[waiting] ** 2
    worth = float(seen) / max(int(light.samples[waiting].sum()), 1)
    effort = Effort.of(relative_error(light, look), light.samples, task.target)
    return BakeResult(int(waiting.sum()), worth, effort, cost)


def bake_kernels(kinds: Iterable[str]) -> tuple[Any, ...]:
    """The entry kernels that baking layers of these ``kinds`` takes, besides those that open a scene."""
    return (*{PATHS[kind] for kind in kinds}, locate_texels)


def kernels_missing(kinds: Iterable[str]) -> bool:
    """Whether kernels that bake layers of these ``kinds`` are yet to be compiled on this machine."""
    return any(not entry.stored for entry in entries_of(bake_kernels(kinds)))


def load_kernels(kinds: Iterable[str]) -> None:
    """Compile or load the kernels that bake layers of these ``kinds``, before there is anything to bake."""
    load(bake_kernels(kinds))


async def dask_setup(worker: Any) -> None:
    """Have a ``worker`` started with ``--preload worker.tasks`` load the kernels of all bakes, and then come."""
    await asyncio.to_thread(load_kernels, KINDS)
