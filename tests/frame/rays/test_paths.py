"""Paths from pixels: what their replicas tell of the error, against brute force, closed forms and statistics."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from isogi_core.files.radiance import write_hdr
from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.rays.pixel_rays import pooled_variance, replicas_for, variance_of_mean
from isogi_core.model.environment import LUMINANCE_WEIGHTS
from isogi_core.plan.scene import Scene
from tests.frame.conftest import CONSTANT, Workbench, ball, luminance, scene_of

BINOMIAL = np.outer([1, 4, 6, 4, 1], [1, 4, 6, 4, 1])


def gbuffer_of(on: np.ndarray) -> GBuffer:
    """Pixels of a picture, with points that nobody reads."""
    pixels = np.flatnonzero(on).astype(np.uint32)
    return GBuffer(on.shape, (1.0,) * 3, (0.0,) * 3, 0.5, pixels, np.zeros((len(pixels), 3), np.float32))


def test_pooled_variance_is_a_weighted_mean_over_neighbours() -> None:
    rng = np.random.default_rng(3)
    on = rng.random((9, 7)) < 0.6
    variance = rng.random(on.sum())
    padded, weights = np.zeros((13, 11)), np.zeros((13, 11))
    padded[2:-2, 2:-2][on], weights[2:-2, 2:-2][on] = variance, 1.0
    expected = [
        (BINOMIAL * padded[y : y + 5, x : x + 5]).sum() / (BINOMIAL * weights[y : y + 5, x : x + 5]).sum()
        for y, x in np.argwhere(on)
    ]
    np.testing.assert_allclose(pooled_variance(variance, gbuffer_of(on)), expected, rtol=1e-12)


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
    """Its radiance is R (1 + n·z)/2, of the normals that rays start by; the ball meets none of them."""
    bench = workbench(scene_of(ball(), 0.0, lights=[half_sky(tmp_path)], albedo=0.6, bounces=0))
    frame = bench.renderer.render(bench.view(size=72, shading="path_traced", samples=samples))
    normals = frame.gbuffer.normals(bench.renderer.tiles)
    expected = 0.6 * (1.0 + normals[:, 2].astype(float)) / 2.0
    wrong = luminance(frame) - expected
    estimated = frame.error[frame.state > 0] * luminance(frame)
    assert 0.9 < np.sqrt((wrong**2).mean()) / expected.mean() / frame.noise < 1.1
    assert 0.9 < (np.abs(wrong) < 1.96 * estimated).mean() < 0.99


def test_a_ball_under_constant_light_has_its_albedo_and_no_error(workbench: Callable[[Scene], Workbench]) -> None:
    bench = workbench(scene_of(ball(), 0.0, lights=[CONSTANT], albedo=0.6, bounces=2))
    frame = bench.renderer.render(bench.view(size=24, shading="path_traced"))
    np.testing.assert_allclose(luminance(frame), 0.6, rtol=1e-6)
    assert frame.noise < 1e-7 and frame.surface > 60 and not frame.provisional


@pytest.mark.parametrize(("samples", "replicas"), [(1, 2), (7, 2), (8, 4), (255, 4), (256, 8), (4096, 8)])
def test_more_samples_make_more_replicas(samples: int, replicas: int) -> None:
    assert replicas_for(samples) == replicas
