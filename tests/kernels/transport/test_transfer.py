"""Irradiance of texels against their transfer, which walks the same paths, and against closed
forms.
"""

import math

import numpy as np
import pytest

from isogi_core.kernels.transport.lights import DIRECTIONAL, POINT
from isogi_core.kernels.transport.paths import PathRules, SampleRange, TransferRules
from isogi_core.kernels.transport.transfer import bake_irradiance, bake_texels
from tests.kernels.fields import field_of
from tests.kernels.transport.lighting import (
    BALL,
    LIGHTS,
    PLANE,
    TORUS,
    lamps,
    place_of,
    surroundings,
)
from tests.scale import COMPILED, few

COUNT = few(40, 3)
WEIGHTS = np.array([0.9, 0.6, 0.3]) ** np.arange(4.0)[:, None]


def bake(voxels, texels, light, weights=WEIGHTS, count=COUNT, first=0, rows=None):
    """`bake_irradiance` from nothing: sums (m, 2, 3)."""
    field = field_of(voxels)
    sums = np.zeros((len(texels), 2, 3))
    place, cells = place_of(field, texels)
    if rows is None:
        rows = np.arange(len(texels))
    bake_irradiance(
        field, cells, place, rows, SampleRange(first, count), PathRules(weights, 1.0), light, sums
    )
    return sums


@pytest.fixture(scope="module")
def texels():
    """Texels on the torus."""
    every = np.argwhere(np.abs(TORUS) < 0.3)
    return every[:: len(every) // few(150, 4)]


def test_under_constant_light_it_is_the_transfers_first_number(texels):
    """√4π (τ_0 direct + indirect), of the same paths, half by half."""
    field = field_of(TORUS)
    m = len(texels)
    place, cells = place_of(field, texels)
    sums = np.zeros((m, 2, 3, 1))
    shares = np.ascontiguousarray(np.hstack([np.zeros((3, 1)), WEIGHTS.T]))
    rules = TransferRules(shares, 1.0, 1)
    orders = np.ones(3, np.int64)
    bake_texels(field, cells, place, np.arange(m), SampleRange(5, COUNT), rules, orders, sums)
    expected = math.sqrt(4.0 * math.pi) * sums[..., 0]
    assert expected.any()
    np.testing.assert_allclose(
        bake(TORUS, texels, surroundings(constant=1.0), first=5), expected, rtol=1e-9
    )


@pytest.mark.parametrize("name", LIGHTS)
def test_texels_are_lit_alike_in_any_company_and_any_goes(texels, name):
    light = LIGHTS[name]
    whole = bake(TORUS, texels, light)
    assert (whole.sum(axis=1) > 0.0).any(axis=0).all() and not np.array_equal(
        whole[:, 0], whole[:, 1]
    )
    for rows in np.array_split(np.random.default_rng(6).permutation(len(texels)), 4):
        some = bake(TORUS, texels, light, rows=rows)
        assert np.array_equal(some[rows], whole[rows]) and not np.delete(some, rows, axis=0).any()
    parts = bake(TORUS, texels, light, count=2) + bake(
        TORUS, texels, light, count=COUNT - 2, first=2
    )
    np.testing.assert_allclose(parts, whole, rtol=1e-12)


def test_a_ball_under_lamps():
    """Each texel of a ball sees what is in front of its tangent plane: Σ E cosθ/π."""
    every = np.argwhere(np.abs(BALL) < 0.4)[::30]
    sun = np.array([0.36, 0.48, 0.8])
    bulb = np.array([20.0, 20.0, 50.0])
    light = surroundings(
        lamps=lamps(
            (DIRECTIONAL, sun, None, (2.0, 1.0, 0.5)), (POINT, bulb, None, (0.0, 90.0, 50.0))
        )
    )
    n = every[:, ::-1] - 20.0
    n = n / np.linalg.norm(n, axis=1, keepdims=True)
    away = bulb - (every[:, ::-1] + 0.3 * n)
    near = np.maximum((n * away).sum(axis=1), 0.0) / np.linalg.norm(away, axis=1) ** 3
    expected = np.maximum(n @ sun, 0.0)[:, None] * (2.0, 1.0, 0.5) + near[:, None] * (
        0.0,
        90.0,
        50.0,
    )
    found = bake(BALL, every, light, count=1).mean(axis=1)
    clear = (np.abs(n @ sun) > 0.1) & (np.abs((n * away).sum(axis=1)) > 2.0)
    assert clear.sum() > 20
    np.testing.assert_allclose(found[clear], expected[clear], atol=0.03)


@COMPILED
def test_bounces_add_what_the_weights_say(texels):
    """Weights of vertices are taken as they are: the sum over single vertices is the whole."""
    light = LIGHTS["all"]
    single = [
        bake(TORUS, texels, light, np.diag(np.ones(4))[k][:, None] * WEIGHTS) for k in range(4)
    ]
    assert all(part.any() for part in single)
    np.testing.assert_allclose(sum(single), bake(TORUS, texels, light), rtol=1e-9)


def test_a_plane_under_a_turned_half_sky():
    """E/π = (1 + cos t)/2 for a plane tilted by t against the sky's pole, which the matrix
    turns.
    """
    sky = np.zeros((2, 1, 3))
    sky[0] = 1.0
    for tilt in (0.0, 60.0, 90.0):
        s, c = math.sin(math.radians(tilt)), math.cos(math.radians(tilt))
        light = surroundings(sky, matrix=np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]))
        count = few(4096, 128)
        found = bake(PLANE, np.array([[20, 20, 20]]), light, np.ones((1, 3)), count) / count
        np.testing.assert_allclose(found, (1.0 + c) / 2.0, atol=20.0 / count)
