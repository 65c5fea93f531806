"""``isogi bench``: measures the speed of this machine at isogi's work.

Benchmarks use its tools, too.
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
from isogi_core.bake.noise import Goal
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
from isogi_core.model.scene_plan import MIN_SAMPLES
from isogi_core.model.view import View, quaternion_from_angles
from isogi_core.plan.scene import Scene
from isogi_core.prepared.prepared_scene import Index, PreparedScene
from isogi_core.runs import Run, serially
from isogi_report.bench import UNREACHED_GOAL
from isogi_server.parameters import FORMATS
from isogi_server.pictures import encode
from isogi_server.progress import open_scene
from isogi_server.settings import cores
from isogi_worker.pool import MAX_TASK_TEXELS

SPEED_CACHE_BYTES = 1 << 30
"""Bytes of light that a measured renderer may hold."""

LOOSEST_GOAL = Goal.checked(1.0)
"""A goal that MIN_SAMPLES samples meet,
so that frames of final light are measured, as most are.
"""

Candidate = Callable[[int], float]
"""A function that does its work in the given round, and returns the seconds that it took."""


Offsets = dict[Index, np.ndarray]
"""Texels by chunk, as offsets within it."""


@dataclass(frozen=True, eq=False)
class Rays:
    """Rays in index space: ``origins`` and ``directions`` (3, n) float64.

    ``levels`` (n,) float64 are the normalised isovalues of the surfaces that they look for, and
    ``sides`` (n,) int8 the sides that they start on.
    """

    origins: np.ndarray
    directions: np.ndarray
    levels: np.ndarray
    sides: np.ndarray

    def __len__(self) -> int:
        return len(self.sides)

    @property
    def columns(self) -> ray_stream.Rays:
        """The rays in the form that kernels take."""
        return ray_stream.Rays(self.levels, self.origins, self.directions, self.sides)

    def part(self, which: Any) -> "Rays":
        """Return some of the rays, as contiguous copies."""
        origins, directions = (
            np.ascontiguousarray(v[:, which]) for v in (self.origins, self.directions)
        )
        return Rays(origins, directions, self.levels[which].copy(), self.sides[which].copy())


def view_of(scene: Scene, size: int, **knobs: Any) -> View:
    """Return the view that is measured: azimuth 40°, elevation 30°, three radii away, 30° high."""
    return View(
        **{"isovalue": scene.isovalue, "camera": scene.camera(40, 30, 3, 30), **knobs},
        width=size,
        height=size,
    )


def isovalues_near(scene: Scene, count: int) -> list[float]:
    """Return ``count`` different isovalues on both sides of the scene's,
    farther and farther away, within a tenth of its range.
    """
    low, high = scene.isovalues
    down = scene.isovalue - low
    up = high - scene.isovalue
    # Stay within a tenth of the shorter side of the range, or of the only side there is.
    reach = 0.1 * (min(down, up) or max(down, up))
    ways = (1.0 if up else -1.0, -1.0 if down else 1.0)
    return [scene.isovalue + ways[i % 2] * reach * (i + 1) / count for i in range(count)]


def make_renderer(scene: Scene, store: str, threads: int | None = None) -> Renderer:
    """Return a renderer over a store, without a server."""
    tiles = Tiles(threads)
    return Renderer(Caches(PreparedScene(scene), store, SPEED_CACHE_BYTES), tiles)


def bake_view(renderer: Renderer, view: View, until: int) -> Frame:
    """Bake in this process the light that ``view`` lacks,
    to ``until`` samples a texel, and render it.
    """
    wanted = wanted_of(renderer.render(view, UNREACHED_GOAL))
    bake_offsets(
        renderer,
        view.shading,
        wanted,
        until,
        tqdm(desc="baking", unit="chunk", total=len(wanted), leave=False),
    )
    return renderer.render(view, UNREACHED_GOAL)


def wanted_of(frame: Frame) -> Offsets:
    """Return the texels that a frame lacks, by chunk."""
    return {demand.index: demand.offsets for demand in frame.demands}


def bake_offsets(renderer: Renderer, shading: str, wanted: Offsets, until: int, bar: tqdm) -> None:
    """Bake texels of chunks for views of this ``shading``,
    on the renderer's threads; ``bar`` counts chunks.
    """
    tasks = list(together(wanted))
    with bar:

        def piece(a: int, b: int) -> None:
            for task in tasks[a:b]:
                bake_chunks(renderer, shading, task, until)
                bar.update(len(task))

        renderer.tiles.run(piece, len(tasks), 1)


def together(wanted: Offsets) -> Iterator[Offsets]:
    """Yield the chunks of ``wanted`` in tasks of at least MAX_TASK_TEXELS texels, the last task
    excepted: about as many as workers bake at a time, so that waves of paths are full.
    """
    task: Offsets = {}
    for index, offsets in wanted.items():
        task[index] = offsets
        if sum(map(len, task.values())) >= MAX_TASK_TEXELS:
            yield task
            task = {}
    if task:
        yield task


def bake_chunks(renderer: Renderer, shading: str, wanted: Offsets, until: int) -> None:
    """Bake texels of some chunks together for views
    of this ``shading``, and write them to the store.
    """
    loader = renderer.caches.of(shading)
    lattice = renderer.prepared.lattice
    chunks = [
        loader.chunk_store.load(index).with_texels(offsets) for index, offsets in wanted.items()
    ]
    # Bake the texels of all chunks in one call, as waves of paths are then full.
    light = Light.joined([chunk.light for chunk in chunks])
    texels = np.concatenate([lattice.positions(chunk.index, chunk.offsets) for chunk in chunks])
    refine(light, texels, loader.chunk_store.spec, until, UNREACHED_GOAL)
    # Write each chunk, and tell the loader that the store has newer light.
    bounds = np.cumsum([0, *(len(chunk.light) for chunk in chunks)]).tolist()
    for chunk, (a, b) in zip(chunks, pairwise(bounds), strict=True):
        loader.chunk_store.save(replace(chunk, light=light.rows(np.arange(a, b))))
        loader.refresh(chunk.index)


def bake_texels(prepared: PreparedScene, texels: np.ndarray, until: int) -> Light:
    """Return the light of ``texels`` (m, 3; z, y, x) after ``until`` samples each."""
    light = Light.dark(prepared.scene.plan, len(texels))
    refine(light, texels, spec_for(prepared, "gi"), until, UNREACHED_GOAL)
    return light


def bake_pieces(
    prepared: PreparedScene, pieces: Sequence[np.ndarray], until: int, run: Run = serially
) -> int:
    """Bake ``pieces`` of texels one by one, by means of ``run``; return the number of paths."""
    paths: list[int] = []

    def bake(a: int, b: int) -> None:
        for piece in pieces[a:b]:
            paths.append(int(np.maximum(bake_texels(prepared, piece, until).samples, 0).sum()))

    run(bake, len(pieces), 1)
    return sum(paths)


def primary_rays(prepared: PreparedScene, size: int) -> Rays:
    """Return the rays of the measured view, in the order of its pixels."""
    volume = prepared.scene.volume
    # Rays through the middles of the pixels, in index space.
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
    """Return the intersections (t, came) of ``rays`` with their surfaces, found on one thread."""
    t = np.empty(len(rays))
    came = np.empty(len(rays), np.int8)
    cells = prepared.maps.covering(rays.levels)
    by(prepared.field, cells, rays.columns, t, came)
    return t, came


def bounce(prepared: PreparedScene, rays: Rays, rng: np.random.Generator) -> Rays:
    """Return cosine-distributed rays from the points that ``rays`` hit."""
    t, came = cast(prepared, rays)
    # Start from the rays that hit, in place: ``bounce_rays`` replaces origins and directions.
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
    """Return the seconds that some work takes."""
    begun = time.perf_counter()
    work()
    return time.perf_counter() - begun


def timed(work: Callable[[], object]) -> Candidate:
    """Return a candidate that does the same in every round."""
    return lambda _: seconds(work)


def take_turns(candidates: Mapping[str, Candidate], repeats: int) -> dict[str, list[float]]:
    """Return the seconds of each candidate in ``repeats`` rounds.

    All candidates work in each round, so that disturbances hit all of them. Round 0 is not counted.
    """
    times: dict[str, list[float]] = {name: [] for name in candidates}
    # Round 0 compiles kernels and fills caches.
    for turn in range(repeats + 1):
        for name, candidate in candidates.items():
            times[name].append(candidate(turn))
    return {name: taken[1:] for name, taken in times.items()}


def medians(candidates: Mapping[str, Candidate], repeats: int) -> dict[str, float]:
    """Return the median seconds of candidates that take turns."""
    return {
        name: statistics.median(taken) for name, taken in take_turns(candidates, repeats).items()
    }


def new_camera(renderer: Renderer, view: View, goal: Goal = LOOSEST_GOAL) -> Candidate:
    """Return a candidate that renders ``view`` from a camera
    that is new to the renderer, with light that is final by the ``goal``.
    """

    def render(_: int) -> float:
        """Forget what is kept of former views, and time the frame."""
        renderer.forget_views()
        return seconds(lambda: renderer.render(view, goal))

    return render


def turned(view: View, turn: float) -> View:
    """Return the view with the light rotated differently in each round."""
    return replace(view, light=quaternion_from_angles(7.0 * turn + 3.0, 5.0, 2.0))


def relight(renderer: Renderer, view: View) -> Candidate:
    """Return a candidate whose frame differs from the one before only by the light's rotation."""

    def render(turn: int) -> float:
        """Render the view under another rotation first, and time the change."""
        renderer.render(turned(view, turn - 0.5), LOOSEST_GOAL)
        return seconds(lambda: renderer.render(turned(view, turn), LOOSEST_GOAL))

    return render


