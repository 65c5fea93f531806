"""Cameras that show the whole surface, and parallel rays."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from isogi_core.files.vector import Vector
from isogi_core.frame.fitting import FILLED, FITTED_SIDE, Stand, fitted, fitted_to_all, nearest
from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.renderer import Renderer
from isogi_core.model.choices import PROJECTIONS
from isogi_core.model.view import Camera, View, orbit, orthographic
from isogi_core.model.volume import Orientation, make_volume
from isogi_core.plan.isovalue_presets import FRONT, SKEW_AZIMUTHS, front_of
from isogi_core.plan.scene import Scene
from tests.frame.conftest import Workbench, ball, scene_of
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


@pytest.mark.parametrize("size", [(1, 400), (400, 1), (300, 200)])
def test_long_pictures_are_fitted_by_few_rays(
    size: tuple[int, int], workbench: Callable[[Scene], Workbench], monkeypatch: pytest.MonkeyPatch
) -> None:
    """All that they show is seen in the square in their middle."""
    renderer = workbench(scene_of(ball(), 0.0)).renderer
    cast = list[int]()

    def gbuffer(view: View) -> GBuffer:
        cast.append(view.width * view.height)
        return Renderer.gbuffer(renderer, view)

    monkeypatch.setattr(renderer, "gbuffer", gbuffer)
    view = replace(workbench(scene_of(ball(), 0.0)).view(), width=size[0], height=size[1])
    found = fitted(renderer, view, 30.0, 20.0)
    assert found is not None
    assert max(cast) <= FITTED_SIDE**2


def test_what_glows_beside_the_surface_is_seen_whole(tmp_path: Path) -> None:
    """A ball at the box's edge, and not a range of values, which may glow anywhere in its box."""
    ball = {"sphere": [85.0, 12.0, 47.0, 8.0]}
    views = []
    for name, glow in (
        ("none", {}),
        ("ball", {"glow": [ball]}),
        ("mist", {"glow": [{"values": [0.003, 0.03]}]}),
    ):
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
    cube, long, wide = (
        front_of(make_volume(np.zeros(shape)), False)
        for shape in ((4, 8, 8), (4, 16, 8), (4, 8, 80))
    )
    assert cube == FRONT and long[0] < cube[0] and wide == (SKEW_AZIMUTHS[1], FRONT[1])


def edges_of(
    bench: Workbench, view: View, stand: Stand, found: tuple[Vector, float], projection: str
) -> np.ndarray:
    """How far the surface reaches in the picture of a camera at a ``stand``, 1 at its edges: left,
    right, down, up.
    """
    camera = orbit(
        found[0],
        bench.scene.volume.radius,
        stand.azimuth,
        stand.elevation,
        found[1],
        view.camera.fov,
    )
    seen = bench.renderer.gbuffer(replace(view, camera=bench.scene.in_box(camera, projection)))
    rows, columns = np.nonzero(seen.rows >= 0)
    x = 2.0 * columns / (view.width - 1) - 1.0
    y = 1.0 - 2.0 * rows / (view.height - 1)
    return np.array([-x.min(), x.max(), -y.min(), y.max()])


