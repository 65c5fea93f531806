"""``isogi publish --interactive``: a page that draws a scene on the visitor's graphics card,
from static files or as one file.
"""

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from isogi_core.bake.noise import Goal
from isogi_core.errors import ViewError
from isogi_core.files.scene_file import LEAST_TARGET, Target, find_source
from isogi_core.files.scene_file import Settings as SceneSettings
from isogi_core.files.spelling import shortest
from isogi_core.frame.card.blocks import raw_scale
from isogi_core.frame.card.coding import Coding, coding_for
from isogi_core.frame.card.obstacles import Obstacle
from isogi_core.frame.features import SEVERAL_SURFACES, SHINE
from isogi_core.frame.rays.control_pixels import TotalError
from isogi_core.frame.renderer import Renderer
from isogi_core.model.view import View
from isogi_core.plan.scene import Scene
from isogi_core.storage.atomic_file import check_folder_writable, check_writable, write_whole
from isogi_server.answers import card_obstacles
from isogi_server.cli.prewarm import context_of, show
from isogi_server.cli.publish import PageRequest, check_output
from isogi_server.cli.render import working
from isogi_server.errors import ParameterError
from isogi_server.exports.live_page import (
    COARSE_LIGHT,
    PAGE,
    Span,
    colour_files,
    document_of,
    first_view,
    light_files,
    page_of,
    poster_of,
    volume_files,
    write_files,
)
from isogi_server.parameters import FrameParams, read
from isogi_server.prewarm.baking import PrewarmContext
from isogi_server.prewarm.order import levels_of, order_of
from isogi_server.prewarm.work import RangeLight, bake_range, views_of
from isogi_server.progress import Progress, open_scene
from isogi_server.settings import Settings
from isogi_server.views import isovalue_of, view_of, with_first_view

LIGHT_TARGET_SHARE = 0.5
"""The target error of light, relative to that of the page's pictures: the page cannot trace
paths where texels are too coarse.
"""

ROUNDING_SHARES = (0.2, 0.4, 0.8, 1.6, 3.2)
"""Rounding errors that are tried, relative to the target; the first one whose files are small
enough is taken.
"""

COARSE_ROUNDING = 0.05
"""Rounding error of coarse light on all pages: about as large as that of means of bricks. With
twice as much, flat sides look blotched.
"""

SIDES_NOT_PUBLISHED = Obstacle(
    SEVERAL_SURFACES.name,
    "A folder holds the light of one surface's outer side alone.",
)
SHINE_NOT_PUBLISHED = Obstacle(
    SHINE.name, "It shines, and no error of shine is measured for pages."
)
"""Obstacles of published pages alone."""

TAKEN = (
    *("isovalue", "azimuth", "elevation", "distance", "fov", "projection", "target"),
    *("yaw", "pitch", "roll", "albedo", "exposure", "background"),
)
"""Parameters of the page's first view that options may give."""

PAGE_BACKGROUNDS = ("light", "dark")
"""Backgrounds that the page offers."""


@dataclass(frozen=True, eq=False)
class PagePlan:
    """The page that is to be made: the ``request``, the parameters and the view that it starts
    with, its isovalues, and the relative ``error`` that its pictures are to reach.
    """

    request: PageRequest
    params: FrameParams
    view: View
    span: Span
    error: float


@dataclass(frozen=True, eq=False)
class PageVersion:
    """A page: its ``files``, and ``facts`` about it, including the error of its pictures."""

    files: Mapping[str, bytes]
    facts: Mapping[str, Any]

    @property
    def nbytes(self) -> int:
        """Return the bytes of all files."""
        return size_of(self.files)

    @property
    def error(self) -> float:
        """Return the relative error of the page's pictures."""
        return float(self.facts["error"]["likely"])


