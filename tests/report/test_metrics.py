"""Scores against closed forms."""

import importlib

import numpy as np
import pytest

from isogi_core.reference import Reference
from isogi_report.metrics import Score, Spread, error_map, score, spread_of

SHAPE = (8, 10)


def grey(light: np.ndarray) -> np.ndarray:
    return np.repeat(light[..., None], 3, axis=-1).astype(np.float32)


def best_of(light: np.ndarray, variance: float = 0.0) -> Reference:
    """A reference of this luminance whose first row is off the surface."""
    on = np.ones(light.shape, np.bool_)
    on[0] = False
    return Reference(grey(light * on), np.where(on, variance, 0.0).astype(np.float32), on, 64, 1.0)


def test_a_picture_has_no_error_against_itself() -> None:
    light = np.random.default_rng(1).random(SHAPE) + 0.5
    own = score(grey(light), best_of(light), 1.0)
    assert own.rmse == own.p99 == own.bias == own.noise == 0.0
    assert own.flip in (None, 0.0)


def test_an_even_error_is_its_own_rmse_percentile_and_bias() -> None:
    own = score(grey(np.full(SHAPE, 1.9)), best_of(np.full(SHAPE, 2.0)), 1.0)
    assert (own.rmse, own.p99, own.bias) == pytest.approx((0.05, 0.05, -0.05), rel=1e-5)


def test_what_is_off_the_surface_counts_nowhere() -> None:
    wild = np.full(SHAPE, 2.0)
    wild[0] = 1000.0
    own = score(grey(wild), best_of(np.full(SHAPE, 2.0)), 1.0)
    assert own.rmse == own.bias == 0.0
    errors = error_map(grey(wild), best_of(np.full(SHAPE, 2.0)))
    assert np.isnan(errors[0]).all()
    assert (errors[1:] == 0.0).all()


def test_the_noise_of_the_reference_is_taken_off() -> None:
    rng = np.random.default_rng(2)
    truth = np.full((200, 200), 1.0)
    sigma = 0.1
    noisy = best_of(truth + sigma * rng.standard_normal(truth.shape), sigma**2)
    off = grey(truth + 0.05 * rng.standard_normal(truth.shape))
    own = score(off, noisy, 1.0)
    assert own.rmse == pytest.approx(0.05, rel=0.1)
    assert own.noise == pytest.approx(0.1, rel=0.01)
    assert score(grey(truth), noisy, 1.0).rmse < 0.02


def test_a_spread_is_never_imaginary_and_nothing_has_none() -> None:
    assert spread_of(np.array([0.1, -0.1]), 1.0, 1.0).rmse == 0.0
    assert spread_of(np.zeros(0), 0.0, 1.0) == Spread(0.0, 0.0, 0.0)


def test_more_noise_is_more_flip() -> None:
    pytest.importorskip("flip_evaluator")
    light = np.full((32, 32), 0.5)
    noise = np.random.default_rng(3).standard_normal(light.shape)
    some, more = (
        score(grey(np.abs(light + s * noise)), best_of(light), 1.0).flip for s in (0.05, 0.2)
    )
    assert some is not None
    assert more is not None
    assert 0.0 < some < more < 1.0


def test_without_the_library_there_is_no_flip(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> None:
        raise ImportError(name)

    monkeypatch.setattr(importlib, "import_module", missing)
    own = score(grey(np.ones(SHAPE)), best_of(np.ones(SHAPE)), 1.0)
    assert own == Score(0.0, 0.0, 0.0, 0.0, None)
