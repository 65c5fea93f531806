"""Cameras that show the whole surface, and parallel rays."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from isogi_core.files.vector import Vector
from isogi_core.frame.fitting import Stand, fitted, fitted_to_all
from isogi_core.frame.gbuffer import GBuffer
from isogi_core.model.choices import PROJECTIONS
from isogi_core.model.view import Camera, View, orbit, orthographic
from isogi_core.model.volume import Orientation, make_volume
from isogi_core.plan.isovalue_presets import front_of
from isogi_core.plan.scene import Scene
from tests.frame.conftest import Workbench, ball, scene_of
from tests.loaded import load_scene

SCENE = load_scene("demo:orbital")


def outside(bench: Workbench, found: tuple[Vector, float], azimuth: float, elevation: float) -> int:
    """Pixels of the surface outside of the picture of a fitted camera, in one of three times the
    height and the width about it.
    """
    size = 240
    fov = 2.0 * np.degrees(np.arctan(3.0 * np.tan(np.radians(15.0))))
    camera = orbit(found[0], bench.scene.volume.radius, azimuth, elevation, found[1], fov)
    view = View(bench.scene.isovalue, bench.scene.in_box(camera), width=size, height=size)
    row, column = np.divmod(bench.renderer.gbuffer(view).pixels.astype(np.int64), size)
    assert len(row) > 20
    third = size // 3
    inside = (row >= third) & (row < 2 * third) & (column >= third) & (column < 2 * third)
    return int((~inside).sum())


def rod_and_speck() -> np.ndarray:
    """A long rod in a corner of the box, and a speck far from it."""
    voxels = np.zeros((40, 48, 64), np.float32)
    voxels[4:9, 3:8, 2:55] = 1.0
    voxels[31:33, 40:42, 5:7] = 1.0
    return voxels


def pillar() -> np.ndarray:
    """A high pillar beside the middle of its box."""
    voxels = np.zeros((64, 40, 40), np.float32)
    voxels[2:60, 22:30, 5:12] = 1.0
    return voxels


@pytest.mark.parametrize("elevation", [0.0, 25.0, -60.0])
@pytest.mark.parametrize("make", [rod_and_speck, pillar])
def test_no_turn_moves_the_surface_out_of_the_picture(
    make: Callable[[], np.ndarray], elevation: float, tmp_path: Path
) -> None:
    """At every azimuth all of it is inside, and at one of them it is as large as the margin
    allows.
    """
    bench = Workbench(
        scene_of(make_volume(make(), spacing=(1.0, 1.0, 1.0)), 0.5), tmp_path / "light"
    )
    found = fitted(bench.renderer, bench.view(), 50.0, elevation)
    assert found is not None
    assert [outside(bench, found, azimuth, elevation) for azimuth in range(0, 360, 20)] == [0] * 18
    nearer = (found[0], 0.8 * found[1])
    assert any(outside(bench, nearer, azimuth, elevation) for azimuth in range(0, 360, 20))


def test_the_camera_turns_about_the_middle_of_the_surface(tmp_path: Path) -> None:
    """Whatever the side that it looks from first, also where the box is turned in the world."""
    for place in (Orientation(), TURNED):
        volume = replace(make_volume(rod_and_speck()), orientation=place)
        bench = Workbench(scene_of(volume, 0.5), tmp_path / "light")
        found = [fitted(bench.renderer, bench.view(), side, 25.0) for side in (0.0, 50.0, 200.0)]
        assert found[0] is not None and found[0] == found[1] == found[2]
        ends = place.to_world(np.argwhere(rod_and_speck() > 0.5)[:, ::-1])
        expected = (ends.min(axis=0) + ends.max(axis=0)) / 2.0
        assert np.abs(np.subtract(found[0][0], expected)).max() < 0.75


EIGHT = {
    "engine_256x256x128_uint8": 70,
    "ct_head_208x256x225_uint8": 64,
    "avm_337x319x154_uint8": 45,
    "mni152_t1_197x233x189_uint8": 140,
    "bucky_32x32x32_uint8": 90,
    "hydrogen3d_64x64x64_float32": 0.1,
    "boston_teapot_256x256x178_uint8": 35,
    "tooth_103x94x161_uint16": 700,
}
"""Shared volumes, and isovalues that show them."""


@pytest.mark.slow
@pytest.mark.parametrize("name", EIGHT)
def test_a_whole_turn_keeps_real_surfaces_inside(
    name: str, shared_data: Path, tmp_path: Path
) -> None:
    scene = load_scene(shared_data / f"{name}.nhdr", isovalue=EIGHT[name])
    bench = Workbench(scene, tmp_path)
    azimuth, elevation = scene.front
    found = fitted(bench.renderer, bench.view(), azimuth, elevation)
    assert found is not None
    turns = range(0, 360, 15)
    assert not any(outside(bench, found, azimuth + turn, elevation) for turn in turns)


GLOWING_BALL = {"sphere": [85.0, 12.0, 47.0, 8.0]}


def reach_of(
    bench: Workbench, found: tuple[Vector, float], point: list[float], radius: float
) -> float:
    """How far a ball reaches in the picture of the fitted camera, 1 at its edges, at the azimuth
    where that is farthest.
    """
    reached = []
    for azimuth in range(0, 360, 5):
        camera = orbit(found[0], bench.scene.volume.radius, azimuth, 20.0, found[1], 30.0)
        away = np.array(point) - camera.eye
        right, up, forward = camera.basis()
        aside = max(abs(away @ right), abs(away @ up)) + radius
        reached.append(aside / (away @ forward) / np.tan(np.radians(15.0)))
    return max(reached)


@pytest.mark.parametrize("size", [(1, 400), (400, 1), (300, 200)])
def test_no_picture_is_fitted_by_rays(
    size: tuple[int, int], workbench: Callable[[Scene], Workbench], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The points of the surface alone decide, however long the picture is."""
    renderer = workbench(scene_of(ball(), 0.0)).renderer
    monkeypatch.setattr(renderer.surface, "gbuffer", lambda *_: pytest.fail("rays are cast"))
    view = replace(workbench(scene_of(ball(), 0.0)).view(), width=size[0], height=size[1])
    assert fitted(renderer, view, 30.0, 20.0) is not None


