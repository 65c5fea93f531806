"""``isogi bench``: how fast this machine is at what isogi does, and what the benchmarks measure
with.
"""

import resource
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise
from typing import Any

import numpy as np
from tqdm import tqdm

from isogi_core.bake.bake_spec import SPECS, spec_for
from isogi_core.bake.refine import refine
from isogi_core.bake.texel_light import Light
from isogi_core.cache.scene_caches import Caches
from isogi_core.errors import ViewError
from isogi_core.files.spelling import shortest
from isogi_core.frame.film import develop
from isogi_core.frame.frame import Frame
from isogi_core.frame.gbuffer import pinhole
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.simd.types import RAY_WIDTH, REGISTER_LANES
from isogi_core.kernels.tracing import ray_stream
from isogi_core.kernels.tracing.cast import cast_batch
from isogi_core.kernels.tracing.intersect import UNKNOWN_SIDE
from isogi_core.kernels.transport.integrator import bounce_rays
from isogi_core.model.choices import VIEW_SHADINGS
from isogi_core.model.scene_plan import MAX_SAMPLES, MIN_SAMPLES
from isogi_core.model.view import View, quaternion_from_angles
from isogi_core.plan.scene import Scene
from isogi_core.prepared.prepared_scene import Index, PreparedScene
from isogi_core.runs import Run, serially
from isogi_report.bench import UNREACHED_TARGET
from server.parameters import FORMATS
from server.pictures import encode
from server.progress import open_scene
from server.settings import cores
from worker.pool import MAX_TASK_TEXELS

SPEED_CACHE_BYTES = 1 << 30
"""Bytes of light that a measured renderer may hold."""

LOOSEST_TARGET = 1.0
"""A target error that FEWEST samples meet: what is measured are frames of light that is final, as
most light is.
"""

Candidate = Callable[[int], float]
"""Does its work in the given round and returns the seconds that it took."""


Offsets = dict[Index, np.ndarray]
"""Texels by their chunks: what each holds of them, by offsets."""


@dataclass(frozen=True, eq=False)
class Rays:
    """``origins`` and ``directions`` (3, n) in index space, ``levels`` (n,) normalised isovalues of
    the surfaces that they look for, all float64, and ``sides`` (n,) int8 that they start on."""

    origins: np.ndarray
    directions: np.ndarray
    levels: np.ndarray
    sides: np.ndarray

    def __len__(self) -> int:
        return len(self.sides)

    @property
    def columns(self) -> ray_stream.Rays:
        """The rays as kernels take them."""
        return ray_stream.Rays(self.levels, self.origins, self.directions, self.sides)

    def part(self, which: Any) -> "Rays":
        """Some of the rays, as arrays of their own."""
        origins, directions = (
            np.ascontiguousarray(v[:, which]) for v in (self.origins, self.directions)
        )
        return Rays(origins, directions, self.levels[which].copy(), self.sides[which].copy())


def view_of(scene: Scene, size: int, **knobs: Any) -> View:
    """The view that is measured: azimuth 40, elevation 30, three radii away, 30 degrees wide."""
    return View(
        **{"isovalue": scene.isovalue, "camera": scene.camera(40, 30, 3, 30), **knobs},
        width=size,
        height=size,
    )


def isovalues_near(scene: Scene, count: int) -> list[float]:
    """Isovalues that differ, farther and farther to both sides of the scene's, within a tenth of
    its range.
    """
    low, high = scene.isovalues
    down = scene.isovalue - low
    up = high - scene.isovalue
    reach = 0.1 * (min(down, up) or max(down, up))
    ways = (1.0 if up else -1.0, -1.0 if down else 1.0)
    return [scene.isovalue + ways[i % 2] * reach * (i + 1) / count for i in range(count)]


def make_renderer(scene: Scene, store: str, threads: int | None = None) -> Renderer:
    """A renderer over a store, with nothing else around it."""
    tiles = Tiles(threads)
    return Renderer(Caches(PreparedScene(scene), store, SPEED_CACHE_BYTES), tiles)


def bake_view(renderer: Renderer, view: View, until: int) -> Frame:
    """Bake in this process what ``view`` lacks, to ``until`` samples a texel, and render it."""
    wanted = wanted_of(renderer.render(view, UNREACHED_TARGET, enough=MAX_SAMPLES))
    bake_offsets(
        renderer,
        view.shading,
        wanted,
        until,
        tqdm(desc="baking", unit="chunk", total=len(wanted), leave=False),
    )
    return renderer.render(view, UNREACHED_TARGET, enough=MAX_SAMPLES)