@pytest.mark.parametrize("projection", PROJECTIONS)
def test_from_many_sides_all_is_seen_from_one_distance(projection: str, tmp_path: Path) -> None:
    """Of two isovalues, from all around and from above: nowhere cut off, and as large as the margin
    allows.
    """
    bench = Workbench(SCENE, tmp_path)
    views = [replace(bench.view(size=120), isovalue=isovalue) for isovalue in (0.01, 0.03)]
    stands = [
        Stand(view, azimuth, elevation)
        for view in views
        for azimuth, elevation in ((0, 0), (120, 30), (250, 70))
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
    """Of a single point the camera would be at no distance: two specks at the ends of a long
    box.
    """
    voxels = np.zeros((160, 8, 8), np.float32)
    voxels[1, 3:5, 3:5] = voxels[-2, 3:5, 3:5] = 1.0
    np.save(tmp_path / "v.npy", voxels)
    bench = Workbench(load_scene(tmp_path / "v.npy", isovalue=0.5), tmp_path / "light")
    view = View(0.5, orbit((0.0, 0.0, 0.0), 1.0, 0.0, 0.0, 3.0, 40.0), width=256, height=192)
    found = fitted(bench.renderer, view, 10.0, 5.0)
    assert found is None or found[1] > 0.05


# --- parallel rays
# --------------------------------------------------------------------------------------------------


SIZE = 64
TURNED = Orientation(
    ((0.0, -1.0, 0.0), (0.6, 0.0, -0.8), (0.8, 0.0, 0.6)), (100.0, -50.0, 7.0), "mm", "LPS"
)
WAYS = [(0.0, 0.0), (35.0, 28.0), (-140.0, -65.0), (90.0, 90.0)]


@pytest.fixture
def bench(workbench: Callable[[Scene], Workbench]) -> Workbench:
    """A ball of radius 12 whose box is turned in the world, and whose voxels are no cubes."""
    return workbench(scene_of(replace(ball(spacing=(1.0, 0.5, 2.0)), orientation=TURNED), 0.0))


def perspective(
    bench: Workbench, azimuth: float, elevation: float, distance: float = 1.2
) -> Camera:
    """A camera of the world, near the ball, that looks past its middle."""
    volume = bench.scene.volume
    x, y, z = volume.world_centre
    return orbit((x + 1.0, y - 2.0, z + 0.5), volume.radius, azimuth, elevation, distance, 40.0)


def seen_by(bench: Workbench, camera: Camera, projection: str) -> tuple[GBuffer, np.ndarray]:
    """What a camera of the world sees, and the places of its pixels from the middle, right and up,
    in pixels.
    """
    view = View(
        0.0, bench.scene.in_box(camera, projection), width=SIZE, height=SIZE, shading="lambert"
    )
    gbuffer = bench.renderer.gbuffer(view)
    row, column = np.divmod(gbuffer.pixels.astype(np.int64), SIZE)
    return gbuffer, np.column_stack([column + 0.5 - SIZE / 2, SIZE / 2 - row - 0.5])


def world(gbuffer: GBuffer) -> np.ndarray:
    """The world's points (m, 3) that a G-buffer shows."""
    return TURNED.to_world(gbuffer.points.astype(np.float64) * gbuffer.spacing)


def parallel_rays(
    bench: Workbench, azimuth: float, elevation: float
) -> tuple[GBuffer, np.ndarray, np.ndarray]:
    """What an orthographic camera sees, and the rays of these pixels: origins (m, 3), and their one
    direction.
    """
    camera = perspective(bench, azimuth, elevation)
    gbuffer, places = seen_by(bench, camera, "orthographic")
    right, up, forward = camera.basis()
    pixel = (
        2.0
        * np.linalg.norm(np.subtract(camera.target, camera.eye))
        * np.tan(np.radians(20.0))
        / SIZE
    )
    return gbuffer, camera.target + pixel * places @ np.stack([right, up]), forward


@pytest.mark.parametrize(("azimuth", "elevation"), WAYS)
def test_points_lie_on_parallel_rays_through_pixels(
    bench: Workbench, azimuth: float, elevation: float
) -> None:
    gbuffer, origins, forward = parallel_rays(bench, azimuth, elevation)
    away = world(gbuffer) - origins
    assert len(away) > 500
    assert np.abs(away - (away @ forward)[:, None] * forward).max() < 1e-4


@pytest.mark.parametrize(("azimuth", "elevation"), WAYS)
def test_the_nearest_point_of_the_ball_is_seen(
    bench: Workbench, azimuth: float, elevation: float
) -> None:
    gbuffer, origins, forward = parallel_rays(bench, azimuth, elevation)
    origins -= bench.scene.volume.world_centre
    b = origins @ forward
    inside = 12.0**2 - (origins**2).sum(axis=1) + b**2
    hit = origins + (-b - np.sqrt(np.maximum(inside, 0.0)))[:, None] * forward
    found = world(gbuffer) - bench.scene.volume.world_centre
    clear = inside > 20.0
    assert clear.sum() > 400
    assert np.linalg.norm(found - hit, axis=1)[clear].max() < 0.15


def off_affine(gbuffer: GBuffer, places: np.ndarray) -> float:
    """By how many pixels the best affine map from the world to the picture is wrong, at most."""
    points = np.column_stack([world(gbuffer), np.ones(len(places))])
    fit, *_ = np.linalg.lstsq(points, places, rcond=None)
    return float(np.abs(points @ fit - places).max())


@pytest.mark.parametrize(("azimuth", "elevation"), WAYS)
def test_lines_that_are_parallel_stay_parallel(
    bench: Workbench, azimuth: float, elevation: float
) -> None:
    camera = perspective(bench, azimuth, elevation)
    assert off_affine(*seen_by(bench, camera, "orthographic")) < 1e-3
    assert off_affine(*seen_by(bench, camera, "perspective")) > 1.0


def test_distance_is_scale_alone(bench: Workbench) -> None:
    near, far = (
        seen_by(bench, perspective(bench, 35.0, 28.0, distance), "orthographic")[0]
        for distance in (0.6, 1.2)
    )
    pixels = {int(pixel): point for pixel, point in zip(far.pixels, world(far), strict=True)}
    camera = perspective(bench, 35.0, 28.0)
    right, up, _ = camera.basis()
    spans = [np.ptp(points @ right) for points in (world(near), world(far))]
    half = 0.6 * bench.scene.volume.radius * np.tan(np.radians(20.0))
    assert spans[0] <= 2.0 * half < spans[1] + 2.0 * half / SIZE and len(pixels) > 500
    assert np.abs((world(near) - camera.target) @ np.stack([right, up]).T).max() < half


def test_what_is_behind_the_eye_is_seen(bench: Workbench) -> None:
    within = perspective(bench, 35.0, 28.0, 0.05)
    gbuffer, _ = seen_by(bench, within, "orthographic")
    _, _, forward = within.basis()
    assert len(gbuffer.points) == SIZE * SIZE
    assert ((world(gbuffer) - within.eye) @ forward).max() < 0.0


def test_the_camera_keeps_the_height_at_its_target() -> None:
    camera = Camera((3.0, 4.0, 5.0), (1.0, 1.0, 1.0), (0.0, 0.1, 1.0), 35.0)
    other = orthographic(camera, 50.0)
    heights = [
        np.linalg.norm(np.subtract(each.target, each.eye)) * np.tan(np.radians(each.fov / 2))
        for each in (camera, other)
    ]
    assert heights[1] == pytest.approx(heights[0], rel=1e-9)
    assert np.stack(other.basis()) == pytest.approx(np.stack(camera.basis()), abs=1e-9)


@pytest.mark.parametrize(("width", "height"), [(64, 64), (128, 64), (64, 128)])
def test_a_surface_is_fitted_to_parallel_rays(bench: Workbench, width: int, height: int) -> None:
    view = bench.view(shading="lambert", size=64)
    view = replace(view, width=width, height=height, orientation=TURNED)
    found = fitted(bench.renderer, view, 35.0, 28.0, "orthographic")
    assert found is not None
    target, distance = found
    near = orbit(target, bench.scene.volume.radius, 35.0, 28.0, distance, 30.0)
    shown = bench.renderer.gbuffer(replace(view, camera=bench.scene.in_box(near, "orthographic")))
    row, column = np.divmod(shown.pixels.astype(np.int64), width)
    rows, columns = (int(np.ptp(part)) + 1 for part in (row, column))
    filled = max(rows / height, columns / width)
    assert 0.88 < filled < 0.98, "it is found in a small picture, to a pixel of that"
    assert abs(row.mean() + 0.5 - height / 2) < 1.5 and abs(column.mean() + 0.5 - width / 2) < 1.5
