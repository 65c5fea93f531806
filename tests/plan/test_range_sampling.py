"""Levels of a range against formulas, and where the adaptive rule falls back to even ones."""

import numpy as np
import pytest

from isogi_core.model.volume import Volume, make_volume
from isogi_core.plan.projection import (
    RANGE_BINS,
    SLIDER_STOPS,
    find_stops,
    least_gradients,
    rounded,
    sample_range,
    shortened,
    spread_down,
)


def radial(profile, size: int = 33, spacing: tuple[float, float, float] = (1.0, 1.0, 1.0), **made) -> Volume:  # type: ignore[no-untyped-def]
    """A volume of a ``profile`` of the distance from its middle, in the world."""
    axes = [(np.arange(size) - (size - 1) / 2.0) * step for step in spacing[::-1]]
    z, y, x = np.meshgrid(*axes, indexing="ij")
    return make_volume(profile(np.sqrt(x * x + y * y + z * z)).astype(np.float32), spacing, **made)


def test_uniform_levels_are_middles_of_equal_parts() -> None:
    volume = radial(lambda r: r)
    levels = sample_range(volume, (2.0, 12.0), 5, "uniform").levels
    assert levels == pytest.approx((3.0, 5.0, 7.0, 9.0, 11.0))


@pytest.mark.parametrize("solid", ["above", "below"])
def test_adaptive_surfaces_are_evenly_spaced(solid: str) -> None:
    """Of f = r², whose surfaces are balls of radius √c: even levels crowd outside, adaptive ones do not."""
    volume = radial(lambda r: r * r, size=65, solid=solid)
    levels = sample_range(volume, (100.0, 900.0), 12, "adaptive")
    radii = np.sqrt(levels.levels)
    even = np.sqrt(sample_range(volume, (100.0, 900.0), 12, "uniform").levels)
    assert (np.diff(levels.levels) > 0.0).all()
    assert np.diff(radii).std() / np.diff(radii).mean() < 0.2 < np.diff(even).std() / np.diff(even).mean()
    assert levels.softened == 0.0
    assert levels.note == ""


def test_the_least_gradient_is_that_of_the_field() -> None:
    """|∇f| = 2r of f = r², whatever the voxels' shape; those of a cell's middle, next to the surface."""
    volume = radial(lambda r: r * r, size=65, spacing=(0.5, 1.0, 0.75))
    low, high = (float(volume.normalise_isovalue(each)) for each in (25.0, 225.0))
    found = least_gradients(volume, (low, high)) * abs(volume.scale)
    radii = np.sqrt(25.0 + 200.0 * (np.arange(RANGE_BINS) + 0.5) / RANGE_BINS)
    assert (found <= 2.0 * radii + 1e-6).all()
    assert (found >= 2.0 * (radii - 1.0)).all()


def test_of_a_large_volume_some_cells_say_nearly_the_same() -> None:
    volume = radial(lambda r: r * r, size=65)
    whole, some = (
        sample_range(volume, (100.0, 900.0), 12, "adaptive", most).levels for most in (np.inf, volume.voxels.size / 40)
    )
    assert some != whole
    np.testing.assert_allclose(np.sqrt(some), np.sqrt(whole), atol=0.5)


def test_stops_are_spread_over_the_range_and_are_short_numbers() -> None:
    volume = radial(lambda r: r * r, size=65)
    stops = find_stops(volume, (100.0, 900.0)).levels
    assert len(stops) == SLIDER_STOPS
    assert np.diff([100.0, *stops, 900.0]).min() > 0.0
    assert max(len(f"{stop:.15g}") for stop in stops) <= 5
    assert find_stops(volume, (300.0, 300.0)).levels == ()


@pytest.mark.parametrize("outlier", [1e3, 1e30, -1e300, np.inf, np.nan])
@pytest.mark.parametrize("scale", [1e-300, 1.0, 1e200])
def test_outliers_move_no_stop(outlier: float, scale: float) -> None:
    values = np.random.default_rng(2).random((9, 9, 9)).cumsum(axis=0) * scale
    values[4, 4, 4] = outlier * scale
    volume = make_volume(values)
    stops = find_stops(volume, (scale, 4.0 * scale)).levels
    assert len(stops) == SLIDER_STOPS
    assert np.diff([1.0, *(stop / scale for stop in stops), 4.0]).min() > 0.0


@pytest.mark.parametrize("scale", [1e-320, 1e-30, 1.0, 1e30, 1e307])
def test_shortened_levels_stay_near_and_in_order(scale: float) -> None:
    levels = [scale * each for each in (-3.14159, 0.123456, 0.234567, 8.7654321)]
    short = shortened(levels, (-4.0 * scale, 9.0 * scale))
    moved = np.abs(np.array(short) / 2.0 - np.array(levels) / 2.0)
    assert (moved <= 0.026 * np.array([0.87, 0.12, 0.12, 0.24]) * scale).all()


def test_numbers_are_rounded_to_powers_of_ten() -> None:
    steps = {60.0: 120.0, 1.0: 123.0, 0.5: 123.5, 0.0: 123.456, float("inf"): 123.456}
    assert {most: rounded(123.456, most) for most in steps} == steps
    assert str(rounded(-0.2, 1.0)) == "0.0"


def test_noise_leaves_even_levels_and_says_so() -> None:
    noise = np.random.default_rng(5).normal(size=(40, 40, 40)).astype(np.float32)
    volume = make_volume(noise)
    adaptive, even = (sample_range(volume, (-1.0, 1.0), 8, way) for way in ("adaptive", "uniform"))
    assert adaptive.softened > 0.5
    assert "levels are even there" in adaptive.note
    np.testing.assert_allclose(adaptive.levels, even.levels, atol=0.15)


def test_no_level_is_in_a_gap_of_the_range() -> None:
    """Two plateaus, 0 and 10, a step between: no surface lies beyond 10, and levels stay below."""
    volume = make_volume(np.repeat([0.0, 10.0, 20.0], [8, 8, 1])[:, None, None] * np.ones((1, 6, 6), np.float32))
    volume.voxels[-1] = np.nan
    levels = sample_range(volume, (0.0, 20.0), 6, "adaptive").levels
    assert min(levels) > 0.0
    assert max(levels) <= 10.05


def test_ranges_of_powers_of_two_spread_to_their_places() -> None:
    draw, places = np.random.default_rng(1), 64
    table, expected = np.full((7, places), np.inf), np.full(places, np.inf)
    for _ in range(40):
        level = int(draw.integers(7))
        first, value = int(draw.integers(places - (1 << level) + 1)), float(draw.random())
        table[level, first] = min(table[level, first], value)
        expected[first : first + (1 << level)] = np.minimum(expected[first : first + (1 << level)], value)
    np.testing.assert_array_equal(spread_down(table), expected)
