"""A task: more light for texels of one chunk. What a worker process runs."""

import asyncio
import time
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from isogi_core.bake.look import Look
from isogi_core.bake.precision import FIRST_RUNG
from isogi_core.bake.recipe import Index, Recipe
from isogi_core.bake.refine import next_samples, refine
from isogi_core.cache.store import ChunkStore
from isogi_core.errors import SceneError
from isogi_core.kernels.irradiance import bake_irradiance
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
    """Bring the texels at ``offsets`` of a chunk to the relative error ``target``, or to ``until`` samples each.

    ``plan`` says what is baked; ``digest`` names the light that the server means: the files may have changed since.
    """

    source: SceneSource
    plan: ScenePlan
    digest: str
    store: str
    index: Index
    offsets: np.ndarray
    until: int
    target: float


@dataclass(frozen=True)
class BakeResult:
    """What a task left: texels not final yet, the fewest samples among them, and the seconds it took."""

    unfinished: int
    fewest: int
    seconds: float


@lru_cache(maxsize=4)
def recipe_of(source: SceneSource) -> Recipe:
    """The scene, opened once a process for all of its looks."""
    return Recipe(build_scene(source))


@lru_cache(maxsize=16)
def opened(source: SceneSource, plan: ScenePlan, digest: str, store: str) -> tuple[Look, ChunkStore]:
    """A look and its store, opened once a process; SceneError where the scene's files are not those of ``digest``."""
    found = Look(recipe_of(source), plan)
    if found.digest != digest:
        recipe_of.cache_clear()
        found = Look(recipe_of(source), plan)
    if found.digest != digest:
        raise SceneError(f"The files of the scene '{source.name}' have changed since the server began: restart it.")
    return found, ChunkStore(store, found)


def bake(task: BakeTask) -> BakeResult:
    """Do a task: read the chunk, add samples, write it back as one object.

    The outcome depends on the texels and their sample counts alone, so a task that is done twice,
    or done again after a kill, leaves the same bytes.
    """
    begun = time.perf_counter()
    look, store = opened(task.source, task.plan, task.digest, task.store)
    chunk = store.load(task.index).with_texels(task.offsets)
    rows = chunk.rows_of(task.offsets)
    light = chunk.light.rows(rows)
    before = [part.samples.copy() for part in light.parts]
    refine(light, chunk.positions(task.offsets), look, task.until, task.target)
    chunk.light.put(rows, light)
    store.save(chunk, [not np.array_equal(part.samples, old) for part, old in zip(light.parts, before, strict=True)])
    waiting = next_samples(light, look, task.target)
    waiting = waiting[waiting >= 0]
    fewest = int(waiting.min()) if len(waiting) else 0
    return BakeResult(len(waiting), fewest, time.perf_counter() - begun)


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


def next_goal(fewest: int) -> int:
    """The sample count that a chunk is taken to next: quickly up to where the light is of use, then by doubling."""
    if fewest < FIRST_RUNG:
        return FIRST_RUNG
    return 4 * fewest if fewest < 256 else 2 * fewest
