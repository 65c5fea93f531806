"""A task: more light for texels of one chunk. What a worker process runs."""

import asyncio
import time
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from isogi_core.bake.effort import Effort
from isogi_core.bake.light import Light
from isogi_core.bake.look import Look
from isogi_core.bake.noise import relative_error
from isogi_core.bake.precision import FIRST_RUNG
from isogi_core.bake.recipe import Index, Recipe
from isogi_core.bake.refine import next_samples, refine
from isogi_core.cache.costs import Cost
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
    """Bring the texels at ``offsets`` of a chunk to the relative error ``level``, or to ``until`` samples each.

    They are final at ``target``. ``plan`` says what is baked; ``digest`` names the light that the server means: the
    files may have changed since.
    """

    source: SceneSource
    plan: ScenePlan
    digest: str
    store: str
    index: Index
    offsets: np.ndarray
    until: int
    level: float
    target: float


@dataclass(frozen=True)
class BakeResult:
    """What a task left and took.

    ``unfinished`` texels are not final yet; ``error`` is theirs, a root mean square, and ``effort`` what they took
    and will. ``cost`` is what the task itself took.
    """

    unfinished: int
    error: float
    effort: Effort
    cost: Cost


@lru_cache(maxsize=4)
def recipe_of(source: SceneSource) -> Recipe:
    """The scene, opened once a process for all of its looks."""
    return Recipe(build_scene(source))


@lru_cache(maxsize=16)
def opened(source: SceneSource, plan: ScenePlan, digest: str, store: str) -> tuple[Look, ChunkStore]:
    """A look and its store, opened once a process, and the kernels that its bake takes.

    SceneError where the scene's files are not those of ``digest``.
    """
    found = Look(recipe_of(source), plan)
    if found.digest != digest:
        recipe_of.cache_clear()
        found = Look(recipe_of(source), plan)
    if found.digest != digest:
        raise SceneError(f"The files of the scene '{source.name}' have changed since the server began: restart it.")
    load_kernels({layer.kind for layer in plan.layers})
    return found, ChunkStore(store, found)


def bake(task: BakeTask) -> BakeResult:
    """Do a task: read the chunk, add samples, write it back as one object.

    The outcome depends on the texels and their sample counts alone, so a task that is done twice,
    or done again after a kill, leaves the same bytes.
    """
    look, store = opened(task.source, task.plan, task.digest, task.store)
    chunk = store.load(task.index).with_texels(task.offsets)
    rows = chunk.rows_of(task.offsets)
    light = chunk.light.rows(rows)
    before, begun = chunk.light.rows(rows), time.process_time()
    refine(light, chunk.positions(task.offsets), look, task.until, max(task.level, task.target))
    seconds = time.process_time() - begun
    chunk.light.put(rows, light)
    pairs = zip(light.parts, before.parts, strict=True)
    store.save(chunk, [not np.array_equal(part.samples, old.samples) for part, old in pairs])
    return result_of(light, look, task.target, cost_of(light.samples, before.samples, seconds))


def cost_of(samples: np.ndarray, before: np.ndarray, seconds: float) -> Cost:
    """The cost of texels that had so many samples ``before``; parts that climb together are of the same paths."""
    taken = np.maximum(samples, 0) - np.maximum(before, 0)
    paths, lit = int(taken.sum()), int(((before == 0) & (samples > 0)).sum())
    return Cost(seconds, paths, lit, seconds * FIRST_RUNG * lit / max(paths, 1))


def result_of(light: Light, look: Look, target: float, cost: Cost) -> BakeResult:
    """What ``light`` still lacks of ``target``, and what was spent on it."""
    waiting = next_samples(light, look, target) >= 0
    error = relative_error(light, look)
    mean = float(np.sqrt((error[waiting] ** 2).mean())) if waiting.any() else 0.0
    return BakeResult(int(waiting.sum()), mean, Effort.of(error, light.samples, target), cost)


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
