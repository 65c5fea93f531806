"""The G-buffer: the conventions of the camera, surfaces that two volumes share, and points of
pictures.
"""

import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from isogi_core.errors import Cancelled
from isogi_core.files.vector import triple
from isogi_core.frame.gbuffer import GBuffer, pinhole, trace
from isogi_core.frame.surface_point import point_at
from isogi_core.frame.tiles import Tiles
from isogi_core.model.view import Camera, View, read_window
from isogi_core.model.volume import Orientation, Volume, make_volume
from isogi_core.plan.scene import Scene
from isogi_core.prepared.prepared_scene import PreparedScene
from tests.frame.conftest import MIDDLE, Workbench, ball, scene_of, shell
from tests.loaded import load_scene

TILES = Tiles(2)


def marks() -> Volume:
    """Three small balls, 12 voxels from the middle along +x (radius 2), +y (radius 3) and +z
    (radius 4).
    """
    z, y, x = np.mgrid[:41, :41, :41] - 20.0
    parts = [
        radius - np.sqrt((x - cx) ** 2 + (y - cy) ** 2 + (z - cz) ** 2)
        for radius, cx, cy, cz in ((2, 12, 0, 0), (3, 0, 12, 0), (4, 0, 0, 12))
    ]
    return make_volume(np.maximum.reduce(parts))


def seen(
    volume: Volume, isovalue: float, azimuth: float, elevation: float = 0.0, size: int = 96
) -> GBuffer:
    """The G-buffer of an orbit view round the middle."""
    scene = scene_of(volume, isovalue)
    view = View(isovalue, scene.camera(azimuth, elevation, 3.0, 30.0), width=size, height=size)
    return trace(view, PreparedScene(scene).surface(view.isovalue), TILES)


def middles(gbuffer: GBuffer) -> dict[str, tuple[float, float]]:
    """Where the three marks are in the picture: (to the right, up) of its middle, by the axis each
    is on.
    """
    y, x = np.divmod(gbuffer.pixels, gbuffer.shape[1])
    axis = np.abs(gbuffer.points - 20.0).argmax(axis=1)
    half = gbuffer.shape[0] / 2
    return {
        name: (float((x + 0.5)[axis == a].mean() - half), float(half - (y + 0.5)[axis == a].mean()))
        for a, name in enumerate("xyz")
    }


@pytest.mark.parametrize(
    ("azimuth", "right", "left", "middle"),
    [(0, "y", "", "x"), (90, "", "x", "y"), (180, "", "y", "x"), (270, "x", "", "y")],
)
def test_azimuth_0_looks_from_x_and_90_from_y_with_z_up(
    azimuth: float, right: str, left: str, middle: str
) -> None:
    places = middles(seen(marks(), 0.0, azimuth))
    assert places["z"][1] > 10 and abs(places["z"][0]) < 1, "+z is at the top, row 0 above it"
    assert abs(places[middle][0]) < 1 and abs(places[middle][1]) < 1
    for name in right:
        assert places[name][0] > 10
    for name in left:
        assert places[name][0] < -10


def test_elevation_90_looks_down_with_the_azimuth_up() -> None:
    places = middles(seen(marks(), 0.0, 0.0, 90.0))
    assert abs(places["z"][0]) < 1 and abs(places["z"][1]) < 1
    assert places["x"][1] < -10, "+x, where azimuth 0 looks from, is at the bottom"
    assert places["y"][0] > 10


def test_pinhole_rays_in_world_space() -> None:
    camera = Camera((10.0, 20.0, 30.0), (1.0, 2.0, 3.0), fov=50.0)
    spacing = (0.5, 2.0, 3.0)
    hole = pinhole(camera, 8, 4, spacing)
    right, up, forward = camera.basis()
    corner, step_right, step_down = (
        np.array(v) * spacing for v in (hole.corner, hole.right, hole.down)
    )
    np.testing.assert_allclose(corner + 4 * step_right + 2 * step_down, forward, atol=1e-12)
    edge = corner + 4 * step_right
    assert edge @ up / (edge @ forward) == pytest.approx(np.tan(np.radians(25.0)))
    assert step_right @ right == pytest.approx(-step_down @ up), "pixels are square"
    np.testing.assert_allclose(np.array(hole.eye) * spacing, camera.eye)


def test_points_and_normals_belong_together() -> None:
    gbuffer = seen(ball(), 0.0, 40.0, 30.0)
    normals = gbuffer.normals(TILES)
    assert gbuffer.normals(TILES) is normals, "found once"
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-5)
    away = (gbuffer.points - 20.0) / np.linalg.norm(gbuffer.points - 20.0, axis=1, keepdims=True)
    assert (away * normals).sum(axis=1).min() > 0.999
    towards = gbuffer.eye - gbuffer.points
    assert (towards * normals).sum(axis=1).min() > -0.2 * np.linalg.norm(towards, axis=1).max(), (
        "none is behind"
    )


def test_positions_are_the_points_in_world_units() -> None:
    gbuffer = seen(ball(42, 15.0, (1.0, 1.0, 3.0)), 0.0, 0.0, size=64)
    assert (np.diff(gbuffer.pixels.astype(int)) > 0).all()
    position = gbuffer.position
    assert position.shape == (64, 64, 3)
    assert np.array_equal(
        position.reshape(-1, 3)[gbuffer.pixels], gbuffer.points * np.array([1, 1, 3], np.float32)
    )
    on = position.any(axis=-1)
    assert on.sum() == len(gbuffer.pixels)
    assert np.abs(np.linalg.norm(position[on] - 21.0, axis=1) - 15.0).max() < 0.6


