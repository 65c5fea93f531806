"""Light that is scattered inside a surface: Chandrasekhar's half-space, and what is kept where nothing is absorbed."""

import math

import numpy as np

from isogi_core.kernels.transport.matter.matter_paths import ALONG_RAY, INWARD
from tests.kernels.fields import field_of
from tests.kernels.rooms import sky, wall
from tests.kernels.transport.matter.passables import ball, gather, passable
from tests.scale import COMPILED, few

LEFT = 0.8
"""The albedo of single scattering, ϖ."""


def half_space():
    """H at Gauss points of (0, 1), and as a function, by iteration: 1/H = √(1-ϖ) + ϖ/2 ∫ x H(x)/(μ + x) dx."""
    x, weights = np.polynomial.legendre.leggauss(64)
    x, weights, h = (x + 1.0) / 2.0, weights / 2.0, np.ones(64)

    def at(mu):
        return 1.0 / (math.sqrt(1.0 - LEFT) + LEFT / 2.0 * (weights * h * x / (np.add.outer(mu, x))).sum(axis=-1))

    for _ in range(200):
        h = at(x)
    return x, weights, h, at


@COMPILED
def test_a_half_space_sends_back_what_chandrasekhar_says():
    """1 - H(μ)√(1-ϖ) of an even sky, to the eye at μ; in the mean over a cosine from the inside."""
    x, weights, h, at = half_space()
    cosines, dark = np.array([1.0, 0.5, 0.25]), math.sqrt(1.0 - LEFT)
    ways = np.column_stack([np.sqrt(1.0 - cosines**2), np.zeros(3), -cosines])
    field = field_of(3.5 - np.mgrid[:8, :8, :8][0])
    met = passable(index=1.0, extinction=50.0, albedo=LEFT)
    points = [*(np.array([3.5, 3.5, 3.5]) - 1.0 * ways), (3.5, 3.5, 3.5)]
    starts = points, [*ways, (0, 0, 1.0)], [ALONG_RAY] * 3 + [INWARD]
    found = gather(field, met, starts, 1 << 16, sky(1.0))[:, 0]
    true = [*(1.0 - at(cosines) * dark), 2.0 * (weights * x * (1.0 - h * dark)).sum()]
    np.testing.assert_allclose(found, true, rtol=0.01)


def test_nothing_is_lost_where_nothing_is_absorbed():
    """A ball of many mean free paths under an even sky, and a floor that is as bright, give what they get."""
    floor = wall((0, 0, 0.0), (12, 0, 0), (0, 12, 0), 0.0, 1.0)
    met = passable([floor], index=1.0, extinction=few(2.0, 0.5))
    starts = [(5.5, 5.5, 9.5), (5.5, 1.5, 5.5), (5.5, 5.5, 0.0)], [(0, 0, 1.0), (0, -1.0, 0), (0, 0, 1.0)]
    found = gather(ball(4.0, 12), met, (*starts, [INWARD, INWARD, 0]), few(256, 4), sky(1.0))
    np.testing.assert_allclose(found, 1.0, rtol=1e-9)


def test_rays_pass_where_the_mean_free_path_is_long():
    """Then a surface is not seen: what comes from inside is what lies behind."""
    met = passable([wall((-50, -50, -5.0), (100, 0, 0), (0, 100, 0), 0.0, 3.0, twofold=True)], 1.0, 1e-9)
    found = gather(ball(4.0, 12), met, ([(5.5, 5.5, 20.0)], [(0, 0, -1.0)], [ALONG_RAY]), 16)
    np.testing.assert_allclose(found, 3.0)
