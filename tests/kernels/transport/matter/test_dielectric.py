"""An interface between two indices of refraction, against Snell's law and Fresnel's formulas."""

import math

import numpy as np
import pytest

from isogi_core.kernels.transport.sampling import fresnel, mirror, refract

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
