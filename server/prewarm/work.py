"""The work of a prewarm: look what its pictures lack, forecast what that takes, bake it, and look again.

Light goes up a ladder of samples (16, 32, 64, …), as it does for a view that somebody looks at. On each rung the
pictures are checked; those that need more of their texels ask for the next. Of whole isosurfaces pictures from a few
sides decide for all texels.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from typing import Any

from isogi_core.bake.noise import Until
from isogi_core.bake.precision import FIRST_LEVEL
from isogi_core.cache.costs import Cost
from isogi_core.model.scene_plan import most_samples
from isogi_core.prepared.prepared_scene import Index
from server.prewarm.context import LOOK, Baking, Batch, Expected, PrewarmContext, Step
from server.prewarm.forecast import START, forecast
from server.prewarm.looking import Pictures, Span, Survey, of_surfaces, with_efforts
from server.prewarm.order import Levels, PrewarmOrder, Views, views_around
from server.prewarm.record import Errors, Summary, failures_of
from server.schemas import TimeLeftSchema
from server.settings import Settings
from worker.progress import CostEstimate

BEFORE, END = (0.0, 0.04), 0.98
"""Where in all of the work the first look begins and ends, and where the last round does, as shares of it."""

BAKED = 0.8
"""The share of a round at which its light is baked, and the pictures are checked."""

TRIAL, DRY_TRIAL = 3.0, 10.0
"""Seconds that a forecast may take, before baking and in a dry run."""

CHECKING = 0.25
"""What the check of a picture takes over what the light of all its texels does: pixels get light of their own while
that costs less than the next rung.
"""

USUAL_END_SHARE = 1 / 64
"""At how many samples pictures end, over those at which the last of their texels would: 16 to 64 at 2 %."""


@dataclass(frozen=True, eq=False)
class Wanted:
    """What is asked for, made out for a scene: its ``views`` or, where there are none, whole isosurfaces of which
    ``samples`` are looked at.
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
    views, levels = Views(order, scene, settings), order.isovalues_of(scene)
    return Wanted(order, views, levels, views_around(order, levels, scene, settings))


@dataclass(eq=False)
class Rounds:
    """What a prewarm has done so far, round by round: the ``places`` that it baked at, what that ``spent``, and its
    ``failures``. Checks of all pictures are expected to take so many seconds of all workers (``checks``).
    """

    context: PrewarmContext
    what: Wanted
    places: set[tuple[Batch, Index]] = field(default_factory=set)
    failures: dict[Index, str] = field(default_factory=dict)
    spent: Cost = field(default_factory=Cost)
    done: float = BEFORE[1]
    checks: float = 0.0

    def __post_init__(self) -> None:
        """Look at no picture yet."""
        views = self.what.samples if self.what.whole else self.what.views
        self.pictures = Pictures(self.context, views, self.what.whole, self.context.rung)

    def look(self, span: Span, end: float) -> Survey:
        """What is lacking now, once pictures are checked as far as they can be until the ``end``, by the monotonic
        clock. Raises StoreError, and Cancelled.
        """
        if not self.what.whole:
            return with_efforts(self.context, self.pictures.look(span, end))
        levels, middle = self.what.levels, sum(span) / 2.0
        found = of_surfaces(self.context, levels, self.pictures.rung, (span[0], middle))
        if found.demands or not self.pictures.waiting:
            return found
        rung, lacking = self.pictures.rung, self.pictures.look((middle, span[1]), end)
        if self.pictures.rung > rung:
            self.context.climbed(self.pictures.rung)
        found = of_surfaces(self.context, levels, self.pictures.rung, (span[1], span[1]))
        for wish in lacking.wishes:
            found.add(*wish)
        return with_efforts(self.context, found)

    def bake(self, found: Survey, ahead: CostEstimate, end: float) -> Survey:
        """Bake what was ``found`` lacking, and what pictures then lack, until the ``end``; what is left of it.

        Raises WorkersError, StoreError, and Cancelled.
        """
        coming = paths_to(found, rung_ahead(self.context, found))
        pace = ahead.seconds / max(coming, 1.0)
        while found.demands and not self.context.late(end):
            coming = max(coming - found.paths, 0.0)
            first, last = self.done, (self.done + END) / 2.0
            baked = first + BAKED * (last - first)
            expected = Expected(pace * found.paths, pace * coming + self.checks, (first, baked))
            baking = Baking(self.context, found.wishes, expected, end)
            baking.run()
            self._note(baking)
            left, self.done = self.look((baked, last), end), last
            if not baking.spent.paths and same(found, left):
                return left
            found, pace = left, self.spent.seconds / self.spent.paths if self.spent.paths else pace
        return found

    def _note(self, baking: Baking) -> None:
        self.places |= {(batch, demand.index) for batch, demand in baking.wishes}
        self.failures |= baking.failures
        self.spent = self.spent.plus(baking.spent)


def same(found: Survey, left: Survey) -> bool:
    """Whether as much is ``left`` as was ``found`` before: it cannot be baked."""
    return found.demands.keys() == left.demands.keys() and found.paths == left.paths


