"""The bench of a report: one view of a scene, its references and its light, made once for all
studies.

Light is baked in memory: that of a few texels, or of all that one view reads, for frames with it.
"""

import math
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from isogi_core.bake.bake_spec import BakeSpec, spec_name
from isogi_core.bake.refine import refine
from isogi_core.bake.texel_light import FIRST_LEVEL, Light, Part
from isogi_core.cache.chunk_record import Chunks
from isogi_core.cache.scene_caches import Caches
from isogi_core.errors import ViewError
from isogi_core.files.spelling import shortest
from isogi_core.frame.frame import Frame
from isogi_core.frame.projected_texels import find_distances
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.tiles import Tiles
from isogi_core.frame.view_texels import ViewTexels
from isogi_core.model.scene_plan import Layer, ScenePlan, most_samples
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
from isogi_report.metrics import Score, score

UNREACHED_TARGET = 1e-9
"""A target error that no texel reaches: all take as many samples as they are asked for."""

TEXELS_A_PIECE = 256
"""Texels that one thread bakes in one go."""


class Bake:
    """The ``light`` of ``texels`` (m, 3; z, y, x) of a look; ``seconds`` of the processor were
    spent on it.

    Those with a ``level`` (m,) that is not NaN lie on the isosurface of that normalised isovalue.
    """

    def __init__(
        self,
        tiles: Tiles,
        spec: BakeSpec,
        layers: tuple[Layer, ...],
        texels: np.ndarray,
        levels: np.ndarray | None = None,
    ) -> None:
        """Begin with ``layers`` of darkness, to be baked on the threads of ``tiles``; by default
        without levels.
        """
        self.tiles = tiles
        self.spec = spec
        self.layers = layers
        self.texels = texels
        if levels is None:
            self.levels = np.full(len(texels), np.nan)
        else:
            self.levels = levels
        self.light = dark(layers, len(texels))
        self.seconds = 0.0

    def grow(self, until: int, target: float = UNREACHED_TARGET) -> None:
        """Bring all texels to ``until`` samples each, or to what is final for a ``target`` error.
        Raises Cancelled.

        What it calls is compiled before, on a texel of which nothing is kept.
        """
        first = self.texels[:1]
        refine(dark(self.layers, len(first)), first, self.spec, FIRST_LEVEL, UNREACHED_TARGET)
        begun = time.process_time()

        def piece(a: int, b: int) -> None:
            for spec, rows in self._specs(a, b):
                light = self.light.rows(rows)
                refine(light, self.texels[rows], spec, until, target)
                self.light.put(rows, light)

        self.tiles.run(piece, len(self.texels), TEXELS_A_PIECE)
        self.seconds += time.process_time() - begun

    def _specs(self, a: int, b: int) -> Iterator[tuple[BakeSpec, np.ndarray]]:
        """The bake specs of texels ``a`` … ``b``, and the rows of each."""
        levels = self.levels[a:b]
        for level in np.unique(levels).tolist():
            shown = None if math.isnan(level) else level
            if shown is None:
                own = np.isnan(levels)
            else:
                own = levels == level
            yield replace(self.spec, shown=shown), a + np.flatnonzero(own)

    @property
    def samples(self) -> float:
        """Mean samples of the texels that can hold light."""
        return float(np.maximum(self.light.samples, 0).sum() / max((~self.light.void).sum(), 1))


