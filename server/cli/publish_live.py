"""``isogi publish --interactive``: a page that draws a scene by the visitor's graphics card, from
static files, or as one file.
"""

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from isogi_core.errors import ViewError
from isogi_core.files.scene_file import LEAST_TARGET, find_source
from isogi_core.files.scene_file import Settings as SceneSettings
from isogi_core.files.spelling import shortest
from isogi_core.frame.card.blocks import Coding, coding_for, raw_scale
from isogi_core.frame.rays.control_pixels import TotalError
from isogi_core.frame.renderer import Renderer
from isogi_core.model.view import View
from isogi_core.plan.scene import Scene
from isogi_core.storage.atomic_file import write_whole
from server.answers import card_obstacles
from server.cli.prewarm import desk_of, show
from server.cli.publish import PageRequest, check_output
from server.cli.render import working
from server.errors import ParameterError
from server.exports.live_page import (
    PAGE,
    Span,
    document_of,
    first_view,
    light_files,
    page_of,
    poster_of,
    volume_files,
    write_files,
)
from server.parameters import FrameParams, read
from server.prewarm.baking import PrewarmContext
from server.prewarm.order import levels_of, order_of
from server.prewarm.work import RangeLight, bake_range, views_of
from server.progress import Progress, open_scene
from server.settings import Settings
from server.views import isovalue_of, view_of, with_first_view

LIGHT_TARGET_SHARE = 0.5
"""The target that light is planned and baked for, over that of the page's pictures: no pixel has
light of its own.
"""

ROUNDING_SHARES = (0.2, 0.4, 0.8, 1.6, 3.2)
"""Errors by rounding that are tried, over the target: the first one whose files are small enough is
taken.
"""

TAKEN = (
    *("isovalue", "azimuth", "elevation", "distance", "fov", "projection", "target"),
    *("yaw", "pitch", "roll", "albedo", "exposure", "background"),
)
"""Options of a view that the page begins with."""

PAGE_BACKGROUNDS = ("light", "dark")
"""Backgrounds that the page has."""


@dataclass(frozen=True, eq=False)
class Wish:
    """A page that is asked for by a ``request``: what it begins with, its isovalues, and the
    ``goal``, an error.
    """

    request: PageRequest
    params: FrameParams
    view: View
    span: Span
    goal: float


@dataclass(frozen=True, eq=False)
class Offer:
    """The ``files`` of a page, and ``facts`` of it: among them the error of its pictures."""

    files: Mapping[str, bytes]
    facts: Mapping[str, Any]

    @property
    def nbytes(self) -> int:
        """Bytes of all files."""
        return size_of(self.files)

    @property
    def error(self) -> float:
        """The relative error of the page's pictures."""
        return float(self.facts["error"]["likely"])


def publish(
    target: str, request: PageRequest, knobs: Mapping[str, str], settings: Settings
) -> dict[str, Any]:
    """Bake the light of a range of isovalues, write a page that draws it, and say how large and how
    good it is.

    Raises SceneError, VolumeError, LightError and ViewError before anything is begun, and ViewError
    where the page takes more than it may; StoreError, WorkersError and OSError later.
    """
    if request.seconds is not None or request.deadline is not None:
        raise ParameterError(
            "--time and --deadline are for pictures: leave them out with --interactive."
        )
    check_output(request.output)
    goal = request.target_error or SceneSettings(find_source(target, {})).target_error
    scene = open_scene(target, settings, target_error=max(LIGHT_TARGET_SHARE * goal, LEAST_TARGET))
    span, params = asked(scene, knobs)
    view = view_of(scene, params, settings)
    with at_work(scene, settings, request.begun) as context:
        refuse_obstacles(context.renderer, view)
        offer = fitting(
            offers(context, Wish(request, params, view, span, goal), settings),
            request.megabytes,
            goal,
        )
    if request.one_file:
        write_whole(request.output, offer.files[PAGE])
    else:
        write_files(request.output, offer.files)
    facts = {"file": str(request.output), "one_file": request.one_file, **offer.facts}
    facts["bytes"] = offer.nbytes
    return {**facts, "seconds": request.passed}


def asked(scene: Scene, knobs: Mapping[str, str]) -> tuple[Span, FrameParams]:
    """The isovalues that are asked for, and the view that the page begins with. Raises
    ParameterError.
    """
    others = [
        name for name in knobs if name not in TAKEN or (":" in knobs[name] and name != "isovalue")
    ]
    if others:
        raise ParameterError(
            f"--{others[0]} {knobs[others[0]]} is for pictures: leave it out with --interactive."
        )
    levels = levels_of([knobs.get("isovalue", f"{scene.isovalue!r}")])
    span = Span(min(levels.all), max(levels.all))
    start = min(max(scene.isovalue, span.low), span.high)
    first = with_first_view(scene, knobs)
    if first.get("background") not in PAGE_BACKGROUNDS and "background" not in knobs:
        first.pop("background", None)
    params = read(FrameParams, {**first, "isovalue": repr(start)}.items())
    for end in (span.low, span.high):
        isovalue_of(scene, params.model_copy(update={"isovalue": end}))
    ground_of(params)
    return span, params


def ground_of(params: FrameParams) -> str:
    """What is behind the surface: light, dark, or as the browser has it. Raises ParameterError."""
    if "background" not in params.model_fields_set:
        return "page"
    if params.background not in PAGE_BACKGROUNDS:
        raise ParameterError(
            f"background must be light or dark with --interactive, not {params.background}."
        )
    return params.background


def refuse_obstacles(renderer: Renderer, view: View) -> None:
    """Raise ViewError where a card cannot draw the scene, and SceneError where that keeps no
    light.
    """
    renderer.prepared.scene.require_texels()
    if found := card_obstacles(renderer.prepared, view, True):
        reasons = " ".join(each.why for each in found)
        raise ViewError(
            f"A page without a server cannot draw this scene: {reasons} Publish pictures of it."
        )


