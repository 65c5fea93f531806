"""Cases of ramps: how far off the light is as a surface's ramp grows thinner, down to a mask."""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest.mock import patch

import numpy as np

from benchmarks.stability.case import Outcome, Size, case
from benchmarks.stability.shapes import body, ramp
from benchmarks.stability.stage import scene_of, view_of
from isogi_core.bake.recipe import Recipe
from isogi_core.bake.refine import Place
from isogi_core.kernels.shading import find_normals
from isogi_core.model.scene import Scene
from isogi_core.model.volume import make_volume
from isogi_core.report.bench import Bench
from isogi_core.report.metrics import Score

GROUP = "ramps"

OWN_PLACES = "relative RMSE with texels in their own places"

WIDTHS = (8.0, 4.0, 2.0, 1.0, 0.5, 0.0)
"""Voxels over which the field goes from nothing to solid."""


def against_paths(scene: Scene, size: int, folder: Path, samples: int = 0) -> Score:
    """The score of a scene's light, baked to its target, against so many paths from each pixel, or all it takes."""
    bench = Bench(scene, view_of(scene, size), folder)
    return bench.score(bench.planned.frame().radiance, bench.reference(samples) if samples else None)


def own_place(texels: np.ndarray, recipe: Recipe, _: float | None = None) -> tuple[Place, np.ndarray]:
    """Texels at their own places, on the isosurfaces through their own voxels; none is void."""
    points = texels[:, ::-1].astype(np.float32)
    normals = np.empty_like(points)
    find_normals(recipe.field, points, (0.0, 0.0, 0.0), normals)
    values = recipe.field.voxels[tuple(texels.T)].astype(np.float64)
    places = (np.ascontiguousarray(each.T, np.float64) for each in (points, normals))
    return (texels, *places, values), np.zeros(len(texels), np.bool_)


@contextmanager
def unmoved() -> Iterator[None]:
    """Within it all texels are lit on their own isosurfaces, those at the edge of a plateau too."""
    with patch("isogi_core.bake.refine.locate", own_place):
        yield


def error_of_ramp(width: float, size: Size) -> Outcome:
    """The error of the light of a body whose ramp is so wide, and what it would be were texels lit in their places."""
    scene = scene_of(make_volume(ramp(body(), width)), 0.5, target_error=0.01)
    pixels, samples = size.pick(32, 64), size.pick(256, 0)
    with TemporaryDirectory() as folder:
        found = against_paths(scene, pixels, Path(folder), samples)
        with unmoved():
            before = against_paths(scene, pixels, Path(folder), samples)
    got = f"99 % of pixels below {found.p99:.1%}; with texels in their own places {before.rmse:.2%}, {before.p99:.1%}"
    return Outcome(found.rmse, got, {OWN_PLACES: before.rmse})


for _width in WIDTHS:
    _name = f"{_width:g} voxel{'s' * (_width != 1.0)} wide" if _width else "no ramp: a mask"
    _expected = "light is as near to the path tracer's, by its relative RMSE, as where the ramp is wide"
    case(GROUP, _name, _expected, 0.02, "relative")(partial(error_of_ramp, _width))
