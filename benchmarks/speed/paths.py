"""Paths per second: baking texels against Mitsuba's path tracer, diffuse 0.7 under constant light,
five segments.

    python -m benchmarks.speed paths [TARGET] [--size 512] [--repeats 5] [--json]

A path is five segments long at most, counted from the surface. Ours start at texels that the
benchmarks' view reads, 64 each, in tasks as workers have them; a texel keeps one coefficient, as
Mitsuba's pixels keep one radiance ("isogi"), or 25 ("isogi order 5"). Mitsuba's start at the eye,
so that it is told a depth of six and the time of the same picture at depth one, the segment from
the eye alone, is taken off; paths are those of pixels that show the surface. No path of either ends
by chance. Mitsuba joins each hit to the light as well (it cannot be told not to), and its mesh is
diffuse on both sides, as an isosurface is. That both do the same work is seen in the segments per
path (texels lie in deeper places than pixels see, so that ours are longer: "segments" is the ratio
of segments a second), and in the light: ours walks from the same pixels. Figures are on one thread
and on two.
"""

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import click
import numpy as np

from benchmarks.common import mesh, mitsuba
from benchmarks.common.measurement import Measurement
from benchmarks.common.scenes import benchmark_scene
from benchmarks.common.suite import part
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.tracing.intersect import OUTSIDE_SIGN
from isogi_core.kernels.transport.integrator import bounce_rays
from isogi_core.model.scene_plan import Layer
from isogi_core.model.view import View
from isogi_core.plan.scene import Scene
from isogi_core.prepared.prepared_scene import PreparedScene
from isogi_report.bench import UNREACHED_GOAL
from isogi_report.speed import (
    Candidate,
    Rays,
    bake_pieces,
    bounce,
    make_renderer,
    medians,
    primary_rays,
    timed,
    together,
    view_of,
    wanted_of,
)

ALBEDO = 0.7
SEGMENTS = 5
ORDER = 5
TEXELS = 16384
SAMPLES = 64
VARIANTS = {"mitsuba llvm": "llvm_ad_rgb", "mitsuba scalar": "scalar_rgb"}
SPP = {"mitsuba llvm": 8, "mitsuba scalar": 2}
THREADS = {1: "one thread", 2: "two threads"}


@dataclass(frozen=True, eq=False)
class Job:
    """A way to trace paths: ``run`` does it on so many threads, and traces ``paths``; ``rest`` is
    no path's time.
    """

    paths: int
    run: Callable[[int], object]
    rest: Callable[[int], object] | None = None


