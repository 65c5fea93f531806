"""``isogi publish --interactive``: a page that draws a scene by the visitor's graphics card, from static files."""

import math
import time
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from isogi_core.errors import ViewError
from isogi_core.frame.card.chunk_light import raw_scale
from isogi_core.frame.card.coding import Coding, coding_for
from isogi_core.frame.rays.control_pixels import TotalError
from isogi_core.frame.renderer import Renderer
from isogi_core.model.view import View
from isogi_core.plan.scene import Scene
from server.card_answers import card_obstacles
from server.cli.prewarm import desk_of, show
from server.cli.publish import Wishes
from server.errors import ParameterError
from server.exports.live_page import (
    Span,
    document_of,
    json_file,
    light_files,
    page_files,
    volume_files,
    write_files,
)
from server.parameters import FrameParams, read
from server.prewarm.context import PrewarmContext
from server.prewarm.order import levels_of, order_of
from server.prewarm.ranges import RangeLight, bake_range, views_of
from server.progress import Progress, compiling, open_scene
from server.render.engine import RenderEngine
from server.render.resources import root_of
from server.render.workforce import scheduler_of
from server.settings import Settings
from server.views import isovalue_of, view_of

ROUNDING = (0.2, 0.4, 0.8, 1.6, 3.2)
"""Errors by rounding that are tried, over the target: the first one whose files are small enough is taken."""

TAKEN = (
    *("isovalue", "azimuth", "elevation", "distance", "fov", "projection", "target"),
    *("yaw", "pitch", "roll", "albedo", "exposure", "background"),
)
"""Options of a view that the page begins with."""

DOCUMENT = 1 << 16
"""Bytes that the document of the page is taken for."""

GROUNDS = ("light", "dark")
"""Backgrounds that the page has."""


@dataclass(frozen=True, eq=False)
class Offer:
    """The files of a page whose light is in a ``coding``, and the ``error`` of its pictures."""

    coding: Coding
    light: Mapping[str, bytes]
    error: TotalError
    nbytes: int


def publish(target: str, wishes: Wishes, knobs: Mapping[str, str], settings: Settings) -> dict[str, Any]:
    """Bake the light of a range of isovalues, write a page that draws it, and say how large and how good it is.

    Raises SceneError, VolumeError, LightError and ViewError before anything is begun, and ViewError where the page
    takes more than it may; StoreError, WorkersError and OSError later.
    """
    begun = time.monotonic()
    if wishes.seconds is not None or wishes.deadline is not None:
        raise ParameterError("--time and --deadline are for pictures: leave them out with --interactive.")
    if not wishes.output.parent.is_dir():
        raise ViewError(f"There is no folder {wishes.output.parent} for {wishes.output.name}: make it first.")
    scene = open_scene(target, settings)
    span, params = asked(scene, knobs)
    view = view_of(scene, params, settings)
    with at_work(scene, wishes, settings, begun) as context:
        refuse_obstacles(context.renderer, view)
        baked = bake(context, view, span, settings)
        page = {**page_files(), **volume_files(context.renderer, span)}
        offer = fitting(context.renderer, baked, page, span, wishes.megabytes, context.target)
        facts = facts_of(scene, span, baked, page, offer)
        light = {"files": sorted(offer.light), "steps": offer.coding.steps.tolist(), **facts}
        document = document_of(context.renderer, params, view, span, {**light, "background": ground_of(params)})
        size = write_files(wishes.output, {**page, **offer.light, "scene.json": json_file(document)})
    return {"file": str(wishes.output), **facts, "bytes": size, "seconds": time.monotonic() - begun}


def asked(scene: Scene, knobs: Mapping[str, str]) -> tuple[Span, FrameParams]:
    """The isovalues that are asked for, and the view that the page begins with. Raises ParameterError."""
    others = [name for name in knobs if name not in TAKEN or (":" in knobs[name] and name != "isovalue")]
    if others:
        raise ParameterError(f"--{others[0]} {knobs[others[0]]} is for pictures: leave it out with --interactive.")
    levels = levels_of([knobs.get("isovalue", f"{scene.isovalue!r}")])
    span = Span(min(levels.all), max(levels.all))
    start = min(max(scene.isovalue, span.low), span.high)
    params = read(FrameParams, {**knobs, "isovalue": repr(start)}.items())
    for end in (span.low, span.high):
        isovalue_of(scene, params.model_copy(update={"isovalue": end}))
    ground_of(params)
    return span, params


def ground_of(params: FrameParams) -> str:
    """What is behind the surface: light, dark, or as the browser has it. Raises ParameterError."""
    if "background" not in params.model_fields_set:
        return "page"
    if params.background not in GROUNDS:
        raise ParameterError(f"background must be light or dark with --interactive, not {params.background}.")
    return params.background