def wanted_of(frame: Frame) -> Offsets:
    """The texels that a frame lacks, chunk by chunk."""
    return {demand.index: demand.offsets for demand in frame.demands}


def bake_offsets(renderer: Renderer, shading: str, wanted: Offsets, until: int, bar: tqdm) -> None:
    """Bake texels of chunks, for views of this ``shading``, on the renderer's threads; the ``bar``
    counts chunks.
    """
    tasks = list(together(wanted))
    with bar:

        def piece(a: int, b: int) -> None:
            for task in tasks[a:b]:
                bake_chunks(renderer, shading, task, until)
                bar.update(len(task))

        renderer.tiles.run(piece, len(tasks), 1)


def together(wanted: Offsets) -> Iterator[Offsets]:
    """The texels of chunks in tasks of MAX_TASK_TEXELS or a few more, as workers bake them."""
    task: Offsets = {}
    for index, offsets in wanted.items():
        task[index] = offsets
        if sum(map(len, task.values())) >= MAX_TASK_TEXELS:
            yield task
            task = {}
    if task:
        yield task


def bake_chunks(renderer: Renderer, shading: str, wanted: Offsets, until: int) -> None:
    """Bake texels of some chunks together, for views of this ``shading``, and keep them in the
    store.
    """
    loader = renderer.caches.of(shading)
    lattice = renderer.prepared.lattice
    chunks = [
        loader.chunk_store.load(index).with_texels(offsets) for index, offsets in wanted.items()
    ]
    light = Light.joined([chunk.light for chunk in chunks])
    texels = np.concatenate([lattice.positions(chunk.index, chunk.offsets) for chunk in chunks])
    refine(light, texels, loader.chunk_store.spec, until, UNREACHED_TARGET)
    bounds = np.cumsum([0, *(len(chunk.light) for chunk in chunks)]).tolist()
    for chunk, (a, b) in zip(chunks, pairwise(bounds), strict=True):
        loader.chunk_store.save(replace(chunk, light=light.rows(np.arange(a, b))))
        loader.refresh(chunk.index)


def bake_texels(prepared: PreparedScene, texels: np.ndarray, until: int) -> Light:
    """The light of ``texels`` (m, 3; z, y, x) after ``until`` samples each."""
    light = Light.dark(prepared.scene.plan, len(texels))
    refine(light, texels, spec_for(prepared, "gi"), until, UNREACHED_TARGET)
    return light


def bake_pieces(
    prepared: PreparedScene, pieces: Sequence[np.ndarray], until: int, run: Run = serially
) -> int:
    """Bake ``pieces`` of texels one by one, by means of ``run``; the paths that were taken."""
    paths: list[int] = []

    def bake(a: int, b: int) -> None:
        for piece in pieces[a:b]:
            paths.append(int(np.maximum(bake_texels(prepared, piece, until).samples, 0).sum()))

    run(bake, len(pieces), 1)
    return sum(paths)


def primary_rays(prepared: PreparedScene, size: int) -> Rays:
    """The rays of the view that is measured, in the order of its pixels."""
    volume = prepared.scene.volume
    camera = pinhole(view_of(prepared.scene, size).camera, size, size, volume.spacing)
    y, x = (np.mgrid[:size, :size] + 0.5).reshape(2, -1)
    corner, right, down, eye = (
        np.array(v)[:, None] for v in (camera.corner, camera.right, camera.down, camera.eye)
    )
    levels = np.full(len(x), prepared.surface(prepared.scene.isovalue).isovalue)
    origins = np.repeat(eye, len(x), axis=1)
    directions = corner + x * right + y * down
    return Rays(origins, directions, levels, np.full(len(x), UNKNOWN_SIDE, np.int8))


def cast(
    prepared: PreparedScene, rays: Rays, by: Callable[..., None] = cast_batch
) -> tuple[np.ndarray, np.ndarray]:
    """Where ``rays`` meet their surfaces: (t, came), on one thread."""
    t = np.empty(len(rays))
    came = np.empty(len(rays), np.int8)
    cells = prepared.maps.covering(rays.levels)
    by(prepared.field, cells, rays.columns, t, came)
    return t, came


def bounce(prepared: PreparedScene, rays: Rays, rng: np.random.Generator) -> Rays:
    """Cosine rays from where ``rays`` hit."""
    t, came = cast(prepared, rays)
    hit = np.isfinite(t)
    on = rays.part(hit)
    bounce_rays(
        prepared.field,
        on.levels,
        on.origins,
        on.directions,
        t[hit],
        came[hit],
        rng.random((2, len(on))),
    )
    return Rays(on.origins, on.directions, on.levels, came[hit])


