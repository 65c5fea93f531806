"""Paths in rooms: one ray at a time, and closed forms."""

import numpy as np
import pytest

from isogi_core.kernels.tracing.walls import NO_WALL
from isogi_core.kernels.transport.colours import NO_COLOURS, colours_of
from isogi_core.kernels.transport.paths import SampleRange
from tests.kernels.fields import field_of
from tests.kernels.rooms import X, Y, Z, box, gather, room_of, sky, starts_in, wall
from tests.kernels.transport.lighting import BALL, LIGHTS, NOISY, on_ball
from tests.oracles.paths import gathered, one_surface
from tests.scale import few

EMPTY = field_of(np.full((3, 3, 3), -1.0) + np.linspace(0.0, 0.5, 3))
"""A field without a surface at 0."""


@pytest.mark.slow
@pytest.mark.parametrize("light", LIGHTS)
@pytest.mark.parametrize("coloured", [False, True])
def test_paths_in_rooms_are_those_of_one_ray_at_a_time(light: str, coloured: bool) -> None:
    """A floor, a lit panel with two sides, and one with a dark back, about a surface with one
    albedo or colours.
    """
    (samples,) = few((64,), (16,))
    field = field_of(NOISY, (0.5, 1.0, 2.0))
    codes = np.random.default_rng(4).integers(1, 256, (21, 41, 41))
    colours = colours_of(
        codes.astype(np.uint8), (2.0, 1.0, 2.0), np.random.default_rng(5).random((256, 3))
    )
    walls = [
        wall((-20.0, -20.0, -2.0), 80.0 * X, 80.0 * Y, 0.6),
        wall((1.0, 10.0, 85.0), 9.0 * Y, 14.0 * X, 0.3, 5.0),
    ]
    walls.append(wall((-3.0, 0.0, 0.0), 40.0 * Y, 80.0 * Z, 0.9, 0.5, twofold=True))
    room = room_of(walls, field.spacing, 0.5, colours if coloured else NO_COLOURS)
    points, normals = on_ball(5)
    starts = (
        [*(points.T * field.spacing), (11.0, 15.0, -2.0)],
        [*normals.T, Z],
        [*[NO_WALL] * 5, 0.0],
    )
    found = gather(field, room, starts, samples, 3, LIGHTS[light], survival=0.7)
    given = starts_in(field, *starts), SampleRange(0, samples), 3, LIGHTS[light]
    expected = gathered(one_surface(field, 0.0, 0.5, room), *given, survival=0.7)[:, :, 0].mean(
        axis=1
    )
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    assert (found > 0.0).all()


@pytest.mark.parametrize("survival", [1.0, 0.6])
def test_a_closed_room_that_glows_all_over(survival: float) -> None:
    """L (1 - ρ^(n + 1)) / (1 - ρ) arrives at its walls, and no sky."""
    (samples,) = few((4096,), (64,))
    room = room_of(box(40.0, 0.5, 2.0), albedo=0.5)
    points = [(11.0, 14.0, 0.0), (20.0, 0.0, 3.0), (40.0, 1.0, 39.0)]
    normals = [Z, Y, -X]
    found = gather(
        EMPTY, room, (points, normals, [4, 2, 1]), samples, 4, sky(9.0), survival=survival
    )
    expected = 2.0 * (1.0 - 0.5**5) / 0.5
    np.testing.assert_allclose(found.mean(axis=0), expected, rtol=0.005 if samples > 64 else 0.2)


def test_a_glowing_room_lights_a_ball_in_it_evenly() -> None:
    """Black walls of radiance L are all that a convex body sees, whichever way its surface
    looks.
    """
    (samples,) = few((2048,), (64,))
    room = room_of([(corner - 30.0, *rest) for corner, *rest in box(100.0, 0.0, 3.0)])
    points, normals = on_ball(8)
    found = gather(field_of(BALL), room, (points.T, normals.T, [NO_WALL] * 8), samples)
    np.testing.assert_allclose(found, 3.0, rtol=1e-3 if samples > 64 else 0.05)


def polygon(p, n, corners):
    """E/π of a polygon of radiance 1 above a point: Σ Θ_i cosγ_i / 2π (Lambert 1760)."""
    towards = [
        np.subtract(corner, p) / np.linalg.norm(np.subtract(corner, p)) for corner in corners
    ]
    total = 0.0
    for a, b in zip(towards, towards[1:] + towards[:1], strict=True):
        across = np.cross(a, b)
        total += np.arccos(a @ b) * (across / np.linalg.norm(across)) @ n
    return abs(total) / (2.0 * np.pi)


def test_floor_points_see_a_lamp_as_a_polygon() -> None:
    (samples,) = few((4096,), (64,))
    corner = np.array([12.0, 10.0, 30.0])
    u = 9.0 * Y
    v = 14.0 * X
    room = room_of([wall((0.0, 0.0, 0.0), 40.0 * X, 40.0 * Y), wall(corner, u, v, radiance=5.0)])
    points = [(19.0, 14.5, 0.0), (1.0, 2.0, 0.0), (39.0, 39.0, 0.0), (19.0, 14.0, 28.0)]
    found = gather(EMPTY, room, (points, [Z] * 4, [0] * 4), samples)[:, 0]
    expected = [
        5.0 * polygon(p, Z, [corner, corner + u, corner + u + v, corner + v]) for p in points
    ]
    np.testing.assert_allclose(found, expected, rtol=0.005 if samples > 64 else 0.5)


def test_what_stands_before_a_lamp_shadows_it() -> None:
    (samples,) = few((256,), (8,))
    lamp = wall((10.0, 10.0, 30.0), 8.0 * Y, 8.0 * X, radiance=5.0)
    screen = wall((5.0, 5.0, 20.0), 18.0 * X, 18.0 * Y)
    room = room_of([wall((0.0, 0.0, 0.0), 40.0 * X, 40.0 * Y), lamp, screen])
    starts = [(14.0, 14.0, 0.0), (39.0, 39.0, 0.0), (14.0, 14.0, 35.0)], [Z, Z, -Z], [0, 0, NO_WALL]
    dark, beside, behind = gather(EMPTY, room, starts, samples)[:, 0]
    assert dark == 0.0
    assert beside > 0.0
    assert behind == 0.0  # a lamp is dark from behind


def test_a_black_ball_over_a_floor_under_a_sky() -> None:
    """E = π L (1 - (R/h)²) right below it."""
    (samples,) = few((4096,), (64,))
    floor = room_of([wall((-400.0, -400.0, -4.0), 900.0 * X, 900.0 * Y, 0.5)])
    found = gather(field_of(BALL), floor, ([(20.0, 20.0, -4.0)], [Z], [0]), samples, light=sky(2.0))
    np.testing.assert_allclose(
        found, 2.0 * (1.0 - (12.0 / 24.0) ** 2), rtol=0.005 if samples > 64 else 0.2
    )
