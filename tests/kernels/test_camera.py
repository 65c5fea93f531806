"""The camera: rays through pixels against NumPy, and the G-buffer of surfaces that can be told in closed form."""

import math

import numpy as np
import pytest
from numba import config

from isogi_core.kernels.camera import Pinhole, pixel_ray, trace_rows
from tests.kernels.test_macrocells import field_of

PYTHON = bool(config.DISABLE_JIT)
SIDE = 12 if PYTHON else 96
Z, Y, X = np.mgrid[:33, :33, :33] - 16.0
BALL = 10.0 - np.sqrt(X * X + Y * Y + Z * Z)
SLOPE = 16.0 - np.broadcast_to(np.arange(33.0)[:, None, None], (33, 33, 33))


def look_down(eye, fov=40.0, width=SIDE, height=SIDE, spacing=(1.0, 1.0, 1.0)):
    """A camera that looks down -z with +x to the right and +y up, written out by hand."""
    pixel = 2.0 * math.tan(math.radians(fov) / 2.0) / height
    x, y, z = spacing
    return Pinhole(
        tuple(a / s for a, s in zip(eye, spacing, strict=True)),
        (-pixel * width / 2.0 / x, pixel * height / 2.0 / y, -1.0 / z),
        (pixel / x, 0.0, 0.0),
        (0.0, -pixel / y, 0.0),
    )


def picture(voxels, iso, camera, width=SIDE, height=SIDE, tile=None, spacing=(1.0, 1.0, 1.0)):
    """Depth (h, w) and position (h, w, 3) of a whole picture, traced in tiles of so many rows."""
    field = field_of(voxels, spacing)
    depth = np.full((height, width), np.nan, np.float32)
    position = np.full((height, width, 3), np.nan, np.float32)
    for first in range(0, height, tile or height):
        rows = slice(first, first + (tile or height))
        trace_rows(field, iso, camera, first, depth[rows], position[rows])
    return depth, position


def pixel_angles(fov, width, height):
    """Tangents (h, w) of the angles right and up of each pixel's centre."""
    right = (np.arange(width) + 0.5 - width / 2.0) / (height / 2.0)
    up = (height / 2.0 - np.arange(height) - 0.5) / (height / 2.0)
    return np.meshgrid(right * math.tan(math.radians(fov) / 2), up * math.tan(math.radians(fov) / 2))


@pytest.mark.parametrize(("width", "height", "fov"), [(7, 5, 40.0), (1, 1, 90.0), (1, 9, 5.0), (64, 2, 170.0)])
def test_pixel_rays_pass_through_pixel_centres(width, height, fov):
    camera = look_down((16, 16, 60), fov, width, height)
    right, up = pixel_angles(fov, width, height)
    for y, x in np.ndindex(height, width):
        ray = pixel_ray(camera, x + 0.5, y + 0.5)
        assert ray == pytest.approx((right[y, x], up[y, x], -1.0), abs=1e-12)


def test_depth_is_the_distance_along_the_view_axis():
    """A plane across the view has one depth, however far aside a pixel looks."""
    depth, position = picture(SLOPE, 0.0, look_down((16, 16, 40), 30.0))
    right, up = pixel_angles(30.0, SIDE, SIDE)
    np.testing.assert_allclose(depth, 24.0, rtol=1e-6)
    np.testing.assert_allclose(position[..., 0], 16.0 + 24.0 * right, atol=1e-5)
    np.testing.assert_allclose(position[..., 1], 16.0 + 24.0 * up, atol=1e-5)
    np.testing.assert_allclose(position[..., 2], 16.0, atol=1e-5)


def test_a_ball_is_hit_where_the_sphere_is():
    depth, position = picture(BALL, 0.0, look_down((16, 16, 66), 30.0))
    right, up = pixel_angles(30.0, SIDE, SIDE)
    a = right**2 + up**2 + 1.0
    inside = 50.0**2 - a * (50.0**2 - 10.0**2)
    expected = np.where(inside >= 0, (50.0 - np.sqrt(np.maximum(inside, 0))) / a, np.inf)
    clear = np.abs(inside) > 60.0
    assert np.array_equal(np.isfinite(depth[clear]), np.isfinite(expected[clear]))
    both = clear & np.isfinite(expected)
    assert np.abs(depth[both] - expected[both]).max() < 0.1
    radius = np.linalg.norm(position[both] - 16.0, axis=-1)
    assert np.abs(radius - 10.0).max() < 0.05
    assert np.isnan(position[~np.isfinite(depth)]).all(), "positions off the surface are left alone"


@pytest.mark.parametrize("tile", [1, 5, 7])
def test_tiles_make_the_same_picture_as_the_whole(tile):
    camera = look_down((16, 16, 60), 35.0)
    for whole, tiled in zip(picture(BALL, 2.0, camera), picture(BALL, 2.0, camera, tile=tile), strict=True):
        assert np.array_equal(whole, tiled, equal_nan=True)


def test_spacing_stretches_the_world_and_leaves_depth_in_world_units():
    spacing = (0.5, 2.0, 3.0)
    camera = look_down((8, 32, 100), 25.0, spacing=spacing)
    depth, position = picture(SLOPE, 0.0, camera, spacing=spacing)
    right, up = pixel_angles(25.0, SIDE, SIDE)
    seen = np.isfinite(depth)
    assert seen.any()
    np.testing.assert_allclose(depth[seen], 100.0 - 16.0 * 3.0, rtol=1e-6)
    np.testing.assert_allclose((position * spacing)[seen][:, 0], 8.0 + 52.0 * right[seen], atol=1e-4)
    np.testing.assert_allclose((position * spacing)[seen][:, 1], 32.0 + 52.0 * up[seen], atol=1e-4)


@pytest.mark.parametrize(
    "eye", [(16, 16, 16), (16, 16, 32), (16.5, 16, 25.9), (16, 16, 33e6), (16, 16, -40), (0, 0, 0)]
)
@pytest.mark.parametrize("fov", [1e-6, 40.0, 179.999])
def test_any_eye_gives_a_picture_of_finite_depths_or_none(eye, fov):
    """Inside the solid, on a face of the box, on the surface, far away, behind, and in a corner."""
    depth, position = picture(BALL, 0.0, look_down(eye, fov, 8, 8), 8, 8)
    hit = np.isfinite(depth)
    assert (depth[hit] >= 0.0).all() and not np.isnan(depth).any()
    assert ((position[hit] >= -1e-3) & (position[hit] <= 32 + 1e-3)).all()


def test_from_within_the_solid_the_surface_is_seen_from_behind():
    depth, _ = picture(BALL, 0.0, look_down((16, 16, 16), 30.0, 3, 3), 3, 3)
    assert depth[1, 1] == pytest.approx(10.0, abs=1e-3)


def test_a_far_eye_sees_what_a_near_one_of_the_same_rays_sees():
    """Parallel rays, nearly: one eye at 1e5 voxels, one at 1e7, each with the angle that frames the ball."""
    views = [picture(BALL, 0.0, look_down((16, 16, 16 + far), math.degrees(2 * 15 / far)))[1] for far in (1e5, 1e7)]
    seen = np.isfinite(views[0]).all(axis=-1) & np.isfinite(views[1]).all(axis=-1)
    assert seen.sum() > 0.25 * SIDE**2
    rim = np.abs(np.linalg.norm(views[0][seen][:, :2] - 16.0, axis=-1) - 10.0) < 0.5
    assert np.abs(views[0][seen] - views[1][seen])[~rim].max() < 1e-2
