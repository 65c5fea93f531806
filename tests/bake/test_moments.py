"""The variance of one path's light, against paths that were drawn."""

import math
from dataclasses import replace

import numpy as np
import pytest

from isogi_core.bake.bake_spec import band_of, square_light
from isogi_core.bake.noise import evenness, path_deviation
from isogi_core.bake.texel_light import Light
from isogi_core.kernels.shading.lattice import LEAST_SPREAD, LIGHT_NUMBERS, light_texels
from isogi_core.model.scene_plan import Layer
from tests.bake.texels import plan_of, rotations_of, spec_of
from tests.kernels.transport.harmonic_bases import basis


@pytest.fixture
def rng() -> np.random.Generator:
    """Random numbers, the same for each test."""
    return np.random.default_rng(12)


def ways(rng: np.random.Generator, count: int) -> np.ndarray:
    """Directions with a cosine about z, of paths that leave; (count, 3)."""
    u, v = rng.random((2, count))
    radius, angle = np.sqrt(u), 2.0 * math.pi * v
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1.0 - u)], axis=-1)


@pytest.mark.parametrize("order", [1, 2, 6])
def test_a_squared_light_is_its_squared_radiance(order: int, rng: np.random.Generator) -> None:
    """Against a fine grid: equal steps in z and in azimuth."""
    light = rng.normal(size=order**2)
    z, angle = (np.arange(400) + 0.5) / 200.0 - 1.0, 2.0 * math.pi * (np.arange(64) + 0.5) / 64
    side = np.sqrt(1.0 - z**2)[:, None]
    grid = np.stack(np.broadcast_arrays(side * np.cos(angle), side * np.sin(angle), z[:, None]), axis=-1)
    values = basis(order, grid.reshape(-1, 3))
    expected = (values @ light) ** 2 @ values * 4.0 * math.pi / len(values)
    np.testing.assert_allclose(square_light(light), expected, rtol=2e-3, atol=2e-3)


def test_a_texels_spread_is_that_of_its_paths_light(rng: np.random.Generator) -> None:
    """Light of two bands, whose square has three and is wholly known; a third of the paths bring nothing."""
    light = np.pad(rng.normal(size=(3, 4)), ((0, 0), (0, 5)))
    colour = np.array([0.2126, 0.7152, 0.0722])
    square = square_light(colour @ light)
    values = basis(3, ways(rng, 3000)) * (rng.random((3000, 1)) < 2 / 3)
    transfer = np.float32(values.mean(axis=0))[None, None]
    lit = np.empty((1, LIGHT_NUMBERS), np.float32)
    args = (np.float32(light), np.float32(square), np.zeros(1, np.int32), 9, lit)
    light_texels(np.zeros(1, np.int32), transfer, np.full(1, 0.1, np.float32), *args)
    variance = (values @ (colour @ light)).var()
    least = LEAST_SPREAD * transfer[0, 0, 0] * square[0]
    assert lit[0, 3] == pytest.approx(0.1 * math.sqrt(variance + least), rel=1e-3)


@pytest.mark.parametrize("channels", [1, 3])
def test_the_deviation_of_paths_is_a_mean_over_rotations(channels: int, rng: np.random.Generator) -> None:
    spec = spec_of(plan_of(Layer("direct", 4, channels)))
    light = Light.dark(spec.plan, 6)
    fading = 0.3 ** band_of(4)
    light.parts[0].coefficients[:] = 0.02 * rng.normal(size=(6, channels, 16)) * fading
    light.parts[0].coefficients[:, :, 0] = 0.2
    lights, estimated = rotations_of(spec.luminance_light, 3000), path_deviation(light, spec)
    second = np.array([square_light(one.sum(axis=0)) for one in lights[:300]])
    seen = light.transfer[:, channels // 2] @ second.mean(axis=0)
    mean = np.einsum("mcn,tcn->mt", light.transfer, lights)
    expected = seen - (mean**2).mean(axis=1) + LEAST_SPREAD * 0.2 * second[0, 0]
    np.testing.assert_allclose(estimated**2, expected, rtol=0.05)


def test_the_deviation_under_two_lights_is_a_mean_over_both(rng: np.random.Generator) -> None:
    """Direct light of order 4 beside a lobe, and reflected light of order 3 with it."""
    spec = spec_of(replace(plan_of(Layer("direct", 4), Layer("indirect", 3)), lobes=1))
    assert len(spec.terms) == 2 and not np.allclose(spec.terms[0].light[:, :9], spec.terms[1].light)
    light, unit = Light.dark(spec.plan, 6), spec.unit
    for part, mean in zip(light.parts, (0.2, 0.05), strict=True):
        part.coefficients[:] = 0.1 * mean * rng.normal(size=part.coefficients.shape) * 0.3 ** band_of(part.layer.order)
        part.coefficients[:, :, 0] = mean
    both = np.zeros((2, 16))
    for row, term in zip(both, spec.terms, strict=True):
        row[: term.order**2] = term.luminance.sum(axis=0) / unit
    turns = rotations_of(both, 3000)
    mean = sum(light.columns([term])[:, 0] @ turns[:, i, : term.order**2].T for i, term in enumerate(spec.terms))
    second = sum(
        part.coefficients[:, 0, 0] * term.square[0] for part, term in zip(light.parts, spec.terms, strict=True)
    )
    expected = np.maximum(second - (mean**2).mean(axis=1), 0.0) + LEAST_SPREAD * second
    np.testing.assert_allclose((path_deviation(light, spec) / unit) ** 2, expected, rtol=0.05)


@pytest.mark.parametrize("share", [1.0, 0.6])
def test_band_0_varies_less_where_paths_bring_equal_light(share: float, rng: np.random.Generator) -> None:
    """Against the variances of paths that were drawn, of which a ``share`` brings light."""
    count = 100_000
    values = basis(2, ways(rng, count)) * (rng.random((count, 1)) < share)
    second = np.array([values[:, 0].mean()])
    variances = values.var(axis=0)
    estimated = evenness(values.mean(axis=0)[None], second, count)
    assert estimated[0] == pytest.approx(variances[0] / variances[1:].mean(), rel=0.02, abs=1e-4)
