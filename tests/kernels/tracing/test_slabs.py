"""Rays against the volume's box and against cells."""

import math

import numpy as np
import pytest

from isogi_core.kernels.tracing.slabs import clip_box, cut_cell, longest, reciprocals
from tests.scale import few


def many(count):
    """That many, or few where Numba is switched off."""
    return few(count, max(count // 1000, 100))


def test_clip_box_against_numpys_slabs():
    rng = np.random.default_rng(4)
    shape = (4, 5, 6)
    size = np.array(shape[::-1]) - 1.0
    for o, d in zip(rng.uniform(-4, 9, (many(2000), 3)), rng.normal(size=(many(2000), 3)), strict=True):
        a, b = -o / d, (size - o) / d
        near, far = max(np.minimum(a, b).max(), 0.0), np.maximum(a, b).min()
        found = clip_box(shape, tuple(o), tuple(d))
        assert found[0] <= found[1] if near <= far else found[0] > found[1]
        if near <= far:
            assert found == pytest.approx((near, far))


@pytest.mark.parametrize("zero", [0.0, -0.0])
def test_a_ray_beside_the_box_or_along_its_face(zero):
    shape = (4, 4, 4)
    assert clip_box(shape, (1.0, 3.5, 1.0), (1.0, zero, zero)) == (math.inf, -math.inf)
    assert clip_box(shape, (1.0, 3.0, 0.0), (1.0, zero, zero)) == (0.0, 2.0)


def test_a_cell_is_cut_as_a_box_of_its_own():
    """Along still axes all of the ray is within; a component too small for a reciprocal counts as still."""
    rng = np.random.default_rng(5)
    for o, d in zip(rng.uniform(-2, 4, (many(2000), 3)), rng.normal(size=(many(2000), 3)), strict=True):
        near, far = cut_cell(tuple(o), reciprocals(tuple(d)), (1, 0, 2), -9.0, 9.0)
        a, b = (np.array([1, 0, 2]) - o) / d, (np.array([2, 1, 3]) - o) / d
        expected = max(np.minimum(a, b).max(), -9.0), min(np.maximum(a, b).min(), 9.0)
        assert (near, far) == pytest.approx(expected, rel=1e-12)
    assert reciprocals((0.0, 5e-324, -4.0)) == (0.0, 0.0, -0.25)
    assert cut_cell((0.5, 9.0, 9.0), (2.0, 0.0, 0.0), (0, 0, 0), -1.0, 1.0) == (-1.0, 1.0)
    assert longest((-3.0, 2.0, 1.0)) == 3.0