class ViewBake(Bake):
    """The light of the texels that a ``view`` reads: layers of its scene's plan, or those given.

    Where projection pays, those that are far from the view's isosurface are lit there too, after
    all others.
    """

    def __init__(self, renderer: Renderer, view: View, layers: tuple[Layer, ...] = ()) -> None:
        """Find the texels; they are in the order of the view's own numbers."""
        self.renderer = renderer
        self.view = view
        self.shown = renderer.texels(view, renderer.gbuffer(view))
        spec = renderer.caches.spec(view.shading)
        places = self.shown.positions
        self.distant = distant_texels(renderer, view, self.shown)
        levels = np.full(len(places) + len(self.distant), np.nan)
        levels[len(places) :] = self.shown.gbuffer.isovalue
        texels = np.concatenate([places, places[self.distant]])
        super().__init__(renderer.tiles, spec, layers or spec.plan.layers, texels, levels)

    def frame(self, light: Light | None = None) -> Frame:
        """The view's frame with the bake's light, or with some ``light`` of the same texels.

        Raises StoreError where the memory for light cannot hold all of it.
        """
        caches = self.renderer.caches
        light = light or self.light
        own = len(self.shown.places)
        self.show(light, np.arange(own))
        if len(self.distant):
            projected = self._chunks(light, self.distant, own)
            caches.projected(self.shown.gbuffer.isovalue).pool.insert(projected, self.shown.chunks)
        return self.renderer.render(self.view, UNREACHED_TARGET)

    def show(self, light: Light, numbers: np.ndarray) -> None:
        """Have frames read this ``light`` of the view's texels with these ``numbers``, and none of
        others.
        """
        pool = self.renderer.caches.of(self.view.shading).pool
        pool.insert(self._chunks(light, numbers, 0), self.shown.chunks)

    def _chunks(self, light: Light, numbers: np.ndarray, first: int) -> Chunks:
        """The texels with these ``numbers`` in the view, and their light from row ``first`` on."""
        shown = self.shown
        counts = np.diff(np.searchsorted(numbers, self.shown.bounds))
        some = np.flatnonzero(counts)
        offsets = np.concatenate([np.empty(0, np.int32), *shown.offsets])[numbers]
        indices = tuple(shown.chunks[i] for i in some.tolist())
        return Chunks(
            indices,
            np.cumsum([0, *counts[some]]),
            offsets,
            light.rows(first + np.arange(len(numbers))),
        )


def distant_texels(renderer: Renderer, view: View, shown: ViewTexels) -> np.ndarray:
    """Numbers of a view's texels that are to be projected as well: none where that does not pay."""
    scene = renderer.prepared.scene
    if spec_name(view.shading) != "gi" or not scene.projection.projects(shown.gbuffer.isovalue):
        return np.empty(0, np.int64)
    return np.flatnonzero(
        find_distances(shown, renderer.prepared, renderer.tiles).beyond(scene.target_error)
    )


def dark(layers: tuple[Layer, ...], texels: int) -> Light:
    """Light of the ``layers`` that no path was sent for yet."""
    return Light(tuple(Part.dark(layer, texels) for layer in layers))


BENCH_CACHE_BYTES = 1 << 30
"""Bytes of light that frames of one scene may hold."""

MIN_REFERENCE_PATHS = 64
MAX_REFERENCE_PATHS = 16384
"""Paths from each pixel of the shortest reference, and of the longest."""

REFERENCE_NOISE_SHARE = 0.1
"""What a reference's noise may be of the error that it is to tell."""

REFERENCE_SHARE = 0.1
"""What growing a reference may take of the time that is left; two more of as many paths are made
for the split.
"""


