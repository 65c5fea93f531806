"""Rays among walls: the same bits in lanes as in numbers, what the camera sees of them, and depth
peels.
"""

import math

import numpy as np
import pytest
from numba import njit

from isogi_core.kernels.tracing.camera import WINDOW_FACE, Pinhole, Sight, trace_pixels
from isogi_core.kernels.tracing.intersect import SOLID_SIGN, UNKNOWN_SIDE, cast
from isogi_core.kernels.tracing.peels import (
    FIRST_WALL_SIDE,
    MAX_PEELED_LAYERS,
    MAX_SURFACES,
    Peeled,
    Shells,
    peel_rays,
)
from isogi_core.kernels.tracing.vec import column, madd
from isogi_core.kernels.tracing.walls import NO_WALL, meet_walls, nearest_wall
from tests.kernels.fields import cells_of, field_of, surface_of
from tests.kernels.rooms import X, Y, Z, box, room_of, wall
from tests.kernels.transport.lighting import NOISY
from tests.scale import few

SPACING = (0.5, 1.0, 2.0)


@njit(cache=True)
def one_by_one(walls, origins, directions, own, t, met):
    for m in range(len(t)):
        t[m], met[m] = nearest_wall(walls, column(origins, m), column(directions, m), own[m], t[m])


@njit(cache=True)
def together(walls, origins, directions, own, t, met):
    meet_walls(walls, origins, directions, own, t, met)


def test_lanes_meet_the_walls_that_numbers_do() -> None:
    (count,) = few((4096,), (64,))
    draw = np.random.default_rng(3)
    slanted = wall((3.0, 1.0, 2.0), 2.0 * (X + Y), 3.0 * (X - Y), twofold=True)
    walls = room_of([*box(10.0), slanted], SPACING).walls
    origins = np.ascontiguousarray(draw.uniform(0.0, 10.0, (3, count)) / np.array(SPACING)[:, None])
    directions = draw.normal(size=(3, count))
    own = draw.integers(-1, 7, count).astype(float)
    directions[0, ::7] = 0.0
    found = []
    for each in (one_by_one, together):
        t = np.full(count, 8.0)
        met = np.empty(count)
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
    pixels = np.empty((2, 256), np.uint32)
    points = np.empty((2, 256, 3), np.float32)
    numbers = np.empty(256, np.int8)
    seen, walled = trace_pixels(
        surface_of(field, 0.0), Sight(walls, WHOLE), camera, 0, 16, pixels, points, numbers
    )
    assert seen > 0
    assert seen + walled < 256  # what passes beside the room
    assert 0 in numbers[:walled]
    assert 1 not in numbers[:walled]
    np.testing.assert_allclose(points[1, :walled][numbers[:walled] == 0][:, 0], -10.0, atol=1e-5)
    radii = np.linalg.norm(points[0, :seen] - 10.0, axis=1)
    np.testing.assert_allclose(radii, 4.0, atol=0.1)
    closed = room.walls
    seen, _ = trace_pixels(
        surface_of(field, 0.0), Sight(closed, WHOLE), camera, 0, 16, pixels, points, numbers
    )
    assert seen == 0
    assert math.isfinite(float(points[1, 0, 0]))


EYE = (20.0, -60.0, 22.0)
LEVELS = (6.0, 0.0, 3.5)
CLEARS = (0.0, 0.7, 0.4)
WHOLE = np.empty((0, 4))
"""The planes of no window."""

OBLIQUE = np.array([[0.6, 0.8, 0.0, -28.3], [0.0, -1.0, 0.0, 27.6]])
"""A window that takes away what is in front of an oblique plane, and what is behind another."""

Met = tuple[list[tuple[int, float, float]], float]
"""What a ray meets, (side, way, weight) each, and what is left of it."""

EMPTY = []
BACK = wall((-40.0, 80.0, -40.0), 120.0 * X, 120.0 * Z)
BETWEEN = [
    BACK,
    wall((10.0, 0.0, 15.0), 20.0 * X + 22.0 * Y, 15.0 * Z),
    wall((10.0, -5.0, 25.0), 8.0 * X, 8.0 * Z),
]
"""No walls; one behind all; and with it one through the surfaces, and one before them."""


@njit(cache=True)
def crossings(field, isovalue, eye, d, near, far):
    """All crossings of a ray with a surface between ``near`` and ``far``: (way, side) each."""
    found = [(math.inf, 0) for _ in range(0)]
    t = near
    side = UNKNOWN_SIDE
    while True:
        step, came = cast(field, isovalue, madd(eye, t, d), d, side)
        t += step
        if not t <= far or t == math.inf:
            return found
        found.append((t, came))
        side = -came


