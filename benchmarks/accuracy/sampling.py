"""Light sampled S3's way beside texels on their own isosurfaces, at equal paths, in a Cornell room.

    python -m benchmarks.accuracy sampling [SCENE] [--size 32] [--levels 16] [--paths 128] [--truth
    256] [--only neghip]

S3 lights K isosurfaces of a range, evenly or adaptively spaced (sections 2.2 and 2.3), at the
vertices of their meshes, and scatters that light to the texels of a lattice by Shepard's method
(section 3.2); isogi lights each texel on the isosurface through its own point. Pictures at the K
isovalues and midway between them read either lattice trilinearly; isogi's frames read the same
texels as irradiance ratios, and are taken here before control pixels have checked them. The truth
is path-traced from each pixel, with as many bounces. RMSE is over surface pixels, less the noise of
the truth, and over all isovalues of a kind.

S3 leaves these out, and here they are: Shepard's neighbours are the NEAREST vertices of all levels
together, weighed by the inverse square of their distance, without Shepard's corrections for
direction and slope; the lattice has a texel a voxel; ε follows from K, and k² as ``range_sampling``
has it. Paths start from the vertices, where S3 gathers photons.

The paths are as many: ``--paths`` for each texel that some picture reads, and as many in all,
rounded up to an even number from each, from those vertices alone that these texels' weights name.
S3 itself lights all vertices. Seconds are of the processor: of S3's way for vertices, weights and
paths, of ours for the bake. Without a SCENE, which has to show its range from +y, shared data are
needed.
"""

import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from statistics import median

import click
import numpy as np
from scipy.spatial import cKDTree

from benchmarks.accuracy.benches import wanted
from benchmarks.accuracy.carrying import lit_texels
from benchmarks.accuracy.errors import rms
from benchmarks.accuracy.papers import interpolate
from benchmarks.common.measurement import Measurement, markdown
from benchmarks.common.scenes import ENGINE, shared_data
from benchmarks.common.suite import part
from isogi_core.bake.texel_light import Light
from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.rays.pixel_rays import Paths
from isogi_core.frame.renderer import Renderer
from isogi_core.model.view import View
from isogi_core.plan.assembly import load_scene
from isogi_core.plan.projection import SPACING_KINDS, sample_range
from isogi_core.plan.scene import Scene
from isogi_core.reference import trace_reference
from isogi_report.bench import Bake, Bench, ViewBake
from isogi_report.exact import Lit, lit_by_paths
from isogi_report.metrics import luminance_of, mean_of, spread_of
from isogi_report.speed import view_of

NEAREST = 8
"""Vertices that a texel's light is made of. Shepard (1968) takes four to ten, seven on the
average.
"""

RANGES: Mapping[str, tuple[str, float, float]] = {
    "nucleon": ("nucleon_41x41x41_uint8.nhdr", 60.0, 220.0),
    "neghip": ("neghip_66x66x66_uint8.nhdr", 30.0, 200.0),
    "engine": (ENGINE, 50.0, 210.0),
    "MNI brain": ("mni152_t1_197x233x189_uint8.nhdr", 40.0, 160.0),
}
"""Files of volumes, and the isovalues that levels are chosen between, by what a person calls
them.
"""

PLACES = ("at levels", "midway")
"""The kinds of isovalues that are shown."""

METHODS = ("S3", "own texels", "as ratios")
"""What pictures are made of: S3's lattice and isogi's, both trilinear, and isogi's as its frames
read it.
"""

HEAD = (
    *(
        "volume",
        "levels",
        "softened, %",
        "vertices lit",
        "texels lit",
        "S3, 10³ paths",
        "own texels, 10³ paths",
    ),
    *(f"{method} {place}, %" for method in METHODS for place in PLACES),
    *("S3, s", "own texels, s"),
)


@dataclass(frozen=True)
class Found:
    """What was found of a volume: relative RMSE by ``METHODS`` and ``PLACES``.

    ``seconds`` are those of S3's way and of ours. So much of the range is ``softened``, see
    ``SampledRange``. S3's way and ours took so many ``paths`` from so many ``vertices`` and
    ``texels``.
    """

    errors: Mapping[tuple[str, str], float]
    seconds: tuple[float, float]
    softened: float
    vertices: int
    texels: int
    paths: tuple[int, int]

    @property
    def cells(self) -> tuple[str, ...]:
        """Its columns of the table, but for the volume and the way."""
        counts = (
            f"{100.0 * self.softened:.0f}",
            f"{self.vertices}",
            f"{self.texels}",
            *(f"{each / 1e3:.0f}" for each in self.paths),
        )
        return (
            *counts,
            *(f"{100.0 * each:.2f}" for each in self.errors.values()),
            *map("{:.1f}".format, self.seconds),
        )

    @property
    def figures(self) -> dict[str, float]:
        """The same as figures."""
        errors = {
            f"{method} {place}: RMSE, %": 100.0 * each
            for (method, place), each in self.errors.items()
        }
        counts = {
            "softened, %": 100.0 * self.softened,
            "vertices lit": self.vertices,
            "texels lit": self.texels,
        }
        paths = {"S3, paths": self.paths[0], "own texels, paths": self.paths[1]}
        return errors | counts | paths | dict(zip(HEAD[-2:], self.seconds, strict=True))