def refuse_obstacles(renderer: Renderer, view: View) -> None:
    """Raise ViewError where a card cannot draw the scene, and SceneError where that keeps no light."""
    renderer.prepared.scene.require_texels()
    if found := card_obstacles(renderer.prepared, view, True):
        reasons = " ".join(each.why for each in found)
        raise ViewError(f"A page without a server cannot draw this scene: {reasons} Publish pictures of it.")


@contextmanager
def at_work(scene: Scene, wishes: Wishes, settings: Settings, begun: float) -> Iterator[PrewarmContext]:
    """An engine with workers, and what a bake of the scene works with."""
    hired = settings.workers, scheduler_of(settings)
    order = order_of({} if wishes.target_error is None else {"target_error": wishes.target_error})
    with (
        closing(RenderEngine([scene], root_of(settings), *hired, settings.memory_mb << 20)) as engine,
        Progress() as bar,
    ):
        bar.begin("loading kernels")
        with compiling(lambda: engine.kernels.progress):
            engine.start()
        yield desk_of(engine, scene, order, partial(show, bar), begun)


def bake(context: PrewarmContext, view: View, span: Span, settings: Settings) -> RangeLight:
    """The light of the ``span``, baked until pictures in the finest coding are at the target."""
    views = [replace(each, albedo=view.albedo) for each in views_of(context, span.low, span.high, settings)]
    return bake_range(context, span.low, span.high, coding_at(context.renderer, ROUNDING[0] * context.target), views)


def coding_at(renderer: Renderer, error: float) -> Coding:
    """The coding of a scene's transfer that errs so much."""
    spec = renderer.caches.spec("gi")
    return coding_for(spec, raw_scale(spec), error)


def fitting(
    renderer: Renderer,
    baked: RangeLight,
    page: Mapping[str, bytes],
    span: Span,
    megabytes: float | None,
    target: float,
) -> Offer:
    """The light in the finest coding whose files fit. Raises ViewError where pictures would miss the target by it."""
    beside = sum(map(len, page.values()))
    most = math.inf if megabytes is None else 1e6 * megabytes - DOCUMENT

    def offered(share: float) -> Offer:
        coding = coding_at(renderer, share * target)
        light = light_files(renderer, span, coding, target)
        return Offer(coding, light, baked.pictures.measure(coding), beside + sum(map(len, light.values())))

    offers = map(offered, ROUNDING)
    best = offer = next(offers)
    while offer.nbytes > most and (coarser := next(offers, None)):
        offer = coarser
    if offer.nbytes > most or (offer is not best and offer.error.likely > max(target, best.error.likely)):
        raise ViewError(too_large(best, offer, beside, most))
    return offer


def too_large(best: Offer, smallest: Offer, beside: int, most: float) -> str:
    """What to say where a page takes more bytes than the ``most``, and what would fit."""
    sentence = f"The page takes {best.nbytes / 1e6:.1f} MB at an error of {best.error.likely:.3f}, and may take less:"
    more = f"allow --megabytes {best.nbytes / 1e6 + 1.0:.0f}"
    if smallest.nbytes <= most:
        at = f"--target-error {1.01 * smallest.error.likely:.2g}, which takes {smallest.nbytes / 1e6:.1f} MB"
        return f"{sentence} {more}, ask for {at}, or for fewer isovalues."
    if beside >= most:
        return f"{sentence} {more}. Its volume and its modules alone take {beside / 1e6:.1f} MB."
    share = (most - beside) / (smallest.nbytes - beside)
    return f"{sentence} {more}, or ask for about {share:.0%} of these isovalues and a larger error."


def facts_of(scene: Scene, span: Span, baked: RangeLight, page: Mapping[str, bytes], offer: Offer) -> dict[str, Any]:
    """What there is to say of a page."""
    volume = sum(len(content) for name, content in page.items() if name.startswith("volume/"))
    error = {"likely": offer.error.likely, "low": offer.error.low, "high": offer.error.high}
    return {
        "scene": scene.name,
        "isovalues": [span.low, span.high],
        "error": error,
        "views": len(baked.pictures),
        "samples": baked.samples,
        "volume_bytes": volume,
        "light_bytes": sum(map(len, offer.light.values())),
        "bytes": offer.nbytes,
    }


def published(facts: Mapping[str, Any]) -> str:
    """What ``publish --interactive`` did, for a person."""
    low, high = facts["isovalues"]
    error = facts["error"]
    good = (
        f"error {error['likely']:.4f} ({error['low']:.4f} to {error['high']:.4f}, measured in {facts['views']} views)"
    )
    parts = f"volume {facts['volume_bytes'] / 1e6:.1f}, light {facts['light_bytes'] / 1e6:.1f}"
    size = f"{facts['bytes'] / 1e6:.1f} MB ({parts})"
    return (
        f"{facts['file']}: isovalues {low:g} to {high:g}, {good}, {size}: open {facts['file']}/index.html on a server"
    )
