"""The work of a prewarm: look which light its pictures lack, forecast the cost, bake it, and look
again.

Light climbs levels of samples (16, 32, 64, …), as for a view that somebody looks at. On each level
the pictures are checked; a picture that is not at its target asks for the next level of its texels.
For whole isosurfaces, pictures from a few sides decide for all texels. Pages that draw by
themselves show only light of texels; ``bake_range`` bakes a range of isovalues for them.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from isogi_core.bake.noise import Effort, relative_error
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
from isogi_server.prewarm.baking import (
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
from isogi_server.prewarm.order import GOLDEN, Levels, PrewarmOrder, Views, order_of, views_around
from isogi_server.prewarm.record import Errors, Summary, failures_of
from isogi_server.render.patience import time_limit
from isogi_server.schemas import TimeLeftSchema
from isogi_server.settings import Settings
from isogi_worker.errors import WorkersError
from isogi_worker.progress import CostEstimate

Span = tuple[float, float]
"""The shares of all work at which a part of it begins and ends."""


@dataclass(eq=False)
class Survey:
    """The light that is lacking, as ``demands`` by batch and chunk.

    For whole isosurfaces, ``seen`` texels were examined, of which ``final`` ones lack nothing.
    """

    demands: dict[tuple[Batch, Index], Demand] = field(default_factory=dict)
    seen: int = 0
    final: int = 0

    def add(self, batch: Batch, demand: Demand) -> None:
        """Add lacking light of a chunk. Light that several views lack is counted once."""
        place = batch, demand.index
        other = self.demands.get(place)
        if other is None:
            self.demands[place] = demand
        else:
            self.demands[place] = demand.joined(other)

    @property
    def wishes(self) -> list[Wish]:
        """All lacking light."""
        return [(batch, demand) for (batch, _), demand in self.demands.items()]

    @property
    def chunks(self) -> int:
        """Number of chunks that lack light, counted for each bake."""
        return len({(batch.light, index) for batch, index in self.demands})

    @property
    def unlit(self) -> int:
        """Number of texels without light."""
        return sum(demand.effort.unlit for demand in self.demands.values())

    @property
    def waiting(self) -> int:
        """Number of texels with light that are to be refined."""
        return round(sum(demand.effort.lit for demand in self.demands.values()))

    @property
    def paths(self) -> float:
        """Number of paths that baking is expected to take."""
        efforts = (demand.effort for demand in self.demands.values())
        return sum(FIRST_LEVEL * effort.unlit + effort.left for effort in efforts)


@dataclass(frozen=True)
class Seen:
    """The state of a picture at the last look: pixels of the surface,
    of these ``final`` ones, and the total relative ``error``.
    """

    surface: int
    final: int
    error: float


class Pictures:
    """The pictures of ``views``, which decide how many samples texels get. Each is checked as a
    server checks a picture that it shows.

    - ``waiting``: pictures that lack light, or whose check is not finished.
    - ``seen``: their states at the last look.
    - ``rung``: the most samples that their texels have, or are to have.
    - ``read``: texels that lacked light at the first look, counted once for each picture that reads
      them.

    With ``sample``, they stand for whole isosurfaces: none has finer texels, and a view whose
    camera stands in a wall is left out.
    """

    def __init__(self, context: PrewarmContext, views: Views, sample: bool, rung: int) -> None:
        """Look at no picture yet."""
        self.waiting = set(range(len(views)))
        self.seen: dict[int, Seen] = {}
        self.rung = rung
        self.read = 0
        self._context = context
        self._views = views
        self._sample = sample

    def look(self, span: Span, end: float) -> Survey:
        """Check each waiting picture as far as its texels allow; return the light that they lack.

        Checks end when the monotonic clock reaches ``end``. Raises StoreError, and Cancelled.
        """
        found = Survey()
        total = len(self.waiting)
        done = 0
        for number, view in enumerate(self._views):
            if number in self.waiting:
                self._context.check()
                self._context.report(
                    Step("Looking", "view", done, total, progress_share(done, total, span))
                )
                # A view of a sample whose camera stands in a wall raises ViewError, and is left
                # out.
                left_out = (ViewError,) if self._sample else ()
                with suppress(*left_out):
                    self._take(number, self._checked(view, end), found)
                if number not in self.seen:
                    self.waiting.discard(number)
                done += 1
        self._context.report(Step("Looking", "view", total, total, span[1]))
        return found

    def _checked(self, view: View, end: float) -> Frame:
        """Take steps of the check of a view until there is none,
        or light of texels is needed first; return the frame.
        """
        context = self._context
        frame = context.frame_of(view)
        # Paths of pixels that somebody looked at before would not last in the store.
        if frame.goes_without_texels:
            context.renderer.surface.checks.require_texels(view, context.goal)
            frame = context.frame_of(view)
        more = True
        # A prewarm is to fill the store: light of pixels would not last.
        prices = SHARED_PRICES if self._sample else AWAITED.of_texels
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
        """Note how good a picture is, and the light that it lacks."""
        wishes = [wish for wish in wishes_of(frame) if not (self._sample and wish[0].fineness)]
        if number not in self.seen:
            self.read += sum(len(demand.offsets) for _, demand in wishes)
        self.seen[number] = Seen(frame.surface, frame.counts["final"], frame.total.likely)
        for wish in wishes:
            found.add(*wish)
        if wishes:
            self.rung = max(self.rung, *(batch.goal.samples for batch, _ in wishes))
        else:
            self.rung = max(self.rung, rung_of(frame))
            if not frame.checkable:
                self.waiting.discard(number)


def rung_of(frame: Frame) -> int:
    """Return the samples that texels of a ``frame`` have,
    apart from those that need fewer; 0 if it reads no texels.
    """
    if frame.quality.lacking:
        return frame.quality.lacking.reading.rung
    return 0


def wishes_of(frame: Frame) -> Iterator[Wish]:
    """Yield the light that the picture of a ``frame`` lacks,
    or the picture with finer texels that is to replace it.
    """
    coming = frame.quality.finer or frame
    for stage in coming.stages:
        if stage.caches:
            side = stage.caches.spec("gi").digest
        else:
            side = ""
        batch = Batch(stage.shown, stage.goal, coming.quality.fineness, side, stage.caches)
        yield from ((batch, demand) for demand in stage.demands)


def with_efforts(context: PrewarmContext, found: Survey) -> Survey:
    """Replace the efforts of lacking light by exact ones,
    from the store, as several views may read the same texels.
    """
    for (batch, index), demand in found.demands.items():
        if demand.effort.unlit < len(demand.offsets):
            context.check()
            found.demands[batch, index] = with_stored_effort(context, batch, demand)
    return found


def survey_surfaces(context: PrewarmContext, levels: Levels, rung: int, span: Span) -> Survey:
    """Return the light that the store lacks for all texels of whole isosurfaces, not those of sides
    and not finer ones, to have ``rung`` samples, or to be good enough by themselves.

    ``span`` is the part of the bar of progress that this takes. Raises StoreError and Cancelled.
    """
    goal = context.goal_at(rung)
    prepared = context.renderer.prepared
    found = Survey()
    volume = prepared.scene.volume
    total = prepared.chunks[0]
    places = [volume.normalise_span(*each) for each in levels.spans]
    # Texels where they lie, each on the isosurface through itself.
    for index, offsets in surface_texels(
        volume.voxels, prepared.shape, prepared.lattice.chunk, places
    ):
        context.check()
        context.report(
            Step("Looking", "layer", index[0], total, progress_share(index[0], total, span))
        )
        batch = Batch(None, goal)
        count_chunk(found, batch, with_stored_effort(context, batch, unseen_demand(index, offsets)))
    # Texels that are projected onto an isosurface.
    for demand in projected_demands(context, levels):
        context.check()
        batch = Batch(demand.shown, goal)
        count_chunk(found, batch, with_stored_effort(context, batch, demand))
    context.report(Step("Looking", "layer", total, total, span[1]))
    return found


def unseen_demand(index: Index, offsets: np.ndarray, shown: Isovalue | None = None) -> Demand:
    """Return a demand for texels of a chunk that no view asks for: all of them count alike."""
    seen = np.ones(len(offsets), np.float32)
    effort = Effort(len(offsets), 0.0, 0.0)
    return Demand(index, offsets, float(len(offsets)), effort, seen, shown)


def projected_demands(context: PrewarmContext, levels: Levels) -> Iterator[Demand]:
    """Yield demands for the texels that must be projected onto
    the isosurfaces of single isovalues; ranges have none.
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
            beyond = distances.beyond(context.goal.error)
            if beyond.any():
                yield unseen_demand(index, offsets[beyond], level)


