"""The work of a prewarm: survey what is lacking, forecast what that takes, bake it, and survey again."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from isogi_core.bake.noise import Effort, good_enough, relative_error
from isogi_core.frame.frame import Frame
from isogi_core.frame.projected_texels import distances_of
from isogi_core.frame.view_texels import Demand
from isogi_core.model.volume import Isovalue
from isogi_core.plan.reachable_texels import surface_texels
from isogi_core.prepared.prepared_scene import Index
from server.prewarm.context import LOOK, Baking, PrewarmContext, Step
from server.prewarm.forecast import START, forecast
from server.prewarm.order import Levels, PrewarmOrder, Views
from server.prewarm.record import Errors, Summary, failures_of
from server.schemas import TimeLeftSchema
from server.settings import Settings
from worker.progress import CostEstimate

Place = tuple[Isovalue | None, Index]
"""The isosurface that texels are projected onto, if any, and their chunk."""


def place_of(demand: Demand) -> Place:
    """The place that a demand is for."""
    return demand.shown, demand.index


@dataclass(frozen=True)
class Quality:
    """How good light is: the ``final`` share of surface pixels, and the ``worst`` and ``mean`` error of views.

    Where whole isosurfaces are asked for, of texels both.
    """

    final: float = 1.0
    worst: float = 0.0
    mean: float = 0.0


@dataclass(eq=False)
class Survey:
    """What is lacking (``demands``), and of that how many lit texels are to be refined (``waiting``).

    ``seen`` pixels show the surface (or so many texels were examined), ``final`` of them with final light; ``means``
    are the errors of the views, or those of chunks and how many texels these are of, and ``worst`` is the largest.
    """

    demands: dict[Place, Demand] = field(default_factory=dict)
    waiting: int = 0
    seen: int = 0
    final: int = 0
    means: list[tuple[float, int]] = field(default_factory=list)
    worst: float = 0.0
    seconds: float = 0.0

    def add(self, frame: Frame) -> None:
        """Take in the frame of a view."""
        self.seen += frame.surface
        self.final += frame.counts["final"]
        self._count(frame.noise, frame.noise, 1)
        projected = () if frame.projection is None else frame.projection.demands
        for demand in (*frame.demands, *projected):
            other = self.demands.get(place_of(demand))
            self.demands[place_of(demand)] = demand if other is None else demand.joined(other)

    def add_chunk(self, found: Found) -> None:
        """Take in a chunk whose texels were looked up."""
        texels, lacking = len(found.demand.offsets), found.demand.effort.unlit + found.waiting
        self.seen += texels
        self.final += texels - lacking
        self._count(float(found.error.mean()), float(found.error.max()), texels)
        if lacking:
            self.demands[place_of(found.demand)] = found.demand
            self.waiting += found.waiting

    @property
    def unlit(self) -> int:
        """Texels without light."""
        return sum(demand.effort.unlit for demand in self.demands.values())

    @property
    def quality(self) -> Quality:
        """How good it all is."""
        share = self.final / self.seen if self.seen else 1.0
        total = sum(weight for _, weight in self.means)
        return Quality(share, self.worst, sum(mean * weight for mean, weight in self.means) / max(total, 1))

    def _count(self, mean: float, worst: float, weight: int) -> None:
        self.means.append((mean, weight))
        self.worst = max(self.worst, worst)


@dataclass(frozen=True, eq=False)
class Found:
    """A chunk as the store has it: what is to be done (``demand``), lit texels among that, and each texel's error."""

    demand: Demand
    waiting: int
    error: np.ndarray


def survey(context: PrewarmContext, views: Views, levels: Levels, span: tuple[float, float]) -> Survey:
    """What is there for the ``views``, or, where there are none, for the whole isosurfaces of the ``levels``.

    ``span`` is where in all of the work this begins and ends, as shares of it. Raises StoreError, and Cancelled.
    """
    begun = time.monotonic()
    found = of_views(context, views, span) if len(views) else of_surfaces(context, levels, span)
    found.seconds = time.monotonic() - begun
    return found


def of_views(context: PrewarmContext, views: Views, span: tuple[float, float]) -> Survey:
    """What the views show; what they have in common is counted once."""
    found = Survey()
    for number, view in enumerate(views):
        context.check()
        context.report(Step("Looking", "view", number, len(views), share_of(number, len(views), span)))
        found.add(context.frame_of(view))
    context.report(Step("Looking", "view", len(views), len(views), span[1]))
    for place, demand in found.demands.items():
        if demand.effort.unlit < len(demand.offsets):
            context.check()
            exact = look_up(context, demand)
            found.demands[place] = exact.demand
            found.waiting += exact.waiting
    return found


