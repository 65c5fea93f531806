"""``isogi prewarm``: bake what views from all sides need, so that they are final at once later."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from isogi_core.model.scene import Scene, load_scene
from isogi_core.model.view import View
from server.errors import ParameterError
from server.params import ViewParams, read
from server.progress import duration, left_text, progress_bar, show
from server.render import PATIENCE, no_light
from server.settings import Settings
from server.values import finite
from server.views import view_of
from worker.errors import WorkersError
from worker.outlook import TimeLeft

if TYPE_CHECKING:
    from isogi_core.frame.frame import Frame
    from isogi_core.frame.texels import Demand
    from server.studio import Studio

MOST_ISOVALUES = 10_000
"""Isovalues in one range, at most."""

LOOK = 1.0
"""Seconds between two looks at how far the baking is."""

GOLDEN = 180.0 * (3.0 - math.sqrt(5.0))
"""The golden angle, degrees."""


@dataclass(eq=False)
class Survey:
    """What ``views`` show with the light that there is, and by chunk what they lack of it.

    ``pixels`` show the surface, ``final`` of them with final light; ``error`` is the largest of any view.
    """

    views: Sequence[View]
    demands: dict[Any, Demand] = field(default_factory=dict)
    pixels: int = 0
    final: int = 0
    error: float = 0.0

    def add(self, frame: Frame) -> None:
        """Take in the frame of a view."""
        self.pixels += frame.surface
        self.final += frame.counts["final"]
        self.error = max(self.error, frame.estimated_error)
        for demand in frame.demands:
            other = self.demands.get(demand.index)
            self.demands[demand.index] = demand if other is None else demand.joined(other)

    @property
    def texels(self) -> int:
        """Texels in the chunks that are not final, of all views together."""
        return sum(len(demand.offsets) for demand in self.demands.values())


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
    levels = [level for text in isovalues for level in levels_in(text)] or [scene.isovalue]
    views = list(views_of(scene, levels, count, knobs, settings))
    error = read(ViewParams, knobs.items()).max_error or scene.target_error
    from server.studio import Studio  # noqa: PLC0415 (kernels: bad input is told before they are compiled)

    place, memory = (settings.store, settings.workers, settings.scheduler), settings.memory_mb << 20
    with closing(Studio([scene], *place, memory)) as studio:
        studio.start(hire=not dry)
        found = survey(studio, scene.id, views, error)
        facts = {"views": len(views), "isovalues": levels, "target_error": error, **lacks(studio, scene, found, error)}
        if dry:
            return {**facts, "final": share(found), "error": found.error}
        found = bake(studio, scene.id, found, error, seconds)
        stopped = "target" if found.final == found.pixels else "time"
        work = {"samples": studio.baker.paths, "stopped": stopped, "seconds": time.monotonic() - started}
    return {**facts, "final": share(found), "error": found.error, **work}


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


def survey(studio: Studio, scene: str, views: Sequence[View], error: float) -> Survey:
    """What the views show with the light that there is at a target ``error``."""
    found = Survey(views)
    with progress_bar("looking", "view", len(views)) as bar:
        for view in views:
            found.add(studio.survey(scene, view, error))
            bar.update()
    return found


def lacks(studio: Studio, scene: Scene, found: Survey, error: float) -> dict[str, Any]:
    """What is to be baked: chunks, texels, bytes before compression, and the seconds that it is likely to take."""
    studio.baker.want(scene.id, found.demands.values(), error)
    left = studio.baker.time_left(scene.id, "prewarm", found.demands)
    size = found.texels * scene.plan.bytes_per_texel
    time_left = None if left is None else {"low": left.low, "likely": left.likely, "high": left.high}
    return {"chunks": len(found.demands), "texels": found.texels, "bytes": size, "time_left": time_left}


def bake(studio: Studio, scene: str, found: Survey, error: float, seconds: float | None) -> Survey:
    """Have all that is lacking baked, and look again.

    Raises WorkersError where the workers fail, or bake nothing for PATIENCE seconds.
    """
    changed, paths = time.monotonic(), 0
    deadline = changed + (math.inf if seconds is None else seconds)
    chunks = list(found.demands)
    with progress_bar("baking", "chunk", len(chunks)) as bar:
        while (waiting := studio.baker.open(scene, chunks)) and time.monotonic() < deadline:
            if studio.baker.paths > paths:
                changed, paths = time.monotonic(), studio.baker.paths
            if studio.trouble() or time.monotonic() - changed > PATIENCE:
                raise WorkersError(studio.trouble() or no_light(studio))
            left = studio.baker.time_left(scene, "prewarm", chunks)
            show(bar, len(chunks) - waiting, len(chunks), left)
            studio.baker.wait(scene, chunks, min(LOOK, max(deadline - time.monotonic(), 0.0)))
        show(bar, len(chunks) - waiting, len(chunks), None)
    if studio.trouble():
        raise WorkersError(studio.trouble())
    return survey(studio, scene, found.views, error)


def share(found: Survey) -> float:
    """The share of surface pixels whose light is final; 1 where no surface is seen."""
    return found.final / found.pixels if found.pixels else 1.0


def sentence(facts: Mapping[str, Any]) -> str:
    """The facts for a person, on one line."""
    what = f"{facts['views']} views, {facts['final']:.1%} of their surface final at {facts['target_error']:g}"
    if "stopped" in facts:
        return f"{what}, {facts['samples']} samples in {duration(facts['seconds'])}"
    left = "unknown: nothing was baked yet" if facts["time_left"] is None else left_text(TimeLeft(**facts["time_left"]))
    size = f"{facts['texels']} texels in {facts['chunks']} chunks, {facts['bytes'] / 1e6:.1f} MB before compression"
    return f"{what}; to bake: {size}; time: {left}"