def count_chunk(found: Survey, batch: Batch, demand: Demand) -> None:
    """Count a chunk of a ``batch`` whose texels were looked up, and add the light that it lacks."""
    texels = len(demand.offsets)
    lacking = demand.effort.unlit + round(demand.effort.lit)
    found.seen += texels
    found.final += texels - lacking
    if lacking:
        found.add(batch, demand)


def with_stored_effort(context: PrewarmContext, batch: Batch, demand: Demand) -> Demand:
    """Return a ``demand`` with the effort that its texels take,
    by the light that the store has of them.
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
    return replace(demand, effort=Effort.of(error, samples, batch.goal))


def progress_share(done: int, total: int, span: Span) -> float:
    """Return the share of all work when ``done`` of ``total`` in a ``span`` are done."""
    return span[0] + (span[1] - span[0]) * done / max(total, 1)


SURVEY_SHARES = (0.0, 0.04)
LAST_ROUND_END_SHARE = 0.98
"""Shares of all work at which the first look begins and ends, and at which the last round ends."""

BAKED_SHARE = 0.8
"""Share of a round at which its light is baked, and the checks of pictures begin."""

TRIAL_SECONDS = 3.0
DRY_TRIAL = 10.0
"""Seconds that a forecast may take, before baking and in a dry run."""

CHECKING = 0.25
"""Cost of checking a picture, relative to that of the light of all its texels:
paths from pixels are traced as long as they cost less than the next level of texels.
"""

USUAL_END_SHARE = 1 / 64
"""Samples at which pictures end, relative to those at
which the last of their texels would: 16 to 64 at 2 %.
"""


@dataclass(frozen=True, eq=False)
class Wanted:
    """An order made out for a scene: its ``views`` or, if there are none,
    whole isosurfaces, which the pictures of ``samples`` stand for.
    """

    order: PrewarmOrder
    views: Views
    levels: Levels
    samples: Views

    @property
    def whole(self) -> bool:
        """True if the order is for whole isosurfaces."""
        return not len(self.views)


def wanted(context: PrewarmContext, order: PrewarmOrder, settings: Settings) -> Wanted:
    """Make out an ``order`` for the scene of a context.

    Raises ViewError if the scene does not allow it.
    """
    scene = context.scene
    views = Views(order, scene, settings)
    levels = order.isovalues_of(scene)
    return Wanted(order, views, levels, views_around(order, levels, scene, settings))


@dataclass(eq=False)
class Rounds:
    """The rounds of a prewarm, each of looking and baking, and their results so far.

    ``places`` are the chunks that were baked, ``spent`` is the cost of that, and ``failures`` are
    chunks given up. ``checks`` is the expected time of all checks of pictures, in seconds of all
    workers.
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
        """Return the light that is lacking now, after checking pictures as far as possible.

        Checks end when the monotonic clock reaches ``end``. Raises StoreError, and Cancelled.
        """
        if not self.what.whole:
            return with_efforts(self.context, self.pictures.look(span, end))
        # For whole isosurfaces, bake all texels to the present level before pictures decide on the
        # next.
        levels = self.what.levels
        middle = sum(span) / 2.0
        found = survey_surfaces(self.context, levels, self.pictures.rung, (span[0], middle))
        if found.demands or not self.pictures.waiting:
            return found
        rung = self.pictures.rung
        lacking = self.pictures.look((middle, span[1]), end)
        if self.pictures.rung > rung:
            self.context.rung_rose(self.pictures.rung)
        found = survey_surfaces(self.context, levels, self.pictures.rung, (span[1], span[1]))
        for wish in lacking.wishes:
            found.add(*wish)
        return with_efforts(self.context, found)

    def bake(self, found: Survey, ahead: CostEstimate, end: float) -> Survey:
        """Bake the light that was ``found`` lacking, and that pictures lack afterwards, until
        ``end``; return the light left.

        Raises WorkersError, StoreError, and Cancelled.
        """
        # Forecast the time per path, for reports of the time left in the first round.
        coming = paths_to(found, rung_ahead(self.context, found))
        pace = ahead.seconds / max(coming, 1.0)
        while found.demands and not self.context.late(end):
            coming = max(coming - found.paths, 0.0)
            # The number of rounds is unknown: give each half of the rest of the progress bar.
            first = self.done
            last = (self.done + LAST_ROUND_END_SHARE) / 2.0
            baked = first + BAKED_SHARE * (last - first)
            seconds = self._seconds(pace, found.paths, found.unlit)
            later = self._seconds(pace, coming) + self.checks
            expected = Expected(seconds, later, (first, baked))
            baking = Baking(self.context, found.wishes, expected, end)
            baking.run()
            self._note(baking)
            left = self.look((baked, last), end)
            self.done = last
            # Stop if nothing was baked and the same light is lacking: it cannot be baked.
            if not baking.spent.paths and is_unchanged(found, left):
                return left
            found = left
        return found

    def _seconds(self, pace: float, paths: float, unlit: int = 0) -> float:
        """Return the seconds that ``paths`` will take, those of first light of ``unlit`` texels
        among them: by the cost of earlier rounds, or if there is none at the forecast ``pace``.
        """
        if self.spent.paths:
            return self.spent.ahead(paths, unlit)
        return pace * paths

    def _note(self, baking: Baking) -> None:
        """Add the places, failures and cost of a round. A failure stays listed even if a later
        round bakes the chunk.
        """
        self.places |= {(batch, demand.index) for batch, demand in baking.wishes}
        self.failures |= baking.failures
        self.spent = self.spent.plus(baking.spent)