def seconds(work: Callable[[], object]) -> float:
    """Time some work."""
    begun = time.perf_counter()
    work()
    return time.perf_counter() - begun


def timed(work: Callable[[], object]) -> Candidate:
    """A candidate that does the same in every round."""
    return lambda _: seconds(work)


def take_turns(candidates: Mapping[str, Candidate], repeats: int) -> dict[str, list[float]]:
    """Seconds of each candidate in ``repeats`` rounds; all of them work in each round, and round 0
    is not counted.
    """
    times: dict[str, list[float]] = {name: [] for name in candidates}
    for turn in range(repeats + 1):
        for name, candidate in candidates.items():
            times[name].append(candidate(turn))
    return {name: taken[1:] for name, taken in times.items()}


def medians(candidates: Mapping[str, Candidate], repeats: int) -> dict[str, float]:
    """Median seconds of candidates that take turns."""
    return {
        name: statistics.median(taken) for name, taken in take_turns(candidates, repeats).items()
    }


def new_camera(renderer: Renderer, view: View, target: float = LOOSEST_TARGET) -> Candidate:
    """A frame of ``view`` from a camera that is new to the renderer, whose light is final at the
    ``target``.
    """

    def render(_: int) -> float:
        renderer.forget_views()
        return seconds(lambda: renderer.render(view, target))

    return render


def turned(view: View, turn: float) -> View:
    """The view under a light that is turned otherwise in each round."""
    return replace(view, light=quaternion_from_angles(7.0 * turn + 3.0, 5.0, 2.0))


def relight(renderer: Renderer, view: View) -> Candidate:
    """A frame that differs by its light's rotation alone from the last one, whose light was turned,
    too.
    """

    def render(turn: int) -> float:
        renderer.render(turned(view, turn - 0.5), LOOSEST_TARGET)
        return seconds(lambda: renderer.render(turned(view, turn), LOOSEST_TARGET))

    return render


TIMED_SHADINGS = tuple(name for name in VIEW_SHADINGS if name != "path_traced")
"""Shadings whose frames are timed: all but the reference, which takes as long as it has paths."""

BAKED_TEXELS = 8192
BAKED_SAMPLES = 64
"""Texels that are baked to measure the speed of a bake, and samples of each: the fewest that make
one final.
"""

Figures = dict[str, Any]


def bench(target: str | None, isovalue: float | None, size: int, repeats: int) -> Figures:
    """The figures of a scene at an isovalue, pictures of ``size`` × ``size`` pixels; see
    ``StepTimes``.

    Raises SceneError, VolumeError and LightError; ViewError where the view shows no surface.
    """
    scene = open_scene(target, None, **({} if isovalue is None else {"isovalue": isovalue}))
    with tempfile.TemporaryDirectory(prefix="isogi-bench-") as store:
        return StepTimes(make_renderer(scene, store, cores()), size, repeats).figures()


