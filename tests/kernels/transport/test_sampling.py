"""Every sampler: chi-square against its own density, and back to the numbers that it came from."""

import math

import numpy as np
import pytest
from numba import njit

from isogi_core.kernels.transport import rng, sampling
from isogi_core.model.environment import guide_of
from tests.kernels.transport.chi2 import ChiSquare
from tests.scale import few

MANY = few(1_000_000, 20_000)
FEW = 2_000
TURN = (0.0, 2.0 * math.pi)
SPHERE = ((-1.0, 1.0), TURN)
HEMISPHERE = ((0.0, 1.0), TURN)
DISC = ((0.0, 1.0), TURN)
EDGES = [0.0, 2.0**-32, 0.5, 1.0 - 2.0**-32]
AXES = [tuple(sign * row) for row in np.eye(3) for sign in (1.0, -1.0)]


def over(function, width):
    """A loop that applies a kernel of (u, v) to the rows of an array (n, 2) and gives (n,
    width).
    """

    @njit
    def loop(points):
        out = np.empty((len(points), width))
        for i in range(len(points)):
            found = function(points[i, 0], points[i, 1])
            for k in range(width):
                out[i, k] = found[k]
        return out

    return loop


@njit
def scrambled(count):
    """The points number 5 of the pair 3 of neighbouring seeds, (count, 2)."""
    points = np.empty((count, 2))
    for seed in range(count):
        points[seed, 0], points[seed, 1] = rng.point_2d(seed, 5, 3)
    return points


def azimuth(x, y):
    """Azimuth in [0, 2π), found without the kernels."""
    return np.mod(np.arctan2(y, x), 2.0 * np.pi)


def squares(seed, count):
    """Independent uniform points of the square, (count, 2)."""
    return np.random.default_rng(seed).random((count, 2))


@pytest.fixture(params=["independent", "scrambled"])
def uniforms(request):
    """Uniform points from NumPy, and those of the sequence that isogi draws from."""
    if request.param == "independent":
        return squares(4, MANY)
    return scrambled(MANY)


def test_chi_square_tells_right_from_wrong():
    """It takes what is right; it rejects 10 % of slope, samples where none may be, and what is no
    density.
    """
    points = squares(20, 1_000_000)
    ChiSquare(points).check()
    assert ChiSquare(points, lambda s, t: 0.95 + 0.1 * s + 0.0 * t).p_value() < 1e-6
    assert ChiSquare(points, lambda s, t: np.where(s < 0.5, 2.0, 0.0) + 0.0 * t).p_value() == 0.0
    with pytest.raises(AssertionError, match="no density"):
        ChiSquare(points, lambda s, t: 1.1 + 0.0 * s * t).check()
    with pytest.raises(AssertionError, match="outside"):
        ChiSquare(points + 0.5).check()


def test_chi_square_has_its_level():
    """Of 400 right sets about 1 % fail, though half of the cells expect less than 5 and are
    pooled.
    """
    sets = (squares(1000 + i, 2000) ** [0.5, 1.0] for i in range(400))
    p = np.array(
        [
            ChiSquare(points, lambda s, t: 2.0 * s + 0.0 * t, cells=(40, 10)).p_value()
            for points in sets
        ]
    )
    assert 0 < np.sum(p < 0.01) <= 12
    assert 0.45 < np.mean(p) < 0.55


def test_disc_follows_its_density(uniforms):
    """In (r², φ), where an area is half the rectangle."""
    x, y = over(sampling.sample_disc, 2)(uniforms).T
    points = np.stack([x * x + y * y, azimuth(x, y)], axis=1)
    ChiSquare(points, lambda r2, phi: sampling.disc_pdf(0.5, 0.5) / 2 + 0 * r2 * phi, DISC).check(
        tests=10
    )


def test_cosine_hemisphere_follows_its_density(uniforms):
    x, y, z = over(sampling.sample_cosine_hemisphere, 3)(uniforms).T
    density = np.vectorize(lambda z, phi: sampling.cosine_hemisphere_pdf(z))
    ChiSquare(np.stack([z, azimuth(x, y)], axis=1), density, HEMISPHERE).check(tests=10)


def test_uniform_sphere_follows_its_density(uniforms):
    x, y, z = over(sampling.sample_uniform_sphere, 3)(uniforms).T
    density = np.vectorize(lambda z, phi: sampling.uniform_sphere_pdf())
    ChiSquare(np.stack([z, azimuth(x, y)], axis=1), density, SPHERE).check(tests=10)


def test_disc_inverts():
    for u, v in [*squares(7, FEW), *((u, v) for u in EDGES for v in EDGES)]:
        x, y = sampling.sample_disc(u, v)
        assert x * x + y * y <= 1.0 + 1e-15
        np.testing.assert_allclose(sampling.invert_disc(x, y), (u, v), atol=1e-15)