def is_unchanged(found: Survey, left: Survey) -> bool:
    """Return True if as much light is ``left`` as was ``found`` before."""
    return found.demands.keys() == left.demands.keys() and found.paths == left.paths


def rung_ahead(context: PrewarmContext, found: Survey) -> int:
    """Return the samples at which pictures are expected to end,
    or those that they want now if these are more.
    """
    wanted_now = max((batch.goal.samples for batch, _ in found.demands), default=FIRST_LEVEL)
    return max(wanted_now, int(USUAL_END_SHARE * most_samples(context.goal.error)))


def paths_to(found: Survey, rung: int) -> float:
    """Return the paths that all texels which lack light take until they have ``rung`` samples."""
    more = ((rung - batch.goal.samples) * len(demand.offsets) for batch, demand in found.wishes)
    return found.paths + sum(more)


def carry_out(context: PrewarmContext, what: Wanted, begun: Callable[[Summary], None]) -> Summary:
    """Bake the light of an order, and return a summary; ``begun`` is called with its forecast
    before the baking.

    Raises StoreError, Cancelled, and WorkersError if there are no workers, or if they bake nothing
    for long.
    """
    rounds = Rounds(context, what)
    since = time.monotonic()
    # Look which light is lacking; workers start meanwhile.
    found = rounds.look(SURVEY_SHARES, context.deadline)
    looked = time.monotonic() - since
    while not context.engine.workers.wait(REPORT_SECONDS):
        context.check()
    summary, ahead = forecast_summary(rounds, found, looked, TRIAL_SECONDS)
    begun(summary)
    # Leave time for a last look, but at most half of the time.
    end = context.deadline - min(looked, context.left / 2.0)
    left = rounds.bake(found, ahead, end)
    late = context.late(end) and bool(left.demands or rounds.pictures.waiting)
    return final_summary(rounds, summary, left, late)


