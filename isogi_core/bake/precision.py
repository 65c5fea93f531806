"""What is rounded on its way to the store: light to half floats, noise to a byte, sample counts to rungs of a ladder.

Light in memory is rounded too, after each rung, so that a texel has the same bits whether it was read or just baked.
"""

import numpy as np

from isogi_core.model.plan import Layer

FIRST_RUNG = 16
"""Samples of a texel's first rung; each further one doubles them."""

VOID = -1
"""Number of samples that marks a texel which can hold no light."""

VOID_CODE = 255

NOISIEST = 16.0
"""The noise, in units of a layer's scale, that code 0 stands for."""

STEPS = 8
"""Codes of noise that halve it: 9 % apart."""

SILENT = 255
"""The code of no noise."""


def round_light(light: np.ndarray, layer: Layer) -> np.ndarray:
    """``light`` as the layer keeps it, float32."""
    if not layer.half:
        return np.asarray(light, np.float32)
    return (light / layer.scale).astype(np.float16).astype(np.float32) * np.float32(layer.scale)


def noise_codes(noise: np.ndarray, scale: float) -> np.ndarray:
    """Bytes of ``noise``: NOISIEST · scale · 2^(-code / STEPS), to the nearest; uint8."""
    with np.errstate(divide="ignore"):
        codes = np.rint(-STEPS * np.log2(np.asarray(noise, np.float64) / (NOISIEST * scale)))
    return np.clip(codes, 0, SILENT).astype(np.uint8)


def noise_of(codes: np.ndarray, scale: float) -> np.ndarray:
    """The noise that bytes stand for, float32."""
    return np.where(codes == SILENT, 0.0, NOISIEST * scale * 2.0 ** (codes / -STEPS)).astype(np.float32)


def rung_codes(samples: np.ndarray) -> np.ndarray:
    """Bytes of sample counts on the ladder: 0 for none, k for FIRST_RUNG · 2^(k - 1), VOID_CODE for VOID; uint8."""
    codes = np.log2(np.maximum(samples, FIRST_RUNG // 2) / (FIRST_RUNG // 2)).astype(np.uint8)
    return np.where(samples == VOID, VOID_CODE, codes).astype(np.uint8)


def samples_of(codes: np.ndarray) -> np.ndarray:
    """The sample counts that bytes stand for, int32."""
    climbed = (FIRST_RUNG // 2) << np.where(codes == VOID_CODE, 0, codes).astype(np.int32)
    return np.where(codes == VOID_CODE, VOID, np.where(codes == 0, 0, climbed)).astype(np.int32)


def next_rung(samples: int) -> int:
    """The sample count that follows ``samples`` on the ladder."""
    return FIRST_RUNG if samples < FIRST_RUNG else 2 * samples
