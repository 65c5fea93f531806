"""Paths at interfaces, through glass and in clouds: Snell, Fresnel, Beer, Chandrasekhar, and an
analytic ball.
"""

import math

import numpy as np
import pytest

from isogi_core.kernels.transport.matter.matter_paths import ALONG_RAY, INWARD
from isogi_core.kernels.transport.sampling import fresnel, mirror, refract
from tests.kernels.fields import field_of
from tests.kernels.rooms import box, sky, wall
from tests.kernels.transport.matter.passables import ball, gather, passable, slab
from tests.scale import COMPILED, few

NORMAL = (0.0, 0.0, 1.0)


def coming(angle):
    """A ray that comes down at an ``angle`` to the normal."""
    return math.sin(angle), 0.0, -math.cos(angle)


@pytest.mark.parametrize("ratio", [1.5, 1 / 1.5, 2.4])
def test_a_refracted_ray_obeys_snells_law(ratio):
    for angle in (0.0, 0.2, 0.5, 0.7):
        w = refract(coming(angle), NORMAL, math.cos(angle), ratio)
        assert np.linalg.norm(w) == pytest.approx(1.0)
        assert w[2] < 0.0
        assert ratio * w[0] == pytest.approx(math.sin(angle), abs=1e-12)
        x, y, z = coming(angle)
        assert mirror((x, y, z), NORMAL, math.cos(angle)) == pytest.approx((x, y, -z))


def test_fresnel_at_brewsters_and_the_critical_angle():
    assert fresnel(1.0, 1.5) == pytest.approx((0.5 / 2.5) ** 2)
    brewster = math.atan(1.5)
    across = ((1.5**2 - 1.0) / (1.5**2 + 1.0)) ** 2
    assert fresnel(math.cos(brewster), 1.5) == pytest.approx(0.5 * across)
    critical = math.asin(1 / 1.5)
    assert fresnel(math.cos(critical + 1e-9), 1 / 1.5) == 1.0
    assert fresnel(math.cos(critical - 1e-3), 1 / 1.5) < 0.9
    assert fresnel(1e-9, 1.5) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("angle", [0.0, 0.4, 1.0, 1.5])
def test_as_much_is_mirrored_the_other_way(angle):
    w = refract(coming(angle), NORMAL, math.cos(angle), 1.5)
    assert fresnel(-w[2], 1 / 1.5) == pytest.approx(fresnel(math.cos(angle), 1.5))


MIDDLE = 11.5
RADIUS = 8.0
SIDE = 24


def test_clear_glass_under_an_even_sky_changes_nothing():
    """Neither what rays through it bring, nor what a floor under it has, which gives off as much
    light as the sky.
    """
    field = ball(RADIUS, SIDE)
    floor = wall((0, 0, 0.0), (SIDE, 0, 0), (0, SIDE, 0), 0.0, 1.0)
    starts = (
        [(MIDDLE, MIDDLE, 0.0), (3.0, 4.0, 0.0), (MIDDLE + 7.9, MIDDLE, 60.0)],
        [(0, 0, 1.0)] * 2 + [(0, 0, -1.0)],
    )
    found = gather(field, passable([floor]), (*starts, [0, 0, ALONG_RAY]), few(256, 4), sky(1.0))
    np.testing.assert_allclose(found[:2], 1.0, rtol=1e-9)
    passed = gather(
        field, passable(), (starts[0][2:], starts[1][2:], [ALONG_RAY]), few(256, 4), sky(1.0)
    )
    np.testing.assert_allclose(passed, 1.0, rtol=1e-9)


@COMPILED
def test_a_slab_passes_what_fresnel_and_beer_leave():
    """(1 - R)² a / (1 - R² a²), a = exp(-σ d): all rays that are mirrored inside are counted."""
    mirrored = 0.04
    left = math.exp(-0.9)
    below = wall((-50.0, -50.0, -5.0), (100.0, 0, 0), (0, 100.0, 0), 0.0, 1.0, twofold=True)
    met = passable([below], 1.5, 0.3)
    found = gather(slab(2.0, 5.0), met, ([(3.2, 3.4, 20.0)], [(0, 0, -1.0)], [ALONG_RAY]), 1 << 14)
    true = (1.0 - mirrored) ** 2 * left / (1.0 - mirrored**2 * left**2)
    assert found[0] == pytest.approx(true, rel=0.005)


