"""Points of pictures against closed forms, and against the planes of the same frame."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from isogi_core.files.grid import triple
from isogi_core.frame.surface_point import point_at
from isogi_core.model.orientation import Orientation
from isogi_core.model.view import View, read_window
from isogi_core.model.volume import Volume
from isogi_core.plan.scene import Scene
from tests.frame.conftest import MIDDLE, Workbench, ball, scene_of, shell
from tests.loaded import load_scene

TURNED = Orientation(((0.0, -1.0, 0.0), (0.6, 0.0, -0.8), (0.8, 0.0, 0.6)), (100.0, -50.0, 7.0), "mm", "LPS")


def lambert(bench: Workbench, **settings: float) -> View:
    """A view of a bench's scene, in its volume's world, that needs no light."""
    view = bench.view(shading="lambert", **settings)
    return replace(view, orientation=bench.scene.volume.orientation)


@pytest.fixture
def turned(workbench: Callable[[Scene], Workbench]) -> Workbench:
    """A ball of radius 12 whose box is turned in the world, and whose voxels are no cubes."""
    volume: Volume = replace(ball(spacing=(1.0, 0.5, 2.0)), orientation=TURNED)
    return workbench(scene_of(volume, 0.0))


def test_a_point_of_a_ball_is_where_the_ball_is(turned: Workbench) -> None:
    frame = turned.renderer.render(lambert(turned))
    centre = np.array(turned.scene.volume.world_centre)
    for row, column in ((32, 32), (25, 40), (40, 25)):
        point = point_at(frame, column, row, turned.scene)
        assert point is not None
        away = np.subtract(point.position, centre)
        assert np.linalg.norm(away) == pytest.approx(12.0, abs=0.1)
        assert point.normal == pytest.approx(away / np.linalg.norm(away), abs=0.03)
        affine = TURNED.affine(turned.scene.volume.spacing)
        assert affine[:, :3] @ point.voxel + affine[:, 3] == pytest.approx(point.position, abs=1e-4)


def test_it_is_the_point_under_the_pixels_ray(turned: Workbench) -> None:
    view = lambert(turned)
    frame, camera = turned.renderer.render(view), view.camera.in_world(TURNED)
    right, up, forward = camera.basis()
    pixel = 2.0 * np.tan(np.radians(camera.fov / 2.0)) / view.height
    ray = forward + pixel * ((40.5 - view.width / 2) * right + (view.height / 2 - 25.5) * up)
    point = point_at(frame, 40, 25, turned.scene)
    assert point is not None
    away = np.subtract(point.position, camera.eye)
    assert np.cross(away / np.linalg.norm(away), ray / np.linalg.norm(ray)) == pytest.approx(0.0, abs=1e-5)


def test_off_the_surface_there_is_no_point(turned: Workbench) -> None:
    frame = turned.renderer.render(lambert(turned))
    for row, column in ((0, 0), (0, 63), (63, 0), (63, 63)):
        assert frame.state[row, column] == 0
        assert point_at(frame, column, row, turned.scene) is None


def test_every_pixel_is_told_as_the_frame_has_it(orbital: Workbench) -> None:
    frame = orbital.renderer.render(orbital.view())
    for row, column in np.ndindex(frame.state.shape):
        point = point_at(frame, column, row, orbital.scene)
        assert (point is not None) == (frame.state[row, column] > 0)
        if point is not None:
            assert point.position == pytest.approx(triple(frame.position[row, column]), abs=1e-5)
            assert point.radiance == triple(frame.radiance[row, column])
            assert (point.state, point.wall) == ("final", None)
            assert point.error == frame.total_error[row, column]


def test_a_wall_is_told_by_its_number(tmp_path: Path) -> None:
    bench = Workbench(load_scene("demo:orbital", room="cornell"), tmp_path)
    frame = bench.renderer.render(lambert(bench, azimuth=90.0, elevation=5.0, distance=2.5))
    walls = bench.scene.lighting.room
    seen = set()
    for pixel, number in zip(frame.gbuffer.walls.pixels, frame.gbuffer.walls.numbers, strict=True):
        point = point_at(frame, int(pixel) % 64, int(pixel) // 64, bench.scene)
        assert point is not None and point.wall == number
        seen.add(number)
        u, v = walls.walls[number].edges
        eye = np.array(frame.view.camera.eye)
        assert np.dot(point.normal, u) == pytest.approx(0.0, abs=1e-6 * np.linalg.norm(u))
        assert np.dot(point.normal, v) == pytest.approx(0.0, abs=1e-6 * np.linalg.norm(v))
        assert np.dot(point.normal, eye - point.position) > 0.0
    assert len(seen) >= 4


def test_coordinates_lie_on_sides_of_a_patient() -> None:
    assert TURNED.sides((1.0, -2.0, 3.0)) == "LAS"
    assert TURNED.sides((-1.0, 0.0, -3.0)) == "RPI"
    assert Orientation().sides((1.0, 2.0, 3.0)) == ""


def test_the_face_of_a_window_has_its_value_and_its_plane(workbench: Callable[[Scene], Workbench]) -> None:
    bench = workbench(scene_of(shell(), 0.0))
    view = View(0.0, bench.scene.camera(0.0, 0.0, 3.0, 30.0), width=48, height=48, shading="lambert")
    frame = bench.renderer.render(replace(view, window=read_window("x>16")))
    row, column = divmod(int(frame.gbuffer.faces.pixels[len(frame.gbuffer.faces.pixels) // 3]), 48)
    point = point_at(frame, column, row, bench.scene)
    assert point is not None and point.value is not None
    assert point.normal == (1.0, 0.0, 0.0) and point.position[0] == pytest.approx(16.0, abs=1e-4)
    away = float(np.linalg.norm(np.subtract(point.position, MIDDLE)))
    assert point.value == pytest.approx(min(12.0 - away, away - 6.0), abs=0.1) and point.value > 0.0
