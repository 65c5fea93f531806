"""Errors of paths from pixels: what replicas tell, and the tail by few controls, as far as they
know it.
"""

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from isogi_core.errors import Cancelled
from isogi_core.files.radiance import write_hdr
from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.rays import pixel_rays
from isogi_core.frame.rays.control_pixels import ControlPixels, TotalError, chances, measure_total
from isogi_core.frame.rays.pixel_rays import pooled_variance, split_into_replicas, variance_of_mean
from isogi_core.frame.rays.tail_error import (
    TailError,
    bounds,
    falls_below,
    gamma_quantile,
    measure_tail,
    shares_above,
    shares_of,
    tail_of,
)
from isogi_core.frame.tiles import Interruption
from isogi_core.model.environment import LUMINANCE_WEIGHTS
from isogi_core.plan.scene import Scene
from tests.frame.conftest import CONSTANT, Workbench, ball, luminance, scene_of

BINOMIAL = np.outer([1, 4, 6, 4, 1], [1, 4, 6, 4, 1])


def gbuffer_of(on: np.ndarray) -> GBuffer:
    """Pixels of a picture, with points that nobody reads."""
    pixels = np.flatnonzero(on).astype(np.uint32)
    return GBuffer(
        on.shape, (1.0,) * 3, (0.0,) * 3, 0.5, pixels, np.zeros((len(pixels), 3), np.float32)
    )