@dataclass(frozen=True, eq=False)
class Bench:
    """What studies are given: a ``scene``, a ``view`` of it, and a ``folder`` for its references.

    ``cancelled`` stops all work on the ``threads``; ``deadline``, a time of ``time.monotonic``, is
    when studies should have ended. ``hurry`` is set where one had to make do with less for it.
    Light is kept in memory alone, and baked again by the next bench: what that costs is among what
    is measured. Pictures are judged at an ``exposure``, by default the scene's own.
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
        """Whether something gave way to time in the study that was begun last: a later one may find
        more.
        """
        return self.hurry.is_set()

    @property
    def whole(self) -> Scene:
        """The scene with as many bounces as may matter, as its reference has."""
        return whole_paths(self.scene)

    def renderer(self, scene: Scene) -> Renderer:
        """A renderer of the scene, or of one like it; its store in the folder stays without
        light.
        """
        store = self.folder / "light" / scene.digest

        def make() -> Renderer:
            return Renderer(
                Caches(PreparedScene(scene), store, BENCH_CACHE_BYTES), self.tiles, filters=False
            )

        return self.once(("renderer", scene.digest, scene.bounces, scene.plan.survival), make)

    @cached_property
    def surface(self) -> np.ndarray:
        """Where the view shows the surface, (h, w) bool; ViewError where it does nowhere."""
        gbuffer = self.renderer(self.scene).gbuffer(self.view)
        if not len(gbuffer.pixels):
            raise ViewError(
                f"Nothing is to be seen at isovalue {shortest(self.view.isovalue)}: choose another "
                "view."
            )
        on = np.zeros(gbuffer.shape, bool)
        on.flat[gbuffer.pixels] = True
        return on

    @cached_property
    def planned(self) -> ViewBake:
        """The view's light as the scene's plan has it, baked to the target error. ViewError where
        nothing is seen.
        """
        self.surface  # noqa: B018
        renderer = self.renderer(self.scene)
        target = self.scene.target_error
        bake = ViewBake(renderer, self.view)
        bake.grow(most_samples(target), target)
        return bake

    @property
    def best(self) -> Reference:
        """The view's reference, grown until its noise is a tenth of the plan's error, or time is
        short.
        """
        return self.grown(REFERENCE_NOISE_SHARE * self._first_error)

    @cached_property
    def _first_error(self) -> float:
        """The relative error of the plan's frame, by the shortest reference."""
        return self.score(self.planned.frame().leaving, self.reference(MIN_REFERENCE_PATHS)).rmse

    def grown(self, noise: float) -> Reference:
        """The view's reference, grown once until its own ``noise`` is so small, or as far as the
        time left allows.
        """
        found: Reference = self.once(("grown", noise), lambda: self._grow(noise))
        if not goal_of(noise).met(found):
            self.hurry.set()
        return found

    def _grow(self, noise: float) -> Reference:
        found = self.reference(MIN_REFERENCE_PATHS)
        scene = self.whole
        goal = replace(
            goal_of(noise),
            seconds=REFERENCE_SHARE * self.left if math.isfinite(self.left) else None,
        )
        for grown in grow_reference(self.renderer(scene), self.view, goal, found):
            found = self._keep(grown, scene)
        return found

    def sized(self, size: int) -> "Bench":
        """The bench of the same view in a picture whose longer side has ``size`` pixels."""
        scale = size / max(self.view.width, self.view.height)
        width, height = (max(round(scale * n), 1) for n in (self.view.width, self.view.height))
        return replace(self, view=replace(self.view, width=width, height=height), _made={})

    def reference(
        self, samples: int, scene: Scene | None = None, bounces: int | None = None
    ) -> Reference:
        """Paths from the view's pixels, at least so many ``samples``, kept in the folder and grown
        from there.

        Of the ``scene`` given, with ``bounces``: by default, where its paths have any, as many as
        may matter.
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
        return (
            self.folder / f"{scene.digest}-{scene.bounces}-{self.view.width}x{self.view.height}.npz"
        )

    def score(self, radiance: Any, best: Reference | None = None) -> Score:
        """The score of a picture of the view, against its own reference unless another is given."""
        if self.exposure is None:
            exposure = self.scene.default_exposure
        else:
            exposure = self.exposure
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
    """The scene with so many ``bounces``; by default with as many as may matter, where it has
    any.
    """
    return with_bounces(scene, bounces if scene.bounces else 0)


def with_plan(scene: Scene, **changes: Any) -> Scene:
    """The scene by a plan that differs from its own in ``changes``."""
    plan: ScenePlan = replace(scene.plan, **changes)
    return replace(scene, plan=plan)
