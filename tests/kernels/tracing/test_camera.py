"""The camera: rays through pixels against NumPy, and the G-buffer of surfaces that can be told in
closed form.
"""

import math

import numpy as np
import pytest
from numba import njit

from isogi_core.kernels.tracing.camera import NO_WALLS, Pinhole, Sight, pixel_ray, trace_pixels
from isogi_core.kernels.tracing.intersect import UNKNOWN_SIDE, cast
from isogi_core.kernels.tracing.vec import madd
from tests.kernels.fields import field_of, surface_of
from tests.scale import few

SIDE = few(96, 12)
ALONE = Sight(NO_WALLS, np.empty((0, 4)))
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
    """Where each pixel meets the surface, (h, w, 3) in index space, NaN where none is seen, in
    tiles of rays.
    """
    field = field_of(voxels, spacing)
    surface = surface_of(field, float(iso))
    position = np.full((width * height, 3), np.nan, np.float32)
    for first in range(0, width * height, tile or width * height):
        count = min(tile or width * height, width * height - first)
        pixels = np.zeros((2, count), np.uint32)
        points = np.zeros((2, count, 3), np.float32)
        hits, beside = trace_pixels(
            surface, ALONE, camera, first, width, pixels, points, np.zeros(count, np.int8)
        )
        assert beside == 0 and not pixels[1].any()
        assert not points[0, hits:].any() and not pixels[0, hits:].any(), (
            "nothing is written past the hits"
        )
        assert (np.diff(pixels[0, :hits].astype(int)) > 0).all()
        position[pixels[0, :hits]] = points[0, :hits]
    return position.reshape(height, width, 3)


def seen(position):
    """Pixels that show the surface, (h, w)."""
    return np.isfinite(position).all(axis=-1)


@njit(cache=True)
def one_by_one(field, iso, camera, position):
    """The same picture by the scalar caster."""
    for y in range(position.shape[0]):
        for x in range(position.shape[1]):
            d = pixel_ray(camera, x + 0.5, y + 0.5)
            t, _ = cast(field, iso, camera.eye, d, UNKNOWN_SIDE)
            if t < math.inf:
                position[y, x, 0], position[y, x, 1], position[y, x, 2] = madd(camera.eye, t, d)


@pytest.mark.parametrize("eye", [(16, 16, 66), (20, 16, 16), (16.5, 16, 25.9), (3, 4, 66)])
@pytest.mark.parametrize("noise", [0.0, 3.0])
def test_packets_find_the_very_points_of_the_scalar_caster(eye, noise):
    voxels = BALL + np.random.default_rng(4).normal(size=BALL.shape) * noise
    camera = look_down(eye, 50.0)
    expected = np.full((SIDE, SIDE, 3), np.nan, np.float32)
    one_by_one(field_of(voxels), 0.5, camera, expected)
    assert seen(expected).mean() > 0.05
    assert np.array_equal(picture(voxels, 0.5, camera), expected, equal_nan=True)


def pixel_angles(fov, width, height):
    """Tangents (h, w) of the angles right and up of each pixel's centre."""
    right = (np.arange(width) + 0.5 - width / 2.0) / (height / 2.0)
    up = (height / 2.0 - np.arange(height) - 0.5) / (height / 2.0)
    return np.meshgrid(
        right * math.tan(math.radians(fov) / 2), up * math.tan(math.radians(fov) / 2)
    )


@pytest.mark.parametrize(
    ("width", "height", "fov"), [(7, 5, 40.0), (1, 1, 90.0), (1, 9, 5.0), (64, 2, 170.0)]
)
def test_pixel_rays_pass_through_pixel_centres(width, height, fov):
    camera = look_down((16, 16, 60), fov, width, height)
    right, up = pixel_angles(fov, width, height)
    for y, x in np.ndindex(height, width):
        ray = pixel_ray(camera, x + 0.5, y + 0.5)
        assert ray == pytest.approx((right[y, x], up[y, x], -1.0), abs=1e-12)


def test_a_ball_is_hit_where_the_sphere_is():
    position = picture(BALL, 0.0, look_down((16, 16, 66), 30.0))
    depth = 66.0 - position[..., 2]
    right, up = pixel_angles(30.0, SIDE, SIDE)
    a = right**2 + up**2 + 1.0
    inside = 50.0**2 - a * (50.0**2 - 10.0**2)
    expected = np.where(inside >= 0, (50.0 - np.sqrt(np.maximum(inside, 0))) / a, np.nan)
    clear = np.abs(inside) > 60.0
    assert np.array_equal(np.isfinite(depth[clear]), np.isfinite(expected[clear]))
    both = clear & np.isfinite(expected)
    assert np.abs(depth[both] - expected[both]).max() < 0.1
    radius = np.linalg.norm(position[both] - 16.0, axis=-1)
    assert np.abs(radius - 10.0).max() < 0.05


@pytest.mark.parametrize("tile", [1, 100, 4096])
def test_tiles_make_the_same_picture_as_the_whole(tile):
    camera = look_down((16, 16, 60), 35.0)
    whole, tiled = (picture(BALL, 2.0, camera, tile=size) for size in (None, tile))
    assert np.array_equal(whole, tiled, equal_nan=True)


@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (0.5, 2.0, 3.0)])
def test_a_plane_across_the_view_is_met_where_each_pixel_looks(spacing):
    x, y, z = 16.0 * np.array(spacing)
    position = picture(
        SLOPE, 0.0, look_down((x, y, z + 24.0), 25.0, spacing=spacing), spacing=spacing
    )
    right, up = pixel_angles(25.0, SIDE, SIDE)
    hit = seen(position)
    assert hit.mean() > 0.5
    world = np.stack([x + 24.0 * right, y + 24.0 * up, np.full_like(up, z)], axis=-1)
    np.testing.assert_allclose((position * spacing)[hit], world[hit], atol=1e-4)
