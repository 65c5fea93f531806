"""Light of whole ranges of isovalues for pages that draw by themselves: baked until their pictures are at the target.

Such pages have the light of texels alone: no texels are projected, and no pixel has light of its own. Their pictures
are measured by control pixels as texels go up the ladder of samples.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

from isogi_core.bake.noise import Until
from isogi_core.bake.precision import FIRST_LEVEL, next_level
from isogi_core.frame.card.coded_picture import ControlPictures
from isogi_core.frame.card.coding import Coding
from isogi_core.model.scene_plan import most_samples
from isogi_core.model.view import View, quaternion_from_angles
from server.prewarm.context import LOOK, Baking, Expected, PrewarmContext, Step
from server.prewarm.forecast import forecast
from server.prewarm.looking import Survey, of_surfaces
from server.prewarm.order import GOLDEN, Levels, order_of, views_around
from server.settings import Settings
from worker.errors import WorkersError

WORTH = 0.95
"""The error after twice as many samples over the one before, at most, where another rung is worth it."""

TRIAL = 3.0
"""Seconds that the forecast of a rung may take."""

BETWEEN = 3
"""Isovalues of a range whose pictures are measured."""


@dataclass(frozen=True, eq=False)
class RangeLight:
    """The light of a range once it is baked: texels have so many ``samples``, and ``pictures`` say how good it is."""

    samples: int
    pictures: ControlPictures


def views_of(context: PrewarmContext, low: float, high: float, settings: Settings) -> list[View]:
    """Views that stand for all of a range of isovalues, from all sides; where the light turns, each turned further."""
    levels = Levels(tuple({low + (high - low) * n / (BETWEEN - 1): None for n in range(BETWEEN)}))
    views = views_around(order_of({"all_directions": True}), levels, context.scene, settings)
    turns = context.scene.lighting.rotating
    return [
        replace(view, light=quaternion_from_angles(number * GOLDEN % 360.0, 0.0, 0.0)) if turns else view
        for number, view in enumerate(views)
    ]


def bake_range(
    context: PrewarmContext, span: tuple[float, float], coding: Coding, views: Iterable[View], goal: float
) -> RangeLight:
    """Bake all texels of isosurfaces in a ``span`` of isovalues until pictures of ``views`` are at the ``goal``.

    That is an error; texels that are at the context's target alone get no more samples. Sooner where more samples make
    pictures no better. Raises WorkersError, StoreError, and Cancelled.
    """
    levels, most = Levels((), (span,)), most_samples(context.target)
    rung, before, pictures = FIRST_LEVEL, math.inf, None
    while not context.engine.workforce.wait(LOOK):
        context.check()
    lacked = lacking(context, levels, rung)
    while True:
        bake_rung(context, lacked, rung)
        while rung < most and not (lacked := lacking(context, levels, next_level(rung))).demands:
            rung = next_level(rung)
        pictures = pictures or measured(context, list(views))
        error = pictures.measure(coding).likely
        if error <= goal or error > WORTH * before or rung >= most:
            return RangeLight(rung, pictures)
        rung, before = next_level(rung), error


def measured(context: PrewarmContext, views: list[View]) -> ControlPictures:
    """The pictures of ``views`` with their control pixels. Raises Cancelled."""

    def report(done: int) -> None:
        context.check()
        context.report(Step("Measuring", "view", done, len(views), done / len(views)))

    return ControlPictures(context.renderer, views, context.target, report)


def lacking(context: PrewarmContext, levels: Levels, rung: int) -> Survey:
    """What texels of whole isosurfaces lack to have as many samples as the ``rung``, or to be at the target alone."""
    return of_surfaces(context, levels, rung, (0.0, 1.0))


def bake_rung(context: PrewarmContext, found: Survey, rung: int) -> None:
    """Bake what was ``found`` lacking of a ``rung``. Raises WorkersError, StoreError, and Cancelled."""
    if not found.demands:
        return
    demands = [demand for _, demand in found.wishes]
    until, workers = Until(context.target, rung), context.engine.workers
    ahead = forecast(context.renderer, demands, until, workers, TRIAL, context.cancelled)
    baking = Baking(context, found.wishes, Expected(ahead.seconds, 0.0, (0.0, 1.0)), context.deadline)
    baking.run()
    if baking.failures:
        raise WorkersError(f"The light of {len(baking.failures)} chunks failed: {next(iter(baking.failures.values()))}")