def test_a_picture_of_nothing_has_no_points() -> None:
    gbuffer = seen(ball(), 11.999, 0.0, size=1)
    empty = seen(make_volume(np.zeros((5, 5, 5))), 0.0, 0.0, size=8)
    assert len(gbuffer.pixels) <= 1
    assert len(empty.pixels) == 0
    assert not empty.position.any()


def test_nbytes_counts_points_and_normals() -> None:
    gbuffer = seen(ball(), 0.0, 0.0, size=64)
    before = gbuffer.nbytes
    gbuffer.normals(TILES)
    assert gbuffer.nbytes == before == len(gbuffer.pixels) * (4 + 12 + 12)


@pytest.mark.parametrize("threads", [1, 3])
def test_threads_change_no_bit(threads: int) -> None:
    scene = scene_of(marks(), 0.0)
    view = View(0.0, scene.camera(30.0, 20.0, 2.5, 30.0), width=50, height=37)
    surface = PreparedScene(scene).surface(view.isovalue)
    one, other = (trace(view, surface, tiles) for tiles in (TILES, Tiles(threads)))
    for name in ("pixels", "points"):
        assert np.array_equal(getattr(one, name), getattr(other, name))


def test_a_cancelled_trace_stops() -> None:
    scene = scene_of(ball(), 0.0)
    cancelled = threading.Event()
    cancelled.set()
    surface = PreparedScene(scene).surface(0.0)
    tiles = TILES.cancelled_by(cancelled)
    with pytest.raises(Cancelled):
        trace(View(0.0, scene.camera(0, 0, 3, 30)), surface, tiles)
    with pytest.raises(Cancelled):
        surface.cells(tiles.run)  # it made no map


@pytest.mark.parametrize("spacing", [(1.0, 1.0, 3.0), (3.0, 1.0, 1.0), (0.5, 1.5, 1.0)])
def test_a_ball_sampled_unevenly_looks_the_same(
    spacing: tuple[float, float, float], workbench: Callable[..., Workbench]
) -> None:
    """To what three times coarser steps lose: the rim moves by less than a pixel, the light by a
    few per cent.
    """
    size = 42
    even, uneven = (
        workbench(scene_of(ball(size, 15.0, steps), 0.0)) for steps in ((1.0, 1.0, 1.0), spacing)
    )
    frames = [
        bench.renderer.render(bench.view(20.0, 30.0, 80, shading="phong"))
        for bench in (even, uneven)
    ]
    both = (frames[0].state > 0) & (frames[1].state > 0)
    assert ((frames[0].state > 0) != (frames[1].state > 0)).sum() < 0.03 * both.sum()
    apart = np.linalg.norm(frames[0].position - frames[1].position, axis=-1)[both]
    assert np.quantile(apart, 0.95) < 0.35 and np.median(apart) < 0.15
    light = [frame.radiance[both].astype(float) for frame in frames]
    assert np.sqrt(((light[0] - light[1]) ** 2).mean()) / light[0].mean() < 0.04


def test_a_part_has_the_points_and_the_normals_of_the_whole() -> None:
    whole = seen(marks(), 0.0, 30.0)
    places = np.arange(0, len(whole.points), 3)
    part = whole.part(places, TILES)
    other = seen(marks(), 0.0, 30.0)
    assert (
        len(places) > 20
        and np.array_equal(part.points, whole.points[places])
        and not len(part.walls.pixels)
    )
    assert part.shown(TILES) is part.shown(TILES)
    assert np.array_equal(part.normals(TILES), other.normals(TILES)[places])
    assert (whole.rows.flat[part.pixels] == places).all() and (whole.rows >= 0).sum() == len(
        whole.points
    )


# --- points of pictures
# -----------------------------------------------------------------------------------------------


TURNED = Orientation(
    ((0.0, -1.0, 0.0), (0.6, 0.0, -0.8), (0.8, 0.0, 0.6)), (100.0, -50.0, 7.0), "mm", "LPS"
)


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
    frame = turned.renderer.render(view)
    camera = view.camera.in_world(TURNED)
    right, up, forward = camera.basis()
    pixel = 2.0 * np.tan(np.radians(camera.fov / 2.0)) / view.height
    ray = forward + pixel * ((40.5 - view.width / 2) * right + (view.height / 2 - 25.5) * up)
    point = point_at(frame, 40, 25, turned.scene)
    assert point is not None
    away = np.subtract(point.position, camera.eye)
    assert np.cross(away / np.linalg.norm(away), ray / np.linalg.norm(ray)) == pytest.approx(
        0.0, abs=1e-5
    )


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


def test_the_face_of_a_window_has_its_value_and_its_plane(
    workbench: Callable[[Scene], Workbench],
) -> None:
    bench = workbench(scene_of(shell(), 0.0))
    view = View(
        0.0, bench.scene.camera(0.0, 0.0, 3.0, 30.0), width=48, height=48, shading="lambert"
    )
    frame = bench.renderer.render(replace(view, window=read_window("x>16")))
    row, column = divmod(int(frame.gbuffer.faces.pixels[len(frame.gbuffer.faces.pixels) // 3]), 48)
    point = point_at(frame, column, row, bench.scene)
    assert point is not None and point.value is not None
    assert point.normal == (1.0, 0.0, 0.0) and point.position[0] == pytest.approx(16.0, abs=1e-4)
    away = float(np.linalg.norm(np.subtract(point.position, MIDDLE)))
    assert point.value == pytest.approx(min(12.0 - away, away - 6.0), abs=0.1) and point.value > 0.0
