"""A camera that shows the whole surface: what it sees of points, and from how near."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from isogi_core.files.grid import Vector
from isogi_core.frame.fitting import FILLED, Stand, fitted, fitted_to_all, nearest
from isogi_core.model.view import PROJECTIONS, View, orbit
from isogi_core.model.volume import make_volume
from isogi_core.plan.isovalue_presets import FRONT, SKEW_AZIMUTHS, front_of
from tests.frame.conftest import Workbench
from tests.loaded import load_scene

SLOPES = (0.3, 0.2)
SCENE = load_scene("demo:orbital")


def seen(points: np.ndarray, aim: np.ndarray, away: float) -> np.ndarray:
    """Where points are in the picture, 1 at its edges, (n, 2)."""
    from_eye = points - aim - [0.0, 0.0, away]
    return np.asarray(np.abs(from_eye[:, :2] / from_eye[:, 2:]) / SLOPES)


@pytest.mark.parametrize("size", [(1.0, 1.0, 1.0), (9.0, 1.0, 3.0), (1.0, 5.0, 20.0)])
def test_all_points_are_seen_and_some_at_an_edge(size: tuple[float, float, float]) -> None:
    points = np.random.default_rng(5).uniform(-1.0, 1.0, (400, 3)) * size + [7.0, -3.0, 11.0]
    aim, away = nearest(points, SLOPES)
    assert 0.95 < seen(points, aim, away).max() < 1.0 / FILLED


def test_a_speck_afar_does_not_push_the_camera_away() -> None:
    points = np.random.default_rng(6).uniform(-1.0, 1.0, (2000, 3))
    _, near = nearest(points, SLOPES)
    _, with_speck = nearest(np.vstack([points, [[500.0, 0.0, 0.0]]]), SLOPES)
    assert with_speck == pytest.approx(near, rel=0.02)


def test_an_orbit_aims_where_the_fit_says() -> None:
    camera = orbit((1.0, 2.0, 3.0), 2.0, 35.0, 25.0, 4.0, 30.0)
    assert np.linalg.norm(np.subtract(camera.eye, (1.0, 2.0, 3.0))) == pytest.approx(8.0)


def test_what_glows_beside_the_surface_is_seen_whole(tmp_path: Path) -> None:
    """A ball at the box's edge, and not a range of values, which may glow anywhere in its box."""
    ball = {"sphere": [85.0, 12.0, 47.0, 8.0]}
    views = []
    for name, glow in (("none", {}), ("ball", {"glow": [ball]}), ("mist", {"glow": [{"values": [0.003, 0.03]}]})):
        bench = Workbench(load_scene("demo:orbital", **glow), tmp_path / name)
        found = fitted(bench.renderer, bench.view(size=16), 30.0, 20.0)
        assert found is not None
        camera = orbit(found[0], bench.scene.volume.radius, 30.0, 20.0, found[1], 30.0)
        away = np.array(ball["sphere"][:3]) - camera.eye
        right, up, forward = camera.basis()
        reach = max(abs(away @ right), abs(away @ up)) + ball["sphere"][3]
        views.append((found, reach / (away @ forward) / np.tan(np.radians(15.0))))
    assert views[0][1] > 1.05
    assert views[1][1] < 1.0
    assert views[2] == views[0]


def test_the_longer_side_lies_across_the_first_picture() -> None:
    cube, long, wide = (front_of(make_volume(np.zeros(shape)), False) for shape in ((4, 8, 8), (4, 16, 8), (4, 8, 80)))
    assert cube == FRONT and long[0] < cube[0] and wide == (SKEW_AZIMUTHS[1], FRONT[1])


def edges_of(bench: Workbench, view: View, stand: Stand, found: tuple[Vector, float], projection: str) -> np.ndarray:
    """How far the surface reaches in the picture of a camera at a ``stand``, 1 at its edges: left, right, down, up."""
    camera = orbit(found[0], bench.scene.volume.radius, stand.azimuth, stand.elevation, found[1], view.camera.fov)
    seen = bench.renderer.gbuffer(replace(view, camera=bench.scene.in_box(camera, projection)))
    rows, columns = np.nonzero(seen.rows >= 0)
    x, y = 2.0 * columns / (view.width - 1) - 1.0, 1.0 - 2.0 * rows / (view.height - 1)
    return np.array([-x.min(), x.max(), -y.min(), y.max()])


@pytest.mark.parametrize("projection", PROJECTIONS)
def test_from_many_sides_all_is_seen_from_one_distance(projection: str, tmp_path: Path) -> None:
    """Of two isovalues, from all around and from above: nowhere cut off, and as large as the margin allows."""
    bench = Workbench(SCENE, tmp_path)
    views = [replace(bench.view(size=120), isovalue=isovalue) for isovalue in (0.01, 0.03)]
    stands = [
        Stand(view, azimuth, elevation) for view in views for azimuth, elevation in ((0, 0), (120, 30), (250, 70))
    ]
    found = fitted_to_all(bench.renderer, stands, projection)
    assert found is not None
    reach = np.array([edges_of(bench, stand.view, stand, found, projection) for stand in stands])
    assert reach.max() == pytest.approx(FILLED, abs=0.04)
    alone = fitted(bench.renderer, views[0], 30.0, 20.0, projection)
    same = fitted_to_all(bench.renderer, [Stand(views[0], 30.0, 20.0)] * 3, projection)
    assert alone is not None and same is not None
    assert [*same[0], same[1]] == pytest.approx([*alone[0], alone[1]], rel=0.01)


def test_a_surface_of_a_pixel_or_two_is_seen_in_the_whole_volume(tmp_path: Path) -> None:
    """Of a single point the camera would be at no distance: two specks at the ends of a long box."""
    voxels = np.zeros((160, 8, 8), np.float32)
    voxels[1, 3:5, 3:5] = voxels[-2, 3:5, 3:5] = 1.0
    np.save(tmp_path / "v.npy", voxels)
    bench = Workbench(load_scene(tmp_path / "v.npy", isovalue=0.5), tmp_path / "light")
    view = View(0.5, orbit((0.0, 0.0, 0.0), 1.0, 0.0, 0.0, 3.0, 40.0), width=256, height=192)
    found = fitted(bench.renderer, view, 10.0, 5.0)
    assert found is None or found[1] > 0.05
