"""Orthographic cameras: rays against a NumPy twin, and pictures in which nothing becomes smaller with its distance."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from isogi_core.frame.fitting import fitted
from isogi_core.frame.gbuffer import GBuffer
from isogi_core.model.orientation import Orientation
from isogi_core.model.view import Camera, View, orbit, orthographic
from isogi_core.plan.scene import Scene
from tests.frame.conftest import Workbench, ball, scene_of

SIZE = 64
TURNED = Orientation(((0.0, -1.0, 0.0), (0.6, 0.0, -0.8), (0.8, 0.0, 0.6)), (100.0, -50.0, 7.0), "mm", "LPS")
WAYS = [(0.0, 0.0), (35.0, 28.0), (-140.0, -65.0), (90.0, 90.0)]


@pytest.fixture
def bench(workbench: Callable[[Scene], Workbench]) -> Workbench:
    """A ball of radius 12 whose box is turned in the world, and whose voxels are no cubes."""
    return workbench(scene_of(replace(ball(spacing=(1.0, 0.5, 2.0)), orientation=TURNED), 0.0))


def perspective(bench: Workbench, azimuth: float, elevation: float, distance: float = 1.2) -> Camera:
    """A camera of the world, near the ball, that looks past its middle."""
    volume = bench.scene.volume
    x, y, z = volume.world_centre
    return orbit((x + 1.0, y - 2.0, z + 0.5), volume.radius, azimuth, elevation, distance, 40.0)


def seen(bench: Workbench, camera: Camera, projection: str) -> tuple[GBuffer, np.ndarray]:
    """What a camera of the world sees, and the places of its pixels from the middle, right and up, in pixels."""
    view = View(0.0, bench.scene.in_box(camera, projection), width=SIZE, height=SIZE, shading="lambert")
    gbuffer = bench.renderer.gbuffer(view)
    row, column = np.divmod(gbuffer.pixels.astype(np.int64), SIZE)
    return gbuffer, np.column_stack([column + 0.5 - SIZE / 2, SIZE / 2 - row - 0.5])


def world(gbuffer: GBuffer) -> np.ndarray:
    """The world's points (m, 3) that a G-buffer shows."""
    return TURNED.to_world(gbuffer.points.astype(np.float64) * gbuffer.spacing)


def parallel_rays(bench: Workbench, azimuth: float, elevation: float) -> tuple[GBuffer, np.ndarray, np.ndarray]:
    """What an orthographic camera sees, and the rays of these pixels: origins (m, 3), and their one direction."""
    camera = perspective(bench, azimuth, elevation)
    gbuffer, places = seen(bench, camera, "orthographic")
    right, up, forward = camera.basis()
    pixel = 2.0 * np.linalg.norm(np.subtract(camera.target, camera.eye)) * np.tan(np.radians(20.0)) / SIZE
    return gbuffer, camera.target + pixel * places @ np.stack([right, up]), forward


@pytest.mark.parametrize(("azimuth", "elevation"), WAYS)
def test_points_lie_on_parallel_rays_through_pixels(bench: Workbench, azimuth: float, elevation: float) -> None:
    gbuffer, origins, forward = parallel_rays(bench, azimuth, elevation)
    away = world(gbuffer) - origins
    assert len(away) > 500
    assert np.abs(away - (away @ forward)[:, None] * forward).max() < 1e-4


@pytest.mark.parametrize(("azimuth", "elevation"), WAYS)
def test_the_nearest_point_of_the_ball_is_seen(bench: Workbench, azimuth: float, elevation: float) -> None:
    gbuffer, origins, forward = parallel_rays(bench, azimuth, elevation)
    origins -= bench.scene.volume.world_centre
    b = origins @ forward
    inside = 12.0**2 - (origins**2).sum(axis=1) + b**2
    hit = origins + (-b - np.sqrt(np.maximum(inside, 0.0)))[:, None] * forward
    found, clear = world(gbuffer) - bench.scene.volume.world_centre, inside > 20.0
    assert clear.sum() > 400
    assert np.linalg.norm(found - hit, axis=1)[clear].max() < 0.15


def off_affine(gbuffer: GBuffer, places: np.ndarray) -> float:
    """By how many pixels the best affine map from the world to the picture is wrong, at most."""
    points = np.column_stack([world(gbuffer), np.ones(len(places))])
    fit, *_ = np.linalg.lstsq(points, places, rcond=None)
    return float(np.abs(points @ fit - places).max())


@pytest.mark.parametrize(("azimuth", "elevation"), WAYS)
def test_lines_that_are_parallel_stay_parallel(bench: Workbench, azimuth: float, elevation: float) -> None:
    camera = perspective(bench, azimuth, elevation)
    assert off_affine(*seen(bench, camera, "orthographic")) < 1e-3
    assert off_affine(*seen(bench, camera, "perspective")) > 1.0


def test_distance_is_scale_alone(bench: Workbench) -> None:
    near, far = (seen(bench, perspective(bench, 35.0, 28.0, distance), "orthographic")[0] for distance in (0.6, 1.2))
    pixels = {int(pixel): point for pixel, point in zip(far.pixels, world(far), strict=True)}
    camera = perspective(bench, 35.0, 28.0)
    right, up, _ = camera.basis()
    spans = [np.ptp(points @ right) for points in (world(near), world(far))]
    half = 0.6 * bench.scene.volume.radius * np.tan(np.radians(20.0))
    assert spans[0] <= 2.0 * half < spans[1] + 2.0 * half / SIZE and len(pixels) > 500
    assert np.abs((world(near) - camera.target) @ np.stack([right, up]).T).max() < half


def test_what_is_behind_the_eye_is_seen(bench: Workbench) -> None:
    within = perspective(bench, 35.0, 28.0, 0.05)
    gbuffer, _ = seen(bench, within, "orthographic")
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
