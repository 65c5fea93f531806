"""Light sampled S3's way: Shepard's weights against sums by hand, light of vertices against that of
pixels.
"""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.accuracy import sampling as module
from benchmarks.accuracy.sampling import (
    METHODS,
    PLACES,
    error,
    light_of_points,
    own_texels,
    sampling,
    shepard,
    shots,
    vertices_of,
)
from isogi_core.plan.projection import SPACING_KINDS
from isogi_core.reference import trace_reference
from isogi_report.exact import lit_by_paths
from tests.benchmarks.parts import bench_of, figures

ROOM = """
volume = "demo:orbital"
room = "cornell"
isovalues = [0.02, 0.06]
isovalue = 0.03
lattice = 0.5
bounces = 1
"""


def test_shepard_weighs_the_nearest_by_inverse_squares() -> None:
    rng = np.random.default_rng(3)
    points = rng.random((60, 3))
    places = rng.random((20, 3))
    near, weights = shepard(points, places)
    for place, numbers, own in zip(places, near, weights, strict=True):
        squares = ((points - place) ** 2).sum(axis=1)
        wanted = np.argsort(squares)[: module.NEAREST]
        assert set(numbers) == set(wanted)
        share = 1.0 / squares[numbers]
        assert np.allclose(own, share / share.sum())


def test_a_place_on_a_point_has_its_light() -> None:
    points = np.random.default_rng(4).random((30, 3))
    near, weights = shepard(points, points)
    assert (near[:, 0] == np.arange(30)).all() and np.allclose(weights[:, 0], 1.0)


def test_few_points_are_all_taken() -> None:
    near, weights = shepard(np.eye(3), np.zeros((2, 3)))
    assert near.shape == (2, 3) and np.allclose(weights, 1.0 / 3.0)


def test_vertices_are_where_edges_cross_the_level() -> None:
    """Of a field that is linear along each axis they are on its plane, one for each edge that the
    plane cuts.
    """
    z, y, x = np.mgrid[:5, :6, :7].astype(np.float32)
    voxels = x + 2.0 * y + 4.0 * z
    slope = np.array([1.0, 2.0, 4.0])
    points = vertices_of(voxels, 9.5)
    assert np.allclose(points @ slope, 9.5)
    cut = sum(int(np.count_nonzero(np.diff(voxels > 9.5, axis=axis))) for axis in range(3))
    assert len(points) == len(np.unique(points, axis=0)) == cut
    assert ((points >= 0.0) & (points <= (6.0, 5.0, 4.0))).all()
    voxels[0, 0, 0] = np.nan
    assert np.isfinite(vertices_of(voxels, -1.0)).all()


def test_vertices_have_the_light_that_pixels_have(tmp_path: Path) -> None:
    bench = bench_of(tmp_path, room="cornell", bounces=1, lattice=0.5)
    renderer = bench.renderer(bench.scene)
    best = trace_reference(renderer, bench.view, 1024)
    points = renderer.gbuffer(bench.view).points
    assert error(light_of_points(renderer, bench.view, points, 256), lit_by_paths(best)) < 0.05


def test_texels_that_views_share_are_baked_once(tmp_path: Path) -> None:
    bench = bench_of(tmp_path, lights=[{"type": "constant"}], bounces=0)
    found = shots(bench.renderer(bench.scene), bench.view, (0.03, 0.031, 1e6))
    assert [place for place, _ in found] == [PLACES[0], PLACES[0], PLACES[1]], (
        "one level shows nothing"
    )
    every, rows = own_texels([bake for _, bake in found], 16)
    assert len(every.texels) < sum(map(len, rows))
    for (_, bake), own in zip(found, rows, strict=True):
        assert np.array_equal(every.texels[own], bake.texels)


def test_the_part_tells_of_both_ways_and_places(tmp_path: Path) -> None:
    """A lattice of two voxels a texel is coarse for either; vertices of other normals count for
    S3's alone.
    """
    scene = tmp_path / "orbital.toml"
    scene.write_text(ROOM)
    found = figures(
        sampling, str(scene), "--size", "16", "--levels", "3", "--paths", "16", "--truth", "64"
    )
    for way in SPACING_KINDS:
        own = {
            key.removeprefix(f"orbital, {way}: "): value
            for key, value in found.items()
            if way in key
        }
        assert {f"{method} {place}: RMSE, %" for method in METHODS for place in PLACES} < set(own)
        assert 1.0 <= own["S3, paths"] / own["own texels, paths"] < 1.8, (
            "two more from a vertex at most"
        )
        assert (
            own["softened, %"] == pytest.approx(0.0, abs=50.0)
            and own["S3, s"] > 0.0 < own["own texels, s"]
        )
        assert 0.0 < own["own texels at levels: RMSE, %"] < own["S3 at levels: RMSE, %"]
    assert all(found[f"S3 / own texels, {place}: RMSE, median"] > 1.0 for place in PLACES)
