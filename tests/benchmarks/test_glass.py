"""Pictures of glass beside the truth: the error of made-up ones, and the part itself."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from benchmarks.accuracy.glass import error_of, glass
from tests.benchmarks.parts import figures


def shown(light: np.ndarray) -> Any:
    """What a frame of one row shows of grey ``light``."""
    gbuffer = SimpleNamespace(pixels=np.arange(len(light)))
    return SimpleNamespace(radiance=np.repeat(light[None, :, None], 3, axis=2), gbuffer=gbuffer)


def test_the_noise_of_the_truth_is_no_part_of_an_error() -> None:
    rng = np.random.default_rng(1)
    halves = 2.0 + rng.normal(scale=0.5, size=(100_000, 2))
    assert error_of(shown(np.full(100_000, 2.1)), halves) == pytest.approx(0.05, rel=0.05)
    assert error_of(shown(np.full(100_000, 2.0)), halves) < 0.02


def test_glass_is_at_its_target_at_rest_and_says_so() -> None:
    found = figures(glass, "demo:casting", "--size", "16", "--trees", "8", "--paths", "8")
    assert 0.0 < found["true at rest, worst"] < 0.03
    assert 0.5 < found["told / true at rest, median"] < 2.0
    assert 0.3 < found["told / true at once, least"] < 3.0
