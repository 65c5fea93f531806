"""The scene plan: the layers of light that are baked for a scene, and the things that are left
out, with reasons and savings.
"""

import math
from dataclasses import dataclass

import numpy as np

MIN_SAMPLES = 64
MAX_SAMPLES = 1 << 20
"""Range of a texel's most samples, for any target error. With fewer than MIN_SAMPLES a dark
texel may have met no light at all.
"""

REPRESENTATIONS = ("vicinity", "constant", "irradiance", "transfer")
"""Kinds of light that a texel may keep, smallest first.

- ``vicinity``: the share of a constant light that arrives without reflection.
- ``constant``: the same with reflected light.
- ``irradiance``: light of lamps and environments that do not move.
- ``transfer``: harmonics, for light that turns.
"""


@dataclass(frozen=True)
class Layer:
    """One kind of light that each texel keeps, in a separate array of the store.

    - ``kind``: "direct" (light that arrives without reflection), "indirect" (reflected light),
      "whole" (both), "irradiance" (both, under the scene's lights), or "glow" (both, of glows
      alone).
    - ``order``, ``channels``: a texel keeps order² coefficients for each channel.
    - ``half``: half floats instead of single ones; ``coarse``: bands from this one on are bytes, if
      it is given.
    - ``scale``: unit of the coefficients, a power of two.
    - ``nodes``: if there are any, channels are not colours: each is light on a grey surface with
      that albedo.
    """

    kind: str
    order: int = 1
    channels: int = 1
    half: bool = True
    coarse: int | None = None
    scale: float = 1.0
    nodes: tuple[float, ...] = ()

    @property
    def coefficients(self) -> int:
        """Numbers that a texel keeps for all channels."""
        return self.channels * self.order**2

    @property
    def floats(self) -> int:
        """Coefficients of a channel that are kept as floats; the others follow them as bytes."""
        if self.coarse is None:
            return self.order**2
        return min(self.coarse, self.order) ** 2

    @property
    def noises(self) -> int:
        """Numbers of a texel's noise: one for band 0, and one for the bands above if there are
        any.
        """
        return 1 if self.order == 1 else 2

    @property
    def bytes_per_texel(self) -> int:
        """Bytes of a texel: its coefficients, a byte for each noise, and one for its sample
        level.
        """
        fine = self.channels * self.floats
        return (2 if self.half else 4) * fine + self.coefficients - fine + self.noises + 1

    @property
    def precision(self) -> str:
        """Precision of the coefficients: "single", "half", or "bytes" for higher bands."""
        if not self.half:
            return "single"
        if self.coarse is None:
            return "half"
        return "bytes"

    @property
    def reflected(self) -> bool:
        """True if it holds reflected light, and so depends on albedo and bounces."""
        return self.kind != "direct"

    @property
    def colours(self) -> int:
        """Number of its channels that are colours of the same light."""
        return 1 if self.nodes else self.channels


GLOW_KIND = "glow"
"""Kind of the layers of glow."""


@dataclass(frozen=True)
class GlowLayer(Layer):
    """Direct and reflected light of ``glows`` glows of radiance 1, one after another in the
    channels.

    Frames apply colours and strengths of the glows. Each glow has the same number of channels,
    those of the surfaces' colours.
    """

    glows: int = 1

    @property
    def colours(self) -> int:
        """Number of channels of one glow, its colours."""
        return self.channels // self.glows

    def lights(self, radiances: np.ndarray) -> list[np.ndarray]:
        """Return the linear RGB, (3, 1) each, by which the channels of a texel are multiplied if
        the glows give off ``radiances`` (glows, 3).

        - A single glow: one entry, its radiance. A frame multiplies each channel by the entry's
          part of the same colour, or its only channel by the whole entry.
        - Several glows of one channel each: an entry for each glow, its radiance. A frame adds up
          channel times entry.
        - Several glows of three channels each: an entry for each channel, the glow's radiance in
          this channel's colour and 0 in the others. A frame adds up channel times entry.
        """
        if self.glows == 1 or self.colours == 1:
            masks = np.ones((1, 3))
        else:
            masks = np.eye(3)
        return [(radiance * mask)[:, None] for radiance in radiances for mask in masks]


