"""Paths through glass and clouds: closed forms, and an analytic ball traced by NumPy."""

import math

import numpy as np
import pytest

from isogi_core.kernels.transport.matter.matter_paths import ALONG_RAY
from tests.kernels.rooms import sky, wall
from tests.kernels.transport.matter.passables import ball, gather, passable, slab
from tests.scale import COMPILED, few

MIDDLE, RADIUS, SIDE = 11.5, 8.0, 24


def test_clear_glass_under_an_even_sky_changes_nothing():
    """Neither what rays through it bring, nor what a floor under it has, which gives off as much light as the sky."""
    field, floor = ball(RADIUS, SIDE), wall((0, 0, 0.0), (SIDE, 0, 0), (0, SIDE, 0), 0.0, 1.0)
    starts = [(MIDDLE, MIDDLE, 0.0), (3.0, 4.0, 0.0), (MIDDLE + 7.9, MIDDLE, 60.0)], [(0, 0, 1.0)] * 2 + [(0, 0, -1.0)]
    found = gather(field, passable([floor]), (*starts, [0, 0, ALONG_RAY]), few(256, 4), sky(1.0))
    np.testing.assert_allclose(found[:2], 1.0, rtol=1e-9)
    passed = gather(field, passable(), (starts[0][2:], starts[1][2:], [ALONG_RAY]), few(256, 4), sky(1.0))
    np.testing.assert_allclose(passed, 1.0, rtol=1e-9)


@COMPILED
def test_a_slab_passes_what_fresnel_and_beer_leave():
    """(1 - R)² a / (1 - R² a²), a = exp(-σ d): all rays that are mirrored inside are counted."""
    mirrored, left = 0.04, math.exp(-0.9)
    below = wall((-50.0, -50.0, -5.0), (100.0, 0, 0), (0, 100.0, 0), 0.0, 1.0, twofold=True)
    met = passable([below], 1.5, 0.3)
    found = gather(slab(2.0, 5.0), met, ([(3.2, 3.4, 20.0)], [(0, 0, -1.0)], [ALONG_RAY]), 1 << 14)
    true = (1.0 - mirrored) ** 2 * left / (1.0 - mirrored**2 * left**2)
    assert found[0] == pytest.approx(true, rel=0.005)


def analytic_ball(points, samples, lamp, n, seed=1):
    """E/π at floor ``points`` (g, 2) under a clear ball, of a lamp (half side, height) of radiance 1 that faces down.

    Rays of a cosine lobe, each refracted or mirrored by chance where it meets the sphere itself.
    """
    draws = np.random.default_rng(seed)
    middle, found = np.full(3, MIDDLE), []
    for point in points:
        r, turn = np.sqrt(draws.random(samples)), 2.0 * np.pi * draws.random(samples)
        w = np.stack([r * np.cos(turn), r * np.sin(turn), np.sqrt(1.0 - r**2)], axis=1)
        o, inside, going = np.tile([*point, 0.0], (samples, 1)), np.zeros(samples, bool), np.ones(samples, bool)
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
            cosine, ratio = -(normal * w).sum(axis=1), np.where(inside, 1.0 / n, n)
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
    half, height = 6.0, 50.0
    corner = (MIDDLE - half, MIDDLE - half, height)
    walls = [
        wall((-50.0, -50.0, 0.0), (124.0, 0, 0), (0, 124.0, 0), 0.5),
        wall(corner, (0, 2 * half, 0), (2 * half, 0, 0), 0.0, 1.0),
    ]
    points = np.array([[MIDDLE, MIDDLE], [MIDDLE + 1.0, MIDDLE], [MIDDLE + 7.0, MIDDLE + 2.0], [30.0, 2.0]])
    samples, rays = 1 << 15, 1 << 16
    starts = np.column_stack([points, np.zeros(4)]), np.tile([0, 0, 1.0], (4, 1)), np.zeros(4)
    found = gather(ball(RADIUS, SIDE), passable(walls), starts, samples)[:, 0]
    true = analytic_ball(points, rays, (half, height), 1.5)
    noise = np.sqrt(true * (1.0 - true) * (1.0 / samples + 1.0 / rays))
    assert (np.abs(found - true) < 0.02 * true + 4.0 * noise).all(), (found, true)
    assert found[0] > 4.0 * found[3]