def carry_out_dry(context: PrewarmContext, what: Wanted) -> Summary:
    """Return the summary of an order with the forecast of its time, without baking.

    Raises StoreError, and Cancelled.
    """
    rounds = Rounds(context, what)
    since = time.monotonic()
    # Looking is the first half of the progress bar, and the forecast is the other one.
    found = rounds.look((0.0, 0.5), context.deadline)
    return forecast_summary(rounds, found, time.monotonic() - since, DRY_TRIAL)[0]


def forecast_summary(
    rounds: Rounds, found: Survey, looked: float, budget: float
) -> tuple[Summary, CostEstimate]:
    """Return the summary before the baking, and the forecast of its cost, which takes about
    ``budget`` seconds.

    The summary's time is that of the whole prewarm: the time passed, the forecast, the baking, and
    looking again, which took ``looked`` seconds at first.
    """
    context = rounds.context
    # Rehearse texels of the scene's light. Finer texels and those of surfaces' sides are not
    # rehearsed, and are taken to cost as much each.
    usual = [demand for batch, demand in found.wishes if batch.usual]
    passed = context.seconds
    rung = rung_ahead(context, found)
    context.report(Step("Trying", "chunk", 0, len(usual), SURVEY_SHARES[1]))
    workers = context.engine.baker.workers
    goal = context.goal_at(rung)
    ahead = forecast(context.renderer, usual, goal, workers, budget, context.cancelled)
    rehearsed = sum(len(demand.offsets) for demand in usual)
    texels = sum(len(demand.offsets) for demand in found.demands.values())
    ahead = ahead.times(texels / max(rehearsed, 1))
    # The check of a picture costs a share of the light of all its texels, and several pictures may
    # read a texel. Pictures of whole isosurfaces are looked at only after the first round: until
    # then, take each texel to be read once.
    pictures_per_texel = rounds.pictures.read / max(texels, 1)
    if rounds.what.whole:
        pictures_per_texel = max(pictures_per_texel, 1.0)
    rounds.checks = CHECKING * ahead.seconds * pictures_per_texel
    context.check()
    # A dry run takes more time for its forecast than the prewarm that it stands for will take.
    if found.demands:
        around = passed + min(context.seconds - passed, TRIAL_SECONDS) + looked
    else:
        around = passed
    # Without lacking light there is no baking, and nothing to start.
    if found.demands and not context.engine.baker.manned:
        around += WORKER_START_SECONDS
    return summary_of(rounds, found, ahead, around + rounds.checks / workers), ahead


