"""A survey: what of the light that is asked for is there, and by chunk what is lacking."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from isogi_core.bake.effort import Effort
from isogi_core.bake.noise import good_enough, relative_error
from isogi_core.frame.texels import Demand
from isogi_core.plan.surface import surface_texels
from server.prewarm.desk import Step

if TYPE_CHECKING:
    from isogi_core.bake.recipe import Index
    from isogi_core.frame.frame import Frame
    from server.prewarm.desk import Desk
    from server.prewarm.levels import Levels
    from server.prewarm.order import Views


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
    """By chunk what is lacking (``demands``), and of that how many lit texels are to be refined (``waiting``).

    ``seen`` pixels show the surface (or so many texels were looked at), ``final`` of them with final light; ``means``
    are the errors of the views, or those of chunks and how many texels these are of, and ``worst`` is the largest.
    """

    demands: dict[Index, Demand] = field(default_factory=dict)
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
        self._count(frame.estimated_error, frame.estimated_error, 1)
        for demand in frame.demands:
            other = self.demands.get(demand.index)
            self.demands[demand.index] = demand if other is None else demand.joined(other)

    def add_chunk(self, found: Found) -> None:
        """Take in a chunk whose texels were looked up."""
        texels, lacking = len(found.demand.offsets), found.demand.effort.unlit + found.waiting
        self.seen += texels
        self.final += texels - lacking
        self._count(float(found.error.mean()), float(found.error.max()), texels)
        if lacking:
            self.demands[found.demand.index] = found.demand
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


def survey(desk: Desk, views: Views, levels: Levels, span: tuple[float, float]) -> Survey:
    """What is there for the ``views``, or, where there are none, for the whole isosurfaces of the ``levels``.

    ``span`` is where in all of the work this begins and ends, as shares of it. Raises StoreError, and Cancelled.
    """
    begun = time.monotonic()
    found = of_views(desk, views, span) if len(views) else of_surfaces(desk, levels, span)
    found.seconds = time.monotonic() - begun
    return found


def of_views(desk: Desk, views: Views, span: tuple[float, float]) -> Survey:
    """What the views show; what they have in common is counted once."""
    found = Survey()
    for number, view in enumerate(views):
        desk.check()
        desk.tell(Step("Looking", "view", number, len(views), share_of(number, len(views), span)))
        found.add(desk.look(view))
    desk.tell(Step("Looking", "view", len(views), len(views), span[1]))
    for index, demand in found.demands.items():
        if demand.effort.unlit < len(demand.offsets):
            desk.check()
            exact = look_up(desk, demand)
            found.demands[index] = exact.demand
            found.waiting += exact.waiting
    return found


def of_surfaces(desk: Desk, levels: Levels, span: tuple[float, float]) -> Survey:
    """What the store has of all texels of whole isosurfaces."""
    recipe, found = desk.renderer.recipe, Survey()
    volume, total = recipe.scene.volume, recipe.chunks[0]
    ranges = [sorted(map(volume.normalise_isovalue, each)) for each in levels.spans]
    places = [(low, high) for low, high in ranges]
    for index, offsets in surface_texels(volume.voxels, recipe.shape, recipe.lattice.chunk, places):
        desk.check()
        desk.tell(Step("Looking", "layer", index[0], total, share_of(index[0], total, span)))
        seen = np.ones(len(offsets), np.float32)
        effort = Effort(len(offsets), 0.0, 0.0)
        found.add_chunk(look_up(desk, Demand(index, offsets, float(len(offsets)), effort, seen)))
    desk.tell(Step("Looking", "layer", total, total, span[1]))
    return found


def look_up(desk: Desk, demand: Demand) -> Found:
    """What the store has of a demand's texels: a read, if there is anything."""
    caches = desk.renderer.caches
    look, chunk = caches.look("gi"), caches.store("gi").read(demand.index)
    if chunk is None:
        effort = Effort(len(demand.offsets), 0.0, 0.0)
        return Found(replace(demand, effort=effort), 0, np.ones(len(demand.offsets)))
    chunk = chunk.with_texels(demand.offsets)
    light = chunk.light.rows(chunk.rows_of(demand.offsets))
    samples, error = np.where(light.void, -1, light.samples), relative_error(light, look)
    effort = Effort.of(error, samples, desk.target)
    waiting = int(((samples > 0) & ~good_enough(error, samples, desk.target)).sum())
    error = np.where(samples < 0, 0.0, np.where(samples == 0, 1.0, np.minimum(error, 1.0)))
    return Found(replace(demand, effort=effort), waiting, error)


def share_of(done: int, total: int, span: tuple[float, float]) -> float:
    """Where between the ends of a ``span`` so much of its work is."""
    return span[0] + (span[1] - span[0]) * done / max(total, 1)