@pytest.mark.parametrize("survival", [1.0, 0.6])
def test_a_glowing_room_is_as_bright_about_clear_matter(survival):
    """L (1 - ρ^(n + 1)) / (1 - ρ) arrives at its walls, past a ball that bends nothing."""
    met = passable([(corner - 2.0, *rest) for corner, *rest in box(16.0, 0.5, 2.0)], index=1.0)
    starts = [(5.5, 4.0, -2.0), (14.0, 2.0, 6.0)], [(0, 0, 1.0), (-1.0, 0, 0)], [4, 1]
    found = gather(ball(3.0, 12), met, starts, few(1024, 64), bounces=4, survival=survival)
    expected = 2.0 * (1.0 - 0.5**5) / 0.5
    np.testing.assert_allclose(found.mean(axis=0), expected, rtol=few(0.01, 0.1))


def analytic_ball(points, samples, lamp, n, seed=1):
    """E/π at floor ``points`` (g, 2) under a clear ball, of a lamp (half side, height) of radiance
    1 that faces down.

    Rays of a cosine lobe, each refracted or mirrored by chance where it meets the sphere itself.
    """
    draws = np.random.default_rng(seed)
    middle = np.full(3, MIDDLE)
    found = []
    for point in points:
        r = np.sqrt(draws.random(samples))
        turn = 2.0 * np.pi * draws.random(samples)
        w = np.stack([r * np.cos(turn), r * np.sin(turn), np.sqrt(1.0 - r**2)], axis=1)
        o = np.tile([*point, 0.0], (samples, 1))
        inside = np.zeros(samples, bool)
        going = np.ones(samples, bool)
        for _ in range(30):
            b = ((o - middle) * w).sum(axis=1)
            c = ((o - middle) ** 2).sum(axis=1) - RADIUS**2
            under = b**2 - c
            root = np.sqrt(np.maximum(under, 0.0))
            t = np.where(inside, -b + root, -b - root)
            going &= (under > 0.0) & (t > 1e-9)
            if not going.any():
                break
            p = o + t[:, None] * w
            normal = (p - middle) / RADIUS * np.where(inside, -1.0, 1.0)[:, None]
            cosine = -(normal * w).sum(axis=1)
            ratio = np.where(inside, 1.0 / n, n)
            square = 1.0 - (1.0 - cosine**2) / ratio**2
            other = np.sqrt(np.maximum(square, 0.0))
            across = (cosine - ratio * other) / (cosine + ratio * other)
            along = (ratio * cosine - other) / (ratio * cosine + other)
            back = draws.random(samples) < np.where(square > 0.0, (across**2 + along**2) / 2.0, 1.0)
            passed = w / ratio[:, None] + (cosine / ratio - other)[:, None] * normal
            turned = np.where(back[:, None], w + 2.0 * cosine[:, None] * normal, passed)
            o, w = np.where(going[:, None], p, o), np.where(going[:, None], turned, w)
            inside = np.where(going & ~back, ~inside, inside)
        half, height = lamp
        end = o + ((height - o[:, 2]) / np.where(w[:, 2] > 0.0, w[:, 2], 1.0))[:, None] * w
        met = (w[:, 2] > 0.0) & (np.abs(end[:, :2] - MIDDLE) <= half).all(axis=1)
        found.append(met.mean())
    return np.array(found)


