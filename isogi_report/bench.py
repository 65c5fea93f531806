"""The bench of a report: one view of a scene, its references and its light, made once for all studies."""

import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from isogi_core.cache.scene_caches import Caches
from isogi_core.errors import ViewError
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.tiles import Tiles
from isogi_core.model.scene_plan import ScenePlan, most_samples
from isogi_core.model.view import View
from isogi_core.plan.scene import Scene
from isogi_core.prepared.prepared_scene import PreparedScene
from isogi_core.reference import (
    Goal,
    Reference,
    grow_reference,
    load_reference,
    refuse_several,
    save_reference,
    trace_reference,
    with_bounces,
)
from isogi_report.bake import ViewBake
from isogi_report.metrics import Score, score

BENCH_CACHE_BYTES = 1 << 30
"""Bytes of light that frames of one scene may hold."""

MIN_REFERENCE_PATHS, MAX_REFERENCE_PATHS = 64, 16384
"""Paths from each pixel of the shortest reference, and of the longest."""

REFERENCE_NOISE_SHARE = 0.1
"""What a reference's noise may be of the error that it is to tell."""

REFERENCE_SHARE = 0.1
"""What growing a reference may take of the time that is left; two more of as many paths are made for the split."""


@dataclass(frozen=True, eq=False)
class Bench:
    """What studies are given: a ``scene``, a ``view`` of it, and a ``folder`` for its references.

    ``cancelled`` stops all work on the ``threads``; ``deadline``, a time of ``time.monotonic``, is when studies should
    have ended. ``hurry`` is set where one had to make do with less for it. Light is kept in memory alone, and baked
    again by the next bench: what that costs is among what is measured. Pictures are judged at an ``exposure``, by
    default the scene's own.
    """

    scene: Scene
    view: View
    folder: Path
    exposure: float | None = None
    cancelled: threading.Event = field(default_factory=threading.Event)
    deadline: float = math.inf
    hurry: threading.Event = field(default_factory=threading.Event)
    threads: Tiles = field(default_factory=Tiles)
    _made: dict[Any, Any] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        refuse_several(self.scene)

    @cached_property
    def tiles(self) -> Tiles:
        """The threads, for work that ends once the bench is cancelled."""
        return self.threads.cancelled_by(self.cancelled)

    @property
    def left(self) -> float:
        """Seconds until the deadline."""
        return self.deadline - time.monotonic()

    @property
    def hurried(self) -> bool:
        """Whether something gave way to time in the study that was begun last: a later one may find more."""
        return self.hurry.is_set()

    @property
    def whole(self) -> Scene:
        """The scene with as many bounces as may matter, as its reference has."""
        return whole_paths(self.scene)

    def renderer(self, scene: Scene) -> Renderer:
        """A renderer of the scene, or of one like it; its store in the folder stays without light."""
        store = self.folder / "light" / scene.digest

        def make() -> Renderer:
            return Renderer(Caches(PreparedScene(scene), store, BENCH_CACHE_BYTES), self.tiles, filters=False)

        return self.once(("renderer", scene.digest, scene.bounces, scene.plan.survival), make)

    @cached_property
    def surface(self) -> np.ndarray:
        """Where the view shows the surface, (h, w) bool; ViewError where it does nowhere."""
        gbuffer = self.renderer(self.scene).gbuffer(self.view)
        if not len(gbuffer.pixels):
            raise ViewError(f"Nothing is to be seen at isovalue {self.view.isovalue:g}: choose another view.")
        on = np.zeros(gbuffer.shape, bool)
        on.flat[gbuffer.pixels] = True
        return on

    @cached_property
    def planned(self) -> ViewBake:
        """The view's light as the scene's plan has it, baked to the target error. ViewError where nothing is seen."""
        self.surface  # noqa: B018
        renderer, target = self.renderer(self.scene), self.scene.target_error
        bake = ViewBake(renderer, self.view)
        bake.grow(most_samples(target), target)
        return bake

    @property
    def best(self) -> Reference:
        """The view's reference, grown until its noise is a tenth of the plan's error, or time is short."""
        return self.grown(REFERENCE_NOISE_SHARE * self._first_error)

    @cached_property
    def _first_error(self) -> float:
        """The relative error of the plan's frame, by the shortest reference."""
        return self.score(self.planned.frame().leaving, self.reference(MIN_REFERENCE_PATHS)).rmse

    def grown(self, noise: float) -> Reference:
        """The view's reference, grown once until its own ``noise`` is so small, or as far as the time left allows."""
        found: Reference = self.once(("grown", noise), lambda: self._grow(noise))
        if not goal_of(noise).met(found):
            self.hurry.set()
        return found

    def _grow(self, noise: float) -> Reference:
        found, scene = self.reference(MIN_REFERENCE_PATHS), self.whole
        goal = replace(goal_of(noise), seconds=REFERENCE_SHARE * self.left if math.isfinite(self.left) else None)
        for grown in grow_reference(self.renderer(scene), self.view, goal, found):
            found = self._keep(grown, scene)
        return found

    def sized(self, size: int) -> "Bench":
        """The bench of the same view in a picture whose longer side has ``size`` pixels."""
        scale = size / max(self.view.width, self.view.height)
        width, height = (max(round(scale * n), 1) for n in (self.view.width, self.view.height))
        return replace(self, view=replace(self.view, width=width, height=height), _made={})

    def reference(self, samples: int, scene: Scene | None = None, bounces: int | None = None) -> Reference:
        """Paths from the view's pixels, at least so many ``samples``, kept in the folder and grown from there.

        Of the ``scene`` given, with ``bounces``: by default, where its paths have any, as many as may matter.
        """
        scene = whole_paths(scene or self.scene, bounces)
        former = self._kept(scene)
        if former is not None and former.samples >= samples:
            return former
        return self._keep(trace_reference(self.renderer(scene), self.view, samples, former), scene)

    def _kept(self, scene: Scene) -> Reference | None:
        """The reference of a scene that is on the bench, or in the folder."""
        path = self._path(scene)
        if path not in self._made and path.exists():
            self._made[path] = load_reference(path, scene, self.view)
        found: Reference | None = self._made.get(path)
        return found

    def _keep(self, reference: Reference, scene: Scene) -> Reference:
        """Put a reference on the bench and into the folder."""
        self.folder.mkdir(parents=True, exist_ok=True)
        save_reference(self._path(scene), reference, scene, self.view)
        self._made[self._path(scene)] = reference
        return reference

    def _path(self, scene: Scene) -> Path:
        return self.folder / f"{scene.digest}-{scene.bounces}-{self.view.width}x{self.view.height}.npz"

    def score(self, radiance: Any, best: Reference | None = None) -> Score:
        """The score of a picture of the view, against its own reference unless another is given."""
        exposure = self.scene.default_exposure if self.exposure is None else self.exposure
        return score(radiance, best or self.best, exposure)

    def once(self, key: Any, make: Callable[[], Any]) -> Any:
        """What was made under this key, or is made now."""
        if key not in self._made:
            self._made[key] = make()
        return self._made[key]


def goal_of(noise: float) -> Goal:
    """Where a reference is good enough whose own noise is to be so small."""
    return Goal(samples=MAX_REFERENCE_PATHS, noise=noise)


def whole_paths(scene: Scene, bounces: int | None = None) -> Scene:
    """The scene with so many ``bounces``; by default with as many as may matter, where it has any."""
    return with_bounces(scene, bounces if scene.bounces else 0)


def with_plan(scene: Scene, **changes: Any) -> Scene:
    """The scene by a plan that differs from its own in ``changes``."""
    plan: ScenePlan = replace(scene.plan, **changes)
    return replace(scene, plan=plan)
