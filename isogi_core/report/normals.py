"""Normals of the smoothed and of the plain gradient, and where rays start above the surface (S1, figure 5)."""

from dataclasses import replace

import numpy as np

from isogi_core.model.scene import Scene
from isogi_core.report.bench import Bench
from isogi_core.report.metrics import error_map, luminance, mean_of, spread_of
from isogi_core.report.sections import Cell, Column, Picture, Section, Table

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
Paths from each pixel, {PATHS} of them, with normals of the gradient that the tricubic B-spline smooths, or of the \
plain gradient of the trilinear field, and with rays that start at other heights above the surface. Differences are \
from the scene's own normals and offset, over the mean luminance; the noise of both pictures is in them, and is what \
the smallest of them show. Plain gradients jump from cell to cell; the pictures show how that looks."""


def study(bench: Bench) -> Section:
    """Each kind of normals and each offset beside the scene's own."""
    best, rows, pictures = bench.reference(PATHS), [], []
    for scene in variants(bench.scene):
        bench.check()
        other = bench.reference(PATHS, scene)
        name = f"{NAMES[scene.normals]}, offset {scene.offset:g}"
        rows.append(row_of(scene, luminance(other.mean[best.on]), luminance(best.mean[best.on])))
        pictures.append(Picture(name, "radiance", other.mean))
        if scene.normals != bench.scene.normals:
            pictures.append(Picture(f"{name}: difference", "error", error_map(other.mean, best)))
    table = Table("Normals and offsets", COLUMNS, tuple(rows))
    return Section("normals", "Normals and offset", ABOUT, (table,), (), tuple(pictures))


NAMES = {"bspline": "smoothed gradient", "gradient": "plain gradient"}
"""What a person calls the scene's kinds of normals."""


def variants(scene: Scene) -> tuple[Scene, ...]:
    """The scene with the other kind of normals, and with other offsets."""
    own = (scene, replace(scene, normals=next(name for name in NAMES if name != scene.normals)))
    return (*own, *(replace(scene, offset=offset) for offset in OFFSETS if offset != scene.offset))


def row_of(scene: Scene, light: np.ndarray, usual: np.ndarray) -> tuple[Cell, ...]:
    """A variant's row of the table, from its pixels' luminance (m,) and the ``usual``."""
    wrong, mean = light - usual, mean_of(usual)
    spread = spread_of(wrong, 0.0, mean)
    return NAMES[scene.normals], scene.offset, spread.rmse, float(np.percentile(np.abs(wrong), 99)) / mean, spread.bias