class StepTimes:
    """Measures one scene. Candidates of one figure take turns; each figure is a median."""

    def __init__(self, renderer: Renderer, size: int, repeats: int) -> None:
        """Measure what ``renderer`` shows at ``size`` × ``size`` pixels, in ``repeats`` rounds."""
        self.renderer = renderer
        self.size = size
        self.repeats = repeats

    @property
    def scene(self) -> Scene:
        """What is measured."""
        return self.renderer.prepared.scene

    @property
    def view(self) -> View:
        """The view that is measured."""
        return view_of(self.scene, self.size)

    @cached_property
    def frame(self) -> Frame:
        """The view's frame, all of its texels baked; ViewError where there are none."""
        frame = bake_view(self.renderer, self.view, MIN_SAMPLES)
        if not frame.surface:
            raise ViewError(
                f"Nothing is to be seen at isovalue {shortest(self.scene.isovalue)}: choose "
                "another."
            )
        return frame

    def figures(self) -> Figures:
        """All figures, by their names."""
        stages: tuple[Callable[[], Figures], ...]
        stages = (
            self.setting,
            self.frames,
            self.isovalues,
            self.encodings,
            self.rays,
            self.bakes,
            memory,
        )
        figures: Figures = {}
        for stage in tqdm(stages, desc="measuring", unit="stage"):
            figures |= stage()
        return figures

    def setting(self) -> Figures:
        """What is measured, and on how much of a machine."""
        return {
            "scene": self.scene.name,
            "isovalue": self.scene.isovalue,
            "size": self.size,
            "bounces": self.scene.bounces,
            "survival": self.scene.plan.survival,
            "branches": self.scene.plan.branches,
            "threads": self.renderer.tiles.threads,
            "lanes": RAY_WIDTH if REGISTER_LANES else 0,
            "surface_pixels": self.frame.surface,
        }

    def frames(self) -> Figures:
        """``frame_ms``, by shading, of a camera that is new, light baked; ``relight_ms``: only the
        light is turned.
        """
        views = {name: replace(self.view, shading=name) for name in TIMED_SHADINGS}
        for spec in SPECS:
            bake_view(self.renderer, views[spec], MIN_SAMPLES)
        candidates = {name: new_camera(self.renderer, view) for name, view in views.items()}
        taken = milliseconds(
            {**candidates, "relight": relight(self.renderer, self.view)}, self.repeats
        )
        return {"relight_ms": taken.pop("relight"), "frame_ms": taken}

    def isovalues(self) -> Figures:
        """``isovalue_ms``: from an isovalue to its picture, its map made again, lit by Lambert's
        law.
        """
        levels = isovalues_near(self.scene, self.repeats + 1)

        def show(turn: int) -> float:
            view = replace(self.view, shading="lambert", isovalue=levels[turn])
            self.renderer.prepared.maps.forget()
            return seconds(lambda: develop(self.renderer.render(view), self.scene.default_exposure))

        return {"isovalue_ms": milliseconds({"": show}, self.repeats)[""]}

    def encodings(self) -> Figures:
        """``encode_ms``, by format: a frame's tone curve and its bytes."""

        candidates = {
            form: timed(partial(encode, self.frame, form, self.scene.default_exposure))
            for form in FORMATS
            if form != "npy"
        }
        return {"encode_ms": milliseconds(candidates, self.repeats)}

    def rays(self) -> Figures:
        """Millions of rays a second and core: of the view, and cosine rays from what they hit."""
        prepared = self.renderer.prepared
        primary = primary_rays(prepared, self.size)
        rays = {"primary": primary, "diffuse": bounce(prepared, primary, np.random.default_rng(1))}

        taken = medians(
            {name: timed(partial(cast, prepared, those)) for name, those in rays.items()},
            self.repeats,
        )
        return {f"{name}_mrays_per_core": len(rays[name]) / taken[name] / 1e6 for name in rays}

    def bakes(self) -> Figures:
        """Millions of paths a second on one core, and texels of 64 samples a second on all cores
        together.
        """
        prepared = self.renderer.prepared
        pieces = list(self._texels())
        bake = partial(bake_pieces, prepared, pieces, BAKED_SAMPLES)
        paths = bake()
        taken = medians(
            {"one": timed(bake), "all": timed(partial(bake, self.renderer.tiles.run))}, self.repeats
        )
        return {
            "bake_mpaths_per_core": paths / taken["one"] / 1e6,
            "bake_texels_per_s": sum(map(len, pieces)) / taken["all"],
        }

    def _texels(self) -> Iterator[np.ndarray]:
        """Texels of the view, (m, 3), those of several chunks together, of which it reads most
        first.
        """
        lattice = self.renderer.prepared.lattice
        count = 0
        wanted = sorted(wanted_of(self.frame).items(), key=lambda pair: -len(pair[1]))
        for task in together(dict(wanted)):
            if count < BAKED_TEXELS:
                texels = np.concatenate(
                    [lattice.positions(index, offsets) for index, offsets in task.items()]
                )
                count += len(texels)
                yield texels


def milliseconds(candidates: dict[str, Candidate], repeats: int) -> dict[str, float]:
    """Median milliseconds of candidates that take turns."""
    return {name: 1000.0 * taken for name, taken in medians(candidates, repeats).items()}


def memory() -> Figures:
    """``peak_mb``: the most megabytes of memory that this process has had at once."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return {"peak_mb": peak / (1e6 if sys.platform == "darwin" else 1e6 / 1024)}


def table(figures: Figures) -> str:
    """Figures for a person, one a line; those by shading or format as ``name.which``."""
    rows: Figures = {}
    for name, value in figures.items():
        if isinstance(value, dict):
            rows |= {f"{name}.{which}": v for which, v in value.items()}
        else:
            rows |= {name: value}
    width = max(map(len, rows))
    return "\n".join(
        f"{name:<{width}}  {f'{v:.4g}' if isinstance(v, float) else v}" for name, v in rows.items()
    )
