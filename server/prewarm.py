"""``isogi prewarm``: bake what views from all sides need, so that they are final at once later."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from typing import TYPE_CHECKING, Any

from isogi_core.model.scene import Scene, load_scene
from isogi_core.model.view import View
from server.durations import span
from server.errors import ParameterError
from server.params import ViewParams, read
from server.progress import left_text, progress_bar, show
from server.render import PATIENCE, no_light
from server.settings import Settings
from server.survey import Survey, survey
from server.values import finite
from server.views import view_of
from worker.errors import WorkersError
from worker.outlook import Outlook, TimeLeft

if TYPE_CHECKING:
    from server.studio import Studio

MOST_ISOVALUES = 10_000
"""Isovalues in one range, at most."""

MOST_VIEWS = 100_000
"""Views of all isovalues together, at most."""

LOOK = 1.0
"""Seconds between two looks at how far the baking is."""

GOLDEN = 180.0 * (3.0 - math.sqrt(5.0))
"""The golden angle, degrees."""


def prewarm(
    target: str,
    isovalues: Sequence[str],
    count: int,
    knobs: Mapping[str, str],
    settings: Settings,
    seconds: float | None = None,
    dry: bool = False,
) -> dict[str, Any]:
    """Bake what ``count`` views at each of the isovalues need, and tell how far it came; ``dry``: what it would take.

    Ends when every pixel is final, or after ``seconds`` of baking. Raises SceneError, VolumeError, LightError and
    ViewError before anything is begun, StoreError and WorkersError later.
    """
    started = time.monotonic()
    scene = load_scene(target)
    levels = levels_of(isovalues, count) or [scene.isovalue]
    views = list(views_of(scene, levels, count, knobs, settings))
    error = read(ViewParams, knobs.items()).max_error or scene.target_error
    from server.studio import Studio  # noqa: PLC0415 (kernels: bad input is told before they are compiled)

    hired = (settings.workers, None if dry else settings.scheduler)
    with closing(Studio([scene], settings.store, *hired, settings.memory_mb << 20)) as studio:
        studio.start(hire=not dry)
        found = survey(studio, scene.id, views, error)
        facts = {"views": len(views), "isovalues": levels, "target_error": error, **lacks(found, scene)}
        if dry:
            left = outlook(studio, scene.id, found, error, settings.workers)
            time_left = {"low": left.low, "likely": left.likely, "high": left.high}
            quality = {"final": found.share, "error": found.error}
            return {**facts, **quality, "workers": settings.workers, "time_left": time_left}
        found = bake(studio, scene.id, found, error, seconds)
        stopped = "target" if found.final == found.pixels else "time"
        work = {"paths": studio.paths, "stopped": stopped, "seconds": time.monotonic() - started}
    return {**facts, "final": found.share, "error": found.error, **work}


def levels_of(texts: Sequence[str], count: int) -> list[float]:
    """The isovalues that the texts tell, each once; ParameterError where ``count`` views of each are too many."""
    levels = list(dict.fromkeys(float(f"{level:.12g}") for text in texts for level in levels_in(text)))
    if len(levels) * count > MOST_VIEWS:
        asked = f"{count:,} views of each of {len(levels):,} isovalues are {count * len(levels):,}"
        raise ParameterError(f"{asked}: ask for {MOST_VIEWS:,} views at most.", "isovalue")
    return levels


def levels_in(text: str) -> list[float]:
    """The isovalues in ``70`` or ``60:120:5`` (first, last, step); ParameterError for anything else."""
    numbers = [finite(part) for part in text.split(":")]
    if len(numbers) == 1 and math.isfinite(numbers[0]):
        return numbers
    if len(numbers) == 3 and all(map(math.isfinite, numbers)):
        first, last, step = numbers
        if step > 0.0 and first <= last and (last - first) / step < MOST_ISOVALUES:
            return [first + step * n for n in range(math.floor((last - first) / step + 1e-9) + 1)]
    wanted = f"a number such as 70, or first:last:step such as 60:120:5 with at most {MOST_ISOVALUES} of them"
    raise ParameterError(f"isovalue must be {wanted}, not '{text[:40]}'.", "isovalue")


def views_of(
    scene: Scene, levels: Sequence[float], count: int, knobs: Mapping[str, str], settings: Settings
) -> Iterator[View]:
    """The views of a scene from ``count`` directions at each of the isovalues; ViewError where one is not allowed."""
    for level in levels:
        for azimuth, elevation in directions(count):
            place = {"isovalue": level, "azimuth": azimuth, "elevation": elevation}
            yield view_of(scene, read(ViewParams, [*place.items(), *knobs.items()]), settings)


def directions(count: int) -> list[tuple[float, float]]:
    """Azimuths and elevations, degrees, of points spread evenly over a sphere: a Fibonacci lattice."""
    heights = (1.0 - (2 * n + 1) / count for n in range(count))
    return [(n * GOLDEN % 360.0, math.degrees(math.asin(height))) for n, height in enumerate(heights)]


def lacks(found: Survey, scene: Scene) -> dict[str, Any]:
    """What is to be baked: chunks that are not final, texels without light and their bytes, and texels with some."""
    size = found.unlit * scene.plan.bytes_per_texel
    return {"chunks": len(found.demands), "texels": found.unlit, "bytes": size, "refined": found.lit}


def outlook(studio: Studio, scene: str, found: Survey, error: float, workers: int) -> TimeLeft:
    """The time that baking all of it is likely to take; where nothing is known of the scene, a few texels are tried."""
    demands = list(found.demands.values())
    left = studio.errand(scene, demands, error).time_left()
    if left is not None:
        return left
    seconds = (found.unlit + found.lit) * studio.seconds_each(scene, demands, error)
    return Outlook().tell(scene, seconds / workers)


def bake(studio: Studio, scene: str, found: Survey, error: float, seconds: float | None) -> Survey:
    """Have all that is lacking baked, and look again.

    Raises WorkersError where the workers fail, or bake nothing for PATIENCE seconds.
    """
    changed, paths = time.monotonic(), 0
    deadline = changed + (math.inf if seconds is None else seconds)
    errand = studio.errand(scene, found.demands.values(), error)
    total = len(errand.chunks)
    with progress_bar("baking", "chunk", total) as bar:
        while (waiting := errand.waiting()) and time.monotonic() < deadline:
            if studio.paths > paths:
                changed, paths = time.monotonic(), studio.paths
            if studio.trouble() or time.monotonic() - changed > PATIENCE:
                raise WorkersError(studio.trouble() or no_light(studio))
            show(bar, total - waiting, total, errand.time_left())
            errand.wait(min(LOOK, max(deadline - time.monotonic(), 0.0)))
        show(bar, total - waiting, total, None)
    if studio.trouble():
        raise WorkersError(studio.trouble())
    return survey(studio, scene, found.views, error)


def sentence(facts: Mapping[str, Any]) -> str:
    """The facts for a person, on one line."""
    what = f"{facts['views']:,} views, {facts['final']:.1%} of their surface final at {facts['target_error']:g}"
    if "stopped" in facts:
        return f"{what}, {facts['paths']:,} paths in {span(facts['seconds'])}"
    lacking = f"{facts['texels']:,} texels without light ({facts['bytes'] / 1e6:.1f} MB before compression)"
    rest = f"and {facts['refined']:,} to be refined where they need it, in {facts['chunks']:,} chunks"
    time_left = left_text(TimeLeft(**facts["time_left"]))
    return f"{what}; to bake: {lacking} {rest}; time with --workers {facts['workers']}: {time_left}"
