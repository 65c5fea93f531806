"""The bench of a report: one view of a scene, its references and its light, made once for all
studies.

Light is baked in memory: of a few texels, or of all texels that one view reads.
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
from isogi_core.bake.noise import Goal
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
from isogi_core.model.scene_plan import Layer, ScenePlan
from isogi_core.model.view import View
from isogi_core.plan.scene import Scene
from isogi_core.prepared.prepared_scene import PreparedScene
from isogi_core.reference import (
    Reference,
    ReferenceGoal,
    grow_reference,
    load_reference,
    refuse_several,
    save_reference,
    trace_reference,
    with_bounces,
)
from isogi_report.metrics import Score, score

UNREACHED_GOAL = Goal(1e-9)
"""A goal whose error no texel reaches,
so that all texels take as many samples as they are asked for.
"""

TEXELS_A_PIECE = 256
"""Texels that one thread bakes in one call."""


class Bake:
    """The ``light`` of ``texels`` (m, 3; z, y, x) by a bake spec, and the processor ``seconds``
    spent on it.

    Texels whose ``level`` (m,) is not NaN are projected onto the isosurface of that normalised
    isovalue.
    """

    def __init__(
        self,
        tiles: Tiles,
        spec: BakeSpec,
        layers: tuple[Layer, ...],
        texels: np.ndarray,
        levels: np.ndarray | None = None,
    ) -> None:
        """Begin with dark ``layers``, to be baked by the threads of ``tiles``;
        by default no texel is projected.
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

    def grow(self, until: int, goal: Goal = UNREACHED_GOAL) -> None:
        """Bring all texels to ``until`` samples each, or to the samples
        that suffice for a ``goal``. Raises Cancelled.
        """
        # Compile the kernels on one texel before the time is taken; drop its light.
        first = self.texels[:1]
        refine(dark(self.layers, len(first)), first, self.spec, FIRST_LEVEL, UNREACHED_GOAL)
        begun = time.process_time()

        def piece(a: int, b: int) -> None:
            for spec, rows in self._specs(a, b):
                light = self.light.rows(rows)
                refine(light, self.texels[rows], spec, until, goal)
                self.light.put(rows, light)

        self.tiles.run(piece, len(self.texels), TEXELS_A_PIECE)
        self.seconds += time.process_time() - begun

    def _specs(self, a: int, b: int) -> Iterator[tuple[BakeSpec, np.ndarray]]:
        """Yield the bake specs of texels ``a`` … ``b``,
        one for each isosurface that they lie on, with their rows.
        """
        levels = self.levels[a:b]
        for level in np.unique(levels).tolist():
            if math.isnan(level):
                yield replace(self.spec, shown=None), a + np.flatnonzero(np.isnan(levels))
            else:
                yield replace(self.spec, shown=level), a + np.flatnonzero(levels == level)

    @property
    def samples(self) -> float:
        """Mean samples of the texels that can hold light."""
        return float(np.maximum(self.light.samples, 0).sum() / max((~self.light.void).sum(), 1))