def part_seen(window: np.ndarray, d: np.ndarray) -> tuple[float, float]:
    """The part of a ray that a window leaves to see."""
    heights = window[:, :3] @ EYE + window[:, 3]
    slopes = window[:, :3] @ d
    near = max([0.0, *(-heights[slopes > 0.0] / slopes[slopes > 0.0])])
    return near, min([math.inf, *(-heights[slopes < 0.0] / slopes[slopes < 0.0])])


def looked_up(field, p):
    """The trilinear value at a point, -inf outside of the box."""
    low = np.minimum(np.floor(p).astype(int), 39)
    if (p < 0.0).any() or (p > 40.0).any():
        return -math.inf
    x, y, z = p - low
    cell = field.voxels[low[2] : low[2] + 2, low[1] : low[1] + 2, low[0] : low[0] + 2].astype(float)
    return float(np.array([1.0 - z, z]) @ (cell @ np.array([1.0 - x, x]) @ np.array([1.0 - y, y])))


def expected(field, window: np.ndarray, walls, d: np.ndarray) -> Met:
    """What a ray meets, (side, way, weight) each, and what is left of it."""
    end, number = nearest_wall(walls, EYE, tuple(d), NO_WALL, math.inf)
    found, left = expected_before(field, window, d, end)
    if number != NO_WALL and left > 0.0:
        return [*found, (FIRST_WALL_SIDE + int(number), end, left)], 0.0
    return found, left


def expected_before(
    field, window: np.ndarray, d: np.ndarray, end: float
) -> tuple[list[tuple[int, float, float]], float]:
    """The same of surfaces and faces, before the ``end`` of the ray at a wall."""
    near, far = part_seen(window, d)
    if near > min(far, end):
        return [], 1.0
    far = min(far, end)
    if near > 0.0 and looked_up(field, np.array(EYE) + near * d) > LEVELS[0]:
        return [(int(WINDOW_FACE), near, 1.0)], 0.0
    ways = [
        (t, 2 * k + (came == SOLID_SIGN))
        for k, level in enumerate(LEVELS)
        for t, came in crossings(field, level, EYE, tuple(d), near, far)
    ]
    left = 1.0
    found = []
    for t, side in sorted(ways):
        clear = CLEARS[side // 2]
        if left > 0.0 and (
            len(found) < MAX_PEELED_LAYERS - 1
            or (len(found) == MAX_PEELED_LAYERS - 1 and clear == 0.0)
        ):
            found.append((side, t, left * (1.0 - clear)))
            if left * clear >= 1.0 / 512.0:
                left = left * clear
            else:
                left = 0.0
    return found, left


@pytest.mark.parametrize("walls", [EMPTY, BETWEEN], ids=["open", "walls"])
@pytest.mark.parametrize("window", [WHOLE, OBLIQUE], ids=["whole", "window"])
def test_rays_meet_what_one_ray_at_a_time_meets(window: np.ndarray, walls: list) -> None:
    field = field_of(NOISY)
    (side,) = few((16,), (5,))
    maps = [cells_of(field, level) for level in LEVELS]
    shells = Shells(
        field, (*maps, *[maps[0]] * (MAX_SURFACES - 3)), np.array(LEVELS), np.array(CLEARS)
    )
    x, z = np.meshgrid(np.linspace(-0.24, 0.24, side), np.linspace(-0.24, 0.24, side))
    directions = np.ascontiguousarray([x.ravel(), np.ones(x.size), z.ravel()])
    room = (MAX_PEELED_LAYERS + 1) * x.size
    left = np.empty(x.size)
    sight = Sight(room_of(walls, field.spacing).walls, window)
    bytes_of = np.empty((2, room), np.int8)
    peeled = Peeled(
        np.empty(room, np.uint32),
        np.empty((room, 3), np.float32),
        *bytes_of,
        np.empty(room, np.float32),
    )
    count = peel_rays(shells, sight, EYE, directions, peeled, left)
    rays, points, sides, ranks, weights = (each[:count] for each in peeled)
    assert count > x.size // 2 and len(np.unique(sides)) >= 5 + len(walls)
    for ray in range(x.size):
        mine = rays == ray
        d = np.array(column(directions, ray))
        those, rest = expected(field, window, sight.walls, d)
        assert sides[mine].tolist() == [each[0] for each in those]
        assert ranks[mine].tolist() == [
            [one[0] for one in those[:k]].count(each[0]) for k, each in enumerate(those)
        ]
        np.testing.assert_allclose(
            points[mine], [EYE + each[1] * d for each in those] or points[mine], atol=1e-4
        )
        np.testing.assert_allclose(weights[mine], [each[2] for each in those], rtol=1e-6)
        assert left[ray] == pytest.approx(rest)
