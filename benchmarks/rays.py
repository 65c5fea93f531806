"""Rays per second of the lanes, of the scalar kernel and of Embree on the mesh of the same isosurface.

    python -m benchmarks.rays [TARGET] [--isovalue 70] [--size 512] [--repeats 9] [--json]

Primary rays of the benchmarks' view, cosine rays from what they hit, cosine rays from what those hit,
on one thread. All candidates take the same rays in turn in one process; figures are ratios of medians.
Embree (optional packages ``embreex`` and ``scikit-image``) traces the marching-cubes mesh.
"""

import json
import statistics
import time
from collections.abc import Callable
from typing import Any

import click
import numpy as np
from numba import types

from benchmarks.common import benchmark_scene, show, view_of
from isogi_core.bake.recipe import Recipe
from isogi_core.frame.gbuffer import pinhole
from isogi_core.kernels._jit import kernel
from isogi_core.kernels.field import FIELD
from isogi_core.kernels.integrator import about, facing_normal, launch, to_index
from isogi_core.kernels.intersect import UNKNOWN
from isogi_core.kernels.lanes import WIDTH
from isogi_core.kernels.packets import ORIGINS, SIDES, VECTOR, cast_rays, cast_rays_one_by_one
from isogi_core.kernels.sampling import sample_cosine_hemisphere
from isogi_core.kernels.vec import column, madd, put_column

Rays = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Origins and directions (3, n) in index space, and the sides they start on (n,)."""


@kernel(types.void(FIELD, types.float64, ORIGINS, ORIGINS, VECTOR, SIDES, ORIGINS))
def scatter(field, iso, origins, directions, t, came, numbers):
    """Turn rays that hit, in place, into cosine rays from where they hit; ``numbers`` (n, 3) in [0, 1)."""
    for m in range(origins.shape[1]):
        d = column(directions, m)
        p = madd(column(origins, m), t[m], d)
        n = facing_normal(field, p, int(came[m]), d)
        w = about(n, sample_cosine_hemisphere(numbers[m, 0], numbers[m, 1]))
        put_column(origins, m, launch(field, iso, p, n, int(came[m])))
        put_column(directions, m, to_index(w, field.spacing))


class Casts:
    """The candidates, for one isosurface."""

    def __init__(self, recipe: Recipe, isovalue: float) -> None:
        """Build the map and, where Embree is at hand, the mesh."""
        self.recipe, self.isovalue = recipe, isovalue
        self.bricks = recipe.bricks(isovalue, isovalue)
        self.embree = embree_scene(recipe.scene.volume.voxels, isovalue)

    def run(self, cast: Callable[..., Any], rays: Rays) -> tuple[np.ndarray, np.ndarray]:
        """(t, came) of ``rays``."""
        t, came = np.empty(rays[0].shape[1]), np.empty(rays[0].shape[1], np.int8)
        cast(self.recipe.field, self.bricks, np.full(len(t), self.isovalue), *rays, t, came)
        return t, came

    def candidates(self, rays: Rays) -> dict[str, Callable[[], Any]]:
        """What to time on ``rays``."""
        found: dict[str, Callable[[], Any]] = {
            "lanes": lambda: self.run(cast_rays, rays),
            "scalar": lambda: self.run(cast_rays_one_by_one, rays),
        }
        if self.embree is not None:
            origins, directions = (np.ascontiguousarray(v.T, np.float32) for v in rays[:2])
            found["embree"] = lambda: self.embree.run(origins, directions)
        return found

    def bounce(self, rays: Rays, rng: np.random.Generator) -> Rays:
        """Cosine rays from where ``rays`` hit."""
        t, came = self.run(cast_rays_one_by_one, rays)
        hit = np.isfinite(t)
        origins, directions = (np.compress(hit, v, axis=1) for v in rays[:2])
        came = came[hit]
        scatter(self.recipe.field, self.isovalue, origins, directions, t[hit], came, rng.random((len(came), 3)))
        return origins, directions, came


def embree_scene(voxels: np.ndarray, isovalue: float) -> Any:
    """Embree's tree over the marching-cubes mesh, None where the packages are missing."""
    try:
        from embreex import rtcore_scene  # noqa: PLC0415
        from embreex.mesh_construction import TriangleMesh  # noqa: PLC0415
        from skimage.measure import marching_cubes  # noqa: PLC0415
    except ImportError:
        return None
    points, triangles, _, _ = marching_cubes(voxels, isovalue, allow_degenerate=False)
    scene = rtcore_scene.EmbreeScene()
    TriangleMesh(scene, points[:, ::-1].astype(np.float32).copy(), triangles.astype(np.int32))
    return scene


def primary_rays(recipe: Recipe, size: int) -> Rays:
    """The rays of the benchmarks' view."""
    camera = pinhole(view_of(recipe.scene, size).camera, size, size, recipe.scene.volume.spacing)
    y, x = (np.mgrid[:size, :size] + 0.5).reshape(2, -1)
    corner, right, down, eye = (np.array(v)[:, None] for v in (camera.corner, camera.right, camera.down, camera.eye))
    directions = corner + x * right + y * down
    return np.repeat(eye, len(x), axis=1), directions, np.full(len(x), UNKNOWN, np.int8)


def measure(casts: Casts, rays: Rays, repeats: int) -> dict[str, float]:
    """Median seconds of each candidate on ``rays``, taken in turn."""
    candidates = casts.candidates(rays)
    times: dict[str, list[float]] = {name: [] for name in candidates}
    for _ in range(repeats + 1):
        for name, cast in candidates.items():
            begun = time.perf_counter()
            cast()
            times[name].append(time.perf_counter() - begun)
    return {name: statistics.median(taken[1:]) for name, taken in times.items()}


@click.command()
@click.argument("target", required=False)
@click.option("--isovalue", type=float, help="Default: the scene's.")
@click.option("--size", default=512, show_default=True, help="Pixels along each side.")
@click.option("--repeats", default=9, show_default=True, help="Runs of each candidate.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def main(target: str | None, isovalue: float | None, size: int, repeats: int, as_json: bool) -> None:
    """Time rays."""
    scene = benchmark_scene(target)
    recipe = Recipe(scene)
    casts = Casts(recipe, scene.volume.normalise_isovalue(isovalue if isovalue is not None else scene.isovalue))
    rays, rng = primary_rays(recipe, size), np.random.default_rng(1)
    figures: dict[str, Any] = {"lanes at once": WIDTH or 0}
    for kind in ("primary", "bounce1", "bounce2"):
        seconds = measure(casts, rays, repeats)
        lanes = seconds.pop("lanes")
        figures[f"{kind}: rays"] = rays[0].shape[1]
        figures[f"{kind}: Mrays/s"] = rays[0].shape[1] / lanes / 1e6
        figures |= {f"{kind}: lanes / {name}": taken / lanes for name, taken in seconds.items()}
        rays = casts.bounce(rays, rng)
    if as_json:
        click.echo(json.dumps(figures))
    else:
        show(f"{scene.name} at {isovalue or scene.isovalue:g}, one thread", figures)


if __name__ == "__main__":
    main()