def test_what_glows_beside_the_surface_is_seen_whole(tmp_path: Path) -> None:
    """A ball at the box's edge, and a mist of values as far as these go in its box."""
    *middle, radius = GLOWING_BALL["sphere"]
    found = {}
    for name, glow in (
        ("none", {}),
        ("ball", {"glow": [GLOWING_BALL]}),
        ("bright", {"glow": [{"values": [0.02, 0.03]}]}),
        ("mist", {"glow": [{"values": [0.003, 0.03]}]}),
        ("boxed", {"glow": [{"values": [0.003, 0.03], "box": [[40, 40, 40], [50, 50, 50]]}]}),
    ):
        bench = Workbench(load_scene("demo:orbital", isovalue=0.02, **glow), tmp_path / name)
        fit = fitted(bench.renderer, bench.view(size=16), 30.0, 20.0)
        assert fit is not None
        found[name] = fit
    assert reach_of(bench, found["none"], middle, radius) > 1.05
    assert 0.8 < reach_of(bench, found["ball"], middle, radius) < 1.0
    assert found["bright"] == found["boxed"] == found["none"]
    assert found["mist"][1] > 1.1 * found["none"][1]


def test_a_room_is_seen_whole_and_a_wide_floor_is_not(tmp_path: Path) -> None:
    room = Workbench(load_scene("demo:orbital", room="cornell"), tmp_path / "room")
    alone = Workbench(load_scene("demo:orbital"), tmp_path / "alone")
    floor = {"corner": [-900, -900, -4], "edges": [[2000, 0, 0], [0, 2000, 0]]}
    wide = Workbench(load_scene("demo:orbital", walls=[floor]), tmp_path / "wide")
    inside, without, on_floor = (
        fitted(each.renderer, each.view(size=16), 90.0, 5.0) for each in (room, alone, wide)
    )
    assert inside is not None and without is not None and on_floor is not None
    camera = orbit(inside[0], room.scene.volume.radius, 90.0, 5.0, inside[1], 30.0)
    right, up, forward = camera.basis()
    reached = []
    for wall in room.scene.lighting.room.walls:
        for a, b in ((0, 0), (0, 1), (1, 0), (1, 1)):
            away = np.array(wall.corner) + a * np.array(wall.edges[0]) + b * np.array(wall.edges[1])
            away -= camera.eye
            reached.append(max(abs(away @ right), abs(away @ up)) / (away @ forward))
    assert 0.9 < max(reached) / np.tan(np.radians(15.0)) < 1.0, "all of it, and as near as can be"
    assert without[1] < on_floor[1] < inside[1] + 0.5


def test_the_longer_side_lies_across_the_first_picture() -> None:
    cube, long, wide = (
        front_of(make_volume(np.zeros(shape)), False)
        for shape in ((4, 8, 8), (4, 16, 8), (4, 8, 80))
    )
    assert 30.0 < cube[0] < 60.0, "two sides are seen"
    assert 10.0 < cube[1] < 45.0, "from a little above"
    assert 10.0 < long[0] < cube[0] < wide[0] < 80.0, "no side is seen straight on"
    assert long[1] == wide[1] == cube[1]


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
    assert 0.9 < reach.max() < 1.0
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