def publish(
    target: Target, request: PageRequest, knobs: Mapping[str, str], settings: Settings
) -> dict[str, Any]:
    """Bake the light of a range of isovalues, and write a page that draws it; return facts about
    its size and quality.

    Raises SceneError, VolumeError, LightError and ViewError before any work; ViewError if the page
    exceeds its size; StoreError, WorkersError and OSError.
    """
    if request.seconds is not None or request.deadline is not None:
        raise ParameterError(
            "--time and --deadline are for pictures: leave them out with --interactive."
        )
    check_output(request.output)
    error = request.target_error or SceneSettings(find_source(target, {})).target_error
    light_error = max(LIGHT_TARGET_SHARE * error, LEAST_TARGET)
    scene = open_scene(target, settings, target_error=light_error)
    span, params = first_view_of(scene, knobs)
    view = view_of(scene, params, settings)
    if request.one_file:
        check_writable(request.output)
    else:
        check_folder_writable(request.output)
    with prewarming(scene, settings, request.begun) as context:
        refuse_obstacles(context.renderer, view)
        # Take the page with the most exact light that fits the size.
        version = first_fitting(
            page_versions(context, PagePlan(request, params, view, span, error), settings),
            request.megabytes,
            error,
        )
    if request.one_file:
        write_whole(request.output, version.files[PAGE])
    else:
        write_files(request.output, version.files)
    facts = {"file": str(request.output), "one_file": request.one_file, **version.facts}
    facts |= {"bytes": version.nbytes, "trouble": ""}
    return {**facts, "seconds": request.passed}


def first_view_of(scene: Scene, knobs: Mapping[str, str]) -> tuple[Span, FrameParams]:
    """Return the isovalues of the page, and the parameters of its first view. Raises
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
    # A background of the scene's first view that no page offers is left out; an option is refused.
    if first.get("background") not in PAGE_BACKGROUNDS and "background" not in knobs:
        first.pop("background", None)
    params = read(FrameParams, {**first, "isovalue": repr(start)}.items())
    # Refuse isovalues outside the scene's range.
    for end in (span.low, span.high):
        isovalue_of(scene, params.model_copy(update={"isovalue": end}))
    # Refuse a wrong background now, before light is baked.
    ground_of(params)
    return span, params


def ground_of(params: FrameParams) -> str:
    """Return the background of the page: "light", "dark", or, if none is given, "page": then the
    page follows the browser's preference. Raises ParameterError for any other background.
    """
    # The parameter has a default, which must not count as given.
    if "background" not in params.model_fields_set:
        return "page"
    if params.background not in PAGE_BACKGROUNDS:
        raise ParameterError(
            f"background must be light or dark with --interactive, not {params.background}."
        )
    return params.background


def refuse_obstacles(renderer: Renderer, view: View) -> None:
    """Raise ViewError if a card cannot draw the scene, and SceneError if the scene keeps no
    light in texels.
    """
    scene = renderer.prepared.scene
    scene.require_texels()
    found = card_obstacles(renderer.prepared, view, True)
    if scene.surfaces.several:
        found.append(SIDES_NOT_PUBLISHED)
    if SHINE.is_shown(scene, view):
        found.append(SHINE_NOT_PUBLISHED)
    if found:
        reasons = " ".join(each.why for each in found)
        raise ViewError(
            f"A page without a server cannot draw this scene: {reasons} Publish pictures of it."
        )


@contextmanager
def prewarming(scene: Scene, settings: Settings, begun: float) -> Iterator[PrewarmContext]:
    """Start an engine with workers, and yield the context in which light of the scene is baked."""
    with Progress() as bar:
        bar.begin("loading kernels")
        with working(scene, settings) as engine:
            yield context_of(engine, scene, order_of({}), partial(show, bar), begun)


def page_versions(
    context: PrewarmContext, planned: PagePlan, settings: Settings
) -> Iterator[PageVersion]:
    """Bake the light until pictures have the error that is planned; yield the page with ever fewer
    bits for its light.
    """
    renderer = context.renderer
    span = planned.span
    views = [
        replace(each, albedo=planned.view.albedo)
        for each in views_of(context, span.low, span.high, settings)
    ]
    codings = [coding_at(renderer, share * planned.error) for share in ROUNDING_SHARES]
    # Measure the pictures with the first, finest coding.
    baked = bake_range(context, (span.low, span.high), codings[0], views, planned.error)
    volume = {**volume_files(renderer, span), **colour_files(renderer, span)}
    document = document_of(renderer, planned.params, planned.view, span)
    first = first_view(renderer, planned.params, document["scene"]["start"], settings)
    poster = poster_of(renderer, planned.params, first, Goal(context.goal.error))
    coarse = coding_at(renderer, COARSE_ROUNDING)
    for coding in codings:
        # Coarser codings need no new light, only other files.
        light = light_files(renderer, span, (coding, coarse), context.goal, first)
        facts = page_facts(renderer.prepared.scene, span, baked, baked.pictures.measure(coding))
        facts["target_error"] = planned.error
        known = {
            "coarse": {"file": COARSE_LIGHT, "steps": coarse.steps.tolist()},
            "files": [name for name in light if name != COARSE_LIGHT],
            "steps": coding.steps.tolist(),
            "background": ground_of(planned.params),
            "caption": planned.request.caption or "",
            **facts,
        }
        files = files_of({**document, "light": known}, poster, {**volume, **light}, planned.request)
        sizes = {"volume_bytes": size_of(volume), "light_bytes": size_of(light)}
        yield PageVersion(files, {**facts, **sizes})


def files_of(
    document: Mapping[str, Any], poster: bytes, data: Mapping[str, bytes], request: PageRequest
) -> dict[str, bytes]:
    """Return the files of a page, which states its size: the page and its ``data``, or all as
    one file.
    """
    inside: Mapping[str, bytes] = data if request.one_file else {}
    outside: Mapping[str, bytes] = {} if request.one_file else data
    # The page is made once to see how large it is.
    size = len(page_of(document, poster, inside)) + size_of(outside)
    known = {**document, "light": {**document["light"], "bytes": size}}
    return {PAGE: page_of(known, poster, inside), **outside}


def size_of(files: Mapping[str, bytes]) -> int:
    """Return the total bytes of files."""
    return sum(map(len, files.values()))


def coding_at(renderer: Renderer, error: float) -> Coding:
    """Return the coding of a scene's transfer that has this rounding error."""
    spec = renderer.caches.spec("gi")
    return coding_for(spec, raw_scale(spec), error)


