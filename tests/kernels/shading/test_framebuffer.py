"""The planes of a frame, and what is added up over them."""

import numpy as np
import pytest

from isogi_core.kernels.shading.framebuffer import (
    CONVERGING,
    FINAL,
    PROVISIONAL,
    Framebuffer,
    luminance,
    put_pixel,
    tally,
)
from isogi_core.model.environment import LUMINANCE_WEIGHTS


def blank(pixels):
    """Planes of so many pixels."""
    return Framebuffer(np.zeros((pixels, 3), np.float32), np.zeros(pixels, np.uint8), np.zeros(pixels, np.float32))


def test_luminance_is_the_models():
    for light in np.random.default_rng(1).random((20, 3)):
        assert luminance(*light) == pytest.approx(light @ LUMINANCE_WEIGHTS, rel=1e-6)


def test_a_pixel_is_written_whole_and_alone():
    planes = blank(3)
    put_pixel(planes, 1, (0.25, 0.5, 0.75), CONVERGING, 0.125)
    assert planes.radiance.tolist() == [[0, 0, 0], [0.25, 0.5, 0.75], [0, 0, 0]]
    assert planes.state.tolist() == [0, CONVERGING, 0] and planes.error.tolist() == [0, 0.125, 0]


def test_tallies_count_the_surface_alone():
    rng, planes = np.random.default_rng(2), blank(500)
    planes.radiance[:], planes.error[:] = rng.random((500, 3)), rng.random(500)
    planes.state[:] = rng.choice([0, PROVISIONAL, CONVERGING, FINAL], 500)
    counts, sums = np.zeros(4, np.int64), np.zeros(2)
    tally(planes, counts, sums)
    assert counts.tolist() == np.bincount(planes.state, minlength=4).tolist()
    on = planes.state > 0
    light = planes.radiance[on].astype(float) @ LUMINANCE_WEIGHTS
    assert sums == pytest.approx([light.sum(), ((light * planes.error[on]) ** 2).sum()], rel=1e-5)