@part(size=32)
@click.argument("target", required=False)
@click.option(
    "--levels",
    type=click.IntRange(2),
    default=16,
    show_default=True,
    help="Levels that S3's way lights.",
)
@click.option(
    "--paths",
    type=click.IntRange(16),
    default=128,
    show_default=True,
    help="Paths from each texel of ours.",
)
@click.option(
    "--truth",
    type=click.IntRange(8),
    default=256,
    show_default=True,
    help="Paths a pixel of references.",
)
@click.option("--only", multiple=True, help="Part of a volume's name; repeatable.")
def sampling(
    target: str | None, levels: int, paths: int, truth: int, size: int, only: tuple[str, ...]
) -> Measurement:
    """Light of K level sets by Shepard's weights (S3), beside texels on their own isosurfaces, at
    equal paths.
    """
    found: dict[tuple[str, str], Found] = {}
    for name, scene in scenes(target, only):
        for way in SPACING_KINDS:
            with tempfile.TemporaryDirectory() as folder:
                view = view_of(scene, size, camera=scene.camera(90.0, 15.0, 2.2, 30.0))
                found[name, way] = measure(
                    Bench(scene, view, Path(folder)), way, levels, paths, truth
                )
            click.echo(" | ".join((name, way, *found[name, way].cells)), err=True)
    rows = [(name, way, *each.cells) for (name, way), each in found.items()]
    figures = {
        f"{name}, {way}: {key}": value
        for (name, way), each in found.items()
        for key, value in each.figures.items()
    }
    for place in PLACES:
        ratios = [
            each.errors["S3", place] / max(each.errors["own texels", place], 1e-6)
            for each in found.values()
        ]
        figures[f"S3 / own texels, {place}: RMSE, median"] = median(ratios)
    return Measurement(
        f"{levels} level sets beside own isosurfaces, {size} × {size}",
        figures,
        markdown(HEAD, rows, 2),
    )


def scenes(target: str | None, only: Sequence[str]) -> Iterator[tuple[str, Scene]]:
    """The scene ``target``, or those of RANGES in a Cornell room with these words in their names.

    No texel is projected. ClickException where the shared data are not at hand.
    """
    if target is not None:
        yield Path(target).stem, load_scene(target).with_settings(projected=False)
        return
    data = shared_data()
    if data is None:
        raise click.ClickException(
            "There are no shared volumes: set ISOGI_SHARED_DATA to a folder that has them."
        )
    for name, (file, low, high) in RANGES.items():
        if wanted(name, only):
            settings = {"room": "cornell", "isovalue": low, "isovalues": [low, high], "albedo": 0.7}
            yield name, load_scene(data / file, **settings).with_settings(projected=False)


def measure(bench: Bench, way: str, count: int, paths: int, truth: int) -> Found:
    """Light a volume S3's way and ours, and hold pictures of both against the truth."""
    scene = bench.scene
    renderer = bench.renderer(bench.scene)
    sampled = sample_range(scene.volume, scene.isovalues, count, way)
    shown = shots(renderer, bench.view, sampled.levels)
    best = [lit_by_paths(trace_reference(renderer, bake.view, truth)) for _, bake in shown]
    own, rows = own_texels([bake for _, bake in shown], paths)
    taken = int(np.maximum(own.light.samples, 0).sum())
    begun = time.process_time()
    scattered, vertices, spent = scatter(renderer, bench.view, sampled.levels, own.texels, taken)
    seconds = time.process_time() - begun, own.seconds
    kept = defaultdict[tuple[str, str], list[float]](list)
    for (place, bake), true, some in zip(shown, best, rows, strict=True):
        for method, light in zip(
            METHODS, pictures(bake, scattered[some], own.light.rows(some)), strict=True
        ):
            kept[method, place].append(error(light, true))
    errors = {(method, place): rms(kept[method, place]) for method in METHODS for place in PLACES}
    return Found(errors, seconds, sampled.softened, vertices, len(own.texels), (spent, taken))


def pictures(bake: ViewBake, scattered: np.ndarray, own: Light) -> tuple[np.ndarray, ...]:
    """Linear RGB (m, 3) of a view's surface pixels by each of METHODS.

    Of its texels ``scattered`` (t, 3) is S3's light, linear RGB, and ``own`` is that of their own
    isosurfaces.
    """
    lit, held = lit_texels(own, RotatedLight(bake.spec, bake.view))
    frame = bake.frame(own).leaving.reshape(-1, 3)[bake.shown.gbuffer.pixels]
    return (
        interpolate(bake.shown, scattered, np.ones(len(held))),
        interpolate(bake.shown, lit[:, :3], held),
        frame,
    )


