"""What is rounded on its way to the store: light to half floats or bytes, noise and sample counts to bytes.

Sample counts climb levels, each twice the one before. Light in memory is rounded too, after each level, so that
a texel has the same bits whether it was read or just baked.
"""

import numpy as np

from isogi_core.model.scene_plan import Layer

FIRST_LEVEL = 16
"""Samples of a texel's first level; each further one doubles them."""

VOID = -1
"""Number of samples that marks a texel which can hold no light."""

VOID_CODE = 255

NOISIEST = 16.0
"""The noise, in units of a layer's scale, that code 0 stands for."""

LARGEST_HALF = 65504.0
"""The most that is kept, in units of a layer's scale: the largest half float. A lamp next to the surface gives more."""

CODES_PER_HALVING = 8
"""Codes that halve a number: 9 % apart."""

NEGATIVE, SMALLEST = 0x80, 0x7F
"""The sign of a coefficient that is kept as a byte, and the code of the smallest: 2^-15.75 of the scale."""

SILENT = 255
"""The code of no noise."""


def round_light(light: np.ndarray, layer: Layer) -> np.ndarray:
    """``light`` (…, n²) as the layer keeps it, float32."""
    fine = light_floats(light[..., : layer.floats] / layer.scale, layer).astype(np.float32)
    coarse = decoded_light(light_codes(light[..., layer.floats :] / layer.scale))
    return np.concatenate([fine, coarse], axis=-1) * np.float32(layer.scale)


def light_floats(light: np.ndarray, layer: Layer) -> np.ndarray:
    """Coefficients, in units of the layer's scale, as the floats it keeps; what is beyond LARGEST_HALF is cut there."""
    return np.clip(light, -LARGEST_HALF, LARGEST_HALF).astype(np.float16 if layer.half else np.float32)


def light_codes(light: np.ndarray) -> np.ndarray:
    """Bytes of coefficients within ±1: a sign, and 1 + the steps from 1 down, to the nearest; 0 is none; uint8."""
    size = np.abs(np.asarray(light, np.float64))
    with np.errstate(divide="ignore"):
        codes = 1.0 + np.rint(-CODES_PER_HALVING * np.log2(size))
    codes = np.where(codes > SMALLEST, 0.0, np.maximum(codes, 1.0)).astype(np.uint8)
    return np.where((light < 0.0) & (codes > 0), codes | NEGATIVE, codes).astype(np.uint8)


def decoded_light(codes: np.ndarray) -> np.ndarray:
    """The coefficients that bytes stand for, float32."""
    return LIGHT_OF[codes]


def _light_table() -> np.ndarray:
    """What each byte of ``light_codes`` stands for; (256,) float32."""
    steps = (np.arange(256) & SMALLEST) - 1.0
    size = np.where(steps < 0.0, 0.0, 2.0 ** (-steps / CODES_PER_HALVING))
    return np.where(np.arange(256) & NEGATIVE, -size, size).astype(np.float32)


LIGHT_OF = _light_table()


def noise_codes(noise: np.ndarray, scale: float) -> np.ndarray:
    """Bytes of ``noise``: NOISIEST · scale · 2^(-code / CODES_PER_HALVING), to the nearest; uint8."""
    with np.errstate(divide="ignore"):
        codes = np.rint(-CODES_PER_HALVING * np.log2(np.asarray(noise, np.float64) / (NOISIEST * scale)))
    return np.clip(codes, 0, SILENT).astype(np.uint8)


def noise_of(codes: np.ndarray, scale: float | np.ndarray) -> np.ndarray:
    """The noise that bytes stand for, float32; ``scale`` is a power of two, or one for each."""
    return np.asarray(NOISE_OF[codes] * np.float32(scale))


def _noise_table() -> np.ndarray:
    """The noise that each byte stands for in units of a layer's scale; (256,) float32."""
    codes = np.arange(256)
    return np.where(codes == SILENT, 0.0, NOISIEST * 2.0 ** (codes / -CODES_PER_HALVING)).astype(np.float32)


NOISE_OF = _noise_table()


def level_codes(samples: np.ndarray) -> np.ndarray:
    """Bytes of sample counts at levels: 0 for none, k for FIRST_LEVEL · 2^(k - 1), VOID_CODE for VOID; uint8."""
    codes = np.log2(np.maximum(samples, FIRST_LEVEL // 2) / (FIRST_LEVEL // 2)).astype(np.uint8)
    return np.where(samples == VOID, VOID_CODE, codes).astype(np.uint8)


def _samples_table() -> np.ndarray:
    """The sample counts that each byte stands for; (256,) int32."""
    codes = np.arange(256)
    climbed = (FIRST_LEVEL // 2) << np.where(codes == VOID_CODE, 0, codes).astype(np.int32)
    return np.where(codes == VOID_CODE, VOID, np.where(codes == 0, 0, climbed)).astype(np.int32)


SAMPLES_OF = _samples_table()
"""The sample counts that bytes stand for: see ``level_codes``."""


def next_level(samples: int) -> int:
    """The sample count of the level above ``samples``."""
    return FIRST_LEVEL if samples < FIRST_LEVEL else 2 * samples