def of_surfaces(context: PrewarmContext, levels: Levels, span: tuple[float, float]) -> Survey:
    """What the store has of all texels of whole isosurfaces."""
    prepared, found = context.renderer.prepared, Survey()
    volume, total = prepared.scene.volume, prepared.chunks[0]
    ranges = [sorted(map(volume.normalise_isovalue, each)) for each in levels.spans]
    places = [(low, high) for low, high in ranges]
    for index, offsets in surface_texels(volume.voxels, prepared.shape, prepared.lattice.chunk, places):
        context.check()
        context.report(Step("Looking", "layer", index[0], total, share_of(index[0], total, span)))
        found.add_chunk(look_up(context, unseen_demand(index, offsets)))
    for demand in projected_demands(context, levels):
        context.check()
        found.add_chunk(look_up(context, demand))
    context.report(Step("Looking", "layer", total, total, span[1]))
    return found


def unseen_demand(index: Index, offsets: np.ndarray, shown: Isovalue | None = None) -> Demand:
    """Texels of a chunk that no view asks for: all of them count alike."""
    seen, effort = np.ones(len(offsets), np.float32), Effort(len(offsets), 0.0, 0.0)
    return Demand(index, offsets, float(len(offsets)), effort, seen, shown)


def projected_demands(context: PrewarmContext, levels: Levels) -> Iterator[Demand]:
    """Texels that are to be projected onto the whole isosurfaces of single isovalues; there are none of ranges."""
    prepared, tiles = context.renderer.prepared, context.renderer.tiles
    lattice, scene = prepared.lattice, prepared.scene
    shown = [scene.volume.normalise_isovalue(level) for level in levels.single]
    for level in filter(scene.projection.projects, shown):
        for index, offsets in surface_texels(scene.volume.voxels, prepared.shape, lattice.chunk, [(level, level)]):
            distances = distances_of(lattice.positions(index, offsets), level, prepared, tiles)
            beyond = distances.beyond(context.target)
            if beyond.any():
                yield unseen_demand(index, offsets[beyond], level)


def look_up(context: PrewarmContext, demand: Demand) -> Found:
    """What the store has of a demand's texels: a read, if there is anything."""
    store = context.renderer.caches.chunk_store_of(demand.shown)
    spec, chunk = store.spec, store.read(demand.index)
    if chunk is None:
        effort = Effort(len(demand.offsets), 0.0, 0.0)
        return Found(replace(demand, effort=effort), 0, np.ones(len(demand.offsets)))
    chunk = chunk.with_texels(demand.offsets)
    light = chunk.light.rows(chunk.rows_of(demand.offsets))
    samples, error = np.where(light.void, -1, light.samples), relative_error(light, spec)
    effort = Effort.of(error, samples, context.target)
    waiting = int(((samples > 0) & ~good_enough(error, samples, context.target)).sum())
    error = np.where(samples < 0, 0.0, np.where(samples == 0, 1.0, np.minimum(error, 1.0)))
    return Found(replace(demand, effort=effort), waiting, error)


def share_of(done: int, total: int, span: tuple[float, float]) -> float:
    """Where between the ends of a ``span`` so much of its work is."""
    return span[0] + (span[1] - span[0]) * done / max(total, 1)


BEFORE, AFTER = (0.0, 0.04), (0.96, 1.0)
"""Where in all of the work looking begins and ends, before and after the baking, as shares of it."""

TRIAL, DRY_TRIAL = 3.0, 10.0
"""Seconds that a forecast may take, before baking and in a dry run."""


@dataclass(frozen=True, eq=False)
class Wanted:
    """What is asked for, made out for a scene: its ``views`` or, where there are none, whole isosurfaces."""

    order: PrewarmOrder
    views: Views
    levels: Levels


def wanted(context: PrewarmContext, order: PrewarmOrder, settings: Settings) -> Wanted:
    """What an order asks for; ViewError where that is not allowed."""
    return Wanted(order, Views(order, context.scene, settings), order.isovalues_of(context.scene))


