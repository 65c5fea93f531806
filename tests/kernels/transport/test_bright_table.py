"""The table that samples directions to bright pixels of an environment."""

import math

import numpy as np
import pytest
from numba import njit

from isogi_core.kernels.transport.lights import draw_bright, pixel_towards
from isogi_core.model.environment import bright_table, solid_angles
from tests.kernels.transport.chi2 import ChiSquare
from tests.scale import few

TURN = np.array([[0.0, -1.0, 0.0], [0.6, 0.0, -0.8], [0.8, 0.0, 0.6]])


def excess_of(bright):
    """Excess of 8 × 12 pixels: one is ``bright``, some are 0, so are one whole row and its end."""
    excess = np.random.default_rng(5).random((8, 12))
    excess[2, 3:7] = excess[5] = excess[:, -1] = excess[0, 0] = 0.0
    excess[4, 4] = bright
    return excess


@njit
def drawn(table, matrix, points):
    """Directions (n, 3) of ``draw_bright`` at (u, v) in the rows of ``points``, and pixels (n,
    2).
    """
    ways = np.empty((len(points), 3))
    pixels = np.empty((len(points), 2), np.int64)
    for k in range(len(points)):
        w, i, j = draw_bright(table, matrix, points[k, 0], points[k, 1])
        ways[k, 0], ways[k, 1], ways[k, 2] = w
        pixels[k, 0], pixels[k, 1] = i, j
    return ways, pixels


@pytest.mark.parametrize("bright", [100.0, 1.0])
def test_directions_follow_their_density(bright):
    excess = excess_of(bright)
    table = bright_table(np.ones((8, 12, 3)), excess)
    points = np.random.default_rng(4).random((few(1_000_000, 20_000), 2))
    ways, _ = drawn(table, np.eye(3), points)
    columns = np.mod(np.arctan2(ways[:, 1], ways[:, 0]) / (2.0 * math.pi), 1.0)

    def density(row, column):
        """Per unit area of the image: dω = 2π² sin(π row) d row d column."""
        there = np.int64(row * 8), np.int64(column * 12), 3
        return table.pixels[there] * 2.0 * math.pi**2 * np.sin(math.pi * row)

    test = ChiSquare(
        np.stack([np.arccos(ways[:, 2]) / math.pi, columns], axis=1), density, cells=(32, 48)
    )
    test.check(tests=2)


def test_the_density_is_that_of_the_sphere():
    excess = excess_of(100.0)
    table = bright_table(np.ones((8, 12, 3)), excess)
    density = table.pixels[..., 3].astype(float)
    assert (density * solid_angles(8, 12)).sum() == pytest.approx(1.0, abs=1e-6)
    np.testing.assert_allclose(density / density.max(), excess / excess.max(), rtol=1e-6)


def test_a_direction_lies_in_its_pixel_which_is_bright():
    excess = excess_of(100.0)
    radiance = np.random.default_rng(6).random((8, 12, 3))
    table = bright_table(radiance, excess)
    edges = [0.0, 2.0**-32, 0.5, 1.0 - 2.0**-32]
    borders = [(u, v) for u in (*edges, *table.rows[:-1]) for v in (*edges, *table.columns[0, :-1])]
    points = np.array([point for point in borders if max(point) < 1.0])
    points = np.concatenate([points, np.random.default_rng(7).random((2000, 2))])
    ways, pixels = drawn(table, TURN, points)
    np.testing.assert_allclose(np.linalg.norm(ways, axis=1), 1.0, atol=1e-14)
    assert (excess[tuple(pixels.T)] > 0.0).all()
    np.testing.assert_allclose(table.pixels[..., :3], radiance, rtol=1e-7)
    # Directions on a border may fall to either side of it, all others lie inside.
    found = np.array([pixel_towards(table.pixels, TURN, tuple(way)) for way in ways[-2000:]])
    assert (found == pixels[-2000:]).all()
