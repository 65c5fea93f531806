"""Rays and walls: the same bits in lanes as in numbers, and what the camera sees of them."""

import math

import numpy as np
from numba import njit

from isogi_core.kernels.tracing.camera import Pinhole, Sight, trace_pixels
from isogi_core.kernels.tracing.vec import column
from isogi_core.kernels.tracing.walls import NO_WALL, meet_walls, nearest_wall
from tests.kernels.fields import field_of, surface_of
from tests.kernels.rooms import X, Y, box, room_of, wall
from tests.scale import few

SPACING = (0.5, 1.0, 2.0)
WHOLE = np.empty((0, 4))
"""The planes of no window."""


@njit
def one_by_one(walls, origins, directions, own, t, met):
    for m in range(len(t)):
        t[m], met[m] = nearest_wall(walls, column(origins, m), column(directions, m), own[m], t[m])


@njit
def together(walls, origins, directions, own, t, met):
    meet_walls(walls, origins, directions, own, t, met)


def test_lanes_meet_the_walls_that_numbers_do() -> None:
    (count,) = few((4096,), (64,))
    draw = np.random.default_rng(3)
    slanted = wall((3.0, 1.0, 2.0), 2.0 * (X + Y), 3.0 * (X - Y), twofold=True)
    walls = room_of([*box(10.0), slanted], SPACING).walls
    origins = np.ascontiguousarray(draw.uniform(0.0, 10.0, (3, count)) / np.array(SPACING)[:, None])
    directions, own = draw.normal(size=(3, count)), draw.integers(-1, 7, count).astype(float)
    directions[0, ::7] = 0.0
    found = []
    for each in (one_by_one, together):
        t, met = np.full(count, 8.0), np.empty(count)
        each(walls, origins, directions, own, t, met)
        found.append((t, met))
    np.testing.assert_array_equal(found[0], found[1])
    assert set(found[0][1]) == {NO_WALL, *range(7)}
    assert not (found[0][1] == own)[own != NO_WALL].any()


def test_the_camera_looks_through_backs_that_are_dark() -> None:
    """From +x: the near face of a cube is passed, its inside and the ball in it are seen."""
    z, y, x = np.mgrid[:21, :21, :21] - 10.0
    field = field_of(4.0 - np.sqrt(x * x + y * y + z * z))
    room = room_of([(corner - 10.0, *rest) for corner, *rest in box(40.0)])
    walls = room.walls._replace(backs=np.zeros(6))
    camera = Pinhole((80.0, 10.0, 10.0), (-1.0, 0.5, 0.5), (0.0, -0.0625, 0.0), (0.0, 0.0, -0.0625))
    pixels, points = np.empty((2, 256), np.uint32), np.empty((2, 256, 3), np.float32)
    numbers = np.empty(256, np.int8)
    seen, walled = trace_pixels(surface_of(field, 0.0), Sight(walls, WHOLE), camera, 0, 16, pixels, points, numbers)
    assert seen > 0
    assert seen + walled < 256  # what passes beside the room
    assert 0 in numbers[:walled]
    assert 1 not in numbers[:walled]
    np.testing.assert_allclose(points[1, :walled][numbers[:walled] == 0][:, 0], -10.0, atol=1e-5)
    radii = np.linalg.norm(points[0, :seen] - 10.0, axis=1)
    np.testing.assert_allclose(radii, 4.0, atol=0.1)
    closed = room.walls
    seen, _ = trace_pixels(surface_of(field, 0.0), Sight(closed, WHOLE), camera, 0, 16, pixels, points, numbers)
    assert seen == 0
    assert math.isfinite(float(points[1, 0, 0]))
