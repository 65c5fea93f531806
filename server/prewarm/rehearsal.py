"""A rehearsal: one chunk is baked as the workers' tasks do it, and nothing of it is kept."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from isogi_core.bake.effort import Effort
from isogi_core.bake.light import Light
from isogi_core.bake.look import Look
from isogi_core.bake.noise import relative_error
from isogi_core.bake.precision import FIRST_RUNG
from isogi_core.bake.refine import refine
from isogi_core.cache.chunk import Chunk
from isogi_core.cache.place import Place
from isogi_core.cache.store import ChunkStore
from isogi_core.frame.texels import Demand
from isogi_core.model.plan import MOST
from worker.tasks import BakeTask, climb, cost_of, result_of
from worker.wants import next_least

if TYPE_CHECKING:
    from isogi_core.frame.renderer import Renderer

NEVER = 1e-9
"""A target error that the first paths do not reach."""

SCHEDULED = Path("/proc/thread-self/schedstat")
"""Where Linux tells of a thread the nanoseconds that it ran, and those that it could have run but had no core."""


@dataclass(frozen=True)
class Rehearsal:
    """What a chunk's ``texels`` take: ``seconds`` of a worker, and those of the ``processor``, in so many ``tasks``.

    Those of a worker are with the time that others had its core, and without that in which threads of one process wait
    for each other, as workers do not: see ``ready_time``. ``maps`` are seconds that a process spends once, ``stored``
    the bytes of the chunk's objects.
    """

    texels: int
    seconds: float
    processor: float
    tasks: float
    maps: float
    stored: int


def rehearse(renderer: Renderer, demand: Demand, target: float, most: float, cancelled: threading.Event) -> Rehearsal:
    """Bake what a chunk lacks until ``target``; what takes more than ``most`` seconds is extrapolated."""
    look, store = renderer.caches.look("gi"), renderer.caches.store("gi")
    texels = look.recipe.lattice.positions(demand.index, demand.offsets)
    maps = first_light(look, texels) - first_light(look, texels)
    chunk = store.load(demand.index).with_texels(demand.offsets)
    rows = chunk.rows_of(demand.offsets)
    light = chunk.light.rows(rows)
    begun, processor = ready_time(), time.thread_time()
    tasks, paths = climb_all(light, texels, look, demand, target, (time.perf_counter() + most, cancelled))
    more = 1.0 + Effort.of(relative_error(light, look), light.samples, target).left / max(paths, 1)
    seconds, processor = ready_time() - begun, time.thread_time() - processor
    chunk.light.put(rows, light)
    begun = ready_time()
    stored = stored_size(store, chunk)
    seconds += tasks * (ready_time() - begun)
    return Rehearsal(len(texels), more * seconds, more * processor, tasks * more, max(maps, 0.0), stored)


def ready_time() -> float:
    """Seconds that this thread ran, or could have run; where the system does not tell, those by the clock."""
    try:
        ran, waited, *_ = SCHEDULED.read_text(encoding="ascii").split()
    except OSError:
        return time.perf_counter()
    return (int(ran) + int(waited)) * 1e-9


def climb_all(
    light: Light, texels: np.ndarray, look: Look, demand: Demand, target: float, limit: tuple[float, threading.Event]
) -> tuple[int, int]:
    """Do the tasks of a chunk to its ``light``, in place: how many, and their paths. Ends at its ``limit``."""
    until, least, tasks, paths = FIRST_RUNG if demand.effort.unlit else MOST, 0.0, 0, 0
    while True:
        place = (look.recipe.scene.source, look.plan, look.digest, Place(""), demand.index)
        task = BakeTask(*place, demand.offsets, demand.footprints, until, least, target)
        before, since = light.samples, time.thread_time()
        climb(light, texels, look, task)
        result = result_of(light, look, task, cost_of(light.samples, before, time.thread_time() - since))
        tasks, paths = tasks + 1, paths + result.cost.paths
        if not result.unfinished or time.perf_counter() > limit[0] or limit[1].is_set():
            return tasks, paths
        until, least = MOST, next_least(result, patient=True)


def first_light(look: Look, texels: np.ndarray) -> float:
    """Seconds that the first paths of texels take; maps that they need are made, where they are not kept."""
    begun = ready_time()
    refine(Light.dark(look.plan, len(texels)), texels, look, FIRST_RUNG, NEVER)
    return ready_time() - begun


def stored_size(store: ChunkStore, chunk: Chunk) -> int:
    """Bytes that a chunk's objects would take."""
    pairs = zip(store.layers, chunk.light.parts, strict=True)
    return sum(len(layer.encode(chunk.index, chunk.offsets, part)) for layer, part in pairs)
