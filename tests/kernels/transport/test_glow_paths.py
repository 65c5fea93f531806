"""Light of glowing regions, in rooms and among surfaces: one ray at a time, closed forms and brute
force.
"""

import numpy as np
import pytest

from isogi_core.kernels.tracing.glow import gather_from_eye
from isogi_core.kernels.tracing.walls import NO_WALL
from isogi_core.kernels.transport.glow_paths import glow_among_surfaces
from isogi_core.kernels.transport.paths import PathRules, SampleRange
from tests.kernels.fields import field_of
from tests.kernels.glows import ball, block, brute_force, gather_glow, glows_of
from tests.kernels.rooms import X, Y, Z, among, box, room_of, starts_in, wall
from tests.kernels.transport.lighting import BALL, NOISY, on_ball
from tests.oracles.paths import DARK, gathered, one_surface, several_surfaces
from tests.scale import few

RAMP = field_of(np.broadcast_to(np.linspace(-1.0, -0.2, 9), (9, 9, 9)), (5.0, 5.0, 5.0))
"""A field without a surface at 0, which grows along x over 40 units of the world."""

SQUARE = room_of([wall((0.0, 0.0, 0.0), 40.0 * X, 40.0 * Y)], RAMP.spacing)
FLOOR = wall((-400.0, -400.0, -4.0), 900.0 * X, 900.0 * Y, (0.5, 0.3, 0.9))
MIDDLE = [20.0, 20.0, 20.0]


def test_glow_is_that_of_one_ray_at_a_time() -> None:
    """Two regions, one of them of some values only, beside a surface on a floor of a colour."""
    (samples,) = few((64,), (8,))
    points, normals = on_ball(5)
    starts = [*points.T, [30.0, 12.0, -4.0]], [*normals.T, Z], [*[NO_WALL] * 5, 0]
    glows = glows_of(
        ball([34.0, 20.0, 20.0], 6.0, high=-3.0), block([6.0, 20.0, 34.0], [2.0, 4.0, 3.0])
    )
    field = field_of(NOISY)
    room = room_of([FLOOR], albedo=0.6)
    found = gather_glow(field, room, starts, glows, samples, 3, 0.7)
    given = starts_in(field, *starts), SampleRange(0, samples), 3, DARK, glows
    expected = gathered(one_surface(field, 0.0, 0.6, room), *given, survival=0.7)[:, :, 1:].mean(
        axis=1
    )
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    assert found.any(axis=(0, 2)).all()


def test_a_floor_sees_a_glowing_ball_as_a_lambert_ball() -> None:
    """E = π L (r/d)² cosθ, at any distance that leaves all of it above the horizon."""
    (samples,) = few((4096,), (64,))
    centre = np.array([20.0, 20.0, 12.0])
    radius = 3.0
    points = np.array([[20.0, 20.0, 0.0], [8.0, 20.0, 0.0], [39.0, 39.0, 0.0], [20.0, 16.0, 4.5]])
    walls = [0, 0, 0, NO_WALL]
    found = gather_glow(
        RAMP, SQUARE, (points, [Z] * 4, walls), glows_of(ball(centre, radius)), samples
    )[:, 0, 1]
    away = centre - points
    away[3, 2] -= 0.3 * 5.0  # rays from the isosurface start above it
    square = (away**2).sum(axis=1)
    np.testing.assert_allclose(
        found, radius**2 * away[:, 2] / square**1.5, rtol=0.01 if samples > 64 else 0.2
    )


@pytest.mark.parametrize("shape", ["ball", "block"])
def test_a_range_of_values_glows_within_its_region(shape: str) -> None:
    """Values from -0.6 on are those beyond x = 20; a point amid the region is lit too."""
    (samples,) = few((8192,), (256,))
    middle = [20.0, 20.0, 9.0]
    low = -0.6
    if shape == "ball":
        region = ball(middle, 8.0, low)
    else:
        region = block(middle, [8.0, 8.0, 8.0], low)
    points = np.array([[12.0, 20.0, 0.0], [33.0, 30.0, 0.0]])

    def inside(q: np.ndarray) -> np.ndarray:
        return (q[:, 0] >= 20.0) & (
            (np.linalg.norm(q - middle, axis=1) <= 8.0) | (shape == "block")
        )

    found = gather_glow(RAMP, SQUARE, (points, [Z] * 2, [0, 0]), glows_of(region), samples)[:, 0, 0]
    expected = [brute_force(p, Z, region, inside) for p in points]
    np.testing.assert_allclose(found, expected, rtol=0.01 if samples > 256 else 0.2)


