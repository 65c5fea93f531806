"""Jumps from frame to frame against closed forms."""

import numpy as np
import pytest

from isogi_core.report import sequences
from isogi_core.report.bench import Bench
from isogi_core.report.reference import REPLICAS, Reference
from isogi_core.report.sequences import Shot, jumps, slide, study, turn
from tests.report.conftest import CONSTANT, MakeBench

SHAPE = (40, 50)


def truth(light: np.ndarray, on: np.ndarray, spread: float = 0.0, seed: int = 0) -> Reference:
    """A reference of this luminance, whose replicas are ``spread`` about it."""
    noise = spread * np.random.default_rng(seed).standard_normal((int(on.sum()), REPLICAS, 1))
    sums = (light[on][:, None, None] + noise) * np.ones(3) / REPLICAS
    mean = np.zeros((*SHAPE, 3), np.float32)
    mean[on] = sums.sum(axis=1)
    return Reference(mean, np.zeros(SHAPE, np.float32), on, 1, 0.0, sums)


def everywhere() -> np.ndarray:
    return np.ones(SHAPE, np.bool_)


def test_a_sequence_that_changes_as_the_truth_does_jumps_nowhere_beyond_it() -> None:
    """An error that stays where it is is none here."""
    rng = np.random.default_rng(1)
    light, change, wrong = rng.random(SHAPE) + 0.5, 0.1 * rng.standard_normal(SHAPE), rng.standard_normal(SHAPE)
    before = Shot(light + wrong, truth(light, everywhere()))
    after = Shot(light + change + wrong, truth(light + change, everywhere()))
    (found,) = jumps([before, after])
    mean = (light + change / 2.0).mean()
    assert found.own == pytest.approx(np.sqrt((change**2).mean()) / mean, rel=1e-5)
    assert found.beyond == pytest.approx(0.0, abs=1e-6) and found.p99 == pytest.approx(0.0, abs=1e-6)


def test_flicker_is_told_whatever_the_truth_does() -> None:
    rng = np.random.default_rng(2)
    light, flicker = np.full(SHAPE, 2.0), 0.2 * rng.standard_normal(SHAPE)
    taken = [Shot(light, truth(light, everywhere())), Shot(light + flicker, truth(light, everywhere()))]
    (found,) = jumps(taken)
    assert found.own == 0.0
    assert found.beyond == pytest.approx(np.sqrt((flicker**2).mean()) / 2.0, rel=1e-5)
    assert found.p99 == pytest.approx(np.percentile(np.abs(flicker), 99) / 2.0, rel=1e-5)


def test_only_pixels_that_show_the_surface_in_both_frames_count() -> None:
    light, left, right = np.full(SHAPE, 1.0), everywhere(), everywhere()
    left[:, :20], right[:, 30:] = False, False
    wild = light.copy()
    wild[:, :20] = wild[:, 30:] = 100.0
    (found,) = jumps([Shot(wild, truth(light, left)), Shot(light, truth(light, right))])
    assert (found.own, found.beyond) == (0.0, 0.0)
    nowhere = np.zeros(SHAPE, np.bool_)
    assert not list(jumps([Shot(light, truth(light, left)), Shot(light, truth(light, nowhere))]))


def test_noise_of_references_is_taken_off_and_what_they_share_cancels() -> None:
    light = np.full(SHAPE, 1.0)
    shared = [Shot(light, truth(light, everywhere(), 1.0, seed=3)) for _ in range(2)]
    (found,) = jumps(shared)
    assert (found.own, found.beyond) == (0.0, 0.0)
    apart = [Shot(light, truth(light, everywhere(), 1.0, seed)) for seed in (4, 5)]
    (found,) = jumps(apart)
    assert max(found.own, found.beyond) < 0.15 and found.p99 > 0.5


def test_views_slide_and_turn(under_sky: Bench) -> None:
    assert [view.isovalue - under_sky.view.isovalue for view in slide(under_sky.view, (0.0, 0.5))] == [0.0, 0.5]
    first, second = turn(under_sky.view, (0.0, 90.0))
    assert first.light == (1.0, 0.0, 0.0, 0.0)
    assert second.light == pytest.approx((np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)))


def test_the_isovalue_slides_within_its_range_and_light_that_stays_is_not_turned(make_bench: MakeBench) -> None:
    bench = make_bench(lights=[CONSTANT])
    found = sequences.sequences(bench)
    assert list(found) == ["the isovalue slides"]
    lowest, highest = bench.scene.isovalues
    assert all(lowest <= view.isovalue <= highest for view in found["the isovalue slides"])


def test_the_study_tells_of_both(under_sky: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sequences, "FRAMES", 2)
    monkeypatch.setattr(sequences, "PATHS", 64)
    section = study(under_sky)
    assert [row[0] for row in section.tables[0].rows] == ["the isovalue slides", "the light turns"]
    assert all(0.0 < float(cell or 0.0) < 1.0 for row in section.tables[0].rows for cell in row[2:])