def page_facts(scene: Scene, span: Span, baked: RangeLight, error: TotalError) -> dict[str, Any]:
    """Return the facts about the light of a page."""
    return {
        "scene": scene.name,
        "isovalues": [span.low, span.high],
        "error": {"likely": error.likely, "low": error.low, "high": error.high},
        "views": len(baked.pictures),
        "samples": baked.samples,
    }


def first_fitting(
    versions: Iterator[PageVersion], megabytes: float | None, target: float
) -> PageVersion:
    """Return the first version that is small enough. Raises ViewError if none is, or if its
    pictures miss the target.
    """
    if megabytes is None:
        most = math.inf
    else:
        most = 1e6 * megabytes
    # Versions become smaller and less exact.
    best = version = next(versions)
    while version.nbytes > most and (coarser := next(versions, None)):
        version = coarser
    if version.nbytes > most or (version is not best and version.error > max(target, best.error)):
        raise ViewError(too_large(best, version, most))
    return version


def too_large(best: PageVersion, smallest: PageVersion, most: float) -> str:
    """Return a sentence about a page that exceeds ``most`` bytes, with the ways to make it fit.

    Both numbers that it advises are a little larger than needed, as they are printed rounded.
    """
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
    # Files besides the light do not shrink: if these are too large, no target helps.
    rest = smallest.nbytes - light
    if rest >= most:
        return f"{sentence} {more}. Its volume and the page alone take {rest / 1e6:.2f} MB."
    return (
        f"{sentence} {more}, or ask for about {(most - rest) / light:.0%} of these "
        "isovalues and a larger error."
    )


def published(facts: Mapping[str, Any]) -> str:
    """Return the facts of ``publish`` as text for a person."""
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
