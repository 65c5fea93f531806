"""Noise at another albedo, against the variance of paths that are drawn one by one."""

import numpy as np
import pytest

from isogi_core.bake.bake_spec import BakeSpec
from isogi_core.frame.lighting import all_weights, reflected_weights, scatter_at, weights_between
from tests.bake.texels import orbital

CHANCES = np.array([0.1, 0.35, 0.7])
"""Of three texels: the chance of their paths to leave at each hit."""


@pytest.fixture(scope="module")
def judged() -> BakeSpec:
    """The orbital under constant light, of which views may ask for albedos up to 0.9; three bounces."""
    return orbital(0.3, sky=False, albedos=(0.0, 0.9))


def light_of(spec: BakeSpec) -> np.ndarray:
    """Band 0 of each term: what such paths bring unreflected, and at each of the albedos that are kept; (3, terms)."""
    k = np.arange(1, spec.plan.bounces + 1)
    left = CHANCES[:, None] * (1.0 - CHANCES[:, None]) ** k
    return np.column_stack([CHANCES, left @ (np.array(spec.plan.nodes) ** k[:, None])])


@pytest.mark.parametrize("albedo", [(0.3, 0.3, 0.3), (0.05, 0.05, 0.05), (0.9, 0.5, 0.1)])
def test_noise_of_reflected_light_falls_as_squares_of_paths(
    albedo: tuple[float, float, float], judged: BakeSpec
) -> None:
    """Of paths that leave by such chances the variance is known: Σ (mean over colours of R^k)² f (1 - f)^k."""
    seen, kept = judged.of_albedo(albedo), light_of(judged)
    k = np.arange(1, judged.plan.bounces + 1)
    left = CHANCES[:, None] * (1.0 - CHANCES[:, None]) ** k
    mix = np.array([0.2126, 0.7152, 0.0722]) * albedo
    brought = (mix / mix.sum()) @ np.array(albedo)[:, None] ** k
    np.testing.assert_allclose(kept @ reflected_weights(seen), left @ brought**2, rtol=0.02, atol=2e-4)
    weights, ones, none = weights_between(seen, judged), np.ones(3, np.float32), np.zeros(3, np.float32)
    ratio = scatter_at(weights, ones, ones, kept) / scatter_at(weights, ones, none, kept)
    np.testing.assert_allclose(ratio**2, left @ brought**2 / (left @ 0.9 ** (2 * k)), rtol=0.05, atol=2e-4)


def test_weights_of_all_paths_leave_the_surface_out(judged: BakeSpec) -> None:
    """Without reflected light it is the same at each albedo; with it there is less at a lower one."""
    dark = judged.of_albedo((0.3, 0.3, 0.3))
    kept = np.array([[1.0, *([0.0] * len(judged.plan.nodes))]])
    np.testing.assert_allclose(kept @ all_weights(dark), kept @ all_weights(judged))
    assert (light_of(judged) @ all_weights(dark) < light_of(judged) @ all_weights(judged)).all()


def test_noise_at_the_judged_albedo_stays(judged: BakeSpec) -> None:
    weights = weights_between(judged, judged)
    scatter = scatter_at(weights, np.array([0.1, 0.2, 0.3]), np.array([0.0, 0.5, 1.0]), light_of(judged))
    np.testing.assert_allclose(scatter, [0.1, 0.2, 0.3], rtol=1e-6)
