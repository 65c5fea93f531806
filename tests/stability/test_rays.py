"""Rays that the slow run of the cases has found, one by one."""

import numpy as np
import pytest

from benchmarks.stability.closed import CLOSED
from benchmarks.stability.leaks import Faults, follow
from benchmarks.stability.surface import ARITHMETICS, surface_of


@pytest.mark.parametrize("by", ARITHMETICS)
@pytest.mark.parametrize(
    ("volume", "isovalue", "origin", "direction"),
    [
        pytest.param("noise", 0.0, (1.0 + 2.0**-16.5, 7.3, 26.8), (-1.0, 1e-200, -1e-310), id="begins in the skin"),
        pytest.param("noise of bytes", 3.5, (35.0, 7.5, 34.0), (-5.0, 4.5, -6.0), id="leaves along a double root"),
    ],
)
def test_a_ray_goes_in_and_out_by_turns(
    volume: str, isovalue: float, origin: tuple[float, ...], direction: tuple[float, ...], by: str
) -> None:
    surface = surface_of(CLOSED[volume][0](), isovalue)
    assert follow(surface, np.array([origin]), np.array([direction]), by) == Faults()
