"""Light of lobes joins a picture."""

import numpy as np
import pytest

from isogi_core.kernels.shading.framebuffer import (
    BLUE_LUMINANCE,
    CONVERGING,
    FINAL,
    GREEN_LUMINANCE,
    PROVISIONAL,
    RED_LUMINANCE,
    Framebuffer,
)
from isogi_core.kernels.shading.lobes import add_lobes

LIGHT = np.array([RED_LUMINANCE, GREEN_LUMINANCE, BLUE_LUMINANCE], float)


@pytest.mark.parametrize("unit", [1.0, 2.0**-40, 2.0**60])
def test_light_of_lobes_joins_a_picture_with_its_error(unit):
    rng = np.random.default_rng(8)
    before = unit * rng.random((6, 3)).astype(np.float32)
    error = np.array([0.1, 0.02, 0.5, 1.0, 0.3, 1.0], np.float32)
    state = np.array([FINAL, CONVERGING, FINAL, PROVISIONAL, 0, FINAL], np.uint8)
    planes, pixels = Framebuffer(before.copy(), state.copy(), error.copy()), np.array([0, 1, 2, 3, 5], np.uint32)
    lit = rng.random((5, 4)).astype(np.float32)
    lit[0] = 0.0
    add_lobes(pixels, lit, unit, planes)
    after = before.astype(float)
    after[pixels] += unit * lit[:, :3]
    np.testing.assert_allclose(planes.radiance, after, rtol=1e-6)
    noise = np.hypot(error * (before @ LIGHT) / unit, np.sqrt(np.insert(lit[:, 3], 4, 0.0)))
    expected = np.minimum(noise / (after @ LIGHT) * unit, 1.0)
    expected[3], expected[4] = 1.0, error[4]
    np.testing.assert_allclose(planes.error, expected, rtol=1e-5)
    assert np.array_equal(planes.state, state)
