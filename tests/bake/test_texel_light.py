"""Light of texels in memory, and what is rounded of it on its way to the store."""

import struct

import numpy as np
import pytest

from isogi_core.bake.texel_light import (
    SAMPLES_OF,
    VOID,
    Light,
    decoded_light,
    level_codes,
    light_codes,
    next_level,
    noise_codes,
    noise_of,
    round_light,
)
from isogi_core.model.scene_plan import MAX_SAMPLES, Layer, ScenePlan
from tests.bake.texels import same

PLAN = ScenePlan("transfer", (Layer("direct", 3), Layer("indirect", 2, 3)), 3, 2, 1.0, 4096)


def some_light(texels: int, seed: int = 1) -> Light:
    """Light of random numbers, 16 samples each."""
    rng = np.random.default_rng(seed)
    light = Light.dark(PLAN, texels)
    for part in light.parts:
        part.samples[:] = 16
        part.noise[:] = rng.random(part.noise.shape)
        part.coefficients[:] = rng.normal(size=part.coefficients.shape)
    return light


def test_rows_are_copies_and_are_put_back_where_they_were() -> None:
    light = some_light(9)
    before = some_light(9)
    which = np.array([7, 0, 4])
    rows = light.rows(which)
    for part in rows.parts:
        part.coefficients[:] += 1.0
    assert same(light, before), "a copy"
    light.put(which, rows)
    assert same(light.rows(which), rows)
    others = np.setdiff1d(np.arange(9), which)
    assert same(light.rows(others), before.rows(others))


def test_a_texel_has_the_samples_of_its_least_sampled_layer() -> None:
    light = some_light(4)
    light.parts[0].samples[:] = [64, 16, VOID, VOID]
    light.parts[1].samples[:] = [16, 0, VOID, 0]
    assert light.samples.tolist() == [16, 0, VOID, VOID]
    assert light.void.tolist() == [False, False, True, True]


def test_layers_add_up_over_their_orders_and_channels() -> None:
    light = some_light(5)
    direct, indirect = (part.coefficients for part in light.parts)
    assert light.transfer.shape == (5, 3, 9)
    for channel in range(3):
        np.testing.assert_array_equal(
            light.transfer[:, channel, :4], direct[:, 0, :4] + indirect[:, channel]
        )
        np.testing.assert_array_equal(light.transfer[:, channel, 4:], direct[:, 0, 4:])


def test_a_texel_void_in_one_layer_is_made_void_in_all() -> None:
    """As when one layer is read before, and the other after, somebody else has written both."""
    light = some_light(9)
    light.parts[0].samples[5] = VOID
    light.agree_on_void()
    assert [part.samples.tolist() for part in light.parts] == [[16] * 5 + [VOID] + [16] * 3] * 2


# --- rounding
# --------------------------------------------------------------------------------------------------


SCALES = (1.0, 2.0**-9, 2.0**6)
CODES = np.arange(256, dtype=np.uint8)


@pytest.mark.parametrize("scale", SCALES)
def test_codes_of_noise_survive_the_round_trip(scale: float) -> None:
    noise = noise_of(CODES, scale)
    assert noise.dtype == np.float32 and (np.diff(noise) < 0.0).all() and noise[255] == 0.0
    assert np.array_equal(noise_codes(noise, scale), CODES)


@pytest.mark.parametrize("scale", SCALES)
def test_noise_is_kept_to_half_a_step(scale: float) -> None:
    """From 16 times the scale down over 31 octaves, in steps of an eighth of an octave."""
    noise = scale * 2.0 ** np.random.default_rng(1).uniform(-27.75, 4.0, 5000)
    kept = noise_of(noise_codes(noise, scale), scale)
    assert np.abs(np.log2(kept / noise)).max() <= 1 / 16 + 1e-6


def test_noise_beyond_the_codes_is_the_loudest_or_none() -> None:
    noise = np.array([1e9, 16.0, 15.0, 1e-30, 0.0])
    assert noise_codes(noise, 1.0).tolist() == [0, 0, 1, 255, 255]