class ViewBake(Bake):
    """The light of the texels that a ``view`` reads, in the layers of its scene's plan or in given
    ones.

    If projection pays for the scene, texels far from the view's isosurface are also lit there;
    these come after all others.
    """

    def __init__(self, renderer: Renderer, view: View, layers: tuple[Layer, ...] = ()) -> None:
        """Find the texels, in the order of the view's own numbers."""
        self.renderer = renderer
        self.view = view
        self.shown = renderer.surface.texels(view, renderer.gbuffer(view))
        spec = renderer.caches.spec(view.shading)
        places = self.shown.positions
        self.distant = distant_texels(renderer, view, self.shown)
        # Distant texels come twice: on their own isosurfaces, and projected onto the view's.
        levels = np.full(len(places) + len(self.distant), np.nan)
        levels[len(places) :] = self.shown.gbuffer.isovalue
        texels = np.concatenate([places, places[self.distant]])
        super().__init__(renderer.tiles, spec, layers or spec.plan.layers, texels, levels)

    def frame(self, light: Light | None = None) -> Frame:
        """Return the view's frame with the bake's light, or with another ``light`` of the same
        texels.

        Raises StoreError if the memory for light cannot hold all of it.
        """
        caches = self.renderer.caches
        light = light or self.light
        own = len(self.shown.places)
        self.show(light, np.arange(own))
        # Projected texels are kept apart, in the cache of their isovalue.
        if len(self.distant):
            projected = self._chunks(light, self.distant, own)
            caches.projected(self.shown.gbuffer.isovalue).pool.insert(projected, self.shown.chunks)
        return self.renderer.render(self.view, Goal.checked(UNREACHED_GOAL.error))

    def show(self, light: Light, numbers: np.ndarray) -> None:
        """Put this ``light`` of the view's texels with the given ``numbers``
        where frames read it, and none of others.
        """
        pool = self.renderer.caches.of(self.view.shading).pool
        pool.insert(self._chunks(light, numbers, 0), self.shown.chunks)

    def _chunks(self, light: Light, numbers: np.ndarray, first: int) -> Chunks:
        """Return the texels with these ``numbers`` in the view
        as chunks, with their light from row ``first`` on.
        """
        shown = self.shown
        # Leave out chunks without any of these texels.
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
    """Return the numbers of a view's texels that must be projected as well;
    none if projection does not pay.
    """
    scene = renderer.prepared.scene
    if spec_name(view.shading) != "gi" or not scene.projection.projects(shown.gbuffer.isovalue):
        return np.empty(0, np.int64)
    return np.flatnonzero(
        find_distances(shown, renderer.prepared, renderer.tiles).beyond(scene.target_error)
    )


def dark(layers: tuple[Layer, ...], texels: int) -> Light:
    """Return light of the ``layers`` without any samples."""
    return Light(tuple(Part.dark(layer, texels) for layer in layers))


BENCH_CACHE_BYTES = 1 << 30
"""Bytes of light that frames of one scene may hold."""

MIN_REFERENCE_PATHS = 64
MAX_REFERENCE_PATHS = 16384
"""Paths from each pixel of the shortest and of the longest reference."""

REFERENCE_NOISE_SHARE = 0.1
"""Noise that a reference may have, as a share of the error to be measured:
it then changes that by 0.5 %.
"""

REFERENCE_SHARE = 0.1
"""Share of the time left that growing a reference may take.
Two more references of as many paths are made for the split.
"""