def test_pooled_variance_is_a_weighted_mean_over_neighbours(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rng = np.random.default_rng(3)
    on = rng.random((9, 7)) < 0.6
    variance = rng.random(on.sum())
    padded = np.zeros((13, 11))
    weights = np.zeros((13, 11))
    padded[2:-2, 2:-2][on] = variance
    weights[2:-2, 2:-2][on] = 1.0
    expected = [
        (BINOMIAL * padded[y : y + 5, x : x + 5]).sum()
        / (BINOMIAL * weights[y : y + 5, x : x + 5]).sum()
        for y, x in np.argwhere(on)
    ]
    np.testing.assert_allclose(pooled_variance(variance, gbuffer_of(on)), expected, rtol=1e-12)
    monkeypatch.setattr(pixel_rays, "POOLED_PIXELS", 2 * 7)
    np.testing.assert_allclose(pooled_variance(variance, gbuffer_of(on)), expected, rtol=1e-12)


class Ways(Interruption):
    """Counts how often work gave way; it is cancelled when it did so ``most`` times."""

    def __init__(self, most: int) -> None:
        super().__init__()
        self.most = most
        self.given = 0

    def give_way(self) -> None:
        self.given += 1
        if self.given == self.most:
            self.set()


def test_a_path_traced_picture_is_the_same_in_passes(
    workbench: Callable[[Scene], Workbench],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It gives way to other work between them, and may end there."""
    room = {"room": "cornell", "albedo": [0.6, 0.5, 0.4]}
    bench = workbench(scene_of(ball(), 0.0, lights=[half_sky(tmp_path)], bounces=1, **room))
    view = bench.view(size=32, shading="path_traced", samples=8)
    whole = bench.renderer.render(view)
    assert len(whole.gbuffer.walls.pixels) > 100 and len(whole.gbuffer.pixels) > 100
    monkeypatch.setattr(pixel_rays, "PASS_PATHS", 8 * 50)
    ways = Ways(10_000)
    frame = bench.renderer.render(view, cancelled=ways)
    of_walls, of_surface = (
        -(-len(pixels) // 50) for pixels in (whole.gbuffer.walls.pixels, whole.gbuffer.pixels)
    )
    assert ways.given == of_walls + of_surface - 2
    for name in ("radiance", "error", "state"):
        np.testing.assert_array_equal(getattr(frame, name), getattr(whole, name))
    with pytest.raises(Cancelled):
        bench.renderer.render(view, cancelled=Ways(3))


@pytest.mark.parametrize("replicas", [2, 4, 8])
def test_intervals_of_pooled_variances_hold_gaussian_errors(replicas: int) -> None:
    on = np.ones((80, 80), np.bool_)
    means = 1.0 + np.random.default_rng(4).normal(size=(on.size, replicas, 1)) * np.ones(3)
    variance = variance_of_mean(means)
    wrong = means.mean(axis=1) @ LUMINANCE_WEIGHTS - 1.0
    assert variance.mean() == pytest.approx(1.0 / replicas, rel=0.05)
    held = np.abs(wrong) < 1.96 * np.sqrt(pooled_variance(variance, gbuffer_of(on)))
    assert 0.92 < held.mean() < 0.96
    alone = np.abs(wrong) < 1.96 * np.sqrt(variance)
    assert alone.mean() < held.mean()


def half_sky(folder: Path) -> dict[str, object]:
    """Radiance 1 from above, 0 from below."""
    image = np.zeros((2, 4, 3), np.float32)
    image[0] = 1.0
    write_hdr(folder / "half.hdr", image)
    return {"type": "probe", "file": str(folder / "half.hdr")}


@pytest.mark.parametrize("samples", [8, 16, 64, 256])
def test_path_traced_errors_are_as_large_as_reported(
    samples: int, workbench: Callable[[Scene], Workbench], tmp_path: Path
) -> None:
    """Its radiance is R (1 + n·z)/2, of the normals that rays start by; the ball meets none of
    them.
    """
    bench = workbench(scene_of(ball(), 0.0, lights=[half_sky(tmp_path)], albedo=0.6, bounces=0))
    frame = bench.renderer.render(bench.view(size=72, shading="path_traced", samples=samples))
    normals = frame.gbuffer.normals(bench.renderer.tiles)
    expected = 0.6 * (1.0 + normals[:, 2].astype(float)) / 2.0
    wrong = luminance(frame) - expected
    estimated = frame.error[frame.state > 0] * luminance(frame)
    assert 0.9 < np.sqrt((wrong**2).mean()) / expected.mean() / frame.noise < 1.1
    assert 0.9 < (np.abs(wrong) < 1.96 * estimated).mean() < 0.99


def test_a_ball_under_constant_light_has_its_albedo_and_no_error(
    workbench: Callable[[Scene], Workbench],
) -> None:
    bench = workbench(scene_of(ball(), 0.0, lights=[CONSTANT], albedo=0.6, bounces=2))
    frame = bench.renderer.render(bench.view(size=24, shading="path_traced"))
    np.testing.assert_allclose(luminance(frame), 0.6, rtol=1e-6)
    assert frame.noise < 1e-7 and frame.surface > 60 and not frame.provisional


@pytest.mark.parametrize(
    ("samples", "replicas", "each"),
    [(1, 2, 1), (7, 2, 4), (8, 4, 2), (255, 4, 64), (256, 8, 32), (4096, 8, 512)],
)
def test_more_samples_make_more_replicas(samples: int, replicas: int, each: int) -> None:
    assert split_into_replicas(samples) == (replicas, each)


def test_no_fewer_paths_are_traced_than_asked_for(
    workbench: Callable[[Scene], Workbench], tmp_path: Path
) -> None:
    """Of surface and walls: two replicas of 3 paths stand for 5, and not for 7."""
    room = {"room": "cornell", "albedo": [0.6, 0.5, 0.4]}
    bench = workbench(scene_of(ball(), 0.0, lights=[half_sky(tmp_path)], bounces=1, **room))
    five, six, seven = (
        bench.renderer.render(bench.view(size=16, shading="path_traced", samples=samples))
        for samples in (5, 6, 7)
    )
    np.testing.assert_array_equal(five.radiance, six.radiance)
    for pixels in (seven.gbuffer.pixels, seven.gbuffer.walls.pixels):
        changed = seven.radiance.reshape(-1, 3)[pixels] != six.radiance.reshape(-1, 3)[pixels]
        assert changed.any(axis=1).mean() > 0.5


# --- tails
# --------------------------------------------------------------------------------------------------


POINTS = 20_000
MEAN = 3.0

Kind = Callable[[np.random.Generator], tuple[np.ndarray, np.ndarray, np.ndarray]]
"""Makes relative errors of all points, the noise of half of the paths from each, and how uncertain
each seems.
"""


def smooth(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Errors as large as the noise of controls, and no hint at where they are larger."""
    return (
        0.02 * rng.normal(size=POINTS),
        np.full(POINTS, 0.02),
        0.02 * rng.uniform(0.5, 1.5, POINTS),
    )


def rough(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A noisy float field: errors of all sizes, and a rough idea of them."""
    size = 0.01 * np.exp(rng.normal(size=POINTS))
    seems = size * np.exp(0.5 * rng.normal(size=POINTS))
    return size * rng.normal(size=POINTS), np.full(POINTS, 0.02), seems


def rims(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Thin bright rims: 1.5 % of the points are wrong by about 12 %, and seem uncertain."""
    rim = rng.random(POINTS) < 0.015
    seems = np.exp(0.4 * rng.normal(size=POINTS))
    wrong = np.where(
        rim, 0.12 * (1.0 + 0.3 * rng.normal(size=POINTS)), 0.01 * rng.normal(size=POINTS)
    )
    return wrong, np.full(POINTS, 0.02), np.where(rim, 0.08, 0.01) * seems


def lamps(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Several small lamps: a tenth of the points has much noise, which is skewed, and smaller
    errors than it.
    """
    noise = np.where(rng.random(POINTS) < 0.1, 0.1, 0.015)
    wrong = 0.02 * rng.normal(size=POINTS) * np.exp(0.5 * rng.normal(size=POINTS))
    return wrong, noise, noise * np.exp(0.3 * rng.normal(size=POINTS))


KINDS = smooth, rough, rims, lamps


def told(
    kind: Kind, count: int, rng: np.random.Generator, bounded: bool = False
) -> tuple[TailError, float]:
    """What so many controls tell of a picture of a kind, and the truth by all of its points; the
    tail ``bounded`` by the total error that they measure.
    """
    wrong, noise, uncertainty = kind(rng)
    chance = chances(uncertainty)
    places = rng.choice(POINTS, count, p=chance)
    if kind is lamps:
        drift = rng.gamma(0.5, 2.0, (count, 2)) - 1.0
    else:
        drift = math.sqrt(2.0) * rng.normal(size=(count, 2))
    halves = 5.0 - MEAN * noise[places, None] * drift / math.sqrt(2.0)
    controls = ControlPixels(places, 1.0 / (POINTS * chance[places]), halves)
    shown = 5.0 + MEAN * wrong[places]
    tail = tail_of(controls, shown, uncertainty, MEAN)
    if bounded:
        tail = tail.within(measure_total(controls.weights * controls.squares(shown), MEAN))
    return tail, float(np.percentile(np.abs(wrong), 99.0))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("count", "apart"), [(256, 0.2), (1024, 0.12), (4096, 0.1)])
def test_the_tail_is_told_as_it_is(kind: Kind, count: int, apart: float) -> None:
    rng = np.random.default_rng(count)
    ratios = [tail.likely / true for tail, true in (told(kind, count, rng) for _ in range(40))]
    assert np.median(ratios) == pytest.approx(1.0, abs=apart)
    if count >= 1024:
        assert np.mean([0.7 < ratio < 1.4 for ratio in ratios]) >= 0.9


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("count", [256, 1024])
def test_the_interval_holds_the_true_tail(kind: Kind, count: int) -> None:
    rng = np.random.default_rng(2 * count)
    tails = [told(kind, count, rng) for _ in range(100)]
    assert np.mean([tail.low <= true <= tail.high for tail, true in tails]) >= 0.92
    assert all(tail.low <= tail.likely <= tail.high for tail, _ in tails)


@pytest.mark.parametrize(("count", "bounded"), [(256, False), (1024, True)])
def test_few_controls_bound_no_tail(count: int, bounded: bool) -> None:
    """Where none of n errs by more, 3 in n may: 256 leave more than 1 %."""
    none = np.zeros((count, 2))
    tail = measure_tail(none, np.ones(count), np.zeros(count, np.int64), np.zeros(count))
    assert tail.likely < 1e-3 and (tail.high < 1e-2) is bounded
    assert bounded or tail.high == 1.0


@pytest.mark.parametrize("kind", KINDS)
def test_the_total_bounds_a_tail_that_controls_do_not(kind: Kind) -> None:
    """256 controls alone leave the interval open in most pictures."""
    rng = np.random.default_rng(11)
    found = [told(kind, 256, rng, bounded=True) for _ in range(60)]
    assert max(tail.high for tail, _ in found) < 1.0
    assert np.mean([tail.low <= true <= tail.high for tail, true in found]) >= 0.92
    assert all(tail.low <= tail.likely <= tail.high for tail, _ in found)


def test_nothing_of_a_known_bound_is_lost() -> None:
    total = TotalError(0.02, 0.015, 0.025, 256)
    assert TailError(0.05, 0.04, 1.0).within(total).high == pytest.approx(0.25)
    assert TailError(0.05, 0.04, 0.07).within(total) == TailError(0.05, 0.04, 0.07)
    assert TailError(0.4, 0.3, 1.0).within(total).high == 0.4


def test_an_interval_never_ends_at_its_middle() -> None:
    """Noise above what controls find moves the interval, and leaves it as wide."""
    total = TotalError(0.010, 0.008, 0.012, 1024)
    assert total.at_least(0.005) == total
    raised = total.at_least(0.011)
    assert (raised.likely, raised.low) == (0.011, 0.008)
    assert raised.high == pytest.approx(0.011 * 1.2)
    assert total.at_least(0.5).high == pytest.approx(0.6)
    assert TotalError(0.0, 0.0, 0.0, 256).at_least(0.01).high == pytest.approx(0.013)
    assert total.at_least(1.0).high == 1.0


def test_a_pixel_that_is_drawn_again_is_one_control() -> None:
    rng = np.random.default_rng(5)
    controls = ControlPixels(np.arange(300), np.ones(300), rng.normal(0.0, 0.01, (300, 2)))
    shown = 0.05 * rng.normal(size=300)
    uncertainty = np.ones(300)
    twice = tail_of(controls.joined(controls), np.tile(shown, 2), uncertainty, 1.0)
    assert twice == tail_of(controls, shown, uncertainty, 1.0)


def test_in_the_dark_the_total_is_all_or_nothing() -> None:
    assert measure_total(np.zeros(4), 0.0) == TotalError(0.0, 0.0, 0.0, 4)
    assert measure_total(np.array([0.0, 1e-9]), 0.0) == TotalError(1.0, 1.0, 1.0, 2)


def test_in_the_dark_the_tail_is_all_or_nothing() -> None:
    controls = ControlPixels(np.arange(2), np.ones(2), np.zeros((2, 2)))
    assert tail_of(controls, np.zeros(2), np.ones(2), 0.0) == TailError(0.0, 0.0, 0.0)
    assert tail_of(controls, np.ones(2), np.ones(2), 0.0) == TailError(1.0, 1.0, 1.0)


def test_without_noise_shares_are_those_of_the_controls() -> None:
    """Controls that show their errors exactly are counted, each by its weight."""
    seen = np.array([0, 3, 3, 1])
    counts = np.array([0.1, 0.2, 0.3, 0.4])
    above = shares_above(np.eye(4)[seen], counts, np.full(4, 0.25))
    assert counts @ above == pytest.approx([0.9, 0.5, 0.5, 0.0])


def test_before_controls_pixels_err_as_their_classes_do() -> None:
    """Where none errs by anything, the shares are of normal errors of each scale."""
    rng = np.random.default_rng(3)
    scales = np.exp(rng.normal(-4.0, 0.8, 500))
    drawn = np.abs(scales * rng.normal(size=(4000, 500)))
    # Shares are of 80 errors by equal factors from 1e-4 to 1.
    borders = np.geomspace(1e-4, 1.0, 159)[1::2]
    counted = np.bincount(np.searchsorted(borders, drawn.ravel()), minlength=80) / drawn.size
    shares = shares_of(scales)
    assert shares.sum() == pytest.approx(1.0)
    # About half of the prior is spread evenly: no normal error reaches the end of the grid.
    odd = 80 * shares[-1]
    assert 0.25 < odd < 0.75
    assert (shares - odd / 80) / (1.0 - odd) == pytest.approx(counted, abs=3e-3)


@pytest.mark.parametrize("chance", [0.025, 0.5, 0.975])
@pytest.mark.parametrize("shape", [1.0, 3.0, 40.0])
def test_gamma_quantiles_are_those_of_tables(shape: float, chance: float) -> None:
    found = gamma_quantile(np.array([2.0]), np.array([4.0 / shape]), stats.norm.ppf(chance))
    true = stats.gamma.ppf(chance, shape, scale=2.0 / shape)
    assert found[0] == pytest.approx(true, rel=0.02, abs=0.05)


def test_equal_weights_have_the_bound_of_poisson_counts() -> None:
    """Five of 500 controls err by more: exact bounds of such a count are known."""
    above = np.zeros((500, 1))
    above[:5] = 1.0
    low, likely, high = bounds(above, np.full(500, 1.0 / 500))
    chance = 0.975
    exact = stats.chi2.ppf([1.0 - chance, chance], [10, 12]) / 1000
    assert likely[0] == pytest.approx(0.01)
    assert [low[0], high[0]] == pytest.approx(exact, rel=0.03)


def test_the_percentile_is_where_shares_come_down() -> None:
    errors = np.array([0.01, 0.1, 1.0])
    assert falls_below(0.01, np.array([0.5, 0.02, 0.0]), errors) == pytest.approx(
        0.1 * math.sqrt(10.0)
    )
    assert falls_below(0.01, np.array([0.009, 0.0, 0.0]), errors) == 0.0
    assert falls_below(0.01, np.array([0.5, 0.2, 0.02]), errors) == 1.0