def test_every_sample_level_has_a_code_of_its_own() -> None:
    levels = [0]
    while levels[-1] < 64 * MAX_SAMPLES:
        levels.append(next_level(levels[-1]))
    assert levels[:8] == [0, 16, 32, 64, 128, 256, 512, 1024]
    codes = level_codes(np.array([*levels, VOID], np.int32))
    assert codes.dtype == np.uint8
    assert codes.tolist() == [*range(len(levels)), 255]
    assert SAMPLES_OF[codes].tolist() == [*levels, VOID]
    assert SAMPLES_OF[codes].dtype == np.int32


def half(number: float) -> float:
    """The nearest IEEE half float, by Python's own packing."""
    return float(struct.unpack("<e", struct.pack("<e", number))[0])


@pytest.mark.parametrize("scale", SCALES)
def test_half_floats_are_the_nearest_and_rounded_once(scale: float) -> None:
    layer = Layer("direct", 5, scale=scale)
    rng = np.random.default_rng(2)
    light = rng.normal(size=(16, 25)) * scale * 10.0 ** rng.uniform(-9, 2, (16, 25))
    rounded = round_light(light, layer)
    assert rounded.dtype == np.float32
    assert rounded.ravel().tolist() == [half(number / scale) * scale for number in light.ravel()]
    assert np.array_equal(round_light(rounded, layer), rounded)
    kept = np.abs(light) > 2.0**-14 * scale
    assert np.abs(rounded / light - 1.0)[kept].max() <= 2.0**-11


@pytest.mark.parametrize("scale", SCALES)
def test_light_beyond_the_largest_is_cut_and_finite(scale: float) -> None:
    light = scale * np.array([1e9, -1e9, 65519.0, 65521.0, 65503.0, 65504.0, -2.0])[:, None]
    rounded = round_light(light, Layer("irradiance", scale=scale)) / scale
    top = np.finfo(np.float16).max
    assert rounded[:, 0].tolist() == [top, -top, top, top, top, top, -2.0]
    single = round_light(light, Layer("irradiance", half=False, scale=scale)) / scale
    assert single[:, 0].tolist() == [top, -top, top, top, 65503.0, top, -2.0]


def test_single_floats_are_kept_as_they_are() -> None:
    light = np.random.default_rng(3).normal(size=(100, 1))
    assert np.array_equal(round_light(light, Layer("direct", half=False)), light.astype(np.float32))


def test_bytes_of_light_survive_the_round_trip() -> None:
    used = CODES[CODES != 0x80]  # a negative zero
    light = decoded_light(used)
    assert light.dtype == np.float32 and len(set(light.tolist())) == len(used)
    assert np.array_equal(light_codes(light), used)
    assert decoded_light(light_codes(np.array([0.0, -0.0, 1.0, -1.0]))).tolist() == [
        0.0,
        0.0,
        1.0,
        -1.0,
    ]


def test_bytes_keep_light_to_half_a_step_and_its_sign() -> None:
    """Down to 2^-15.75 of the scale, in steps of an eighth of an octave."""
    size = np.random.default_rng(4).uniform(-15.75, 0.0, 5000)
    for sign in (1.0, -1.0):
        kept = decoded_light(light_codes(sign * 2.0**size))
        assert (sign * kept > 0.0).all()
        assert np.abs(np.log2(np.abs(kept)) - size).max() <= 1 / 16 + 1e-6
    assert not decoded_light(light_codes(np.array([1.0, -1.0]) * 2.0**-15.9)).any()


@pytest.mark.parametrize("scale", SCALES)
def test_only_the_higher_bands_are_bytes(scale: float) -> None:
    layer = Layer("direct", 5, coarse=2, scale=scale)
    light = 0.2 * scale * np.random.default_rng(5).normal(size=(30, 1, 25))
    rounded = round_light(light, layer)
    assert np.array_equal(
        rounded[..., :4], round_light(light[..., :4], Layer("direct", 2, scale=scale))
    )
    assert np.array_equal(
        rounded[..., 4:], decoded_light(light_codes(light[..., 4:] / scale)) * np.float32(scale)
    )
    assert np.array_equal(round_light(rounded, layer), rounded)
