"""What S1's choices are worth: the lattice's density (figure 12), normals and offset (5), vicinity
shading (10).

    python -m benchmarks.accuracy choices [SCENE] [--size 80] [--paths 512] [-o FOLDER]

Lattices and vicinity shading are baked to the target error and held against the reference;
"interpolation" is what remains beside light at the pixels' own points, which a finer lattice mends
alone. Normals and offsets are those of path-traced pictures, and differ from the scene's own by so
much: all are of the same random numbers.
"""

import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import click

from benchmarks.accuracy.benches import bench_of
from benchmarks.common.measurement import Measurement
from benchmarks.common.scenes import benchmark_scene
from benchmarks.common.suite import part
from isogi_core.bake.noise import Goal
from isogi_core.model.view import View
from isogi_core.plan.scene import Scene
from isogi_report.bench import Bench, ViewBake
from isogi_report.exact import lit_by_frame, lit_by_paths, own_light, reference_difference
from isogi_report.metrics import mean_of, spread_of

LATTICES = (0.5, 1.0, 2.0)
"""Texels along each axis, as multiples of the scene's."""

OFFSETS = (0.0, 0.05, 0.3, 1.0)
"""Voxels above the surface at which rays start."""

NORMALS = {"bspline": "smoothed gradient", "gradient": "plain gradient"}
"""What a person calls the kinds of normals."""


@part(size=80)
@click.argument("target", required=False)
@click.option(
    "--paths",
    type=click.IntRange(8),
    default=512,
    show_default=True,
    help="Paths a pixel of pictures.",
)
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path, file_okay=False),
    help="Where references are kept.",
)
def choices(target: str | None, size: int, paths: int, output: Path | None) -> Measurement:
    """Errors by the lattice's density, by normals and offset, and of vicinity shading."""
    scene = benchmark_scene(target)
    with tempfile.TemporaryDirectory() as passing:
        bench = bench_of(scene, size, output or Path(passing))
        figures = {**dict(lattices(bench)), **dict(vicinity(bench)), **dict(surfaces(bench, paths))}
    return Measurement(f"{scene.name} at {scene.isovalue:g}, {size} × {size}", figures)


def lattices(bench: Bench) -> Iterator[tuple[str, float]]:
    """Errors and costs of the plan's light on lattices of other densities."""
    own = own_light(bench)
    for times in LATTICES:
        scene = bench.scene.with_settings(lattice=times * bench.scene.settings.lattice)
        if times == 1.0:
            bake = bench.planned
        else:
            bake = baked(bench, scene, bench.view)
        lit = lit_by_frame(bake.frame())
        carried = spread_of(lit.light - own.light, lit.noise + own.noise, mean_of(own.light))
        name = f"{scene.settings.lattice:g} texels per voxel"
        yield f"{name}: interpolation, %", 100.0 * carried.rmse
        yield from scored(name, bench, bake)


def vicinity(bench: Bench) -> Iterator[tuple[str, float]]:
    """Vicinity shading as a picture of global illumination; nothing where the plan's own is
    that.
    """
    if bench.scene.plan.representation != "vicinity":
        bake = baked(bench, bench.scene, replace(bench.view, shading="vicinity"))
        yield from scored("vicinity shading", bench, bake)


def scored(name: str, bench: Bench, bake: ViewBake) -> Iterator[tuple[str, float]]:
    """What a bake's frame errs by, and what it took."""
    score = bench.score(bake.frame().radiance)
    yield f"{name}: RMSE, %", 100.0 * score.rmse
    yield f"{name}: 99th percentile, %", 100.0 * score.p99
    yield f"{name}: texels", len(bake.texels)
    yield f"{name}: bake, s", bake.seconds


def baked(bench: Bench, scene: Scene, view: View) -> ViewBake:
    """The light of a view of a scene, baked to the target error."""
    bake = ViewBake(bench.renderer(scene), view)
    goal = Goal(scene.target_error)
    bake.grow(goal.most_samples, goal)
    return bake


def surfaces(bench: Bench, paths: int) -> Iterator[tuple[str, float]]:
    """How far path-traced pictures with other normals and offsets are from the scene's own."""
    best = bench.reference(paths)
    mean = mean_of(lit_by_paths(best).light)
    for scene in variants(bench.scene):
        change = reference_difference(bench.reference(paths, scene), best)
        spread = spread_of(change.light, change.noise, mean)
        name = f"{NORMALS[scene.settings.normals]}, offset {scene.settings.offset:g}"
        yield f"{name}: difference, %", 100.0 * spread.rmse
        yield f"{name}: bias, %", 100.0 * spread.bias


def variants(scene: Scene) -> tuple[Scene, ...]:
    """The scene with the other kind of normals, and with other offsets."""
    other = next(name for name in NORMALS if name != scene.settings.normals)
    return (
        scene.with_settings(normals=other),
        *(
            scene.with_settings(offset=offset)
            for offset in OFFSETS
            if offset != scene.settings.offset
        ),
    )