@contextmanager
def at_work(scene: Scene, settings: Settings, begun: float) -> Iterator[PrewarmContext]:
    """An engine with workers, and what a bake of the scene works with."""
    with Progress() as bar:
        bar.begin("loading kernels")
        with working(scene, settings) as engine:
            yield desk_of(engine, scene, order_of({}), partial(show, bar), begun)


def offers(context: PrewarmContext, wish: Wish, settings: Settings) -> Iterator[Offer]:
    """The page with ever fewer bits of light, baked until pictures of the first one are at the
    goal.
    """
    renderer = context.renderer
    target = context.target
    span = wish.span
    views = [
        replace(each, albedo=wish.view.albedo)
        for each in views_of(context, span.low, span.high, settings)
    ]
    codings = [coding_at(renderer, share * wish.goal) for share in ROUNDING_SHARES]
    baked = bake_range(context, (span.low, span.high), codings[0], views, wish.goal)
    volume = volume_files(renderer, span)
    document = document_of(renderer, wish.params, wish.view, span)
    first = first_view(renderer, wish.params, document["scene"]["start"], settings)
    poster = poster_of(renderer, wish.params, first, target)
    for coding in codings:
        light = light_files(renderer, span, coding, target, first)
        facts = page_facts(renderer.prepared.scene, span, baked, baked.pictures.measure(coding))
        facts["target_error"] = wish.goal
        known = {
            "files": list(light),
            "steps": coding.steps.tolist(),
            "background": ground_of(wish.params),
            "caption": wish.request.caption or "",
            **facts,
        }
        files = files_of({**document, "light": known}, poster, {**volume, **light}, wish.request)
        sizes = {"volume_bytes": size_of(volume), "light_bytes": size_of(light)}
        yield Offer(files, {**facts, **sizes})


def files_of(
    document: Mapping[str, Any], poster: bytes, data: Mapping[str, bytes], request: PageRequest
) -> dict[str, bytes]:
    """The files of a page, which says how many bytes it takes: it and its ``data``, or all as one
    file.
    """
    inside: Mapping[str, bytes] = data if request.one_file else {}
    outside: Mapping[str, bytes] = {} if request.one_file else data
    # The page is made once to see how large it is.
    size = len(page_of(document, poster, inside)) + size_of(outside)
    known = {**document, "light": {**document["light"], "bytes": size}}
    return {PAGE: page_of(known, poster, inside), **outside}


def size_of(files: Mapping[str, bytes]) -> int:
    """Bytes of files."""
    return sum(map(len, files.values()))


def coding_at(renderer: Renderer, error: float) -> Coding:
    """The coding of a scene's transfer with this error."""
    spec = renderer.caches.spec("gi")
    return coding_for(spec, raw_scale(spec), error)


def page_facts(scene: Scene, span: Span, baked: RangeLight, error: TotalError) -> dict[str, Any]:
    """What there is to say of a page's light."""
    return {
        "scene": scene.name,
        "isovalues": [span.low, span.high],
        "error": {"likely": error.likely, "low": error.low, "high": error.high},
        "views": len(baked.pictures),
        "samples": baked.samples,
    }


def fitting(some: Iterator[Offer], megabytes: float | None, target: float) -> Offer:
    """The first offer that takes no more than it may. Raises ViewError where its pictures would
    miss the target.
    """
    if megabytes is None:
        most = math.inf
    else:
        most = 1e6 * megabytes
    best = offer = next(some)
    while offer.nbytes > most and (coarser := next(some, None)):
        offer = coarser
    if offer.nbytes > most or (offer is not best and offer.error > max(target, best.error)):
        raise ViewError(too_large(best, offer, most))
    return offer


def too_large(best: Offer, smallest: Offer, most: float) -> str:
    """What to say where a page takes more bytes than the ``most``, and what would fit."""
    sentence = (
        f"The page takes {best.nbytes / 1e6:.2f} MB at an error of {best.error:.3f}, "
        "and may take less:"
    )
    more = f"allow --megabytes {best.nbytes / 1e6 + 0.01:.2f}"
    if smallest.nbytes <= most:
        at = (
            f"--target-error {1.01 * smallest.error:.2g}, which takes "
            f"{smallest.nbytes / 1e6:.2f} MB"
        )
        return f"{sentence} {more}, ask for {at}, or for fewer isovalues."
    light = smallest.facts["light_bytes"]
    beside = smallest.nbytes - light
    if beside >= most:
        return f"{sentence} {more}. Its volume and the page alone take {beside / 1e6:.2f} MB."
    return (
        f"{sentence} {more}, or ask for about {(most - beside) / light:.0%} of these "
        "isovalues and a larger error."
    )


def published(facts: Mapping[str, Any]) -> str:
    """What ``publish --interactive`` did, for a person."""
    low, high = facts["isovalues"]
    error = facts["error"]
    good = (
        f"error {error['likely']:.4f} ({error['low']:.4f} to {error['high']:.4f}, measured "
        f"in {facts['views']} views)"
    )
    if error["likely"] > facts["target_error"]:
        good += f", above the target of {facts['target_error']:g}"
    parts = f"volume {facts['volume_bytes'] / 1e6:.1f}, light {facts['light_bytes'] / 1e6:.1f}"
    size = f"{facts['bytes'] / 1e6:.1f} MB ({parts})"
    if facts["one_file"]:
        where = f"open {facts['file']} in a browser"
    else:
        where = f"open {facts['file']}/{PAGE} on a server"
    return (
        f"{facts['file']}: isovalues {shortest(low)} to {shortest(high)}, {good}, {size}: {where}"
    )