def summary_of(rounds: Rounds, found: Survey, ahead: CostEstimate, around: float) -> Summary:
    """Return the summary before the baking;
    ``around`` are the seconds spent before and after it.
    """
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
        target_error=context.goal.error,
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


def final_summary(rounds: Rounds, ahead: Summary, left: Survey, late: bool) -> Summary:
    """Return the summary after the baking.

    It is ``late`` if its time ended before the light ``left`` was baked.
    """
    reasons = list(rounds.failures.items())
    spent = rounds.spent
    context = rounds.context
    # Pictures are not looked at while texels lack light: do it once more, without further checks.
    if late and rounds.what.whole:
        rounds.pictures.look((LAST_ROUND_END_SHARE, 1.0), time.monotonic())
    if late:
        stopped = "deadline"
    elif reasons:
        stopped = "failures"
    else:
        stopped = "target"
    facts = {
        "paths": spent.paths,
        "seconds": context.seconds,
        "processor_seconds": spent.seconds,
        "stopped": stopped,
        "stored_bytes": stored_bytes(context, rounds.places),
        "failed": len(reasons),
        "failures": failures_of(reasons),
    }
    return ahead.model_copy(update=facts | quality_fields(rounds, left))


def quality_fields(rounds: Rounds, left: Survey) -> dict[str, Any]:
    """Return the fields of a summary that say how good light is:
    by pictures, and for whole isosurfaces the share of texels.
    """
    pictures = rounds.pictures
    seen = list(pictures.seen.values())
    errors = [each.error for each in pictures.seen.values()] or [1.0]
    final = sum(each.final for each in seen)
    total = sum(each.surface for each in seen)
    # For whole isosurfaces count texels instead of pixels; none are final before pictures have
    # decided.
    if rounds.what.whole:
        total = left.seen
        final = left.final
        if pictures.waiting and not left.demands:
            final = 0
    worst = max(errors)
    mean = sum(errors) / len(errors)
    return {
        "final": final / total if total else 1.0,
        "error": worst,
        "errors": Errors(worst=worst, mean=mean),
    }