def shots(renderer: Renderer, view: View, levels: Sequence[float]) -> list[tuple[str, ViewBake]]:
    """The levels, and the isovalues midway between them, that show any of the surface: the place of
    each, and its bake.

    Nothing is baked yet. ClickException where one of PLACES has no isovalue that does.
    """
    midway = [(low + high) / 2.0 for low, high in pairwise(levels)]
    found = [
        (place, value)
        for place, values in zip(PLACES, (levels, midway), strict=True)
        for value in values
    ]
    views = [(place, replace(view, isovalue=value)) for place, value in found]
    seen = [
        (place, ViewBake(renderer, each))
        for place, each in views
        if len(renderer.gbuffer(each).pixels)
    ]
    if {place for place, _ in seen} != set(PLACES):
        raise click.ClickException(
            "Few of these isovalues show a surface: choose another range, or more levels."
        )
    return seen


def own_texels(bakes: Sequence[ViewBake], paths: int) -> tuple[Bake, list[np.ndarray]]:
    """All texels of some ``bakes``, each baked once with so many ``paths`` on its own isosurface.

    And for each bake the rows of its texels, (texels,).
    """
    numbers = np.concatenate([bake.shown.numbers(bake.shown.places) for bake in bakes])
    _, first, rows = np.unique(numbers, return_index=True, return_inverse=True)
    texels = np.concatenate([bake.texels for bake in bakes])[first]
    every = Bake(bakes[0].tiles, bakes[0].spec, bakes[0].layers, texels)
    every.grow(paths)
    return every, np.split(rows, np.cumsum([len(bake.texels) for bake in bakes])[:-1])


def scatter(
    renderer: Renderer, view: View, levels: Sequence[float], texels: np.ndarray, paths: int
) -> tuple[np.ndarray, int, int]:
    """S3's light of ``texels`` (t, 3; z, y, x), by so many ``paths`` in all, or a few more: (t, 3)
    float64 linear RGB.

    And from how many vertices of the isosurfaces at these ``levels`` they start, and how many they
    are.
    """
    prepared = renderer.prepared
    volume = renderer.prepared.scene.volume
    meshes = [
        vertices_of(volume.voxels, float(volume.normalise_isovalue(level))) for level in levels
    ]
    points = np.concatenate(meshes)
    spacing = np.array(volume.spacing)
    near, weights = shepard(points * spacing, texels[:, ::-1] * prepared.step * spacing)
    asked, rows = np.unique(near, return_inverse=True)
    each = -(-paths // (2 * len(asked)))
    bounds = np.searchsorted(asked, np.cumsum([0, *map(len, meshes)])).tolist()
    parts = zip(levels, pairwise(bounds), strict=True)
    light = [
        light_of_points(renderer, replace(view, isovalue=c), points[asked[a:b]], each)
        for c, (a, b) in parts
    ]
    scattered = np.einsum("tk,tkc->tc", weights, np.concatenate(light)[rows.reshape(near.shape)])
    return scattered, len(asked), 2 * each * len(asked)


def vertices_of(voxels: np.ndarray, level: float) -> np.ndarray:
    """Where the edges of cells cross a normalised isovalue: the vertices of Marching Cubes; (n, 3)
    float64, x, y, z.

    The trilinear surface passes through them, too.
    """
    found = []
    for axis in range(3):
        along = np.moveaxis(voxels, axis, 0)
        crossed = np.nonzero((along[1:] > level) != (along[:-1] > level))
        low, high = (each[crossed].astype(np.float64) for each in (along[:-1], along[1:]))
        places = np.array(crossed, np.float64)
        places[0] += (level - low) / (high - low)
        found.append(np.insert(places[1:], axis, places[0], axis=0)[::-1].T)
    points = np.concatenate(found)
    return points[np.isfinite(points).all(axis=1)]


def shepard(points: np.ndarray, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Numbers (t, NEAREST) of the ``points`` (n, 3) around each of the ``places`` (t, 3), and their
    weights.

    These are the inverse squares of the distances, and add up to 1. Source: Shepard 1968, by S3,
    section 3.2.
    """
    away, near = cKDTree(points).query(places, min(NEAREST, len(points)))
    away, near = (np.reshape(each, (len(places), -1)) for each in (away, near))
    weights = 1.0 / np.maximum(away, 1e-9) ** 2
    return near, weights / weights.sum(axis=1, keepdims=True)


def light_of_points(renderer: Renderer, view: View, points: np.ndarray, paths: int) -> np.ndarray:
    """Linear RGB that leaves ``points`` (m, 3) of the view's isosurface, by twice so many ``paths``
    each; (m, 3).
    """
    sums = np.zeros((len(points), 2, 3))
    surface = renderer.prepared.surface(view.isovalue)
    if len(points):
        row = GBuffer.of_points(surface, renderer.gbuffer(view).eye, points)
        Paths(RotatedLight(renderer.caches.spec("gi"), view), row, renderer.tiles).add(
            sums, 0, 0, paths
        )
    return sums.mean(axis=1) / paths


def error(light: np.ndarray, true: Lit) -> float:
    """Relative RMSE of ``light`` (m, 3), linear RGB, at surface pixels, less the truth's noise."""
    return spread_of(luminance_of(light) - true.light, true.noise, mean_of(true.light)).rmse
