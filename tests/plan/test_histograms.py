"""Histograms on an even axis, and on one by powers of ten."""

import numpy as np
import pytest

from isogi_core.model.volume import make_volume
from isogi_core.plan.histograms import shown_histogram


def decades(span: float) -> np.ndarray:
    """Values whose logarithms are even over so many powers of ten, to 1; 24³ of them."""
    logarithms = -span * np.random.default_rng(4).random((24, 24, 24))
    return (10.0**logarithms).astype(np.float32)


def crowded(values: np.ndarray) -> np.ndarray:
    """The values, and one that is ten times as large as the largest of them."""
    values[0, 0, 0] = 10.0 * values.max()
    return values


@pytest.mark.parametrize("solid", ["above", "below"])
def test_values_of_many_decades_have_bins_of_even_ratios(solid: str) -> None:
    values = decades(5.0)
    shown = shown_histogram(make_volume(values, solid=solid))
    assert shown.logarithmic
    ratios = shown.edges[2:] / shown.edges[1:-1]
    assert ratios == pytest.approx(ratios[0], rel=1e-6)
    assert shown.edges[[0, -1]] == pytest.approx([values.min(), values.max()], rel=1e-6)
    assert shown.counts.sum() == values.size
    expected = np.histogram(values.astype(np.float64), shown.edges)[0]
    assert np.abs(shown.counts - expected).sum() < 0.01 * values.size
    assert np.ptp(shown.counts[1:]) < 8 * np.sqrt(shown.counts[1:].mean())


@pytest.mark.parametrize(
    "values",
    [
        crowded(decades(1.0)),
        decades(5.0) - np.float32(0.5),
        (200.0 * decades(5.0)).astype(np.uint8),
        np.float32(1.0) - np.float32(0.9) * decades(5.0),
        np.zeros((4, 4, 4), np.float32),
    ],
    ids=["few decades", "negative", "whole numbers", "at the high end", "constant"],
)
def test_other_values_have_even_bins(values: np.ndarray) -> None:
    shown = shown_histogram(make_volume(values))
    assert not shown.logarithmic
    assert np.diff(shown.edges) == pytest.approx(np.diff(shown.edges)[0], rel=1e-6)
    assert shown.counts.sum() == values.size