def stored_bytes(context: PrewarmContext, places: Iterable[tuple[Batch, Index]]) -> int:
    """Return the bytes that the chunks at these places take in the store."""
    once = {(batch.light, index): batch for batch, index in places}
    stored = (
        (index, layer)
        for (_, index), batch in once.items()
        for layer in context.store_of(batch).layers
    )
    return sum(len(layer.read(index) or b"") for index, layer in stored)


WORTHWHILE_ERROR_RATIO = 0.95
"""Largest ratio of the error after a doubling of samples
to that before at which another doubling is tried.
"""

BETWEEN = 3
"""Isovalues of a range whose pictures are measured."""


@dataclass(frozen=True, eq=False)
class RangeLight:
    """The baked light of a range: the ``samples`` of texels,
    and ``pictures`` that measure its error.
    """

    samples: int
    pictures: ControlPictures


def views_of(context: PrewarmContext, low: float, high: float, settings: Settings) -> list[View]:
    """Return views that stand for a range of isovalues, from all sides.

    If the light rotates, each has another rotation.
    """
    levels = Levels(tuple({low + (high - low) * n / (BETWEEN - 1): None for n in range(BETWEEN)}))
    views = views_around(order_of({"all_directions": True}), levels, context.scene, settings)
    if not context.scene.lighting.rotating:
        return list(views)
    return [
        replace(view, light=quaternion_from_angles(number * GOLDEN % 360.0, 0.0, 0.0))
        for number, view in enumerate(views)
    ]


def bake_range(
    context: PrewarmContext,
    span: tuple[float, float],
    coding: Coding,
    views: Iterable[View],
    target: float,
) -> RangeLight:
    """Bake all texels of isosurfaces in a ``span`` of isovalues until pictures of ``views`` have
    the error ``target``.

    Texels that are at the context's goal by themselves get no more samples. Baking ends early if
    more samples do not make pictures better. Raises WorkersError, StoreError, and Cancelled.
    """
    levels = Levels((), (span,))
    most = most_samples(context.goal.error)
    rung = FIRST_LEVEL
    before = math.inf
    pictures = None
    while not context.engine.workers.wait(REPORT_SECONDS):
        context.check()
    lacked = survey_range(context, levels, rung)
    while True:
        bake_rung(context, lacked, rung)
        # Skip levels that lack no texel.
        while rung < most:
            lacked = survey_range(context, levels, next_level(rung))
            if lacked.demands:
                break
            rung = next_level(rung)
        if pictures is None:
            pictures = trace_controls(context, list(views))
        error = pictures.measure(coding).likely
        # Stop at the target, or if another level is not worth it.
        if error <= target or error > WORTHWHILE_ERROR_RATIO * before or rung >= most:
            return RangeLight(rung, pictures)
        rung = next_level(rung)
        before = error


def trace_controls(context: PrewarmContext, views: list[View]) -> ControlPictures:
    """Return the pictures of ``views`` with their control pixels. Raises Cancelled."""

    def report(done: int) -> None:
        context.check()
        context.report(Step("Measuring", "view", done, len(views), done / len(views)))

    return ControlPictures(context.renderer, views, context.goal, report)


def survey_range(context: PrewarmContext, levels: Levels, rung: int) -> Survey:
    """Return the light that texels of whole isosurfaces lack
    to have ``rung`` samples, or to be good enough by themselves.
    """
    return survey_surfaces(context, levels, rung, (0.0, 1.0))


def bake_rung(context: PrewarmContext, found: Survey, rung: int) -> None:
    """Bake the light that was ``found`` lacking of a level.

    Raises WorkersError, StoreError, and Cancelled.
    """
    if not found.demands:
        return
    demands = [demand for _, demand in found.wishes]
    goal = context.goal_at(rung)
    workers = context.engine.baker.workers
    # Forecast the time for reports of progress, and bake.
    ahead = forecast(context.renderer, demands, goal, workers, TRIAL_SECONDS, context.cancelled)
    baking = Baking(
        context, found.wishes, Expected(ahead.seconds, 0.0, (0.0, 1.0)), context.deadline
    )
    baking.run()
    if baking.failures:
        raise WorkersError(
            f"The light of {len(baking.failures)} chunks failed: "
            f"{next(iter(baking.failures.values()))}"
        )
