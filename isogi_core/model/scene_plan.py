"""The scene plan: the layers that are baked for a scene; what is left out, why, and what that
saves.
"""

import math
from dataclasses import dataclass

import numpy as np

MIN_SAMPLES = 64
MAX_SAMPLES = 1 << 20
"""Bounds of the samples for any target error. With fewer than MIN_SAMPLES a dark texel may have met
no light at all.
"""

REPRESENTATIONS = ("vicinity", "constant", "irradiance", "transfer")
"""Kinds of light that a texel may keep, the smallest first.

``vicinity``: the share of a constant light that arrives unreflected. ``constant``: the same with
reflected light. ``irradiance``: that of lights which do not move. ``transfer``: harmonics, for
lights that turn.
"""


@dataclass(frozen=True)
class Layer:
    """One kind of light that each texel keeps, in an array of its own in the store.

    ``kind`` is "direct" (light that arrives unreflected), "indirect" (reflected light), "whole"
    (both), "irradiance" (both, under the scene's own lights), or "glow" (both, of what glows
    alone). ``order``² coefficients for each of the ``channels``, as half floats where ``half``, and
    from band ``coarse`` on, if given, as bytes. They are multiples of ``scale``, a power of two.
    Where there are ``nodes``, channels are not colours: each is of a grey surface with that albedo.
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
        """Coefficients of a channel that are kept as floats; the others follow them, as bytes."""
        if self.coarse is None:
            return self.order**2
        return min(self.coarse, self.order) ** 2

    @property
    def noises(self) -> int:
        """Numbers of a texel's noise: one for band 0, and one for the bands above where there are
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
        """The precision of coefficients: "single", "half", or "bytes" for higher bands."""
        if not self.half:
            return "single"
        if self.coarse is None:
            return "half"
        return "bytes"

    @property
    def reflected(self) -> bool:
        """Whether it holds light that was reflected, and so depends on albedo and bounces."""
        return self.kind != "direct"

    @property
    def colours(self) -> int:
        """How many of its channels are colours of the same light."""
        return 1 if self.nodes else self.channels


GLOW_KIND = "glow"
"""The kind of layers of what glows."""


@dataclass(frozen=True)
class GlowLayer(Layer):
    """What arrives of so many ``glows`` of radiance 1, direct and reflected, one after the other:
    their colours and strengths are those of frames. Each has as many channels as the others, those
    of the surfaces' colours.
    """

    glows: int = 1

    @property
    def colours(self) -> int:
        """How many of its channels are colours of the same light."""
        return self.channels // self.glows

    def lights(self, radiances: np.ndarray) -> list[np.ndarray]:
        """Light, (3, 1) linear RGB, that its channels meet where the glows give off ``radiances``
        (glows, 3): of all channels together where there is one glow, else of each by itself.
        """
        if self.glows == 1 or self.colours == 1:
            shares = np.ones((1, 3))
        else:
            shares = np.eye(3)
        return [(light * share)[:, None] for light in radiances for share in shares]


@dataclass(frozen=True)
class Saving:
    """A saving: an ``amount`` of a ``unit``; ``measured``, or else computed."""

    amount: float
    unit: str
    measured: bool = False


@dataclass(frozen=True)
class LeftOut:
    """One thing that is left out of a scene, the reason in one sentence, and what that saves."""

    what: str
    why: str
    saves: tuple[Saving, ...] = ()


@dataclass(frozen=True)
class ScenePlan:
    """The layers that are baked for a scene, and how frames are lit with them.

    ``order`` is that of the light that texels are lit with, 1 where they keep no harmonics; a layer
    may have more. ``bounces`` counts surface hits after the first; from the second on a path goes
    on with the chance ``survival``. From the first one it goes on in so many ``branches``.
    ``samples`` are the most that a texel takes; so many ``lobes`` of the light are no part of
    direct light in texels, but lit by shadow rays from pixels; ``errors`` names relative errors
    that the plan expects, by what is cut off; ``notes`` are sentences on those above the target.
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
        """The channels that light is shown in: the most colours of any layer."""
        return max(layer.colours for layer in self.layers)

    @property
    def nodes(self) -> tuple[float, ...]:
        """The albedos that reflected light is kept for, where views may ask for others; see
        ``plan.albedos``.
        """
        return next((layer.nodes for layer in self.layers if layer.nodes), ())

    @property
    def indirect_order(self) -> int | None:
        """The order of reflected light where that is a layer of its own."""
        return next((layer.order for layer in self.layers if layer.kind == "indirect"), None)

    @property
    def half(self) -> bool:
        """Whether coefficients are kept as half floats."""
        return all(layer.half for layer in self.layers)

    @property
    def precision(self) -> str:
        """How coefficients are kept: "bytes" where the higher bands of any layer are, or else
        "half" or "single".
        """
        return min(layer.precision for layer in self.layers)

    @property
    def bytes_per_texel(self) -> int:
        """Bytes that one texel takes in the store before compression."""
        return sum(layer.bytes_per_texel for layer in self.layers)


def texel_target(target: float) -> float:
    """The relative error at which texels are final, where pixels are to come to a ``target``: 1.84
    times it.

    A pixel mixes eight texels, whose noises are independent: by the weights w it has √Σw² of
    theirs. Of trilinear weights, over points spread evenly between texels, Σw² is (2/3)³ on the
    average. So pixels whose texels are all just final are at the target in the root mean square. As
    Σw² is at most 1, none is beyond 1.84 times the target.
    """
    return 1.5**1.5 * target


def most_samples(target: float) -> int:
    """The most samples of a texel, of pictures of the relative error ``target``: 2048 at 2 %.

    A texel that has taken them is final: its remaining noise is reported and not reduced further.
    It is a power of two that grows as the error's -3/2: the stratified points' error falls about as
    n^-2/3, so that a target which most texels reach leaves few behind.
    """
    samples = 4096.0 * (0.02 / max(texel_target(target), 1e-6)) ** 1.5
    return min(max(1 << round(math.log2(samples)), MIN_SAMPLES), MAX_SAMPLES)