TIMED_SHADINGS = tuple(name for name in VIEW_SHADINGS if name != "path_traced")
"""Shadings whose frames are timed:
all but the reference, whose time depends on its number of paths.
"""

BAKED_TEXELS = 8192
BAKED_SAMPLES = 64
"""Texels that are baked to measure the speed of a bake,
and samples of each: the fewest that make one final.
"""

Figures = dict[str, Any]


def bench(target: str | None, isovalue: float | None, size: int, repeats: int) -> Figures:
    """Return the figures of a scene at an isovalue, for pictures of ``size`` × ``size`` pixels; see
    ``StepTimes``.

    Raises SceneError, VolumeError and LightError, and ViewError if the view shows no surface.
    """
    scene = open_scene(target, None, **({} if isovalue is None else {"isovalue": isovalue}))
    with tempfile.TemporaryDirectory(prefix="isogi-bench-") as store:
        return StepTimes(make_renderer(scene, store, cores()), size, repeats).figures()


class StepTimes:
    """Measures one scene. Candidates of one figure take turns; each figure is a median."""

    def __init__(self, renderer: Renderer, size: int, repeats: int) -> None:
        """Measure the ``renderer`` at ``size`` × ``size`` pixels, in ``repeats`` rounds."""
        self.renderer = renderer
        self.size = size
        self.repeats = repeats

    @property
    def scene(self) -> Scene:
        """The scene that is measured."""
        return self.renderer.prepared.scene

    @property
    def view(self) -> View:
        """The view that is measured."""
        return view_of(self.scene, self.size)

    @cached_property
    def frame(self) -> Frame:
        """The view's frame, with all of its texels baked. Raises ViewError if there are none."""
        frame = bake_view(self.renderer, self.view, MIN_SAMPLES)
        if not frame.surface:
            raise ViewError(
                f"Nothing is to be seen at isovalue {shortest(self.scene.isovalue)}: choose "
                "another."
            )
        return frame

    def figures(self) -> Figures:
        """Return all figures by name."""
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
        """Return the subject of the measurement, and the resources it uses."""
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
        """Return ``frame_ms`` by shading, for a new camera with baked light,
        and ``relight_ms``, for a new rotation of the light.
        """
        views = {name: replace(self.view, shading=name) for name in TIMED_SHADINGS}
        # All shadings read the light of one of the specs.
        for spec in SPECS:
            bake_view(self.renderer, views[spec], MIN_SAMPLES)
        candidates = {name: new_camera(self.renderer, view) for name, view in views.items()}
        taken = milliseconds(
            {**candidates, "relight": relight(self.renderer, self.view)}, self.repeats
        )
        return {"relight_ms": taken.pop("relight"), "frame_ms": taken}

    def isovalues(self) -> Figures:
        """Return ``isovalue_ms``: the time from a new isovalue to its picture,
        shaded by Lambert's law, with its map of active cells.
        """
        # Each round takes another isovalue, so that no map of active cells is there yet.
        levels = isovalues_near(self.scene, self.repeats + 1)

        def show(turn: int) -> float:
            view = replace(self.view, shading="lambert", isovalue=levels[turn])
            self.renderer.prepared.maps.forget()
            return seconds(lambda: develop(self.renderer.render(view), self.scene.default_exposure))

        return {"isovalue_ms": milliseconds({"": show}, self.repeats)[""]}

    def encodings(self) -> Figures:
        """Return ``encode_ms`` by format: the time for a frame's tone curve and its bytes."""

        candidates = {
            form: timed(partial(encode, self.frame, form, self.scene.default_exposure))
            for form in FORMATS
            if form != "npy"
        }
        return {"encode_ms": milliseconds(candidates, self.repeats)}

    def rays(self) -> Figures:
        """Return millions of rays per second and core:
        of the view, and diffuse rays from the points that they hit.
        """
        prepared = self.renderer.prepared
        primary = primary_rays(prepared, self.size)
        rays = {"primary": primary, "diffuse": bounce(prepared, primary, np.random.default_rng(1))}

        taken = medians(
            {name: timed(partial(cast, prepared, those)) for name, those in rays.items()},
            self.repeats,
        )
        return {f"{name}_mrays_per_core": len(rays[name]) / taken[name] / 1e6 for name in rays}

    def bakes(self) -> Figures:
        """Return millions of paths per second on one core,
        and texels of BAKED_SAMPLES samples per second on all cores.
        """
        prepared = self.renderer.prepared
        pieces = list(self._texels())
        bake = partial(bake_pieces, prepared, pieces, BAKED_SAMPLES)
        # A first bake counts the paths, and makes the maps of active cells.
        paths = bake()
        taken = medians(
            {"one": timed(bake), "all": timed(partial(bake, self.renderer.tiles.run))}, self.repeats
        )
        return {
            "bake_mpaths_per_core": paths / taken["one"] / 1e6,
            "bake_texels_per_s": sum(map(len, pieces)) / taken["all"],
        }

    def _texels(self) -> Iterator[np.ndarray]:
        """Yield texels of the view, (m, 3), in tasks, those chunks first of which it reads most."""
        lattice = self.renderer.prepared.lattice
        count = 0
        wanted = sorted(wanted_of(self.frame).items(), key=lambda pair: -len(pair[1]))
        # Stop once there are enough texels for a steady figure.
        for task in together(dict(wanted)):
            if count < BAKED_TEXELS:
                texels = np.concatenate(
                    [lattice.positions(index, offsets) for index, offsets in task.items()]
                )
                count += len(texels)
                yield texels


def milliseconds(candidates: dict[str, Candidate], repeats: int) -> dict[str, float]:
    """Return the median milliseconds of candidates that take turns."""
    return {name: 1000.0 * taken for name, taken in medians(candidates, repeats).items()}


def memory() -> Figures:
    """Return ``peak_mb``: the largest amount of memory that this process has had, in megabytes."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    # macOS counts bytes, Linux units of 1024 bytes.
    return {"peak_mb": peak / (1e6 if sys.platform == "darwin" else 1e6 / 1024)}


def table(figures: Figures) -> str:
    """Return figures as text, one a line; those by shading or format as ``name.which``."""
    rows: Figures = {}
    for name, value in figures.items():
        if isinstance(value, dict):
            rows |= {f"{name}.{which}": v for which, v in value.items()}
        else:
            rows |= {name: value}
    width = max(map(len, rows))
    texts = {name: f"{v:.4g}" if isinstance(v, float) else str(v) for name, v in rows.items()}
    return "\n".join(f"{name:<{width}}  {text}" for name, text in texts.items())
