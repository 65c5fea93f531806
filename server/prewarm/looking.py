"""What a prewarm finds in the store: what its pictures, or whole isosurfaces, lack, and how good they are."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np

from isogi_core.bake.noise import Effort, relative_error
from isogi_core.bake.precision import FIRST_LEVEL
from isogi_core.errors import ViewError
from isogi_core.frame.frame import Frame
from isogi_core.frame.projected_texels import distances_of
from isogi_core.frame.rays.picture_plan import AWAITED, KEPT
from isogi_core.frame.view_texels import Demand
from isogi_core.model.view import View
from isogi_core.model.volume import Isovalue
from isogi_core.plan.reachable_texels import surface_texels
from isogi_core.prepared.prepared_scene import Index
from server.prewarm.context import Batch, PrewarmContext, Step, Wish
from server.prewarm.order import Levels, Views

Span = tuple[float, float]
"""Where in all of the work a part of it begins and ends, as shares of it."""


@dataclass(eq=False)
class Survey:
    """What is lacking (``demands``).

    Of whole isosurfaces ``seen`` texels were examined, and ``final`` of them lack nothing.
    """

    demands: dict[tuple[Batch, Index], Demand] = field(default_factory=dict)
    seen: int = 0
    final: int = 0

    def add(self, batch: Batch, demand: Demand) -> None:
        """Take in what is lacking; what views have in common is counted once."""
        place = batch, demand.index
        other = self.demands.get(place)
        self.demands[place] = demand if other is None else demand.joined(other)

    @property
    def wishes(self) -> list[Wish]:
        """All that is lacking."""
        return [(batch, demand) for (batch, _), demand in self.demands.items()]

    @property
    def chunks(self) -> int:
        """Chunks that lack light, those of each bake."""
        return len({(replace(batch, enough=0), index) for batch, index in self.demands})

    @property
    def unlit(self) -> int:
        """Texels without light."""
        return sum(demand.effort.unlit for demand in self.demands.values())

    @property
    def waiting(self) -> int:
        """Texels that are lit, and are to be refined."""
        return round(sum(demand.effort.lit for demand in self.demands.values()))

    @property
    def paths(self) -> float:
        """Paths that the baking of it is expected to take."""
        efforts = (demand.effort for demand in self.demands.values())
        return sum(FIRST_LEVEL * effort.unlit + effort.left for effort in efforts)


@dataclass(frozen=True)
class Seen:
    """What a picture showed when it was last looked at: pixels of the surface, how many of them were ``final``, and its
    total relative ``error``.
    """

    surface: int
    final: int
    error: float


class Pictures:
    """The pictures of ``views``, which say how many samples texels are to have: each is checked as a server checks
    those that it shows. Those in ``waiting`` are not through: they lack light, or their check goes on.

    ``rung`` is how many samples the texels of any of them have, or are to have; ``read`` counts texels that lacked
    light at the first look, as often as pictures read them. Where they are a ``sample`` of whole
    isosurfaces, none has finer texels, and one whose camera stands in a wall is left out.
    """

    def __init__(self, context: PrewarmContext, views: Views, sample: bool, rung: int) -> None:
        """Look at none yet."""
        self.waiting = set(range(len(views)))
        self.seen: dict[int, Seen] = {}
        self.rung, self.read = rung, 0
        self._context, self._views, self._sample = context, views, sample

    def look(self, span: Span, end: float) -> Survey:
        """Check each that is not through as far as its texels allow; what they lack then.

        Checks end when the monotonic clock is at the ``end``. Raises StoreError, and Cancelled.
        """
        found, total, done = Survey(), len(self.waiting), 0
        for number, view in enumerate(self._views):
            if number in self.waiting:
                self._context.check()
                self._context.report(Step("Looking", "view", done, total, share_of(done, total, span)))
                with suppress(*(ViewError,) * self._sample):
                    self._take(number, self._checked(view, end), found)
                self.waiting -= {number} if number not in self.seen else set()
                done += 1
        self._context.report(Step("Looking", "view", total, total, span[1]))
        return found

    def _checked(self, view: View, end: float) -> Frame:
        """The frame of a view once its check has no step to take, or wants light of texels first."""
        context = self._context
        frame, more = context.frame_of(view), True
        while more and frame.checkable and not context.late(end):
            more = context.refine(view, KEPT if self._sample else AWAITED)
            frame = context.frame_of(view)
        return frame

    def _take(self, number: int, frame: Frame, found: Survey) -> None:
        """Note how good a picture is, and what it lacks."""
        wishes = [wish for wish in lacking_of(frame) if not (self._sample and wish[0].fineness)]
        self.read += 0 if number in self.seen else sum(len(demand.offsets) for _, demand in wishes)
        self.seen[number] = Seen(frame.surface, frame.counts["final"], frame.total.likely)
        for wish in wishes:
            found.add(*wish)
        self.rung = max(self.rung, *(batch.enough for batch, _ in wishes), 0 if wishes else rung_of(frame))
        if not wishes and not frame.checkable:
            self.waiting.discard(number)


def rung_of(frame: Frame) -> int:
    """The samples that texels of a ``frame`` have, but those which need fewer; 0 where it reads no texels."""
    return frame.quality.lacking.reading.rung if frame.quality.lacking else 0


def lacking_of(frame: Frame) -> Iterator[Wish]:
    """What the picture of a ``frame`` lacks, or the finer one that is coming in its place."""
    coming = frame.quality.finer or frame
    for stage in coming.stages:
        side = stage.caches.spec("gi").digest if stage.caches else ""
        batch = Batch(stage.shown, stage.enough, coming.quality.fineness, side, stage.caches)
        yield from ((batch, demand) for demand in stage.demands)


def with_efforts(context: PrewarmContext, found: Survey) -> Survey:
    """What is lacking with the exact efforts of texels that several views read, by the store."""
    for (batch, index), demand in found.demands.items():
        if demand.effort.unlit < len(demand.offsets):
            context.check()
            found.demands[batch, index] = look_up(context, batch, demand)
    return found


def of_surfaces(context: PrewarmContext, levels: Levels, enough: int, span: Span) -> Survey:
    """What the store lacks of all texels of whole isosurfaces, which are to have ``enough`` samples."""
    prepared, found = context.renderer.prepared, Survey()
    volume, total = prepared.scene.volume, prepared.chunks[0]
    places = [volume.normalise_span(*each) for each in levels.spans]
    for index, offsets in surface_texels(volume.voxels, prepared.shape, prepared.lattice.chunk, places):
        context.check()
        context.report(Step("Looking", "layer", index[0], total, share_of(index[0], total, span)))
        batch = Batch(None, enough)
        count(found, batch, look_up(context, batch, unseen_demand(index, offsets)))
    for demand in projected_demands(context, levels):
        context.check()
        batch = Batch(demand.shown, enough)
        count(found, batch, look_up(context, batch, demand))
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


def count(found: Survey, batch: Batch, demand: Demand) -> None:
    """Take in a chunk of a ``batch`` whose texels were looked up."""
    texels, lacking = len(demand.offsets), demand.effort.unlit + round(demand.effort.lit)
    found.seen += texels
    found.final += texels - lacking
    if lacking:
        found.add(batch, demand)


def look_up(context: PrewarmContext, batch: Batch, demand: Demand) -> Demand:
    """A ``demand`` with the effort that its texels take by what the store has of them: a read, if there is anything."""
    store = context.store_of(batch)
    spec, chunk = store.spec, store.read(demand.index)
    if chunk is None:
        return replace(demand, effort=Effort(len(demand.offsets), 0.0, 0.0))
    chunk = chunk.with_texels(demand.offsets)
    light = chunk.light.rows(chunk.rows_of(demand.offsets))
    samples, error = np.where(light.void, -1, light.samples), relative_error(light, spec)
    return replace(demand, effort=Effort.of(error, samples, context.target, batch.enough))


def share_of(done: int, total: int, span: Span) -> float:
    """Where between the ends of a ``span`` so much of its work is."""
    return span[0] + (span[1] - span[0]) * done / max(total, 1)
