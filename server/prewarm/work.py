"""The work of a prewarm: look what its pictures lack, forecast what that takes, bake it, and look
again.

Light goes up a ladder of samples (16, 32, 64, …), as it does for a view that somebody looks at. On
each rung the pictures are checked; those that need more of their texels ask for the next. Of whole
isosurfaces pictures from a few sides decide for all texels. Pages that draw by themselves have the
light of texels alone, for a range of isovalues.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from isogi_core.bake.noise import Effort, Until, relative_error
from isogi_core.bake.texel_light import FIRST_LEVEL, next_level
from isogi_core.cache.costs import Cost
from isogi_core.errors import Cancelled, ViewError
from isogi_core.frame.card.coded_picture import ControlPictures
from isogi_core.frame.card.coding import Coding
from isogi_core.frame.demand import Demand
from isogi_core.frame.frame import Frame
from isogi_core.frame.projected_texels import distances_of
from isogi_core.frame.rays.picture_plan import AWAITED, SHARED_PRICES
from isogi_core.model.scene_plan import most_samples
from isogi_core.model.view import View, quaternion_from_angles
from isogi_core.model.volume import Isovalue
from isogi_core.plan.reachable_texels import surface_texels
from isogi_core.prepared.prepared_scene import Index
from server.prewarm.baking import (
    REPORT_SECONDS,
    WORKER_START_SECONDS,
    Baking,
    Batch,
    Expected,
    PrewarmContext,
    Step,
    Wish,
    forecast,
)
from server.prewarm.order import GOLDEN, Levels, PrewarmOrder, Views, order_of, views_around
from server.prewarm.record import Errors, Summary, failures_of
from server.render.bakes import time_limit
from server.schemas import TimeLeftSchema
from server.settings import Settings
from worker.errors import WorkersError
from worker.progress import CostEstimate

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
        if other is None:
            self.demands[place] = demand
        else:
            self.demands[place] = demand.joined(other)

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
    """What a picture showed when it was last looked at: pixels of the surface, how many of them
    were ``final``, and its total relative ``error``.
    """

    surface: int
    final: int
    error: float


class Pictures:
    """The pictures of ``views``, which say how many samples texels are to have: each is checked as
    a server checks those that it shows. Those in ``waiting`` are not through: they lack light, or
    their check goes on.

    ``rung`` is how many samples the texels of any of them have, or are to have; ``read`` counts
    texels that lacked light at the first look, as often as pictures read them. Where they are a
    ``sample`` of whole isosurfaces, none has finer texels, and one whose camera stands in a wall is
    left out.
    """

    def __init__(self, context: PrewarmContext, views: Views, sample: bool, rung: int) -> None:
        """Look at none yet."""
        self.waiting = set(range(len(views)))
        self.seen: dict[int, Seen] = {}
        self.rung = rung
        self.read = 0
        self._context = context
        self._views = views
        self._sample = sample

    def look(self, span: Span, end: float) -> Survey:
        """Check each that is not through as far as its texels allow; what they lack then.

        Checks end when the monotonic clock is at the ``end``. Raises StoreError, and Cancelled.
        """
        found = Survey()
        total = len(self.waiting)
        done = 0
        for number, view in enumerate(self._views):
            if number in self.waiting:
                self._context.check()
                self._context.report(
                    Step("Looking", "view", done, total, share_of(done, total, span))
                )
                with suppress(*(ViewError,) * self._sample):
                    self._take(number, self._checked(view, end), found)
                if number not in self.seen:
                    self.waiting -= {number}
                else:
                    self.waiting -= set()
                done += 1
        self._context.report(Step("Looking", "view", total, total, span[1]))
        return found

    def _checked(self, view: View, end: float) -> Frame:
        """The frame of a view once its check has no step to take, or wants light of texels
        first.
        """
        context = self._context
        frame = context.frame_of(view)
        more = True
        prices = SHARED_PRICES if self._sample else AWAITED
        with time_limit(end) as over:
            while more and frame.checkable and not context.late(end):
                try:
                    more = context.refine(view, prices, over)
                except Cancelled:
                    context.check()
                    return frame
                frame = context.frame_of(view)
        return frame

    def _take(self, number: int, frame: Frame, found: Survey) -> None:
        """Note how good a picture is, and what it lacks."""
        wishes = [wish for wish in lacking_of(frame) if not (self._sample and wish[0].fineness)]
        if number in self.seen:
            self.read += 0
        else:
            self.read += sum(len(demand.offsets) for _, demand in wishes)
        self.seen[number] = Seen(frame.surface, frame.counts["final"], frame.total.likely)
        for wish in wishes:
            found.add(*wish)
        self.rung = max(
            self.rung, *(batch.enough for batch, _ in wishes), 0 if wishes else rung_of(frame)
        )
        if not wishes and not frame.checkable:
            self.waiting.discard(number)


def rung_of(frame: Frame) -> int:
    """The samples that texels of a ``frame`` have, but those which need fewer; 0 where it reads no
    texels.
    """
    if frame.quality.lacking:
        return frame.quality.lacking.reading.rung
    return 0


def lacking_of(frame: Frame) -> Iterator[Wish]:
    """What the picture of a ``frame`` lacks, or the finer one that is coming in its place."""
    coming = frame.quality.finer or frame
    for stage in coming.stages:
        if stage.caches:
            side = stage.caches.spec("gi").digest
        else:
            side = ""
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
    """What the store lacks of all texels of whole isosurfaces, which are to have ``enough``
    samples.
    """
    prepared = context.renderer.prepared
    found = Survey()
    volume = prepared.scene.volume
    total = prepared.chunks[0]
    places = [volume.normalise_span(*each) for each in levels.spans]
    for index, offsets in surface_texels(
        volume.voxels, prepared.shape, prepared.lattice.chunk, places
    ):
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
    seen = np.ones(len(offsets), np.float32)
    effort = Effort(len(offsets), 0.0, 0.0)
    return Demand(index, offsets, float(len(offsets)), effort, seen, shown)


def projected_demands(context: PrewarmContext, levels: Levels) -> Iterator[Demand]:
    """Texels that are to be projected onto the whole isosurfaces of single isovalues; there are
    none of ranges.
    """
    prepared = context.renderer.prepared
    tiles = context.renderer.tiles
    lattice = prepared.lattice
    scene = prepared.scene
    shown = [scene.volume.normalise_isovalue(level) for level in levels.single]
    for level in filter(scene.projection.projects, shown):
        for index, offsets in surface_texels(
            scene.volume.voxels, prepared.shape, lattice.chunk, [(level, level)]
        ):
            distances = distances_of(lattice.positions(index, offsets), level, prepared, tiles)
            beyond = distances.beyond(context.target)
            if beyond.any():
                yield unseen_demand(index, offsets[beyond], level)


def count(found: Survey, batch: Batch, demand: Demand) -> None:
    """Take in a chunk of a ``batch`` whose texels were looked up."""
    texels = len(demand.offsets)
    lacking = demand.effort.unlit + round(demand.effort.lit)
    found.seen += texels
    found.final += texels - lacking
    if lacking:
        found.add(batch, demand)


def look_up(context: PrewarmContext, batch: Batch, demand: Demand) -> Demand:
    """A ``demand`` with the effort that its texels take by what the store has of them: a read, if
    there is anything.
    """
    store = context.store_of(batch)
    spec = store.spec
    chunk = store.read(demand.index)
    if chunk is None:
        return replace(demand, effort=Effort(len(demand.offsets), 0.0, 0.0))
    chunk = chunk.with_texels(demand.offsets)
    light = chunk.light.rows(chunk.rows_of(demand.offsets))
    samples = np.where(light.void, -1, light.samples)
    error = relative_error(light, spec)
    return replace(demand, effort=Effort.of(error, samples, context.target, batch.enough))


def share_of(done: int, total: int, span: Span) -> float:
    """Where between the ends of a ``span`` so much of its work is."""
    return span[0] + (span[1] - span[0]) * done / max(total, 1)


SURVEY_SHARES = (0.0, 0.04)
LAST_ROUND_END_SHARE = 0.98
"""Where in all of the work the first look begins and ends, and where the last round does, as shares
of it.
"""

BAKED_SHARE = 0.8
"""The share of a round at which its light is baked, and the pictures are checked."""

TRIAL_SECONDS = 3.0
DRY_TRIAL = 10.0
"""Seconds that a forecast may take, before baking and in a dry run."""

CHECKING = 0.25
"""What the check of a picture takes over what the light of all its texels does: pixels get light of
their own while that costs less than the next rung.
"""

USUAL_END_SHARE = 1 / 64
"""At how many samples pictures end, over those at which the last of their texels would: 16 to 64 at
2 %.
"""


@dataclass(frozen=True, eq=False)
class Wanted:
    """What is asked for, made out for a scene: its ``views`` or, where there are none, whole
    isosurfaces of which ``samples`` are looked at.
    """

    order: PrewarmOrder
    views: Views
    levels: Levels
    samples: Views

    @property
    def whole(self) -> bool:
        """Whether it is whole isosurfaces."""
        return not len(self.views)


def wanted(context: PrewarmContext, order: PrewarmOrder, settings: Settings) -> Wanted:
    """What an order asks for; ViewError where that is not allowed."""
    scene = context.scene
    views = Views(order, scene, settings)
    levels = order.isovalues_of(scene)
    return Wanted(order, views, levels, views_around(order, levels, scene, settings))


@dataclass(eq=False)
class Rounds:
    """What a prewarm has done so far, round by round: the ``places`` that it baked at, what that
    ``spent``, and its ``failures``. Checks of all pictures are expected to take so many seconds of
    all workers (``checks``).
    """

    context: PrewarmContext
    what: Wanted
    places: set[tuple[Batch, Index]] = field(default_factory=set)
    failures: dict[Index, str] = field(default_factory=dict)
    spent: Cost = field(default_factory=Cost)
    done: float = SURVEY_SHARES[1]
    checks: float = 0.0

    def __post_init__(self) -> None:
        """Look at no picture yet."""
        if self.what.whole:
            views = self.what.samples
        else:
            views = self.what.views
        self.pictures = Pictures(self.context, views, self.what.whole, self.context.rung)

    def look(self, span: Span, end: float) -> Survey:
        """What is lacking now, once pictures are checked as far as they can be until the ``end``,
        by the monotonic clock. Raises StoreError, and Cancelled.
        """
        if not self.what.whole:
            return with_efforts(self.context, self.pictures.look(span, end))
        levels = self.what.levels
        middle = sum(span) / 2.0
        found = of_surfaces(self.context, levels, self.pictures.rung, (span[0], middle))
        if found.demands or not self.pictures.waiting:
            return found
        rung = self.pictures.rung
        lacking = self.pictures.look((middle, span[1]), end)
        if self.pictures.rung > rung:
            self.context.climbed(self.pictures.rung)
        found = of_surfaces(self.context, levels, self.pictures.rung, (span[1], span[1]))
        for wish in lacking.wishes:
            found.add(*wish)
        return with_efforts(self.context, found)

    def bake(self, found: Survey, ahead: CostEstimate, end: float) -> Survey:
        """Bake what was ``found`` lacking, and what pictures then lack, until the ``end``; what is
        left of it.

        Raises WorkersError, StoreError, and Cancelled.
        """
        coming = paths_to(found, rung_ahead(self.context, found))
        pace = ahead.seconds / max(coming, 1.0)
        while found.demands and not self.context.late(end):
            coming = max(coming - found.paths, 0.0)
            first = self.done
            last = (self.done + LAST_ROUND_END_SHARE) / 2.0
            baked = first + BAKED_SHARE * (last - first)
            expected = Expected(pace * found.paths, pace * coming + self.checks, (first, baked))
            baking = Baking(self.context, found.wishes, expected, end)
            baking.run()
            self._note(baking)
            left = self.look((baked, last), end)
            self.done = last
            if not baking.spent.paths and same(found, left):
                return left
            found = left
            if self.spent.paths:
                pace = self.spent.seconds / self.spent.paths
        return found

    def _note(self, baking: Baking) -> None:
        self.places |= {(batch, demand.index) for batch, demand in baking.wishes}
        self.failures |= baking.failures
        self.spent = self.spent.plus(baking.spent)


def same(found: Survey, left: Survey) -> bool:
    """Whether as much is ``left`` as was ``found`` before: it cannot be baked."""
    return found.demands.keys() == left.demands.keys() and found.paths == left.paths


def rung_ahead(context: PrewarmContext, found: Survey) -> int:
    """The samples at which pictures are expected to end: those of USUAL_END_SHARE, or those that
    they want now.
    """
    wanted_now = max((batch.enough for batch, _ in found.demands), default=FIRST_LEVEL)
    return max(wanted_now, int(USUAL_END_SHARE * most_samples(context.target)))


def paths_to(found: Survey, rung: int) -> float:
    """The paths that all texels which lack light take until they have so many samples."""
    wanted_now = ((batch.enough, demand) for batch, demand in found.wishes)
    return found.paths + sum((rung - enough) * len(demand.offsets) for enough, demand in wanted_now)


def carry_out(context: PrewarmContext, what: Wanted, begun: Callable[[Summary], None]) -> Summary:
    """Bake what is asked for, and sum it up; ``begun`` is given what is known before the baking.

    Raises StoreError, Cancelled, and WorkersError where there are no workers, or these bake nothing
    for long.
    """
    rounds = Rounds(context, what)
    since = time.monotonic()
    found = rounds.look(SURVEY_SHARES, context.deadline)
    looked = time.monotonic() - since
    while not context.engine.workforce.wait(REPORT_SECONDS):
        context.check()
    summary, ahead = look_ahead(rounds, found, looked, TRIAL_SECONDS)
    begun(summary)
    end = context.deadline - min(looked, context.left / 2.0)
    left = rounds.bake(found, ahead, end)
    late = context.late(end) and bool(left.demands or rounds.pictures.waiting)
    return summed_up(rounds, summary, left, late)


def carry_out_dry(context: PrewarmContext, what: Wanted) -> Summary:
    """What there is to do for what is asked for, and the time that it takes. Raises StoreError, and
    Cancelled.
    """
    rounds = Rounds(context, what)
    since = time.monotonic()
    found = rounds.look((0.0, 0.5), context.deadline)
    return look_ahead(rounds, found, time.monotonic() - since, DRY_TRIAL)[0]


def look_ahead(
    rounds: Rounds, found: Survey, looked: float, budget: float
) -> tuple[Summary, CostEstimate]:
    """What is lacking, and a forecast of what its baking takes, in about ``budget`` seconds.

    The summary has the time of the whole: what has passed, a trial, the baking, and looking again,
    which took so many seconds at first (``looked``).
    """
    context = rounds.context
    usual = [demand for batch, demand in found.wishes if batch.usual]
    passed = context.seconds
    rung = rung_ahead(context, found)
    context.report(Step("Trying", "chunk", 0, len(usual), SURVEY_SHARES[1]))
    workers = context.engine.baker.workers
    until = Until(context.target, rung)
    ahead = forecast(context.renderer, usual, until, workers, budget, context.cancelled)
    texels, others = (
        sum(len(demand.offsets) for demand in each) for each in (usual, found.demands.values())
    )
    ahead = ahead.times(others / max(texels, 1))
    rounds.checks = (
        CHECKING
        * ahead.seconds
        * max(rounds.pictures.read / max(others, 1), float(rounds.what.whole))
    )
    context.check()
    if found.demands:
        around = passed + min(context.seconds - passed, TRIAL_SECONDS) + looked
    else:
        around = passed
    if found.demands and not context.engine.baker.manned:
        around += WORKER_START_SECONDS
    return summary_of(rounds, found, ahead, around + rounds.checks / workers), ahead


def summary_of(rounds: Rounds, found: Survey, ahead: CostEstimate, around: float) -> Summary:
    """What is known before the baking; so many seconds are spent ``around`` it."""
    context = rounds.context
    what = rounds.what
    workers = context.engine.baker.workers
    left = ahead.time_left(workers, around)
    return Summary(
        scene=context.scene.id,
        order=what.order,
        views=len(what.views),
        isovalues=what.levels.single,
        ranges=what.levels.ranges,
        target_error=context.target,
        chunks=found.chunks,
        texels=found.unlit,
        refined=found.waiting,
        bytes=found.unlit * context.scene.plan.bytes_per_texel,
        stored_bytes=ahead.stored,
        processor_seconds=ahead.processor,
        workers=workers,
        **quality_fields(rounds, found),
        time_left=TimeLeftSchema(low=left.low, likely=left.likely, high=left.high),
    )


def summed_up(rounds: Rounds, ahead: Summary, left: Survey, late: bool) -> Summary:
    """What it came to, beside what was known ``ahead``; it is ``late`` where its time ended before
    what is ``left``.
    """
    reasons = list(rounds.failures.items())
    spent = rounds.spent
    context = rounds.context
    if late and rounds.what.whole:
        rounds.pictures.look((LAST_ROUND_END_SHARE, 1.0), time.monotonic())
    done = {"paths": spent.paths, "seconds": context.seconds, "processor_seconds": spent.seconds}
    if late:
        stopped = "deadline"
    elif reasons:
        stopped = "failures"
    else:
        stopped = "target"
    size = stored_bytes(context, rounds.places)
    facts = {
        **done,
        "stopped": stopped,
        "stored_bytes": size,
        "failed": len(reasons),
        "failures": failures_of(reasons),
    }
    return ahead.model_copy(update=facts | quality_fields(rounds, left))


def quality_fields(rounds: Rounds, left: Survey) -> dict[str, Any]:
    """How good light is, as fields of a summary: by pictures, and of whole isosurfaces the share of
    texels.
    """
    pictures = rounds.pictures
    seen = list(pictures.seen.values())
    errors = [each.error for each in pictures.seen.values()] or [1.0]
    final = sum(each.final for each in seen)
    total = sum(each.surface for each in seen)
    if rounds.what.whole:
        final = left.final * bool(left.demands or not pictures.waiting)
        total = left.seen
    worst = max(errors)
    mean = sum(errors) / len(errors)
    return {
        "final": final / total if total else 1.0,
        "error": worst,
        "errors": Errors(worst=worst, mean=mean),
    }


def stored_bytes(context: PrewarmContext, places: Iterable[tuple[Batch, Index]]) -> int:
    """Bytes that the chunks at these places take in the store."""
    once = {(replace(batch, enough=0), index) for batch, index in places}
    stored = ((index, layer) for batch, index in once for layer in context.store_of(batch).layers)
    return sum(len(layer.read(index) or b"") for index, layer in stored)


WORTHWHILE_ERROR_RATIO = 0.95
"""The error after twice as many samples over the one before, at most, where another rung is worth
it.
"""

BETWEEN = 3
"""Isovalues of a range whose pictures are measured."""


@dataclass(frozen=True, eq=False)
class RangeLight:
    """The light of a range once it is baked: texels have so many ``samples``, and ``pictures`` say
    how good it is.
    """

    samples: int
    pictures: ControlPictures


def views_of(context: PrewarmContext, low: float, high: float, settings: Settings) -> list[View]:
    """Views that stand for all of a range of isovalues, from all sides; where the light turns, each
    turned further.
    """
    levels = Levels(tuple({low + (high - low) * n / (BETWEEN - 1): None for n in range(BETWEEN)}))
    views = views_around(order_of({"all_directions": True}), levels, context.scene, settings)
    turns = context.scene.lighting.rotating
    return [
        replace(view, light=quaternion_from_angles(number * GOLDEN % 360.0, 0.0, 0.0))
        if turns
        else view
        for number, view in enumerate(views)
    ]


def bake_range(
    context: PrewarmContext,
    span: tuple[float, float],
    coding: Coding,
    views: Iterable[View],
    goal: float,
) -> RangeLight:
    """Bake all texels of isosurfaces in a ``span`` of isovalues until pictures of ``views`` are at
    the ``goal``.

    That is an error; texels that are at the context's target alone get no more samples. Sooner
    where more samples make pictures no better. Raises WorkersError, StoreError, and Cancelled.
    """
    levels = Levels((), (span,))
    most = most_samples(context.target)
    rung = FIRST_LEVEL
    before = math.inf
    pictures = None
    while not context.engine.workforce.wait(REPORT_SECONDS):
        context.check()
    lacked = lacking(context, levels, rung)
    while True:
        bake_rung(context, lacked, rung)
        while rung < most and not (lacked := lacking(context, levels, next_level(rung))).demands:
            rung = next_level(rung)
        pictures = pictures or measured(context, list(views))
        error = pictures.measure(coding).likely
        if error <= goal or error > WORTHWHILE_ERROR_RATIO * before or rung >= most:
            return RangeLight(rung, pictures)
        rung = next_level(rung)
        before = error


def measured(context: PrewarmContext, views: list[View]) -> ControlPictures:
    """The pictures of ``views`` with their control pixels. Raises Cancelled."""

    def report(done: int) -> None:
        context.check()
        context.report(Step("Measuring", "view", done, len(views), done / len(views)))

    return ControlPictures(context.renderer, views, context.target, report)


def lacking(context: PrewarmContext, levels: Levels, rung: int) -> Survey:
    """What texels of whole isosurfaces lack to have as many samples as the ``rung``, or to be at
    the target alone.
    """
    return of_surfaces(context, levels, rung, (0.0, 1.0))


def bake_rung(context: PrewarmContext, found: Survey, rung: int) -> None:
    """Bake what was ``found`` lacking of a ``rung``. Raises WorkersError, StoreError, and
    Cancelled.
    """
    if not found.demands:
        return
    demands = [demand for _, demand in found.wishes]
    until = Until(context.target, rung)
    workers = context.engine.baker.workers
    ahead = forecast(context.renderer, demands, until, workers, TRIAL_SECONDS, context.cancelled)
    baking = Baking(
        context, found.wishes, Expected(ahead.seconds, 0.0, (0.0, 1.0)), context.deadline
    )
    baking.run()
    if baking.failures:
        raise WorkersError(
            f"The light of {len(baking.failures)} chunks failed: "
            f"{next(iter(baking.failures.values()))}"
        )
