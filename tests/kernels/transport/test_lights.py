"""Each lamp against its closed form, and its harmonics."""

import math

import numpy as np
import pytest
from numba import njit

from isogi_core.kernels.transport.harmonics import evaluate
from isogi_core.kernels.transport.lights import (
    AREA,
    DIRECTIONAL,
    POINT,
    LampArrays,
    illuminate,
    project_lamps,
)
from tests.scale import few

COUNT = few(20_000, 400)
N = (0.0, 0.6, 0.8)
COLOUR = np.array([3.0, 2.0, 1.0])


def lamp(kind, place, edges=((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))):
    """One lamp among two: the first is another, which gives nothing."""
    places = np.array([(1.0, 0.0, 0.0), place])
    both = np.array([np.zeros((2, 3)), edges])
    return LampArrays(
        np.array([DIRECTIONAL, kind], np.int8), places, both, np.array([(0.0, 0.0, 0.0), COLOUR])
    )


@njit(cache=True)
def shine(lamps, p, n, numbers, towards, distances, light):
    """`illuminate` of lamp 1 for each pair of numbers."""
    for i in range(len(numbers)):
        w, distances[i], c = illuminate(lamps, 1, p, n, numbers[i, 0], numbers[i, 1])
        towards[i, 0], towards[i, 1], towards[i, 2] = w
        light[i, 0], light[i, 1], light[i, 2] = c


def illuminated(lamps, p, n=N, count=COUNT):
    """Directions (n, 3), distances (n,) and light (n, 3) from random numbers."""
    numbers = np.random.default_rng(9).random((count, 2))
    towards = np.empty((count, 3))
    distances = np.empty(count)
    light = np.empty((count, 3))
    shine(lamps, p, n, numbers, towards, distances, light)
    np.testing.assert_allclose(np.linalg.norm(towards, axis=1), 1.0, rtol=1e-12)
    return towards, distances, light


def test_a_point_gives_the_cosine_over_its_distance_squared():
    towards, distances, light = illuminated(lamp(POINT, (1.0, 4.0, 6.0)), (1.0, 1.0, 2.0), count=2)
    np.testing.assert_allclose(towards, [(0.0, 0.6, 0.8)] * 2, rtol=1e-12)
    np.testing.assert_allclose(distances, 5.0)
    np.testing.assert_allclose(light, [COLOUR / 25.0] * 2, rtol=1e-12)


@pytest.mark.parametrize("kind", [POINT, AREA])
def test_a_lamp_behind_the_surface_gives_nothing(kind):
    if kind == AREA:
        edges = [(0.0, 0.0, 1.0), (0.0, 1.0, 0.0)]
    else:
        edges = np.zeros((2, 3))
    _, _, light = illuminated(lamp(kind, (0.0, -3.0, -9.0), edges), (1.0, 1.0, 2.0))
    assert not light.any()


@pytest.mark.parametrize("away", [0.0, 1e-170])
def test_a_point_that_touches_the_surface_gives_nothing_there(away):
    """Touching it is being so near that the square of the distance is nothing."""
    numbers = np.full((1, 2), 0.5)
    towards = np.empty((1, 3))
    distances = np.empty(1)
    light = np.empty((1, 3))
    shine(lamp(POINT, (0.0, 0.0, away)), (0.0, 0.0, 0.0), N, numbers, towards, distances, light)
    assert distances[0] == 0.0 and not light.any() and np.isfinite(towards).all()


@pytest.mark.parametrize("half", [0.0, 5.0, 45.0])
def test_a_directional_lamp_fills_its_disc_evenly(half):
    """A facing surface gets E/π from every ray; the rays' density is cosθ/(π sin²α) over the
    disc.
    """
    sine = math.sin(math.radians(half))
    edges = sine * np.array([(1.0, 0.0, 0.0), (0.0, 0.8, -0.6)])
    towards, distances, light = illuminated(lamp(DIRECTIONAL, N, edges), (5.0, 6.0, 7.0))
    cosines = towards @ N
    np.testing.assert_allclose(light, np.broadcast_to(COLOUR, light.shape), rtol=1e-9)
    assert (distances == np.inf).all() and cosines.min() >= math.cos(math.radians(half)) - 1e-12
    if half:
        mean = 2.0 / 3.0 * (1.0 - math.cos(math.radians(half)) ** 3) / sine**2
    else:
        mean = 1.0
    assert cosines.mean() == pytest.approx(mean, abs=4.0 * cosines.std() / COUNT**0.5 + 1e-12)
    assert np.abs((towards - cosines[:, None] * N).mean(axis=0)).max() <= 4.0 * sine / COUNT**0.5


def test_an_area_adds_up_to_the_integral_over_it():
    """Against midpoints: ∫ cosθ cosθ'/(π r²) dA, of a skew parallelogram that dips below the
    horizon.
    """
    corner = (-3.0, 2.0, 4.0)
    u = np.array([4.0, 0.0, -9.0])
    v = np.array([1.0, 5.0, 0.0])
    p = np.array([0.0, 0.0, 1.0])
    _, distances, light = illuminated(lamp(AREA, corner, [u, v]), tuple(p))
    a, b = ((np.mgrid[:400, :400] + 0.5) / 400).reshape(2, -1, 1)
    away = corner + a * u + b * v - p
    r = np.linalg.norm(away, axis=1)
    facing = np.maximum(-away @ np.cross(u, v), 0.0) * np.maximum(away @ N, 0.0) / r**4
    assert 0.05 < (facing == 0.0).mean() < 0.95
    assert distances.min() > r.min() - 0.05 and distances.max() < r.max() + 0.05
    noise = light[:, 0].std() / COUNT**0.5
    np.testing.assert_allclose(light.mean(axis=0), facing.mean() * COLOUR, atol=4.0 * noise)


def test_lamps_far_away_or_small_are_one_another():
    """A point at distance D of intensity E D² is a directional lamp; a small area L A facing the
    point is a point.
    """
    d = np.array([0.36, 0.48, 0.8])
    p = (3.0, -2.0, 1.0)
    _, _, sun = illuminated(lamp(DIRECTIONAL, d), p, count=1)
    for far in (1e6, 1e30, 1e140):
        point = lamp(POINT, far * d)
        _, distances, light = illuminated(
            point._replace(colours=point.colours * far**2), p, count=1
        )
        np.testing.assert_allclose(light, sun, rtol=1e-5)
        np.testing.assert_allclose(distances, far, rtol=1e-5)
    for size in (1e-3, 1e-12):
        edges = size * np.array([(0.0, 0.6, -0.36), (0.8, 0.0, -0.36)])
        area = abs(np.cross(*edges) @ d)
        _, _, point = illuminated(lamp(POINT, p + 5.0 * d), p, count=1)
        both = [
            illuminated(lamp(AREA, p + 5.0 * d, e), p, count=9)[2] for e in (edges, edges[::-1])
        ]
        np.testing.assert_allclose(sum(both), area * np.repeat(point, 9, axis=0), rtol=1e-3)


def test_harmonics_of_lamps_are_those_of_their_directions():
    d = np.array([(0.0, 0.0, 1.0), (0.36, -0.48, 0.8)])
    irradiances = np.array([COLOUR, (0.5, 0.0, 4.0)])
    found = np.ones((3, 25))
    basis = np.empty((2, 25))
    for k in range(2):
        evaluate(5, *d[k], basis[k])
    project_lamps(5, d, irradiances, found)
    np.testing.assert_allclose(found, 1.0 + irradiances.T @ basis, rtol=1e-12)