@pytest.mark.slow
@COMPILED
def test_a_caustic_is_that_of_an_analytic_ball():
    half = 6.0
    height = 50.0
    corner = (MIDDLE - half, MIDDLE - half, height)
    walls = [
        wall((-50.0, -50.0, 0.0), (124.0, 0, 0), (0, 124.0, 0), 0.5),
        wall(corner, (0, 2 * half, 0), (2 * half, 0, 0), 0.0, 1.0),
    ]
    points = np.array(
        [[MIDDLE, MIDDLE], [MIDDLE + 1.0, MIDDLE], [MIDDLE + 7.0, MIDDLE + 2.0], [30.0, 2.0]]
    )
    samples = 1 << 15
    rays = 1 << 16
    starts = np.column_stack([points, np.zeros(4)]), np.tile([0, 0, 1.0], (4, 1)), np.zeros(4)
    found = gather(ball(RADIUS, SIDE), passable(walls), starts, samples)[:, 0]
    true = analytic_ball(points, rays, (half, height), 1.5)
    noise = np.sqrt(true * (1.0 - true) * (1.0 / samples + 1.0 / rays))
    assert (np.abs(found - true) < 0.02 * true + 4.0 * noise).all(), (found, true)
    assert found[0] > 4.0 * found[3]


LEFT = 0.8
"""The albedo of single scattering, ϖ."""


def half_space():
    """H at Gauss points of (0, 1), and as a function, by iteration: 1/H = √(1-ϖ) + ϖ/2 ∫ x H(x)/(μ
    + x) dx.
    """
    x, weights = np.polynomial.legendre.leggauss(64)
    x = (x + 1.0) / 2.0
    weights = weights / 2.0
    h = np.ones(64)

    def at(mu):
        return 1.0 / (
            math.sqrt(1.0 - LEFT)
            + LEFT / 2.0 * (weights * h * x / (np.add.outer(mu, x))).sum(axis=-1)
        )

    for _ in range(200):
        h = at(x)
    return x, weights, h, at


@COMPILED
def test_a_half_space_sends_back_what_chandrasekhar_says():
    """1 - H(μ)√(1-ϖ) of an even sky, to the eye at μ; in the mean over a cosine from the inside."""
    x, weights, h, at = half_space()
    cosines = np.array([1.0, 0.5, 0.25])
    dark = math.sqrt(1.0 - LEFT)
    ways = np.column_stack([np.sqrt(1.0 - cosines**2), np.zeros(3), -cosines])
    field = field_of(3.5 - np.mgrid[:8, :8, :8][0])
    met = passable(index=1.0, extinction=50.0, albedo=LEFT)
    points = [*(np.array([3.5, 3.5, 3.5]) - 1.0 * ways), (3.5, 3.5, 3.5)]
    starts = points, [*ways, (0, 0, 1.0)], [ALONG_RAY] * 3 + [INWARD]
    found = gather(field, met, starts, 1 << 16, sky(1.0))[:, 0]
    true = [*(1.0 - at(cosines) * dark), 2.0 * (weights * x * (1.0 - h * dark)).sum()]
    np.testing.assert_allclose(found, true, rtol=0.01)


def test_nothing_is_lost_where_nothing_is_absorbed():
    """A ball of many mean free paths under an even sky, and a floor that is as bright, give what
    they get.
    """
    floor = wall((0, 0, 0.0), (12, 0, 0), (0, 12, 0), 0.0, 1.0)
    met = passable([floor], index=1.0, extinction=few(2.0, 0.5))
    starts = (
        [(5.5, 5.5, 9.5), (5.5, 1.5, 5.5), (5.5, 5.5, 0.0)],
        [(0, 0, 1.0), (0, -1.0, 0), (0, 0, 1.0)],
    )
    found = gather(ball(4.0, 12), met, (*starts, [INWARD, INWARD, 0]), few(256, 4), sky(1.0))
    np.testing.assert_allclose(found, 1.0, rtol=1e-9)


def test_rays_pass_where_the_mean_free_path_is_long():
    """Then a surface is not seen: what comes from inside is what lies behind."""
    met = passable(
        [wall((-50, -50, -5.0), (100, 0, 0), (0, 100, 0), 0.0, 3.0, twofold=True)], 1.0, 1e-9
    )
    found = gather(ball(4.0, 12), met, ([(5.5, 5.5, 20.0)], [(0, 0, -1.0)], [ALONG_RAY]), 16)
    np.testing.assert_allclose(found, 3.0)