def rung_ahead(context: PrewarmContext, found: Survey) -> int:
    """The samples at which pictures are expected to end: those of USUAL_END_SHARE, or those that they want now."""
    wanted_now = max((batch.enough for batch, _ in found.demands), default=FIRST_LEVEL)
    return max(wanted_now, int(USUAL_END_SHARE * most_samples(context.target)))


def paths_to(found: Survey, rung: int) -> float:
    """The paths that all texels which lack light take until they have so many samples."""
    wanted_now = ((batch.enough, demand) for batch, demand in found.wishes)
    return found.paths + sum((rung - enough) * len(demand.offsets) for enough, demand in wanted_now)


def carry_out(context: PrewarmContext, what: Wanted, begun: Callable[[Summary], None]) -> Summary:
    """Bake what is asked for, and sum it up; ``begun`` is given what is known before the baking.

    Raises StoreError, Cancelled, and WorkersError where there are no workers, or these bake nothing for long.
    """
    rounds, since = Rounds(context, what), time.monotonic()
    found = rounds.look(BEFORE, context.deadline)
    looked = time.monotonic() - since
    while not context.engine.workforce.wait(LOOK):
        context.check()
    summary, ahead = look_ahead(rounds, found, looked, TRIAL)
    begun(summary)
    end = context.deadline - min(looked, context.left / 2.0)
    left = rounds.bake(found, ahead, end)
    late = context.late(end) and bool(left.demands or rounds.pictures.waiting)
    return summed_up(rounds, summary, left, late)


def carry_out_dry(context: PrewarmContext, what: Wanted) -> Summary:
    """What there is to do for what is asked for, and the time that it takes. Raises StoreError, and Cancelled."""
    rounds, since = Rounds(context, what), time.monotonic()
    found = rounds.look((0.0, 0.5), context.deadline)
    return look_ahead(rounds, found, time.monotonic() - since, DRY_TRIAL)[0]


def look_ahead(rounds: Rounds, found: Survey, looked: float, budget: float) -> tuple[Summary, CostEstimate]:
    """What is lacking, and a forecast of what its baking takes, in about ``budget`` seconds.

    The summary has the time of the whole: what has passed, a trial, the baking, and looking again, which took so many
    seconds at first (``looked``).
    """
    context = rounds.context
    usual = [demand for batch, demand in found.wishes if batch.usual]
    passed, rung = context.seconds, rung_ahead(context, found)
    context.report(Step("Trying", "chunk", 0, len(usual), BEFORE[1]))
    workers, until = context.engine.workers, Until(context.target, rung)
    ahead = forecast(context.renderer, usual, until, workers, budget, context.cancelled)
    texels, others = (sum(len(demand.offsets) for demand in each) for each in (usual, found.demands.values()))
    ahead = ahead.times(others / max(texels, 1))
    rounds.checks = CHECKING * ahead.seconds * max(rounds.pictures.read / max(others, 1), float(rounds.what.whole))
    context.check()
    around = passed + min(context.seconds - passed, TRIAL) + looked if found.demands else passed
    around += START if found.demands and not context.engine.manned else 0.0
    return summary_of(rounds, found, ahead, around + rounds.checks / workers), ahead


def summary_of(rounds: Rounds, found: Survey, ahead: CostEstimate, around: float) -> Summary:
    """What is known before the baking; so many seconds are spent ``around`` it."""
    context, what = rounds.context, rounds.what
    workers = context.engine.workers
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
    """What it came to, beside what was known ``ahead``; it is ``late`` where its time ended before what is ``left``."""
    reasons, spent, context = list(rounds.failures.items()), rounds.spent, rounds.context
    if late and rounds.what.whole:
        rounds.pictures.look((END, 1.0), time.monotonic())
    done = {"paths": spent.paths, "seconds": context.seconds, "processor_seconds": spent.seconds}
    stopped = "deadline" if late else "failures" if reasons else "target"
    size = stored_bytes(context, rounds.places)
    facts = {**done, "stopped": stopped, "stored_bytes": size, "failed": len(reasons), "failures": failures_of(reasons)}
    return ahead.model_copy(update=facts | quality_fields(rounds, left))


def quality_fields(rounds: Rounds, left: Survey) -> dict[str, Any]:
    """How good light is, as fields of a summary: by pictures, and of whole isosurfaces the share of texels."""
    pictures = rounds.pictures
    seen, errors = list(pictures.seen.values()), [each.error for each in pictures.seen.values()] or [1.0]
    final, total = sum(each.final for each in seen), sum(each.surface for each in seen)
    if rounds.what.whole:
        final, total = left.final * bool(left.demands or not pictures.waiting), left.seen
    worst, mean = max(errors), sum(errors) / len(errors)
    return {"final": final / total if total else 1.0, "error": worst, "errors": Errors(worst=worst, mean=mean)}


def stored_bytes(context: PrewarmContext, places: Iterable[tuple[Batch, Index]]) -> int:
    """Bytes that the chunks at these places take in the store."""
    once = {(replace(batch, enough=0), index) for batch, index in places}
    stored = ((index, layer) for batch, index in once for layer in context.store_of(batch).layers)
    return sum(len(layer.read(index) or b"") for index, layer in stored)
