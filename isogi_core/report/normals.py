"""Normals of the smoothed and of the plain gradient, and where rays start above the surface (S1, figure 5)."""

from collections.abc import Iterator
from dataclasses import replace

from isogi_core.model.scene import Scene
from isogi_core.report.bench import Bench
from isogi_core.report.metrics import map_of, mean_of, spread_of
from isogi_core.report.points import Lit, apart, lit_by_paths
from isogi_core.report.reference import Reference
from isogi_core.report.sections import Cell, Column, Picture, Section, Table

KEY, TITLE = "normals", "Normals and offset"

PATHS = 512
"""Paths from each pixel of a picture."""

OFFSETS = (0.0, 0.05, 0.3, 1.0)
"""Voxels above the surface at which rays start."""

COLUMNS = (
    Column("normals"),
    Column("offset, voxels", "number"),
    Column("difference", "share"),
    Column("99th percentile", "share"),
    Column("bias", "share"),
)

ABOUT = f"""\
Paths from each pixel, {PATHS} of them or more, with normals of the gradient that the tricubic B-spline smooths, or of \
the plain gradient of the trilinear field, and with rays that start at other heights above the surface. Differences \
are from the scene's own normals and offset, over the mean luminance, less their noise but in the percentile and the \
maps: all pictures are of the same random numbers, and most of their noise cancels. Plain gradients jump from cell to \
cell; the pictures show how that looks."""


def study(bench: Bench) -> Section:
    """Each kind of normals and each offset beside the scene's own."""
    best, rows = bench.reference(PATHS), []
    pictures, mean = [Picture(name_of(bench.scene), "radiance", best.mean)], mean_of(lit_by_paths(best).light)
    for scene in variants(bench.scene):
        bench.check()
        other = bench.reference(PATHS, scene)
        change = apart(other, best)
        rows.append(row_of(scene, change, mean))
        pictures += pictures_of(scene, other, change, bench.scene, mean)
    table = Table("Normals and offsets", COLUMNS, tuple(rows))
    return Section(KEY, TITLE, ABOUT, (table,), (), tuple(pictures))


def pictures_of(scene: Scene, other: Reference, change: Lit, usual: Scene, mean: float) -> Iterator[Picture]:
    """What is shown of a variant: where it differs from the ``usual`` scene, and its own picture by other normals."""
    if scene.normals != usual.normals:
        yield Picture(name_of(scene), "radiance", other.mean)
    if scene is not usual:
        yield Picture(f"{name_of(scene)}: difference", "error", map_of(change.light, other.on, mean))


NAMES = {"bspline": "smoothed gradient", "gradient": "plain gradient"}
"""What a person calls the scene's kinds of normals."""


def variants(scene: Scene) -> tuple[Scene, ...]:
    """The scene with the other kind of normals, and with other offsets."""
    own = (scene, replace(scene, normals=next(name for name in NAMES if name != scene.normals)))
    return (*own, *(replace(scene, offset=offset) for offset in OFFSETS if offset != scene.offset))


def name_of(scene: Scene) -> str:
    """What a person calls a variant."""
    return f"{NAMES[scene.normals]}, offset {scene.offset:g}"


def row_of(scene: Scene, change: Lit, mean: float) -> tuple[Cell, ...]:
    """A variant's row of the table, from what it changes at the surface pixels and the ``mean`` luminance."""
    spread = spread_of(change.light, change.noise, mean)
    return NAMES[scene.normals], scene.offset, spread.rmse, spread.p99, spread.bias
