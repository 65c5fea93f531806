"""Light of a set of texels: for each layer of a plan a table with one row per texel, and its
rounding.

The store keeps light as half floats or bytes, noise and sample counts as bytes. Sample counts climb
levels, each twice the one before. Light in memory is rounded as well after each level, so that a
texel that is read has the same bits as one that was just baked.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from isogi_core.bake.bake_spec import Term
from isogi_core.kernels.shading import texel_table
from isogi_core.model.scene_plan import Layer, ScenePlan

FIRST_LEVEL: int = texel_table.FIRST_LEVEL
"""Samples of a texel's first level; each further level doubles them."""

VOID = -1
"""Number of samples that marks a texel which cannot hold light."""

VOID_CODE = 255

NOISIEST = 16.0
"""Noise that code 0 stands for, in units of a layer's scale."""

LARGEST_HALF = 65504.0
"""Largest coefficient that is kept, in units of a layer's scale: the largest half float. Only a
lamp next to the surface gives more.
"""

CODES_PER_HALVING = 8
"""Number of codes by which a value halves; neighbouring codes are 9 % apart."""

NEGATIVE = 0x80
SMALLEST = 0x7F
"""The sign of a coefficient that is kept as a byte, and the code of the smallest: 2^-15.75 of the
scale.
"""

SILENT = 255
"""Code of no noise."""


def round_light(light: np.ndarray, layer: Layer) -> np.ndarray:
    """Return ``light`` (…, n²) as the layer keeps it, float32."""
    # The first coefficients are kept as floats, the rest as bytes.
    fine = light_floats(light[..., : layer.floats] / layer.scale, layer).astype(np.float32)
    coarse = decoded_light(light_codes(light[..., layer.floats :] / layer.scale))
    return np.concatenate([fine, coarse], axis=-1) * np.float32(layer.scale)


def light_floats(light: np.ndarray, layer: Layer) -> np.ndarray:
    """Return coefficients, in units of the layer's scale, as the floats that it keeps, limited
    to LARGEST_HALF.
    """
    return np.clip(light, -LARGEST_HALF, LARGEST_HALF).astype(
        np.float16 if layer.half else np.float32
    )


def light_codes(light: np.ndarray) -> np.ndarray:
    """Return bytes of coefficients within ±1: a sign, and 1 + the steps from 1 down, rounded; 0
    stands for 0; uint8.
    """
    size = np.abs(np.asarray(light, np.float64))
    with np.errstate(divide="ignore"):
        codes = 1.0 + np.rint(-CODES_PER_HALVING * np.log2(size))
    # Light too small for a code becomes 0; light above the scale takes the first code.
    codes = np.where(codes > SMALLEST, 0.0, np.maximum(codes, 1.0)).astype(np.uint8)
    return np.where((light < 0.0) & (codes > 0), codes | NEGATIVE, codes).astype(np.uint8)


def decoded_light(codes: np.ndarray) -> np.ndarray:
    """Return the coefficients of bytes, float32."""
    return LIGHT_OF[codes]


def _light_table() -> np.ndarray:
    """Return the coefficient of each byte of ``light_codes``; (256,) float32."""
    steps = (np.arange(256) & SMALLEST) - 1.0
    size = np.where(steps < 0.0, 0.0, 2.0 ** (-steps / CODES_PER_HALVING))
    return np.where(np.arange(256) & NEGATIVE, -size, size).astype(np.float32)


LIGHT_OF = _light_table()


def noise_codes(noise: np.ndarray, scale: float) -> np.ndarray:
    """Return bytes of ``noise``: NOISIEST · scale · 2^(-code / CODES_PER_HALVING), rounded;
    uint8.
    """
    # No noise has an infinite code, which is cut to SILENT.
    with np.errstate(divide="ignore"):
        codes = np.rint(
            -CODES_PER_HALVING * np.log2(np.asarray(noise, np.float64) / (NOISIEST * scale))
        )
    return np.clip(codes, 0, SILENT).astype(np.uint8)


def noise_of(codes: np.ndarray, scale: float | np.ndarray) -> np.ndarray:
    """Return the noise of bytes, float32; ``scale`` is a power of two, or one for each."""
    return np.asarray(NOISE_OF[codes] * np.float32(scale))


def _noise_table() -> np.ndarray:
    """Return the noise of each byte in units of a layer's scale; (256,) float32."""
    codes = np.arange(256)
    return np.where(codes == SILENT, 0.0, NOISIEST * 2.0 ** (codes / -CODES_PER_HALVING)).astype(
        np.float32
    )


NOISE_OF = _noise_table()