def view_texels(scene: Scene, size: int) -> list[np.ndarray]:
    """About TEXELS texels that the view reads, (m, 3; z, y, x) task by task as workers bake them,
    from all over it.
    """
    with tempfile.TemporaryDirectory() as store:
        renderer = make_renderer(scene, store)
        wanted = wanted_of(renderer.render(view_of(scene, size), UNREACHED_GOAL))
        place = renderer.prepared.lattice.positions
    tasks = list(together(wanted))
    some = tasks[:: max(sum(map(len, wanted.values())) // TEXELS, 1)]
    return [
        np.concatenate([place(index, offsets) for index, offsets in task.items()]) for task in some
    ]


def bake_job(scene: Scene, texels: list[np.ndarray]) -> Job:
    """Ours: tasks of texels, one after the other or two at once."""
    prepared = PreparedScene(scene)
    tiles = {threads: Tiles(threads) for threads in THREADS}
    bake = partial(bake_pieces, prepared, texels, SAMPLES)
    return Job(bake(), lambda threads: bake(tiles[threads].run))


def mitsuba_jobs(scene: Scene, view: View, surface: int) -> Iterator[tuple[str, Job]]:
    """Those variants of Mitsuba that run here."""
    if not (mitsuba.installed() and mesh.installed()):
        return
    points, triangles = mesh.make_mesh(
        scene.volume, scene.volume.normalise_isovalue(scene.isovalue)
    )
    world = points * np.array(scene.volume.spacing, np.float32), triangles
    for name, variant in VARIANTS.items():
        if mitsuba.usable(variant):
            long, short = (
                mitsuba.PathTracer(variant, world, view, ALBEDO, n) for n in (SEGMENTS + 1, 1)
            )
            spp = SPP[name]
            yield name, Job(surface * spp, partial(long.picture, spp), partial(short.picture, spp))


def timers(jobs: dict[str, Job]) -> dict[str, Candidate]:
    """What takes turns: each job on one thread and on two, and what is to be taken off."""
    found: dict[str, Candidate] = {}
    for name, job in jobs.items():
        for threads in THREADS:
            found[f"{name} {threads}"] = timed(partial(job.run, threads))
            if job.rest is not None:
                found[f"{name} {threads} rest"] = timed(partial(job.rest, threads))
    return found


def summarise(jobs: dict[str, Job], taken: dict[str, float], longer: float) -> dict[str, float]:
    """Mpaths/s of each job, and ratios of ours to each of the others; our paths are ``longer`` by
    so much.
    """
    rates = {}
    for name, job in jobs.items():
        for threads in THREADS:
            key = f"{name} {threads}"
            rates[name, threads] = job.paths / (taken[key] - taken.get(f"{key} rest", 0.0)) / 1e6
    figures = {
        f"{name}, {THREADS[threads]}: Mpaths/s": rate for (name, threads), rate in rates.items()
    }
    for name in jobs:
        if name.startswith("mitsuba"):
            figures |= {
                f"isogi / {name}, {text}": rates["isogi", n] / rates[name, n]
                for n, text in THREADS.items()
            }
            figures |= {
                f"isogi / {name}, segments, {text}": longer * rates["isogi", n] / rates[name, n]
                for n, text in THREADS.items()
            }
    return figures


def texel_rays(prepared: PreparedScene, texels: np.ndarray, rng: np.random.Generator) -> Rays:
    """The first segments of paths from ``texels`` of a lattice that lies on the voxels, one
    each.
    """
    levels = prepared.field.voxels[tuple(texels.T)].astype(np.float64)
    origins = np.ascontiguousarray(texels[:, ::-1].T, np.float64)
    down = np.zeros((3, len(texels)))
    down[2] = -1.0
    sides = np.full(len(texels), OUTSIDE_SIGN, np.int8)
    bounce_rays(
        prepared.field,
        levels,
        origins,
        down,
        np.zeros(len(texels)),
        sides,
        rng.random((2, len(texels))),
    )
    return Rays(origins, down, levels, sides)


def walk(prepared: PreparedScene, rays: Rays, rng: np.random.Generator) -> tuple[float, float]:
    """Segments per path of paths that begin with ``rays``, and their mean light Σ R^k of those that
    leave.
    """
    begun = len(rays)
    going = len(rays)
    light = 0.0
    segments = 0
    for k in range(SEGMENTS):
        segments += going
        if going:
            rays = bounce(prepared, rays, rng)
        light += ALBEDO**k * (going - len(rays))
        going = len(rays)
    return segments / begun, light / begun


def equals(
    scene: Scene, texels: list[np.ndarray], size: int, jobs: dict[str, Job]
) -> dict[str, float]:
    """Figures that show that both do the same work."""
    prepared = PreparedScene(scene)
    rng = np.random.default_rng(1)
    ours, _ = walk(prepared, texel_rays(prepared, np.concatenate(texels), rng), rng)
    theirs, light = walk(prepared, bounce(prepared, primary_rays(prepared, size), rng), rng)
    figures = {
        "segments per path: texels": ours,
        "segments per path: pixels": theirs,
        "radiance: isogi": ALBEDO * light,
    }
    for name, job in jobs.items():
        if job.rest is not None:
            picture = np.asarray(job.run(2))[..., 0].sum(dtype=np.float64)
            figures[f"radiance: {name}"] = picture / (
                job.paths / SPP[name]
            )  # its background is black
    return figures


@part(size=512, repeats=5)
@click.argument("target", required=False)
def paths(target: str | None, size: int, repeats: int) -> Measurement:
    """Paths a second: baking texels beside Mitsuba's path tracer."""
    fixed: dict[str, Any] = {
        "albedo": ALBEDO,
        "bounces": SEGMENTS - 1,
        "lattice": 1,
        "lights": [{"type": "constant"}],
    }
    planned = benchmark_scene(target, "constant", **fixed)
    one = replace(planned, plan=replace(planned.plan, survival=1.0))
    many = replace(one, plan=replace(one.plan, layers=(Layer("whole", ORDER),), order=ORDER))
    texels = view_texels(one, size)
    surface = len(
        bounce(PreparedScene(one), primary_rays(PreparedScene(one), size), np.random.default_rng(1))
    )
    jobs = {"isogi": bake_job(one, texels), "isogi order 5": bake_job(many, texels)}
    jobs |= dict(mitsuba_jobs(one, view_of(one, size), surface))
    same = equals(one, texels, size, jobs)
    longer = same["segments per path: texels"] / same["segments per path: pixels"]
    figures: dict[str, Any] = summarise(jobs, medians(timers(jobs), repeats), longer) | same
    figures |= {name: "not installed" for name in VARIANTS if name not in jobs}
    return Measurement(f"{one.name} at {one.isovalue:g}, {SEGMENTS} segments", figures)
