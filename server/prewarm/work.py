"""The work of a prewarm: look what is lacking, tell what that takes, have it baked, and look again."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from server.facts import TimeLeftFacts
from server.prewarm.baking import LOOK, Baking
from server.prewarm.desk import Step
from server.prewarm.forecast import START, Forecast, forecast
from server.prewarm.levels import Levels
from server.prewarm.order import PrewarmOrder, Views
from server.prewarm.summary import Errors, Summary, failures_of
from server.prewarm.survey import Quality, Survey, survey

if TYPE_CHECKING:
    from isogi_core.bake.recipe import Index
    from server.prewarm.desk import Desk
    from server.settings import Settings

BEFORE, AFTER = (0.0, 0.04), (0.96, 1.0)
"""Where in all of the work looking begins and ends, before and after the baking, as shares of it."""

HALF = 0.5
"""Where an adaptive scene's views are looked at between."""

TRIAL, DRY_TRIAL = 3.0, 10.0
"""Seconds that a forecast may take, before baking and in a dry run."""


@dataclass(frozen=True, eq=False)
class Wanted:
    """What is asked for, made out for a scene: its ``views`` or, where there are none, whole isosurfaces."""

    order: PrewarmOrder
    views: Views
    levels: Levels


def wanted(desk: Desk, order: PrewarmOrder, settings: Settings) -> Wanted:
    """What an order asks for; ViewError where that is not allowed."""
    return Wanted(order, Views(order, desk.scene, settings), order.isovalues_of(desk.scene))


def carry_out(desk: Desk, what: Wanted, begun: Callable[[Summary], None]) -> Summary:
    """Bake what is asked for, and sum it up; ``begun`` is given what is known before the baking.

    Raises StoreError, Cancelled, and WorkersError where there are no workers, or these bake nothing for long.
    """
    found = survey(desk, what.views, what.levels, BEFORE)
    while not desk.studio.await_workers(LOOK):
        desk.check()
    ahead, expected = look_ahead(desk, what, found, TRIAL)
    begun(ahead)
    stages = stages_of(desk, what)
    end = desk.deadline - min((len(stages) - 1) * found.seconds, desk.left / 2.0)
    bakings: list[Baking] = []
    texels = 0
    for span in pairwise(stages):
        failed = {index for baking in bakings for index in baking.failures}
        demands = [demand for index, demand in found.demands.items() if index not in failed]
        if bakings and (not demands or bakings[-1].late):
            break
        baking = Baking(desk, demands, expected, span, end)
        baking.run()
        bakings.append(baking)
        texels, before = texels + int(found.unlit), found.unlit + found.waiting
        if baking.done > 0 or baking.spent.paths > 0:
            found = survey(desk, what.views, what.levels, AFTER if span[1] == AFTER[0] else (span[1], span[1]))
        expected = (found.unlit + found.waiting) / max(before, 1) * baking.spent.seconds / desk.studio.workers
    counted = {"texels": texels, "bytes": texels * desk.scene.plan.bytes_per_texel}
    return summed_up(desk, ahead.model_copy(update=counted), found.quality, bakings)


def stages_of(desk: Desk, what: Wanted) -> tuple[float, ...]:
    """Where in all of the work baking begins, is looked at, and ends, as shares of it.

    What views of an adaptive scene need of all texels is known once every second one is lit; of whole isosurfaces all
    are baked.
    """
    between = (HALF,) if desk.scene.adaptive and len(what.views) else ()
    return (BEFORE[1], *between, AFTER[0])


def carry_out_dry(desk: Desk, what: Wanted) -> Summary:
    """What there is to do for what is asked for, and the time that it takes. Raises StoreError, and Cancelled."""
    ahead, _ = look_ahead(desk, what, survey(desk, what.views, what.levels, (0.0, 0.5)), DRY_TRIAL)
    return ahead


def look_ahead(desk: Desk, what: Wanted, found: Survey, budget: float) -> tuple[Summary, float]:
    """What is lacking of what is asked for, and the seconds that baking it takes, told within about ``budget`` seconds.

    The summary has the time of the whole: what has passed, a trial, the baking, and looking again.
    """
    workers, demands, passed = desk.studio.workers, list(found.demands.values()), desk.seconds
    desk.tell(Step("Trying", "chunk", 0, len(demands), BEFORE[1]))
    ahead = forecast(desk.renderer, demands, desk.target, workers, budget, desk.cancelled)
    desk.check()
    around = passed + min(desk.seconds - passed, TRIAL) + found.seconds if demands else passed
    around += START if demands and not desk.studio.manned else 0.0
    return summary_of(desk, what, found, ahead, around), ahead.seconds / workers


def summary_of(desk: Desk, what: Wanted, found: Survey, ahead: Forecast, around: float) -> Summary:
    """What is known before the baking; so many seconds are spent ``around`` it."""
    workers, demands = desk.studio.workers, found.demands
    left, quality = ahead.time_left(workers, around), found.quality
    return Summary(
        scene=desk.scene.id,
        order=what.order,
        views=len(what.views),
        isovalues=what.levels.single,
        ranges=what.levels.ranges,
        target_error=desk.target,
        chunks=len(demands),
        texels=found.unlit,
        refined=found.waiting,
        bytes=found.unlit * desk.scene.plan.bytes_per_texel,
        stored_bytes=ahead.stored,
        processor_seconds=ahead.processor,
        workers=workers,
        **told(quality),
        time_left=TimeLeftFacts(low=left.low, likely=left.likely, high=left.high),
    )


def summed_up(desk: Desk, ahead: Summary, quality: Quality, bakings: Sequence[Baking]) -> Summary:
    """What it came to, beside what was known ``ahead``."""
    reasons = [each for baking in bakings for each in baking.failures.items()]
    paths, seconds = (sum(getattr(baking.spent, name) for baking in bakings) for name in ("paths", "seconds"))
    done = {"paths": paths, "seconds": desk.seconds, "processor_seconds": seconds}
    stopped = "deadline" if bakings[-1].late else "failures" if reasons else "target"
    chunks = {demand.index for baking in bakings for demand in baking.demands}
    size = {"chunks": len(chunks), "stored_bytes": stored_bytes(desk, chunks)}
    facts = {**done, **size, "stopped": stopped, "failed": len(reasons), "failures": failures_of(reasons)}
    return ahead.model_copy(update=facts | told(quality))


def told(quality: Quality) -> dict[str, Any]:
    """How good light is, as a summary tells it."""
    errors = Errors(worst=quality.worst, mean=quality.mean)
    return {"final": quality.final, "error": quality.worst, "errors": errors}


def stored_bytes(desk: Desk, indices: Iterable[Index]) -> int:
    """Bytes that chunks take in the store."""
    layers = desk.renderer.caches.store("gi").layers
    return sum(len(layer.read(index) or b"") for index in indices for layer in layers)