@dataclass(frozen=True, eq=False)
class Bench:
    """The things that studies work with: a ``scene``, a ``view`` of it, and a ``folder`` for its
    references.

    ``cancelled`` stops all work on the ``threads``. ``deadline``, a time of ``time.monotonic``, is
    when studies should end; ``hurry`` is set if a study had to measure less because of it. Light is
    kept in memory only, and baked again by the next bench, as its cost is to be measured. Pictures
    are compared at an ``exposure``, by default the scene's.
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
        """True if the last study measured less for lack of time,
        so that another run may measure more.
        """
        return self.hurry.is_set()

    @property
    def whole(self) -> Scene:
        """The scene with as many bounces as may matter, as its reference has."""
        return whole_paths(self.scene)

    def renderer(self, scene: Scene) -> Renderer:
        """Return the renderer of ``scene``, the scene of the bench or a variation of it, made on
        first use. Its pictures show the light of texels unfiltered.
        """
        # Caches need a store. This one stays without light: light is put into the page pool
        # directly.
        store = self.folder / "light" / scene.digest

        def make() -> Renderer:
            return Renderer(
                Caches(PreparedScene(scene), store, BENCH_CACHE_BYTES), self.tiles, filters=False
            )

        # Paths of references depend on bounces and survival, which the digest leaves out if texels
        # keep no reflected light.
        return self.once(("renderer", scene.digest, scene.bounces, scene.plan.survival), make)

    @cached_property
    def surface(self) -> np.ndarray:
        """Mask of the surface in the view, (h, w) bool. Raises ViewError if there is none."""
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
        """The view's light by the scene's plan, baked to the target error.

        Raises ViewError if nothing is seen.
        """
        self.surface  # noqa: B018
        renderer = self.renderer(self.scene)
        goal = Goal(self.scene.target_error)
        bake = ViewBake(renderer, self.view)
        bake.grow(goal.most_samples, goal)
        return bake

    @property
    def best(self) -> Reference:
        """The view's reference, grown until its noise is a tenth
        of the plan's error, or time is short.
        """
        return self.grown(REFERENCE_NOISE_SHARE * self._first_error)

    @cached_property
    def _first_error(self) -> float:
        """The relative error of the plan's frame, by the shortest reference."""
        return self.score(self.planned.frame().leaving, self.reference(MIN_REFERENCE_PATHS)).rmse

    def grown(self, noise: float) -> Reference:
        """Return the view's reference,
        grown once until its ``noise`` is this small, or as far as time allows.
        """
        found: Reference = self.once(("grown", noise), lambda: self._grow(noise))
        # The reference is noisier than it should be: another run may do better.
        if not reference_goal(noise).met(found):
            self.hurry.set()
        return found

    def _grow(self, noise: float) -> Reference:
        """Grow the view's reference until its ``noise`` is this small,
        or the time for it is over; keep each state.
        """
        found = self.reference(MIN_REFERENCE_PATHS)
        scene = self.whole
        goal = reference_goal(noise)
        if math.isfinite(self.left):
            goal = replace(goal, seconds=REFERENCE_SHARE * self.left)
        for grown in grow_reference(self.renderer(scene), self.view, goal, found):
            found = self._keep(grown, scene)
        return found

    def sized(self, size: int) -> "Bench":
        """Return a bench of the same view in a picture whose longer side has ``size`` pixels."""
        scale = size / max(self.view.width, self.view.height)
        width, height = (max(round(scale * n), 1) for n in (self.view.width, self.view.height))
        return replace(self, view=replace(self.view, width=width, height=height), _made={})

    def reference(
        self, samples: int, scene: Scene | None = None, bounces: int | None = None
    ) -> Reference:
        """Return a reference of at least ``samples`` paths from each of the view's pixels. It is
        kept in the folder, and grown from there.

        It is of the given ``scene`` with ``bounces``, by default as many as may matter if its paths
        have any.
        """
        scene = whole_paths(scene or self.scene, bounces)
        # A reference is a sum of paths, so a shorter one in the folder is extended.
        former = self._kept(scene)
        if former is not None and former.samples >= samples:
            return former
        return self._keep(trace_reference(self.renderer(scene), self.view, samples, former), scene)

    def _kept(self, scene: Scene) -> Reference | None:
        """Return the reference of a scene from the bench or the folder; None if there is none."""
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
        """Return the file of a scene's reference."""
        return (
            self.folder / f"{scene.digest}-{scene.bounces}-{self.view.width}x{self.view.height}.npz"
        )

    def score(self, radiance: Any, best: Reference | None = None) -> Score:
        """Return the score of a picture of the view against
        the ``best`` reference, by default the view's.
        """
        if self.exposure is None:
            exposure = self.scene.default_exposure
        else:
            exposure = self.exposure
        return score(radiance, best or self.best, exposure)

    def once(self, key: Any, make: Callable[[], Any]) -> Any:
        """Return the value under this key; make it on first use."""
        if key not in self._made:
            self._made[key] = make()
        return self._made[key]


def reference_goal(noise: float) -> ReferenceGoal:
    """Return the goal of a reference with at most this relative ``noise``."""
    return ReferenceGoal(samples=MAX_REFERENCE_PATHS, noise=noise)


def whole_paths(scene: Scene, bounces: int | None = None) -> Scene:
    """Return the scene with ``bounces``, by default as many as may matter if it has any."""
    return with_bounces(scene, bounces if scene.bounces else 0)


def with_plan(scene: Scene, **changes: Any) -> Scene:
    """Return the scene with a plan that differs from its own in the given ``changes``."""
    plan: ScenePlan = replace(scene.plan, **changes)
    return replace(scene, plan=plan)