def carry_out(context: PrewarmContext, what: Wanted, begun: Callable[[Summary], None]) -> Summary:
    """Bake what is asked for, and sum it up; ``begun`` is given what is known before the baking.

    Raises StoreError, Cancelled, and WorkersError where there are no workers, or these bake nothing for long.
    """
    found = survey(context, what.views, what.levels, BEFORE)
    while not context.engine.workforce.wait(LOOK):
        context.check()
    ahead, expected = look_ahead(context, what, found, TRIAL)
    begun(ahead)
    end = context.deadline - min(found.seconds, context.left / 2.0)
    baking = Baking(context, list(found.demands.values()), expected, (BEFORE[1], AFTER[0]), end)
    baking.run()
    new = light_walls(context, what.views, end) or baking.done > 0 or baking.spent.paths > 0
    quality = survey(context, what.views, what.levels, AFTER).quality if new else found.quality
    return summed_up(context, ahead, quality, baking)


def light_walls(context: PrewarmContext, views: Views, end: float) -> bool:
    """Light the walls that the ``views`` show until they are final, or the monotonic clock is at the ``end``.

    Whether there was light to add. Raises Cancelled.
    """
    scene, tiles, lit = context.scene, context.renderer.tiles.cancelled_by(context.cancelled), False
    for number, view in enumerate(views if scene.room.any and not context.late(end) else ()):
        context.report(Step("Lighting the walls of", "view", number, len(views), AFTER[0]))
        frame = context.frame_of(view)
        while frame.walls_waiting and frame.checkable and not context.late(end):
            if not context.renderer.refine(view, context.target, tiles):
                break
            frame, lit = context.frame_of(view), True
    return lit


def carry_out_dry(context: PrewarmContext, what: Wanted) -> Summary:
    """What there is to do for what is asked for, and the time that it takes. Raises StoreError, and Cancelled."""
    ahead, _ = look_ahead(context, what, survey(context, what.views, what.levels, (0.0, 0.5)), DRY_TRIAL)
    return ahead


def look_ahead(context: PrewarmContext, what: Wanted, found: Survey, budget: float) -> tuple[Summary, float]:
    """What is lacking of what is asked for, and a forecast of the seconds that baking takes, in about ``budget``.

    The summary has the time of the whole: what has passed, a trial, the baking, and looking again.
    """
    workers, demands, passed = context.engine.workers, list(found.demands.values()), context.seconds
    context.report(Step("Trying", "chunk", 0, len(demands), BEFORE[1]))
    ahead = forecast(context.renderer, demands, context.target, workers, budget, context.cancelled)
    context.check()
    around = passed + min(context.seconds - passed, TRIAL) + found.seconds if demands else passed
    around += START if demands and not context.engine.manned else 0.0
    return summary_of(context, what, found, ahead, around), ahead.seconds / workers


def summary_of(context: PrewarmContext, what: Wanted, found: Survey, ahead: CostEstimate, around: float) -> Summary:
    """What is known before the baking; so many seconds are spent ``around`` it."""
    workers, demands = context.engine.workers, found.demands
    left, quality = ahead.time_left(workers, around), found.quality
    return Summary(
        scene=context.scene.id,
        order=what.order,
        views=len(what.views),
        isovalues=what.levels.single,
        ranges=what.levels.ranges,
        target_error=context.target,
        chunks=len(demands),
        texels=found.unlit,
        refined=found.waiting,
        bytes=found.unlit * context.scene.plan.bytes_per_texel,
        stored_bytes=ahead.stored,
        processor_seconds=ahead.processor,
        workers=workers,
        **quality_fields(quality),
        time_left=TimeLeftSchema(low=left.low, likely=left.likely, high=left.high),
    )


def summed_up(context: PrewarmContext, ahead: Summary, quality: Quality, baking: Baking) -> Summary:
    """What it came to, beside what was known ``ahead``."""
    reasons, spent = list(baking.failures.items()), baking.spent
    done = {"paths": spent.paths, "seconds": context.seconds, "processor_seconds": spent.seconds}
    stopped = "deadline" if baking.late else "failures" if reasons else "target"
    size = stored_bytes(context, baking.demands)
    facts = {**done, "stopped": stopped, "stored_bytes": size, "failed": len(reasons), "failures": failures_of(reasons)}
    return ahead.model_copy(update=facts | quality_fields(quality))


def quality_fields(quality: Quality) -> dict[str, Any]:
    """How good light is, as fields of a summary."""
    errors = Errors(worst=quality.worst, mean=quality.mean)
    return {"final": quality.final, "error": quality.worst, "errors": errors}


def stored_bytes(context: PrewarmContext, demands: Iterable[Demand]) -> int:
    """Bytes that the chunks of the demands take in the store."""
    caches = context.renderer.caches
    stored = ((demand.index, layer) for demand in demands for layer in caches.chunk_store_of(demand.shown).layers)
    return sum(len(layer.read(index) or b"") for index, layer in stored)