@dataclass(frozen=True)
class Saving:
    """A saving: an ``amount`` of a ``unit``; it is ``measured``, or else computed."""

    amount: float
    unit: str
    measured: bool = False


@dataclass(frozen=True)
class LeftOut:
    """One thing that is left out of a scene, the reason in one sentence, and its savings."""

    what: str
    why: str
    saves: tuple[Saving, ...] = ()


@dataclass(frozen=True)
class ScenePlan:
    """The layers that are baked for a scene, and the rules of light for frames and paths.

    - ``representation``: one of REPRESENTATIONS; ``layers``: kept by each texel.
    - ``order``: of the light that texels are lit with, 1 without harmonics; a layer may have more.
    - ``bounces``: surface hits after the first; ``survival``: probability that a path continues
      after its second and later hits; ``branches``: number of ways in which it continues from the
      first hit.
    - ``samples``: most samples of a texel.
    - ``lobes``: number of lobes that are left out of direct light in texels and lit by shadow rays
      from pixels.
    - ``errors``: expected relative errors by cause; ``notes``: sentences on those above the target.
    - ``left_out``: everything that the plan leaves out.
    """

    representation: str
    layers: tuple[Layer, ...]
    order: int
    bounces: int
    survival: float
    samples: int
    lobes: int = 0
    branches: int = 1
    errors: tuple[tuple[str, float], ...] = ()
    notes: tuple[str, ...] = ()
    left_out: tuple[LeftOut, ...] = ()

    @property
    def channels(self) -> int:
        """Channels that light is shown in: the most colours of any layer."""
        return max(layer.colours for layer in self.layers)

    @property
    def nodes(self) -> tuple[float, ...]:
        """Albedos that reflected light is kept for if views may ask for others; see
        ``plan.albedo_nodes``.
        """
        return next((layer.nodes for layer in self.layers if layer.nodes), ())

    @property
    def indirect_order(self) -> int | None:
        """Order of reflected light if that is a separate layer, else None."""
        return next((layer.order for layer in self.layers if layer.kind == "indirect"), None)

    @property
    def half(self) -> bool:
        """True if all coefficients are kept as half floats or bytes."""
        return all(layer.half for layer in self.layers)

    @property
    def precision(self) -> str:
        """Precision of the coefficients: "bytes" if the higher bands of any layer are, or else
        "half" or "single".
        """
        # The three words are in alphabetical order from the coarsest to the finest.
        return min(layer.precision for layer in self.layers)

    @property
    def bytes_per_texel(self) -> int:
        """Bytes that one texel takes in the store before compression."""
        return sum(layer.bytes_per_texel for layer in self.layers)


def texel_target(target: float) -> float:
    """Return the relative error at which texels are final if pixels are to reach a ``target``: 1.84
    times it.

    A pixel mixes eight texels with independent noise: with the weights w it has √Σw² of theirs. For
    trilinear weights at points spread evenly between texels, Σw² is (2/3)³ on average, so that
    pixels whose texels are all just final are at the target in the root mean square. As Σw² is at
    most 1, no pixel is above 1.84 times the target.
    """
    return 1.5**1.5 * target


def most_samples(target: float) -> int:
    """Return the most samples of a texel for pictures of the relative error ``target``: 2048 at 2
    %.

    A texel that has taken them is final: its remaining noise is reported and not reduced further.
    The number is a power of two that grows as the error's -3/2, as the error of stratified points
    falls about as n^-2/3: a target that most texels reach then leaves few behind.
    """
    # 2048 samples at 2 %, in proportion to error^(-3/2), rounded to a power of two.
    samples = 4096.0 * (0.02 / max(texel_target(target), 1e-6)) ** 1.5
    return min(max(1 << round(math.log2(samples)), MIN_SAMPLES), MAX_SAMPLES)