def test_disc_density_ends_at_the_rim():
    assert sampling.disc_pdf(0.6, 0.79) == 1.0 / math.pi
    assert sampling.disc_pdf(0.6, 0.81) == 0.0


def test_cosine_hemisphere_inverts():
    for u, v in [*squares(8, FEW), *((u, v) for u in EDGES for v in EDGES)]:
        d = sampling.sample_cosine_hemisphere(u, v)
        assert math.hypot(*d) == pytest.approx(1.0, abs=1e-15) and d[2] >= 0.0
        np.testing.assert_allclose(sampling.invert_cosine_hemisphere(d), (u, v), atol=1e-15)


def test_no_light_from_below():
    assert sampling.cosine_hemisphere_pdf(-0.1) == 0.0


def test_uniform_sphere_inverts():
    for u, v in [*squares(9, FEW), (0.5, 0.0), (2.0**-32, 1.0 - 2.0**-32)]:
        d = sampling.sample_uniform_sphere(u, v)
        assert math.hypot(*d) == pytest.approx(1.0, abs=2e-15)
        np.testing.assert_allclose(sampling.invert_uniform_sphere(d), (u, v), atol=1e-12)
    assert sampling.sample_uniform_sphere(0.0, 0.3) == (0.0, 0.0, 1.0)


def test_cosines_and_sines_of_parts_of_a_turn():
    for part in [*np.linspace(0.0, 1.0, 97), *squares(13, FEW)[:, 0], 1.0 - 2.0**-53]:
        found = sampling.cosine_and_sine_of_turn(part)
        expected = math.cos(2.0 * math.pi * part), math.sin(2.0 * math.pi * part)
        np.testing.assert_allclose(found, expected, atol=1e-15)


def test_latlong_conventions():
    """Row 0 is +z; column 0 starts at azimuth 0 (+x) and azimuth grows, by +y, with the column."""
    expected = {
        (1.0, 0.0, 0.0): (0.5, 0.0),
        (0.0, 1.0, 0.0): (0.5, 0.25),
        (-1.0, 0.0, 0.0): (0.5, 0.5),
        (0.0, -1.0, 0.0): (0.5, 0.75),
        (0.0, 0.0, 1.0): (0.0, 0.0),
        (0.0, 0.0, -1.0): (1.0, 0.0),
    }
    for direction, place in expected.items():
        assert sampling.direction_to_latlong(direction) == pytest.approx(place, abs=1e-15)


def test_latlong_column_stays_below_one():
    for y in (-5e-324, -1e-300, -1e-17, -0.0):
        row, column = sampling.direction_to_latlong((1.0, y, 0.0))
        assert row == 0.5 and 0.0 <= column < 1.0


def test_latlong_inverts():
    """Directions by the definition of the image go back to their places."""
    for row, column in squares(10, FEW):
        theta, phi = math.pi * row, 2.0 * math.pi * column
        direction = (
            math.sin(theta) * math.cos(phi),
            math.sin(theta) * math.sin(phi),
            math.cos(theta),
        )
        np.testing.assert_allclose(
            sampling.direction_to_latlong(direction), (row, column), atol=1e-12
        )


@pytest.mark.parametrize("count", [1, 3, 7, 64, 500])
def test_guides_of_rows_are_those_of_a_search(count):
    """Also for shares next to k/n, whose product with n is rounded."""
    random = np.random.default_rng(count)
    places = np.arange(count + 1) / count
    near = np.sort(random.choice(places, (150, count + 1)), axis=1)
    near[::3] = np.nextafter(near[::3], 0.0)
    near[1::3] = np.minimum(np.nextafter(near[1::3], 1.0), 1.0)
    near[:, 0], near[:, -1] = 0.0, 1.0
    expected = [
        np.minimum(np.searchsorted(row, places, side="right") - 1, count - 1) for row in near
    ]
    guides = guide_of(near)
    assert guides.dtype == np.int32
    np.testing.assert_array_equal(guides, expected)


@pytest.mark.parametrize("count", [1, 3, 7, 64, 500])
def test_intervals_are_those_of_a_search(count):
    """With and without intervals of width 0, at the borders and between them."""
    for share in (0.0, 0.5, 0.95):
        random = np.random.default_rng(count)
        weights = np.where(random.random(count) < share, 0.0, random.random(count) ** 8)
        weights[random.integers(count)] = 1.0
        cdf = np.append(0.0, weights.cumsum()) / weights.cumsum()[-1]
        guide = guide_of(cdf)
        borders = np.concatenate([cdf, np.nextafter(cdf, 0.0), np.nextafter(cdf, 1.0)])
        for u in [*borders, *random.random(200), 1.0 - 2.0**-53]:
            if 0.0 <= u < 1.0:
                found = sampling.find_interval(cdf, guide, u)
                assert found == np.searchsorted(cdf, u, side="right") - 1
                assert 0.0 <= sampling.share_of_interval(cdf, found, u) <= 1.0
                assert weights[found] > 0.0
