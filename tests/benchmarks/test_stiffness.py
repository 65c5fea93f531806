import numpy as np
import pytest

from benchmarks.accuracy.stiffness import Surface, figures, fit
from isogi_core.plan.projection import Expectation


def surface(steep: float, noisy: float, error: float, told: float) -> Surface:
    return Surface("made", steep, noisy, Expectation(told / 2, told, 2 * told), error)


def test_a_law_is_found_again() -> None:
    shares = np.random.default_rng(3).uniform(0.0, 1.0, (40, 2))
    surfaces = [surface(s, n, 0.004 + 0.03 * s + 0.2 * n, 0.1) for s, n in shares]
    assert fit(surfaces) == pytest.approx((0.004, 0.03, 0.2), rel=1e-3)


def test_what_was_told_is_judged() -> None:
    surfaces = [surface(0.1, 0.0, error, told) for error, told in [(0.01, 0.01), (0.03, 0.02), (0.1, 0.04)]]
    found = figures(surfaces)
    assert found["surfaces"] == 3
    assert found["measured / told, percentile 50"] == pytest.approx(1.5)
    assert found["within the range that is told"] == pytest.approx(2 / 3)
    assert found["rank correlation"] == pytest.approx(1.0)
