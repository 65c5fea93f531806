"""Which pixels are to have light of their own, and how many paths that takes."""

from dataclasses import replace

import numpy as np
import pytest

from isogi_core.bake.noise import RATE
from isogi_core.frame.rays.control_pixels import ControlPixels, spread_errors, variance_of_halves
from isogi_core.frame.rays.own_light import (
    AIM,
    FILTERED_VARIANCE_SHARE,
    FIRST_PATHS,
    REPLICAS,
    Choice,
    Growth,
    PixelLight,
    choose_points,
    foreseen_paths,
)
from isogi_core.frame.rays.pixel_rays import variance_of_mean
from isogi_core.frame.rays.point_paths import Estimate

POINTS, PATHS, NOISE = 2000, 512, 0.02
NONE = np.empty(0, np.int64)


@pytest.fixture(scope="module")
def wrong() -> np.ndarray:
    """How much each point errs: a quarter of them twenty times as much as the others."""
    rng = np.random.default_rng(1)
    return np.where(np.arange(POINTS) % 4 == 0, 1.0, 0.05) * (0.5 + rng.random(POINTS))


@pytest.fixture(scope="module")
def controls(wrong: np.ndarray) -> ControlPixels:
    """Controls at all points of a picture that shows 0; paths have the same noise everywhere."""
    noise = np.random.default_rng(2).normal(0.0, NOISE, (POINTS, 2))
    return ControlPixels(np.arange(POINTS), np.ones(POINTS), wrong[:, None] + noise)


def chosen(wrong: np.ndarray, controls: ControlPixels, allowed: float, own: np.ndarray = NONE) -> Choice:
    errors = spread_errors(wrong, controls, np.zeros(POINTS)) ** 2
    return choose_points(errors, variance_of_halves(wrong, controls), PATHS, own, allowed)


def light_of(places: np.ndarray, count: int, deviation: float) -> PixelLight:
    """Light whose replicas' means have this standard deviation of luminance about 1."""
    means = 1.0 + deviation * np.array([-1.0, 1.0, -1.0, 1.0]) * np.sqrt(3.0 / 4.0)
    sums = np.repeat(count * means[None, :, None], len(places), axis=0) * np.ones(3)
    estimate = Estimate(sums, np.full(len(places), count))
    return PixelLight(places, estimate, np.ones((len(places), 3)), variance_of_mean(estimate.means), NONE)


def test_those_that_err_most_are_chosen(wrong: np.ndarray, controls: ControlPixels) -> None:
    choice = chosen(wrong, controls, 0.01)
    assert set(choice.places) <= set(np.flatnonzero(wrong > 0.4)) and len(choice.places) > 400
    assert np.array_equal(choice.places, np.unique(choice.places))


def test_what_is_left_and_noise_make_what_is_allowed(wrong: np.ndarray, controls: ControlPixels) -> None:
    choice = chosen(wrong, controls, 0.002)
    assert choice.count > FIRST_PATHS
    left = np.delete(spread_errors(wrong, controls, np.zeros(POINTS)) ** 2, choice.places).sum()
    assert left + choice.variance == pytest.approx(0.002 * POINTS)
    each = FILTERED_VARIANCE_SHARE * NOISE**2 / REPLICAS * (PATHS / choice.count) ** (2.0 / RATE)
    assert len(choice.places) * each == pytest.approx(choice.variance, rel=0.1)


def test_no_other_number_of_points_takes_fewer_paths(wrong: np.ndarray, controls: ControlPixels) -> None:
    allowed, choice = 0.01, chosen(wrong, controls, 0.01)
    squares = np.sort(spread_errors(wrong, controls, np.zeros(POINTS)) ** 2)[::-1]

    def cost(many: int) -> float:
        variance = allowed * POINTS - squares[many:].sum()
        if variance <= 0.0:
            return np.inf
        return many * max(
            PATHS * (many * FILTERED_VARIANCE_SHARE * NOISE**2 / REPLICAS / variance) ** (RATE / 2.0), FIRST_PATHS
        )

    least = min(cost(many) for many in range(1, POINTS + 1))
    assert cost(len(choice.places)) == pytest.approx(least, rel=0.02)


def test_points_with_light_of_their_own_keep_it(wrong: np.ndarray, controls: ControlPixels) -> None:
    own = np.arange(1, 200, 4)
    assert set(own) <= set(chosen(wrong, controls, 0.01, own).places)


def test_all_are_chosen_where_nothing_else_will_do(controls: ControlPixels) -> None:
    even = chosen(np.ones(POINTS), replace(controls, halves=np.ones((POINTS, 2))), 1e-9)
    assert len(even.places) == POINTS


def test_growing_light_says_what_is_left_of_it() -> None:
    places = np.arange(10)
    begun = Growth(Choice(places, 10 * 0.1**2, 100.0, NONE), PixelLight.none())
    assert begun.left == 10 * REPLICAS * 100 and begun.next == FIRST_PATHS
    begun.note(10)
    assert begun.left == 10 * REPLICAS * 100 - 10
    known = Growth(begun.choice, light_of(places, 16, 2.0 * 0.2))
    assert not known.enough and known.next == 32
    assert known.wanted == pytest.approx(16 * 2.0**RATE)
    assert known.left == pytest.approx(10 * REPLICAS * (16 * 2.0**RATE - 16))
    near = Growth(begun.choice, light_of(places, 64, 2.0 * 0.11))
    assert 64 < near.next < 128
    assert Growth(begun.choice, light_of(places, 128, 2.0 * 0.09)).enough


def test_more_points_begin_with_as_many_paths_as_others_have() -> None:
    grown = Growth(Choice(np.arange(20), 1.0, 40.0, NONE), light_of(np.arange(10), 32, 0.1))
    assert grown.next == 32 and grown.left == REPLICAS * (20 * 40.0 - 10 * 32)


def test_paths_are_foreseen_as_for_errors_that_are_spread() -> None:
    """Brute force: squares drawn from the distribution, each number of points tried."""
    target, error, points, effort = 0.02, 0.03, 20_000, 0.5
    squares = np.sort(error**2 * np.random.default_rng(3).exponential(size=points))[::-1]
    variance = (AIM * target) ** 2 * points - np.append(squares[::-1].cumsum()[::-1][1:], 0.0)
    many = np.arange(1, points + 1)
    cost = many * effort * (many / np.maximum(variance, 1e-300)) ** (RATE / 2.0)
    assert foreseen_paths(points, error, target, effort) == pytest.approx(cost[variance > 0.0].min(), rel=0.05)


def test_no_paths_are_foreseen_where_light_is_good_enough() -> None:
    assert foreseen_paths(1000, 0.9 * AIM * 0.02, 0.02, 0.5) == 0.0


def test_in_the_dark_all_points_are_traced_once() -> None:
    """Nothing is allowed there, as the true light is 0, and no path brings any."""
    dark = ControlPixels(np.arange(POINTS), np.ones(POINTS), np.zeros((POINTS, 2)))
    errors = spread_errors(np.ones(POINTS), dark, np.full(POINTS, 0.3)) ** 2
    choice = choose_points(errors, np.zeros(POINTS), PATHS, NONE, 0.0)
    assert len(choice.places) == POINTS and choice.count == FIRST_PATHS
    assert Growth(choice, light_of(choice.places, FIRST_PATHS, 0.0)).enough