def level_codes(samples: np.ndarray) -> np.ndarray:
    """Return bytes of sample counts at levels: 0 for none, k for FIRST_LEVEL · 2^(k - 1),
    VOID_CODE for VOID; uint8.
    """
    # Levels are powers of two from FIRST_LEVEL on, so that their logarithm counts them.
    codes = np.log2(np.maximum(samples, FIRST_LEVEL // 2) / (FIRST_LEVEL // 2)).astype(np.uint8)
    return np.where(samples == VOID, VOID_CODE, codes).astype(np.uint8)


def _samples_table() -> np.ndarray:
    """Return the sample count of each byte; (256,) int32."""
    codes = np.arange(256)
    climbed = (FIRST_LEVEL // 2) << np.where(codes == VOID_CODE, 0, codes).astype(np.int32)
    return np.where(codes == VOID_CODE, VOID, np.where(codes == 0, 0, climbed)).astype(np.int32)


SAMPLES_OF = _samples_table()
"""Sample counts of bytes: see ``level_codes``."""


def next_level(samples: int) -> int:
    """Return the sample count of the level above ``samples``."""
    if samples < FIRST_LEVEL:
        return FIRST_LEVEL
    return 2 * samples


@dataclass(frozen=True, eq=False)
class Part:
    """Light of texels in one ``layer``, one row each.

    - ``samples`` (m,) int32: paths taken, both randomisations together, or VOID.
    - ``noise`` (m, noises) float32: standard error of a coefficient in band 0, and above it.
    - ``coefficients`` (m, channels, n²) float32.
    """

    layer: Layer
    samples: np.ndarray
    noise: np.ndarray
    coefficients: np.ndarray

    @classmethod
    def dark(cls, layer: Layer, texels: int) -> "Part":
        """Return texels without any samples."""
        coefficients = np.zeros((texels, layer.channels, layer.order**2), np.float32)
        return cls(
            layer,
            np.zeros(texels, np.int32),
            np.zeros((texels, layer.noises), np.float32),
            coefficients,
        )

    @classmethod
    def undefined(cls, layer: Layer, texels: int) -> "Part":
        """Allocate texels that are to be filled."""
        coefficients = np.empty((texels, layer.channels, layer.order**2), np.float32)
        return cls(
            layer,
            np.empty(texels, np.int32),
            np.empty((texels, layer.noises), np.float32),
            coefficients,
        )

    @classmethod
    def joined(cls, parts: Sequence["Part"]) -> "Part":
        """Concatenate the texels of several parts of one layer."""
        columns = zip(
            *((part.samples, part.noise, part.coefficients) for part in parts), strict=True
        )
        return cls(parts[0].layer, *map(np.concatenate, columns))

    def rows(self, which: np.ndarray) -> "Part":
        """Copy some rows."""
        return Part(self.layer, self.samples[which], self.noise[which], self.coefficients[which])

    def among(self, at: np.ndarray, places: np.ndarray) -> "Part":
        """Place the texels, which lie at the places ``at``, among all at the ascending ``places``;
        the others are dark.
        """
        whole = Part.dark(self.layer, len(places))
        whole.put(np.searchsorted(places, at), self)
        return whole

    def channel(self, number: int) -> "Part":
        """Return the texels with channel ``number`` of their coefficients alone."""
        one = np.ascontiguousarray(self.coefficients[:, number : number + 1])
        return Part(self.layer, self.samples, self.noise, one)

    def put(self, which: np.ndarray, part: "Part") -> None:
        """Write the rows of ``part`` to some rows of this one."""
        self.samples[which] = part.samples
        self.noise[which] = part.noise
        self.coefficients[which] = part.coefficients


@dataclass(frozen=True, eq=False)
class Light:
    """The ``parts`` of texels' light, in the order of the plan's layers."""

    parts: tuple[Part, ...]

    @classmethod
    def dark(cls, plan: ScenePlan, texels: int) -> "Light":
        """Return texels without any samples."""
        return cls(tuple(Part.dark(layer, texels) for layer in plan.layers))

    @classmethod
    def joined(cls, lights: Sequence["Light"]) -> "Light":
        """Concatenate the texels of several lights of one plan."""
        return cls(
            tuple(
                Part.joined(parts) for parts in zip(*(light.parts for light in lights), strict=True)
            )
        )

    def __len__(self) -> int:
        return len(self.parts[0].samples)

    def rows(self, which: np.ndarray) -> "Light":
        """Copy some rows."""
        return Light(tuple(part.rows(which) for part in self.parts))

    def put(self, which: np.ndarray, light: "Light") -> None:
        """Write the rows of ``light`` to some rows of this one."""
        for mine, part in zip(self.parts, light.parts, strict=True):
            mine.put(which, part)

    @property
    def samples(self) -> np.ndarray:
        """The fewest samples of any part, VOID if a texel cannot hold light; (m,) int32."""
        return np.min([part.samples for part in self.parts], axis=0)

    @property
    def void(self) -> np.ndarray:
        """True for each texel that cannot hold light; (m,) bool."""
        return np.any([part.samples == VOID for part in self.parts], axis=0)

    def agree_on_void(self) -> None:
        """Make a texel void in all parts if it is so in one: a part may have been lost, or read
        while another is written.
        """
        void = self.void
        for part in self.parts:
            part.samples[void] = VOID

    @property
    def transfer(self) -> np.ndarray:
        """The sum of the parts; (m, channels, n²) float32 with the most channels and the
        highest order of any.
        """
        return sum_of(self.parts, max(part.layer.channels for part in self.parts))

    def columns(self, terms: Sequence[Term]) -> np.ndarray:
        """Return the sums of the parts of each of the ``terms``, side by side; (m, channels, Σ
        n²) float32.
        """
        # Sum the layers of each term, with as many channels as the most colourful layer, and cut
        # them to the light's order.
        channels = max(part.layer.colours for part in self.parts)
        sums = [sum_of(self._of(term), channels)[:, :, : term.order**2] for term in terms]
        if len(sums) == 1:
            return sums[0]
        return np.concatenate(sums, axis=2)

    def _of(self, term: Term) -> list["Part"]:
        """Return the parts of a ``term``. If it has a node, return that channel of its part alone:
        such a term is one albedo or one glow of several that its layer keeps.
        """
        parts = [self.parts[i] for i in term.layers]
        if term.node is None:
            return parts
        return [part.channel(term.node) for part in parts]


def sum_of(parts: Sequence[Part], channels: int) -> np.ndarray:
    """Return the sum of some parts' coefficients; (m, channels, n²) float32 with the highest
    order of any.
    """
    # A layer of a lower order adds to the first bands; one with a single channel adds to all.
    n = max(part.coefficients.shape[2] for part in parts)
    total = np.zeros((len(parts[0].samples), channels, n), np.float32)
    for part in parts:
        total[:, :, : part.coefficients.shape[2]] += part.coefficients
    return total
