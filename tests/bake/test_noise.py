"""The error estimate: its weights, its calibration against a long bake, and when a texel is done."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from isogi_core.bake.light import VOID, Light
from isogi_core.bake.noise import FEWEST, FLOOR, finished, most_samples, relative_error
from isogi_core.bake.recipe import Recipe, band_of, noise_weights
from isogi_core.kernels.harmonics import rotate
from isogi_core.model.scene import load_scene
from tests.bake.test_refine import COMPILED, baked, orbital_recipe, surface_texels

ORDER = 5


def turned(light: np.ndarray, count: int, seed: int = 1) -> np.ndarray:
    """The light (channels, n²) under so many random rotations, (count, channels, n²)."""
    out = np.empty((count, *light.shape))
    for matrix, place in zip(Rotation.random(count, rng=seed).as_matrix(), out, strict=True):
        rotate(ORDER, np.ascontiguousarray(matrix), light, place)
    return out


def light_of(recipe: Recipe, transfer: np.ndarray, spread: np.ndarray, samples: float = 16.0) -> Light:
    """Light with this direct transfer (m, n²) and spread (m, channels, n²)."""
    light = Light.dark(recipe.scene.plan, len(transfer))
    light.planes[:, 0] = samples
    light.direct[:] = transfer
    light.spread[:] = spread
    return light


def test_bands_of_coefficients() -> None:
    assert band_of(3).tolist() == [0, 1, 1, 1, 2, 2, 2, 2, 2]


def test_weights_pool_each_band_with_its_neighbours() -> None:
    """A twin in loops: Σ_l |ℓ_l|² times the mean square of the coefficients of the bands l - 1, l, l + 1."""
    rng = np.random.default_rng(2)
    light, spread = rng.normal(size=(3, 25)), rng.normal(size=(3, 25))
    expected = 0.0
    for c in range(3):
        for l in range(ORDER):
            near = np.abs(band_of(ORDER) - l) <= 1
            power = (light[c, band_of(ORDER) == l] ** 2).sum()
            expected += power * (spread[c, near] ** 2).mean()
    assert (noise_weights(light, ORDER) * spread**2).sum() == pytest.approx(expected)


def test_the_estimate_is_a_mean_over_all_turns_of_the_light() -> None:
    """Spreads drawn alike in every coefficient, as noise nearly is: pooling then changes nothing on average."""
    rng = np.random.default_rng(3)
    light, spreads = rng.normal(size=(1, 25)) * 0.5 ** band_of(ORDER), rng.normal(size=(400, 25))
    told = (spreads**2 @ noise_weights(light, ORDER)[0]).mean()
    seen = ((turned(light, 400)[:, 0] @ spreads.T) ** 2).mean()
    assert told == pytest.approx(seen, rel=0.05)


def test_error_is_relative_to_the_texels_own_light() -> None:
    recipe = Recipe(load_scene("demo:orbital", lights=[{"type": "constant", "radiance": 3.0}], albedo=0.5))
    transfer, spread = np.zeros((3, 25)), np.zeros((3, 1, 25))
    transfer[:, 0] = np.array([1.0, 0.8, 0.01]) / np.sqrt(4 * np.pi)
    spread[:, 0, 0] = 0.02 / np.sqrt(4 * np.pi)
    error = relative_error(light_of(recipe, transfer, spread), recipe)
    alone = 0.02 / np.sqrt(4)  # one coefficient of the four in bands 0 and 1 that are pooled
    np.testing.assert_allclose(error, [alone, alone / 0.8, alone / FLOOR], rtol=1e-5)


def test_no_light_has_no_error() -> None:
    recipe = Recipe(load_scene("demo:orbital", lights=[{"type": "constant", "radiance": 0.0}]))
    error = relative_error(light_of(recipe, np.ones((2, 25)), np.ones((2, 1, 25))), recipe)
    assert error.tolist() == [0.0, 0.0]


def test_a_texel_is_done_when_good_enough_spent_or_void() -> None:
    recipe = orbital_recipe()
    light = light_of(recipe, np.ones((5, 25)), np.ones((5, 1, 25)))
    light.spread[1] = 0.0
    light.planes[:, 0] = [FEWEST, FEWEST, most_samples(0.01), VOID, 0]
    assert finished(light, recipe, 0.01).tolist() == [False, True, True, True, False]
    light.spread[:] = 0.0
    assert finished(light, recipe, 0.01).tolist() == [True, True, True, True, False], "unlit is never done"
    light.planes[0, 0] = FEWEST / 2
    assert not finished(light, recipe, 0.01)[0], "few paths that all died say nothing"


def test_a_stricter_target_is_worth_more_samples() -> None:
    worth = [most_samples(target) for target in (1.0, 0.05, 0.02, 0.01, 0.005, 1e-4)]
    assert worth == sorted(worth) and worth[2] == 4096
    assert all(n & (n - 1) == 0 for n in worth), "rungs of the ladder are powers of two"


@COMPILED
def test_error_falls_as_samples_are_added() -> None:
    recipe = orbital_recipe()
    texels = surface_texels(recipe, 60)
    errors = [
        np.sqrt((relative_error(Light(recipe.scene.plan, baked(recipe, texels, n)), recipe) ** 2).mean())
        for n in (16, 128, 1024)
    ]
    assert errors[1] < 0.5 * errors[0] and errors[2] < 0.5 * errors[1]


@pytest.mark.slow
@COMPILED
def test_the_estimate_is_calibrated() -> None:
    """500 texels of the orbital: what 64 samples are wrong by, against 8192, is what their spread says."""
    recipe = orbital_recipe()
    texels = surface_texels(recipe, 500)
    estimate, reference = (Light(recipe.scene.plan, baked(recipe, texels, n)) for n in (64, 8192))
    assert (reference.samples == 8192).all() and len(texels) == 500
    lights = turned(recipe.luminance_light, 12)[:, 0]
    wrong = (estimate.transfer - reference.transfer)[:, 0] @ lights.T
    told = estimate.spread[:, 0] @ lights.T
    ratios = np.sqrt((wrong**2).mean(axis=0) / (told**2).mean(axis=0))
    assert ratios.min() > 0.75 and ratios.max() < 1.3, ratios
    mean = reference.transfer[:, 0, 0] * recipe.luminance_light[0, 0]
    bright = mean > FLOOR * recipe.luminance_light[0, 0] / np.sqrt(4 * np.pi)
    seen = np.sqrt(((wrong / mean[:, None])[bright] ** 2).mean())
    assert 0.75 < seen / np.sqrt((relative_error(estimate, recipe)[bright] ** 2).mean()) < 1.3
