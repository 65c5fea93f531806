"""Few and many samples: sums that do not drift, and means that rounding does not hold up."""

import math
from contextlib import AbstractContextManager
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from isogi_core.bake.noise import Goal, mean_luminance
from isogi_core.bake.refine import add_to_mean, locate, refine, sample_transfer
from isogi_core.bake.texel_light import FIRST_LEVEL, Light, round_light
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.rays.pixel_rays import Paths
from isogi_core.model.scene_plan import MAX_SAMPLES, Layer
from isogi_core.plan.budget import BYTE_ROUNDING, HALF_ONE
from isogi_report.bench import ViewBake
from tests.stability.scenes import body_volume, is_finite, lit, view_bake, view_of

EXPECTED = {"half floats": HALF_ONE, "bytes": BYTE_ROUNDING, "single floats": 4e-8}
"""The error that the planner expects of rounding, by how one number is kept."""


def under_half_a_sky(pixels: int) -> AbstractContextManager[ViewBake]:
    """A body under half a sky that turns, nothing of it baked."""
    half = np.zeros((8, 16, 3))
    half[:4] = 1.0
    scene = lit(body_volume(), 0.5, half, bounces=2)
    return view_bake(scene, view_of(scene, pixels))


def test_the_sum_of_paths_is_that_of_exact_addition() -> None:
    """The kernel's sum of all paths of a pixel, beside ``math.fsum`` of one at a time."""
    count = 1 << 9
    with under_half_a_sky(3) as bake:
        gbuffer = bake.renderer.gbuffer(bake.view)
        tiles = bake.renderer.tiles
        paths = Paths(RotatedLight(bake.spec, bake.view), gbuffer, tiles)
        together = np.zeros((len(gbuffer.points), 1, 3))
        paths.add(together, 0, 0, count)
        ones = np.zeros((count, *together.shape))
        for sample, one in enumerate(ones):
            paths.add(one, 0, sample, 1)
    exact = [math.fsum(pixel) for pixel in ones.reshape(count, -1).T]
    assert exact
    np.testing.assert_allclose(together.ravel(), exact, rtol=1e-12)


@pytest.mark.parametrize("kept", EXPECTED)
def test_rounded_means_of_a_million_err_as_the_planner_expects(kept: str) -> None:
    """Root mean square over texels, where a mean is rounded whenever its samples double; no plan
    is to keep more bytes than that takes.
    """
    found = math.sqrt(float((errors_of_means(kept) ** 2).mean()))
    assert 0.6 * EXPECTED[kept] <= found <= EXPECTED[kept]


@pytest.mark.parametrize("kept", EXPECTED)
def test_rounding_pulls_means_neither_up_nor_down(kept: str) -> None:
    assert abs(float(errors_of_means(kept).mean())) <= 0.1 * EXPECTED[kept]


@cache
def errors_of_means(kept: str) -> np.ndarray:
    """Relative errors of means of 2^20 samples that were rounded after each rung, (texels,)
    float64.
    """
    layer = Layer("direct", 2, half=kept != "single floats", coarse=1 if kept == "bytes" else None)
    random = np.random.default_rng(3)
    texels = 20_000
    true = np.exp(random.uniform(-6.0, 0.0, texels)) * random.choice([-1.0, 1.0], texels)
    mean = np.zeros((texels, 4), np.float32)
    total = np.zeros(texels)
    samples = 0
    while samples < MAX_SAMPLES:
        count = max(samples, FIRST_LEVEL)
        added = count * true + math.sqrt(count) * 0.3 * true * random.normal(size=texels)
        light = np.repeat(added[:, None], 4, axis=1)
        mean = round_light(add_to_mean(mean, samples, light, samples + count), layer)
        total = total + added
        samples = samples + count
    return np.asarray(mean[:, 3] * samples / total - 1.0)


@pytest.mark.parametrize("count", [1 << 14, pytest.param(MAX_SAMPLES, marks=pytest.mark.slow)])
def test_the_light_of_a_texel_is_the_mean_of_its_samples(count: int) -> None:
    """Baked rung by rung, as it is kept, beside one sum of the same paths; luminance, over the mean
    of it.
    """
    with under_half_a_sky(3) as bake:
        texels = bake.texels[:8]
        spec = bake.spec
        kept, exact = (Light.dark(spec.plan, len(texels)) for _ in range(2))
        refine(kept, texels, spec, count, Goal(1e-9))
        place, void = locate(texels, spec.prepared)
        layers = spec.plan.layers
        for part, (halves, _) in zip(
            exact.parts, sample_transfer(layers, place, void, spec, 0, count), strict=True
        ):
            part.coefficients[:] = halves.sum(axis=1)[:, :, : part.layer.order**2] / count
        one, other = (mean_luminance(light, spec)[~void] for light in (kept, exact))
    assert other.mean() > 0.0
    assert float(np.abs(one - other).max() / other.mean()) <= 0.002


def test_frames_of_one_path_per_pixel_are_finite() -> None:
    with under_half_a_sky(16) as bake:
        frame = bake.renderer.render(replace(bake.view, shading="path_traced", samples=1))
    assert frame.surface > 50
    assert is_finite(frame)