@pytest.mark.parametrize("high", [np.inf, -0.45])
def test_a_mask_glows_by_its_nearest_voxels(high: float) -> None:
    """Voxels from number 4 on along x reach to half a voxel before it, x = 17.5; values up to -0.45
    to x = 27.5.
    """
    (samples,) = few((8192,), (256,))
    bits = np.zeros(RAMP.voxels.shape, np.uint8)
    bits[:, :, 4:] = 1
    bits[:, :4] |= 2  # of another region
    region = block([20.0, 20.0, 9.0], [10.0, 8.0, 8.0], high=high)
    points = np.array([[12.0, 20.0, 0.0], [33.0, 30.0, 0.0]])

    def inside(q: np.ndarray) -> np.ndarray:
        return np.asarray((q[:, 0] >= 17.5) & ((q[:, 0] <= 27.5) | np.isinf(high)))

    found = gather_glow(
        RAMP, SQUARE, (points, [Z] * 2, [0, 0]), glows_of(region, bits=bits), samples
    )[:, 0, 0]
    expected = [brute_force(p, Z, region, inside) for p in points]
    np.testing.assert_allclose(found, expected, rtol=0.01 if samples > 256 else 0.2)


@pytest.mark.parametrize("masked", [False, True])
def test_thin_layers_are_as_bright_as_they_are_thick(masked: bool) -> None:
    """Values of a hundredth are half a unit along x, a tenth of a voxel, wherever that lies; longer
    when oblique.
    """
    if masked:
        bits = np.full(RAMP.voxels.shape, 255, np.uint8)
    else:
        bits = None
    regions = [block([20.0] * 3, [20.0] * 3, low, low + 0.01) for low in np.linspace(-0.9, -0.3, 8)]
    directions = np.ascontiguousarray(
        np.array([[0.2, 0.0, 0.0], [0.16, 0.12, 0.0], [0.18, 0.0, 0.1]]).T
    )
    light = np.zeros((3, len(regions)))
    reaches = np.full(3, np.inf)
    gather_from_eye(
        RAMP, glows_of(*regions, bits=bits), (0.0, 0.2, 0.2), directions, reaches, light
    )
    slant = np.linalg.norm(directions, axis=0) / directions[0]
    np.testing.assert_allclose(
        light, np.outer(0.5 * slant, [region[-1] for region in regions]), rtol=1e-5
    )


def test_what_is_behind_the_surface_is_not_lit() -> None:
    """A ball that glows above another one: half of that sees none of it, and none is mixed up with
    a second one.
    """
    (samples,) = few((256,), (16,))
    points, normals = on_ball(64)
    glows = glows_of(ball([20.0, 20.0, 38.0], 2.0), ball([20.0, 20.0, 2.0], 2.0))
    found = gather_glow(
        field_of(BALL), room_of([]), (points.T, normals.T, [NO_WALL] * 64), glows, samples
    )[..., 0]
    above = normals[2] > 0.9
    below = normals[2] < -0.9
    assert (found[above, 0] > 0.0).all() and (found[below, 0] == 0.0).all()
    assert (found[below, 1] > 0.0).all() and (found[above, 1] == 0.0).all()


@pytest.mark.slow
@pytest.mark.parametrize("survival", [1.0, 0.6])
def test_a_closed_room_keeps_what_glows_in_it(survival: float) -> None:
    """Light is kept: E/π is (1 - ρ^(n + 1)) / (1 - ρ) in the mean over the walls, as the rate is
    that of the room.
    """
    count, samples = few((2048, 256), (256, 8))
    side = 40.0
    albedo = 0.5
    bounces = 3
    walls = box(side, albedo)
    room = room_of(walls, RAMP.spacing)
    rng = np.random.default_rng(1)
    numbers = rng.integers(0, 6, count)
    shares = rng.random((count, 2, 1))
    points = room.corners[numbers] + (shares * room.edges[numbers]).sum(axis=1)
    glows = glows_of(block([20.0] * 3, [20.0] * 3))
    starts = points, room.normals[numbers], numbers
    found = gather_glow(RAMP, room, starts, glows, samples, bounces, survival)
    expected = (1.0 - albedo ** (bounces + 1)) / (1.0 - albedo)
    assert found.mean() == pytest.approx(expected, rel=0.01 if samples > 8 else 0.1)


