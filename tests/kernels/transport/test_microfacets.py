"""The GGX lobe: its energy, its symmetry, its density, and the mirror that it becomes."""

import math

import numpy as np
import pytest
from numba import njit

from isogi_core.kernels.transport.microfacets import (
    ENERGY_STEPS,
    ShineLobe,
    energy_at,
    fill_energy,
    light_below,
    reflected,
    reflected_pdf,
    sample_reflected,
    schlick_fresnel,
)
from tests.kernels.transport.chi2 import ChiSquare
from tests.scale import few

ALPHAS = (0.01, 0.09, 0.36, 1.0)
MANY = few(400_000, 40_000)


@njit(cache=True)
def drawn(alpha, v, points):
    """``sample_reflected`` of points (n, 2) of the square; (n, 3)."""
    out = np.empty((len(points), 3))
    for i in range(len(points)):
        out[i, 0], out[i, 1], out[i, 2] = sample_reflected(alpha, v, points[i, 0], points[i, 1])
    return out


@njit(cache=True)
def densities(alpha, v, ways):
    """``reflected_pdf`` of directions (n, 3); (n,)."""
    out = np.empty(len(ways))
    for i in range(len(ways)):
        out[i] = reflected_pdf(alpha, v, (ways[i, 0], ways[i, 1], ways[i, 2]))
    return out


def seen_at(cosine):
    """A direction at a ``cosine`` to the normal."""
    return math.sqrt(1.0 - cosine**2), 0.0, cosine


def integrated(alpha, cosine, count=1024):
    """(A, B) by midpoints over the normals of facets, in NumPy, with D cosθ dω = du dφ/2π for tan²θ
    = α² u/(1 - u).
    """
    rest, phi = np.meshgrid(
        (np.arange(count) + 0.5) / count, (np.arange(count) + 0.5) * (2.0 * np.pi / count)
    )
    weights = 3.0 * rest**2
    rest = rest**3  # of 1 - u, finer where facets are steep
    tangent = alpha * np.sqrt((1.0 - rest) / rest)
    z = 1.0 / np.sqrt(1.0 + tangent**2)
    h = np.stack([z * tangent * np.cos(phi), z * tangent * np.sin(phi), z], axis=-1)
    v = np.array(seen_at(cosine))
    towards = h @ v
    l_z = 2.0 * towards * z - cosine

    def hidden(c):
        return 0.5 * (np.sqrt(1.0 + alpha**2 * (1.0 / np.maximum(c, 1e-9) ** 2 - 1.0)) - 1.0)

    light = np.where(
        (towards > 0.0) & (l_z > 0.0),
        towards / (cosine * z) / (1.0 + hidden(cosine) + hidden(l_z)),
        0.0,
    )
    edge = (1.0 - np.clip(towards, 0.0, 1.0)) ** 5
    return float((weights * light * (1.0 - edge)).mean()), float((weights * light * edge).mean())


@pytest.fixture(scope="module")
def tables():
    """The table of energy of each of ALPHAS."""
    found = {}
    for alpha in ALPHAS:
        found[alpha] = np.empty((ENERGY_STEPS + 1, 2))
        fill_energy(alpha, found[alpha])
    return found


@pytest.mark.parametrize("alpha", ALPHAS)
def test_energy_is_the_integral_over_facets(tables, alpha):
    for cosine in (0.1, 0.35, 0.7, 1.0):
        np.testing.assert_allclose(
            energy_at(tables[alpha], cosine), integrated(alpha, cosine), atol=3e-3
        )


def test_no_lobe_mirrors_more_than_arrives(tables):
    for table in tables.values():
        assert (table >= 0.0).all()
        assert table.sum(axis=1).max() <= 1.0 + 1e-9
    assert tables[0.01][ENERGY_STEPS].sum() > 0.995


@pytest.mark.parametrize("alpha", ALPHAS)
def test_light_and_viewer_may_change_places(alpha):
    ways = np.random.default_rng(4).normal(size=(200, 2, 3))
    ways[..., 2] = np.abs(ways[..., 2]) + 0.05
    ways /= np.linalg.norm(ways, axis=2, keepdims=True)
    for v, l in ways.tolist():
        there = reflected(alpha, tuple(v), tuple(l)) / l[2]
        back = reflected(alpha, tuple(l), tuple(v)) / v[2]
        assert there == pytest.approx(back, rel=1e-9)
        facing = (0.04, 0.5, 1.0)
        assert schlick_fresnel(facing, tuple(v), tuple(l)) == pytest.approx(
            schlick_fresnel(facing, tuple(l), tuple(v))
        )


@pytest.mark.slow
@pytest.mark.parametrize("cosine", [0.25, 0.5, 1.0])
@pytest.mark.parametrize("alpha", [0.25, 0.6, 1.0])
def test_directions_follow_their_density(alpha, cosine):
    v = seen_at(cosine)
    ways = drawn(alpha, v, np.random.default_rng(7).random((MANY, 2)))
    np.testing.assert_allclose(np.linalg.norm(ways, axis=1), 1.0, rtol=1e-9)

    def density(z, phi):
        z, phi = np.broadcast_arrays(z, phi)
        r = np.sqrt(1.0 - z**2)
        around = np.stack([r * np.cos(phi), r * np.sin(phi), z], axis=-1)
        return densities(alpha, v, around.reshape(-1, 3)).reshape(z.shape)

    places = np.column_stack(
        [np.clip(ways[:, 2], -1.0, 1.0), np.mod(np.arctan2(ways[:, 1], ways[:, 0]), 2 * np.pi)]
    )
    cells = (48, 48)  # so that the density ends where a cell does, at -cosine
    ChiSquare(places, density, ((-1.0, 1.0), (0.0, 2.0 * math.pi)), cells).check(tests=9)


def test_a_smooth_lobe_is_a_mirror():
    v = seen_at(0.6)
    ways = drawn(0.02**2, v, np.random.default_rng(1).random((1000, 2)))
    apart = np.degrees(np.arccos(np.clip(ways @ (-v[0], -v[1], v[2]), -1.0, 1.0)))
    assert np.median(apart) < 0.1


def test_a_coat_leaves_what_it_does_not_mirror(tables):
    facing = (0.04, 0.2, 0.9)
    lobe = ShineLobe(0.09, facing, 0.8, False, 0.0, tables[0.09])
    for cosine in (1e-3, 0.3, 1.0):
        a, b = energy_at(tables[0.09], cosine)
        np.testing.assert_allclose(
            light_below(lobe, cosine), [1.0 - 0.8 * (each * a + b) for each in facing]
        )
    assert light_below(lobe._replace(metal=True), 0.3) == pytest.approx((0.2, 0.2, 0.2))
