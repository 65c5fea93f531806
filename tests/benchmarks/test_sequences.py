"""Jumps from frame to frame against closed forms."""

import numpy as np
import pytest

from benchmarks.accuracy.sequences import Shot, jumps, sequences, slide, turn
from isogi_core.plan.assembly import load_scene
from isogi_core.reference import Reference
from isogi_report.speed import view_of
from tests.benchmarks.parts import figures

SHAPE = (40, 50)


def truth(light: np.ndarray, on: np.ndarray, spread: float = 0.0, seed: int = 0) -> Reference:
    """A reference of this luminance, whose eight replicas are ``spread`` about it."""
    noise = spread * np.random.default_rng(seed).standard_normal((int(on.sum()), 8, 1))
    sums = (light[on][:, None, None] + noise) * np.ones(3) / 8
    mean = np.zeros((*SHAPE, 3), np.float32)
    mean[on] = sums.sum(axis=1)
    return Reference(mean, np.zeros(SHAPE, np.float32), on, 1, 0.0, sums)


def everywhere() -> np.ndarray:
    return np.ones(SHAPE, np.bool_)


def test_a_sequence_that_follows_the_truth_has_no_jumps() -> None:
    """An error that stays where it is is none here."""
    rng = np.random.default_rng(1)
    light = rng.random(SHAPE) + 0.5
    change = 0.1 * rng.standard_normal(SHAPE)
    wrong = rng.standard_normal(SHAPE)
    before = Shot(light + wrong, truth(light, everywhere()))
    after = Shot(light + change + wrong, truth(light + change, everywhere()))
    (found,) = jumps([before, after])
    mean = (light + change / 2.0).mean()
    assert found.own == pytest.approx(np.sqrt((change**2).mean()) / mean, rel=1e-5)
    assert found.beyond == pytest.approx(0.0, abs=1e-6) and found.p99 == pytest.approx(
        0.0, abs=1e-6
    )


def test_flicker_is_told_whatever_the_truth_does() -> None:
    rng = np.random.default_rng(2)
    light = np.full(SHAPE, 2.0)
    flicker = 0.2 * rng.standard_normal(SHAPE)
    taken = [
        Shot(light, truth(light, everywhere())),
        Shot(light + flicker, truth(light, everywhere())),
    ]
    (found,) = jumps(taken)
    assert found.own == 0.0
    assert found.beyond == pytest.approx(np.sqrt((flicker**2).mean()) / 2.0, rel=1e-5)
    assert found.p99 == pytest.approx(np.percentile(np.abs(flicker), 99) / 2.0, rel=1e-5)


def test_only_pixels_that_show_the_surface_in_both_frames_count() -> None:
    light = np.full(SHAPE, 1.0)
    left = everywhere()
    right = everywhere()
    left[:, :20] = False
    right[:, 30:] = False
    wild = light.copy()
    wild[:, :20] = wild[:, 30:] = 100.0
    (found,) = jumps([Shot(wild, truth(light, left)), Shot(light, truth(light, right))])
    assert (found.own, found.beyond) == (0.0, 0.0)
    nowhere = np.zeros(SHAPE, np.bool_)
    assert not list(jumps([Shot(light, truth(light, left)), Shot(light, truth(light, nowhere))]))


def test_noise_of_references_is_subtracted_shared_noise_cancels() -> None:
    light = np.full(SHAPE, 1.0)
    shared = [Shot(light, truth(light, everywhere(), 1.0, seed=3)) for _ in range(2)]
    (found,) = jumps(shared)
    assert (found.own, found.beyond) == (0.0, 0.0)
    apart = [Shot(light, truth(light, everywhere(), 1.0, seed)) for seed in (4, 5)]
    (found,) = jumps(apart)
    assert max(found.own, found.beyond) < 0.15 and found.p99 > 0.5


def test_views_slide_and_turn() -> None:
    view = view_of(load_scene("demo:orbital"), 8)
    assert [each.isovalue - view.isovalue for each in slide(view, (0.0, 0.5))] == [0.0, 0.5]
    first, second = turn(view, (0.0, 90.0))
    assert first.light == (1.0, 0.0, 0.0, 0.0)
    assert second.light == pytest.approx((np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)))


def test_the_part_tells_of_both() -> None:
    sliding = (
        "--from",
        "0.02",
        "--to",
        "0.03",
        "--step",
        "0.01",
        "--turns",
        "1",
        "--degrees",
        "20",
    )
    found = figures(
        sequences, "demo:orbital", *sliding, "--paths", "16", "--error", "0.5", "--size", "12"
    )
    assert found["isovalue: steps"] == found["light: steps"] == 1
    assert all(
        0.0 < found[f"{what}: the truth's jump, root mean square, mean"] < 100.0
        for what in ("isovalue", "light")
    )