def test_an_eye_gathers_chords() -> None:
    """Rate times chord, as far as the ray goes: of a ball 2 √(r² - b²), of a box its edge."""
    field = field_of(np.full((3, 3, 3), -1.0), (2.0, 4.0, 5.0))
    glows = glows_of(ball([20.0, 0.0, 0.0], 5.0), block([20.0, 0.0, 0.0], [2.0, 9.0, 9.0]))
    directions = np.ascontiguousarray(np.array([[0.5, 0.0, 0.0]] * 4 + [[0.5, -0.05, 0.0]]).T)
    reaches = np.array([np.inf, 20.0, 16.0, 1.0, np.inf])
    light = np.zeros((5, 2))
    gather_from_eye(
        field, glows, (0.0, 0.75, 0.0), directions, reaches, light
    )  # 3 units above the middle
    expected = (
        0.15 * np.array([8.0, 4.0, 0.0, 0.0]),
        glows.rates[1] * np.array([4.0, 2.0, 0.0, 0.0]),
    )
    np.testing.assert_allclose(light[:4], np.transpose(expected), atol=1e-12)
    assert light[4, 0] > 1.2 and light[4, 1] > glows.rates[1] * 4.0


def gather(scene, starts, glows, samples, bounces=0, survival=1.0):
    """E/π (g, k, 3) at ``starts``: world points and normals (g, 3), on walls by number or on the
    first surface (-1).
    """
    given = starts_in(scene.field, *starts)
    g = len(starts[0])
    k = len(glows.rates)
    rules = PathRules(np.ones((bounces + 1, 3)), survival)
    sums = np.zeros((g, 3 * k))
    glow_among_surfaces(scene, given, SampleRange(0, samples), rules, glows, sums)
    return sums.reshape(g, k, 3) / samples


def test_glow_among_surfaces_is_that_of_one_ray_at_a_time() -> None:
    (samples,) = few((64,), (8,))
    points, normals = on_ball(5)
    starts = [*points.T, [30.0, 12.0, -4.0]], [*normals.T, Z], [*[NO_WALL] * 5, 0]
    glows = glows_of(ball(MIDDLE, 4.0), block([6.0, 20.0, 34.0], [2.0, 4.0, 3.0]))
    thin = [(0.1, 0.2, 0.3), 0.2]
    scene = among(field_of(NOISY), 0.0, [3.5], [0.5, 0.7], [0.3, 0.6], thin, [FLOOR])
    found = gather(scene, starts, glows, samples, 3, 0.7)
    given = starts_in(scene.field, *starts), SampleRange(0, samples), 3, DARK, glows
    expected = gathered(several_surfaces(scene), *given, survival=0.7)[:, :, 1:].mean(axis=1)
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    assert found.any(axis=(0, 2)).all()


@pytest.mark.parametrize("clear", [0.25, 1.0])
def test_what_glows_in_a_clear_shell_is_dimmed_by_it(clear: float) -> None:
    """E = c π L (r/d)² cosθ on a floor: each ray passes the black shell once."""
    (samples,) = few((4096,), (64,))
    field = field_of(BALL)
    glows = glows_of(ball(MIDDLE, 4.0))
    points = np.array([[20.0, 20.0, -4.0], [34.0, 20.0, -4.0]])
    found = gather(
        among(field, 0.0, [], [0.0], [clear], walls=[FLOOR]),
        (points, [Z, Z], [0, 0]),
        glows,
        samples,
    )
    away = MIDDLE - points
    expected = clear * 16.0 * away[:, 2] / (away**2).sum(axis=1) ** 1.5
    np.testing.assert_allclose(found[:, 0, 1], expected, rtol=0.01 if samples > 64 else 0.4)


def test_what_glows_in_a_closed_sheet_lights_it_from_inside() -> None:
    """From outside a sheet shows τ E of its inner side, E = π L (r/R)²: its share of that is τ/(ρ +
    τ).
    """
    (samples,) = few((1024,), (64,))
    field = field_of(BALL)
    (points, normals) = on_ball(6)
    sheet = among(field, 0.0, [], [0.2], [0.0], [0.6])
    found = gather(
        sheet, (points.T, normals.T, [NO_WALL] * 6), glows_of(ball(MIDDLE, 4.0)), samples
    )
    inside = 12.0 - 0.3  # rays start so far from the sheet
    np.testing.assert_allclose(
        found.mean(), 0.75 * (4.0 / inside) ** 2, rtol=0.01 if samples > 64 else 0.3
    )
