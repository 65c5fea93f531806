import numpy as np
import pytest

from isogi_core.bake.noise import Effort, efforts, expected_samples, good_enough, samples_left, samples_needed
from isogi_core.bake.texel_light import VOID
from isogi_core.model.scene_plan import MIN_SAMPLES, most_samples, texel_target

TARGET = 0.05
ERRORS = texel_target(TARGET)


def test_samples_follow_the_rate_of_errors_up_to_a_level() -> None:
    error, samples = ERRORS * np.array([4.0, 2.0, 1.02, 60.0, 0.2]), np.array([64, 64, 64, 64, 16])
    goals = [512, 256, 128, most_samples(TARGET), MIN_SAMPLES]  # 64 · 4^1.5 = 512, 64 · 2^1.5 = 181
    assert (samples + samples_left(error, samples, TARGET)).tolist() == goals


def test_texels_at_the_rate_take_the_predicted_samples() -> None:
    rng = np.random.default_rng(5)
    scale = rng.uniform(0.5, 5.0, 1000)
    samples = np.full(1000, 64)
    predicted = samples + samples_left(scale * samples ** (-2 / 3), samples, TARGET)
    while not (done := good_enough(scale * samples ** (-2 / 3), samples, TARGET)).all():
        samples = np.where(done, samples, 2 * samples)
    np.testing.assert_array_equal(samples[predicted > 128], predicted[predicted > 128])


def test_efforts_are_summed_chunk_by_chunk() -> None:
    rng = np.random.default_rng(6)
    samples = rng.choice([VOID, 0, 16, 64, 256, 2048], 400)
    error, chunks = rng.uniform(0.0, 0.3, 400), rng.integers(0, 5, 400)
    found = efforts(chunks, 6, error, samples, TARGET)
    for chunk in range(6):
        own = [(e, n) for e, n, at in zip(error, samples, chunks, strict=True) if at == chunk]
        lit = [(e, n) for e, n in own if n > 0 and not good_enough(np.array(e), np.array(n), TARGET)]
        left = sum(float(samples_left(np.array([e]), np.array([n]), TARGET)[0]) for e, n in lit)
        expected = sum(n == 0 for _, n in own), sum(n for _, n in lit), left, 0.0, len(lit)
        assert found[chunk].tolist() == pytest.approx(expected)
        mine = chunks == chunk
        assert Effort.of(error[mine], samples[mine], TARGET) == pytest.approx(expected)


def test_unlit_texels_are_expected_to_need_what_others_do() -> None:
    """What the unlit ones among the others would need is the mean of the chunk's lit ones."""
    samples, chunks = np.array([64, 64, 0, 0, 16]), np.array([0, 0, 0, 1, 3])
    error = ERRORS * np.array([4.0, 2.0, 180.0, 180.0, 0.2])
    first, second, last = samples_needed(error[[0, 1, 4]], samples[[0, 1, 4]], TARGET)
    assert (first, second, last) == (512, 256, MIN_SAMPLES)
    assert expected_samples(chunks, 4, error, samples, TARGET).tolist() == [1.5 * (512 + 256), 0.0, 0.0, MIN_SAMPLES]
