"""Stiff fields: light is that of the path tracer on masks, ramps and terraces, and thin walls are
dark behind.
"""

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest

from isogi_core.model.view import Camera, View
from isogi_core.model.volume import make_volume
from isogi_core.plan.scene import Scene
from isogi_report.bench import Bench
from isogi_report.metrics import luminance_of
from tests.stability.scenes import (
    frame_of,
    renderer_of,
    scene_of,
    scenes_of,
    surface_light,
    view_of,
)
from tests.stability.volumes import STIFF, ball, body, grid, ramp

TARGET = 0.02
"""The relative error that light is baked to, as by default."""

MOST = {
    "mask": 2.5 * TARGET,
    "mask of bytes": 2.5 * TARGET,
    "ramp of a voxel": 2.0 * TARGET,
    "terraces": 2.0 * TARGET,
    "metal in a scan": 2.0 * TARGET,
    "gradients apart by 1e6": 2.0 * TARGET,
}
"""The relative RMSE of each specimen's light at most: the target, and as much again as texels lie
beside pixels.

Masks may err by half as much more: they are also looked at near their ends, half a voxel from where
texels are lit.
"""

DARK = 0.5
"""Share of its light that a pixel lacks where it counts as dark."""

SOLID = 4
ROOM = 12
"""Voxels of solid around both rooms, and of a room, along each axis."""

DEPTH = ROOM + 2 * SOLID
MIDDLE = (DEPTH - 1) / 2


@cache
def against_paths(name: str) -> tuple[float, int]:
    """The worst relative RMSE of a specimen's frames against paths from each pixel, and how many
    pixels are dark.
    """
    worst = 0.0
    dark = 0
    for scene in scenes_of(name, STIFF[name], target_error=TARGET):
        with TemporaryDirectory() as folder:
            bench = Bench(scene, view_of(scene, 24), Path(folder))
            radiance = bench.planned.frame().radiance
            best = bench.reference(128)
        lacks = luminance_of(best.mean - radiance)
        dark += int((lacks > DARK * luminance_of(best.mean)).sum())
        worst = max(worst, bench.score(radiance, best).rmse)
    return worst, dark


@pytest.mark.parametrize("name", MOST)
def test_light_is_that_of_the_path_tracer(name: str) -> None:
    assert against_paths(name)[0] <= MOST[name]


def test_hardly_any_pixel_lacks_half_its_light() -> None:
    """A known fault: of all stiff specimens four pixels may.

    Just beside the isovalue of a plateau the surface lies half a voxel from where its texels are
    lit: in the corner of a crease a pixel may read one that is shut in.
    """
    assert sum(against_paths(name)[1] for name in MOST) <= 4


@pytest.mark.parametrize("width", [4.0, 1.0, 0.5, 0.0], ids="{:g} voxels wide".format)
def test_light_on_thin_ramps_is_as_good_as_on_wide_ones(width: float, tmp_path: Path) -> None:
    """Texels at the edge of a plateau are lit half-way down it: in their own places a mask's err by
    5.6 %.
    """
    scene = scene_of(make_volume(ramp(body(), width)), 0.5, target_error=0.01)
    bench = Bench(scene, view_of(scene, 32), tmp_path)
    assert bench.score(bench.planned.frame().radiance, bench.reference(256)).rmse <= 0.02


def test_the_outline_of_a_mask_of_a_ball_is_its_disc() -> None:
    """From afar it covers the disc's area to half a voxel of radius, from wherever one looks."""
    radius = 20.3
    side = 48
    pixels = 256
    distance = 100.0
    fov = 0.9
    volume = make_volume(ramp(ball(grid(side, side, side), (0.0, 0.0, 0.0), radius), 0.0))
    scene = scene_of(volume, 0.5)
    across = 2.0 * distance * volume.radius * np.tan(np.radians(fov / 2))
    with renderer_of(scene) as renderer:
        for azimuth, elevation in np.random.default_rng(2).uniform((0, -80), (360, 80), (6, 2)):
            view = view_of(
                scene, pixels, azimuth=azimuth, elevation=elevation, distance=distance, fov=fov
            )
            covered = len(renderer.gbuffer(view).pixels) / pixels**2
            assert across * np.sqrt(covered / np.pi) == pytest.approx(radius, abs=0.5)


def rooms(wall: int, lit: int, slope: float = 0.0) -> np.ndarray:
    """Two rooms side by side along x; ``lit`` is the one without a roof.

    The wall between them is so many voxels thick, and leans by ``slope`` along y; its ramps are a
    voxel wide.
    """
    width = DEPTH + wall + ROOM
    z, y, x = np.ogrid[:DEPTH, :DEPTH, :width]
    away = abs(x - (width - 1) / 2 + slope * (y - MIDDLE)) / np.hypot(1.0, slope)
    free = (x >= SOLID) & (x < width - SOLID) & (abs(y - MIDDLE) < ROOM / 2) & (z >= SOLID)
    free &= (z < SOLID + ROOM) | ((x > (width - 1) / 2 - slope * (y - MIDDLE)) == bool(lit))
    return np.where(free, np.clip((wall + 1) / 2 - away, 0.0, 1.0), 1.0).astype(np.float32)


def inside(room: int, wall: int) -> View:
    """From the back of a room at the wall between both."""
    way = 1 if room == 0 else -1
    middle = MIDDLE + room * (wall + ROOM)
    eye = (middle - way * 0.4 * ROOM, MIDDLE, MIDDLE)
    target = (middle, MIDDLE, MIDDLE)
    return View(0.5, Camera(eye, target, fov=80.0), width=16, height=16)


def light_by_texels(scene: Scene, view: View) -> float:
    """Mean luminance that texels give the surface of a view."""
    return float(surface_light(frame_of(scene, view, 64)).mean())


def light_by_paths(scene: Scene, view: View) -> float:
    """Mean luminance that paths give the surface of a view."""
    with TemporaryDirectory() as folder:
        reference = Bench(scene, view, Path(folder)).reference(64)
    return float(luminance_of(reference.mean[reference.on]).mean())


@pytest.mark.parametrize("lit", [0, 1], ids=["from the left", "from the right"])
@pytest.mark.parametrize(
    ("wall", "slope", "most"),
    [
        # A texel in the corner where three walls of one voxel meet is lit on one side, and read
        # from the other too.
        pytest.param(1, 0.0, 0.04, id="a voxel, upright"),
        pytest.param(2, 0.0, 0.01, id="2 voxels, upright"),
        pytest.param(3, 0.0, 0.01, id="3 voxels, upright"),
        # Cells that a leaning wall of one voxel runs through have texels of both its sides at their
        # corners.
        pytest.param(1, 0.3, 0.3, id="a voxel, leaning"),
        pytest.param(2, 0.3, 0.01, id="2 voxels, leaning"),
        pytest.param(3, 0.3, 0.01, id="3 voxels, leaning"),
    ],
)
def test_a_closed_room_beside_an_open_one_is_dark(
    wall: int, slope: float, most: float, lit: int
) -> None:
    """By texels to a share of the open room's light, and by paths to a thousandth of it."""
    scene = scene_of(make_volume(rooms(wall, lit, slope)), 0.5, target_error=0.1)
    near, far = (inside(room, wall) for room in (lit, 1 - lit))
    open_light = light_by_texels(scene, near)
    assert open_light > 0.1
    assert light_by_texels(scene, far) <= most * open_light
    assert light_by_paths(scene, far) <= 1e-3 * light_by_paths(scene, near)
