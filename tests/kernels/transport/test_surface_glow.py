"""Light of glowing regions among several surfaces: as in a room, behind clear shells, and inside sheets."""

import numpy as np
import pytest

from isogi_core.kernels.tracing.walls import NO_WALL
from isogi_core.kernels.transport.glow_paths import glow_among_surfaces
from isogi_core.kernels.transport.paths import PathRules, SampleRange
from tests.kernels.fields import field_of
from tests.kernels.glows import ball, block, gather_glow, glows_of
from tests.kernels.rooms import X, Y, Z, room_of, starts_in, wall
from tests.kernels.transport.lighting import BALL, NOISY, on_ball
from tests.kernels.transport.surfaces import among
from tests.oracles.paths import DARK, gathered, several_surfaces
from tests.scale import few

MIDDLE = [20.0, 20.0, 20.0]
FLOOR = wall((-400.0, -400.0, -4.0), 900.0 * X, 900.0 * Y, 0.5)


def gather(scene, starts, glows, samples, bounces=0, survival=1.0):
    """E/π (g, k, 3) at ``starts``: world points and normals (g, 3), on walls by number or on the first surface (-1)."""
    given, g, k = starts_in(scene.field, *starts), len(starts[0]), len(glows.rates)
    rules, sums = PathRules(np.ones((bounces + 1, 3)), survival), np.zeros((g, 3 * k))
    glow_among_surfaces(scene, given, SampleRange(0, samples), rules, glows, sums)
    return sums.reshape(g, k, 3) / samples


def test_about_one_opaque_surface_paths_are_those_of_a_room() -> None:
    """The very numbers, of two regions, with a floor that reflects."""
    (samples,) = few((64,), (8,))
    points, normals = on_ball(5)
    starts = [*points.T, [30.0, 12.0, -4.0]], [*normals.T, Z], [*[NO_WALL] * 5, 0]
    glows, field = glows_of(ball([34.0, 20.0, 20.0], 3.0), block([6.0, 20.0, 34.0], [2.0, 4.0, 3.0])), field_of(NOISY)
    found = gather(among(field, 0.0, [], [0.6], [0.0], walls=[FLOOR]), starts, glows, samples, 3, 0.7)
    expected = gather_glow(field, room_of([FLOOR], albedo=0.6), starts, glows, samples, 3, 0.7)
    np.testing.assert_allclose(found, expected, rtol=1e-12)
    assert found.any(axis=(0, 2)).all()


def test_glow_among_surfaces_is_that_of_one_ray_at_a_time() -> None:
    (samples,) = few((64,), (8,))
    points, normals = on_ball(5)
    starts = [*points.T, [30.0, 12.0, -4.0]], [*normals.T, Z], [*[NO_WALL] * 5, 0]
    glows, thin = glows_of(ball(MIDDLE, 4.0), block([6.0, 20.0, 34.0], [2.0, 4.0, 3.0])), [(0.1, 0.2, 0.3), 0.2]
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
    field, glows = field_of(BALL), glows_of(ball(MIDDLE, 4.0))
    points = np.array([[20.0, 20.0, -4.0], [34.0, 20.0, -4.0]])
    found = gather(among(field, 0.0, [], [0.0], [clear], walls=[FLOOR]), (points, [Z, Z], [0, 0]), glows, samples)
    away = MIDDLE - points
    expected = clear * 16.0 * away[:, 2] / (away**2).sum(axis=1) ** 1.5
    np.testing.assert_allclose(found[:, 0, 1], expected, rtol=0.01 if samples > 64 else 0.4)


def test_what_glows_in_a_closed_sheet_lights_it_from_inside() -> None:
    """From outside a sheet shows τ E of its inner side, E = π L (r/R)²: its share of that is τ/(ρ + τ)."""
    (samples,) = few((1024,), (64,))
    field, (points, normals) = field_of(BALL), on_ball(6)
    sheet = among(field, 0.0, [], [0.2], [0.0], [0.6])
    found = gather(sheet, (points.T, normals.T, [NO_WALL] * 6), glows_of(ball(MIDDLE, 4.0)), samples)
    inside = 12.0 - 0.3  # rays start so far from the sheet
    np.testing.assert_allclose(found.mean(), 0.75 * (4.0 / inside) ** 2, rtol=0.01 if samples > 64 else 0.3)
