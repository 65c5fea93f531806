"""The bench of a report: one view of a scene, its references and its light, made once for all studies."""

import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from isogi_core.bake.recipe import Recipe
from isogi_core.cache.caches import Caches
from isogi_core.errors import Cancelled, ViewError
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.tiles import Tiles
from isogi_core.model.plan import ScenePlan, most_samples
from isogi_core.model.scene import Scene
from isogi_core.model.view import View
from isogi_core.plan.budget import LONGEST_PATH
from isogi_core.report.bake import ViewBake
from isogi_core.report.metrics import Score, score
from isogi_core.report.reference import Reference, load_reference, save_reference, trace_reference

MEMORY = 256 << 20
"""Bytes of light that frames of one scene may hold."""

FIRST, MOST = 64, 16384
"""Paths from each pixel of the shortest reference, and of the longest."""

FINE = 0.1
"""What a reference's noise may be of the error that it is to tell."""

SHARE = 0.2
"""What growing a reference may take of the time that is left."""


@dataclass(frozen=True, eq=False)
class Bench:
    """What studies are given: a ``scene``, a ``view`` of it, and a ``folder`` for its light and references.

    ``cancelled`` stops all work; ``deadline``, a time of ``time.monotonic``, is when studies should have ended.
    ``hurry`` is set where one had to make do with less for it. Pictures are judged at an ``exposure``, by default
    the scene's own.
    """

    scene: Scene
    view: View
    folder: Path
    exposure: float | None = None
    cancelled: threading.Event = field(default_factory=threading.Event)
    deadline: float = math.inf
    hurry: threading.Event = field(default_factory=threading.Event)
    tiles: Tiles = field(default_factory=Tiles)
    _made: dict[Any, Any] = field(default_factory=dict, repr=False)

    @property
    def left(self) -> float:
        """Seconds until the deadline."""
        return self.deadline - time.monotonic()

    @property
    def hurried(self) -> bool:
        """Whether something gave way to time in the study that was begun last: a later one may find more."""
        return self.hurry.is_set()

    def renderer(self, scene: Scene) -> Renderer:
        """A renderer of the scene, or of one like it, with a store of its own in the folder."""
        store = self.folder / "light" / scene.digest

        def make() -> Renderer:
            return Renderer(Caches(Recipe(scene, self.tiles.run), store, MEMORY), self.tiles)

        return self.once(("renderer", scene.digest, scene.bounces), make)

    @cached_property
    def planned(self) -> ViewBake:
        """The view's light as the scene's plan has it, baked to the target error. ViewError where nothing is seen."""
        renderer, target = self.renderer(self.scene), self.scene.target_error
        if not len(renderer.gbuffer(self.view).points):
            raise ViewError(f"Nothing is to be seen at isovalue {self.view.isovalue:g}: choose another view.")
        bake = ViewBake(renderer, self.view)
        bake.grow(most_samples(target), target, self.cancelled)
        return bake

    @cached_property
    def best(self) -> Reference:
        """The view's reference, grown until its noise is a tenth of the plan's error, or time is short."""
        frame = self.planned.frame()
        return self.grown(FINE * self.score(frame.radiance, self.reference(FIRST)).rmse)

    def grown(self, noise: float) -> Reference:
        """The view's reference, grown until its own ``noise`` is so small, or as far as the time left allows."""
        best, end = self.reference(FIRST), time.monotonic() + SHARE * self.left
        while best.noise > noise and best.samples < MOST and time.monotonic() < end:
            best = self.reference(2 * best.samples)
        return best

    def sized(self, size: int) -> "Bench":
        """The bench of the same view in a picture whose longer side has ``size`` pixels."""
        scale = size / max(self.view.width, self.view.height)
        width, height = (max(round(scale * n), 1) for n in (self.view.width, self.view.height))
        return replace(self, view=replace(self.view, width=width, height=height), _made={})

    def reference(self, samples: int, scene: Scene | None = None, bounces: int | None = None) -> Reference:
        """Paths from the view's pixels, at least so many ``samples``, kept in the folder and grown from there.

        Of the ``scene`` told, with ``bounces``: by default, where its paths have any, as many as may matter.
        """
        scene = longer(scene or self.scene, bounces)
        key = "reference", scene.digest, scene.bounces
        file = self.folder / f"{scene.digest}-{scene.bounces}-{self.view.width}x{self.view.height}.npz"
        if key not in self._made and file.exists():
            self._made[key] = load_reference(file, scene, self.view)
        former: Reference | None = self._made.get(key)
        if former is None or former.samples < samples:
            grown = trace_reference(self.renderer(scene), self.view, samples, former, self.cancelled)
            self.folder.mkdir(parents=True, exist_ok=True)
            save_reference(file, grown, scene, self.view)
            self._made[key] = grown
        found: Reference = self._made[key]
        return found

    def score(self, radiance: Any, best: Reference | None = None) -> Score:
        """The score of a picture of the view, against its own reference unless another is told."""
        exposure = self.scene.default_exposure if self.exposure is None else self.exposure
        return score(radiance, best or self.best, exposure)

    def check(self) -> None:
        """Raise Cancelled where nobody waits for the report."""
        if self.cancelled.is_set():
            raise Cancelled("The report was stopped.")

    def once(self, key: Any, make: Callable[[], Any]) -> Any:
        """What was made under this key, or is made now."""
        if key not in self._made:
            self._made[key] = make()
        return self._made[key]


def longer(scene: Scene, bounces: int | None = None) -> Scene:
    """The scene with so many ``bounces``; by default with as many as may matter, where it has any."""
    longest = max(scene.bounces, LONGEST_PATH) if scene.bounces else 0
    return with_plan(scene, bounces=longest if bounces is None else bounces)


def with_plan(scene: Scene, **changes: Any) -> Scene:
    """The scene by a plan that differs from its own in ``changes``."""
    plan: ScenePlan = replace(scene.plan, **changes)
    return replace(scene, plan=plan)
