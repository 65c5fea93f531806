"""Noise of texels' light: its estimate, the error at which a texel is good enough, and the
number of samples that this takes.
"""

import math
from collections.abc import Iterable, Mapping
from itertools import product
from typing import NamedTuple, Self

import numpy as np

from isogi_core.bake.bake_spec import BakeSpec, band_of
from isogi_core.bake.texel_light import FIRST_LEVEL, Light, Part
from isogi_core.kernels.shading.lattice import LEAST_SPREAD
from isogi_core.model.scene_plan import (
    MAX_SAMPLES,
    MIN_SAMPLES,
    GlowLayer,
    Layer,
    most_samples,
    texel_target,
)
from isogi_core.plan.albedo_nodes import mixing_weights

FLOOR = 0.5
"""Share of unoccluded light: the error of darker texels is relative to this light, not to their
small one.
"""

DECAYS: Mapping[str, tuple[float, float]] = {
    "direct": (0.38, 0.24),
    "indirect": (0.46, 0.49),
    "whole": (0.46, 0.35),
    "irradiance": (0.42, 0.42),
    "glow": (0.42, 0.42),
}
"""Factors by which doubling the samples reduces the variance of band 0, and the excess of the bands
above it, by kind of layer.

Points are stratified, and direct light is smooth between its edges, so that it gains most; plain
random points, and almost also long paths, have one half. From mean squares of differences of halves
over 16 to 1024 samples, on two views each of the engine, the CT head, the bonsai, the MNI brain,
the casting and the orbital: right within a tenth, except 0.35 (orbital) to 0.41 (bonsai) for band 0
of direct light, and 0.22 to 0.30 above it.
"""

BAND_0 = np.array([0.75, 1 / 12, 1 / 12, 1 / 12])
"""Weights of the coefficients of bands 0 and 1 in the variance of band 0.

The difference of two halves in band 0 is a single number, and says too little; band 1 comes from
the same paths, and is scaled to band 0 by ``evenness``.
"""


MIN_LUMINANCE = 1e-30
"""Luminance, in the unit of a bake spec, that stands for zero in a divisor."""


class Goal(NamedTuple):
    """The goal of a picture: the relative ``error`` that it is to reach, and the ``samples`` after
    which its texels need no more, even if they have a larger error each.

    ``Goal(error)`` is for pictures without a check: their texels reach the error by themselves, or
    take as many samples as any may. ``Goal.checked(error)`` is for all others. ``goal_of`` of
    ``isogi_server/views.py`` makes it from the HTTP parameter ``max_error`` or the option
    ``--target-error``; all stages down to a ``BakeTask`` take it as ``goal``.
    """

    error: float
    samples: int = MAX_SAMPLES

    @classmethod
    def checked(cls, error: float) -> Self:
        """Return the goal of a picture that control pixels check: its texels begin with the first
        level of samples, and take more when the check asks for them.
        """
        return cls(error, FIRST_LEVEL)

    @classmethod
    def strictest(cls, goals: Iterable["Goal"]) -> Self:
        """Return the goal that covers all ``goals``: the least error and the most samples of any.
        There must be one.
        """
        errors, samples = zip(*goals, strict=True)
        return cls(min(errors), max(samples))

    @property
    def texel_error(self) -> float:
        """The relative error at which texels are good enough by themselves."""
        return texel_target(self.error)

    @property
    def most_samples(self) -> int:
        """The samples after which texels need no more."""
        return min(most_samples(self.error), self.samples)

    def covers(self, other: "Goal") -> bool:
        """Return True if light that reaches this goal also reaches the ``other`` one: the error is
        as strict or stricter, and the samples are as many or more.
        """
        return self.error <= other.error and self.samples >= other.samples


def deviations(light: Light, spec: BakeSpec) -> np.ndarray:
    """Return the standard error of the luminance of each part, a mean over all turns of the
    light; (parts, texels) float64.
    """
    return np.array([deviation(part, spec) for part in light.parts])


def deviation(part: Part, spec: BakeSpec) -> np.ndarray:
    """Return the standard error of the luminance of one part, (texels,) float64: see
    ``BakeSpec.gains``.

    Its square is at least a quarter of the variance that follows if band 0 has the noise of the
    bands above, in case band 0 was estimated too small by chance.
    """
    # Weight the squared noises of band 0 and of the bands above by their parts in the luminance.
    squares = part.noise.astype(np.float64) ** 2
    gains = spec.gains(part.layer)
    return np.asarray(np.sqrt(np.maximum(squares @ gains, squares[:, -1] * gains.sum() / 4.0)))


def mean_luminance(light: Light, spec: BakeSpec) -> np.ndarray:
    """Return the mean luminance of each texel over all turns of the light, lobes included;
    (texels,) float64.
    """
    total = np.zeros(len(light))
    for part in light.parts:
        total += part.coefficients[:, :, 0].astype(np.float64) @ white(part.layer, spec)
    return total


def white(layer: Layer, spec: BakeSpec) -> np.ndarray:
    """Return the weight of band 0 of each channel of a ``layer`` in a texel's luminance, a mean
    over all turns of the light, in which higher bands vanish; (channels,) float64.

    If views may ask for other albedos, reflected light is weighted as at the lowest of them, while
    ``BakeSpec.mix`` and ``gains`` weight noise as at the highest: noise over luminance is then an
    upper bound of the relative error at each of them.
    """
    if isinstance(layer, GlowLayer):
        return spec.glow_weights(layer)
    weights = spec.luminance_light[:, 0]
    if layer.nodes:
        return np.asarray(
            weights.sum()
            * mixing_weights(spec.prepared.scene.surfaces.lowest, layer.nodes, spec.plan.bounces)
        )
    return np.array(weights if layer.channels == len(weights) else weights.sum(keepdims=True))


def standard_error(light: Light, spec: BakeSpec) -> np.ndarray:
    """Return the standard error of each texel's luminance, all parts together; (texels,)
    float64.
    """
    return np.asarray(np.sqrt((deviations(light, spec) ** 2).sum(axis=0)))


def level(light: Light, spec: BakeSpec) -> np.ndarray:
    """Return the luminance that each texel's error is relative to: the texel's, but at least
    FLOOR of unoccluded light; (texels,) float64.
    """
    return np.maximum(mean_luminance(light, spec), least_level(spec))


def least_level(spec: BakeSpec) -> float:
    """Return the luminance that errors of the darkest texels are relative to."""
    return FLOOR * max(spec.unoccluded, MIN_LUMINANCE * spec.unit)


def relative_error(light: Light, spec: BakeSpec) -> np.ndarray:
    """Return the relative standard error of each texel's luminance, a mean over all turns of
    the light; (texels,).
    """
    return np.asarray(standard_error(light, spec) / level(light, spec))


def finished(light: Light, spec: BakeSpec, goal: Goal) -> np.ndarray:
    """Return which texels are good enough for pictures with a ``goal``, or void; (texels,) bool."""
    return light.void | good_enough(relative_error(light, spec), light.samples, goal)


def good_enough(error: np.ndarray, samples: np.ndarray, goal: Goal) -> np.ndarray:
    """Return which texels of this relative ``error`` need no more samples for a ``goal``; bool.

    Either their error is small enough, or they have the most ``samples`` that the goal asks for.
    """
    small = (error <= goal.texel_error) & (samples >= MIN_SAMPLES)
    return small | (samples >= goal.most_samples)


def noise_of_halves(
    halves: np.ndarray, samples: int, order: int, evenness: np.ndarray | float = 1.0
) -> np.ndarray:
    """Estimate standard errors of coefficients, in band 0 and above it, from two independent
    randomisations.

    ``halves`` (m, 2, N²) are sums over half of ``samples`` each, with the bands below ``order`` in
    front. Band 0 is judged together with band 1, by BAND_0 and ``evenness`` (m,). The bands above
    share the mean of their variances. Returns (m, 1 or 2) float64.
    """
    # Each half mean is its sum over samples / 2. A quarter of the squared difference of both
    # estimates the variance of their mean.
    squares = ((halves[:, 0] - halves[:, 1]) / samples) ** 2
    low = np.average(squares[:, :4], axis=1, weights=BAND_0[: squares.shape[1]])
    # Scale the share of band 1 to the variance of band 0.
    if squares.shape[1] > 1:
        low += (evenness - 1.0) * (squares[:, 1:4] @ BAND_0[1:])
    if order == 1:
        return np.sqrt(low[:, None])
    # Average the bands above 0 with equal weight for each band.
    weights = 1.0 / (2 * band_of(order)[1:] + 1)
    return np.sqrt(np.stack([low, squares[:, 1 : order**2] @ weights / weights.sum()], axis=1))


def evenness(mean: np.ndarray, second: np.ndarray, samples: int) -> np.ndarray:
    """Return the variance of band 0 over the mean variance of a coefficient of band 1, for random
    paths; (m,) float64.

    Of ``samples`` paths that bring light X from ω, ``mean`` (m, >= 4) is the mean of X Y_i(ω), and
    ``second`` (m,) that of X² Y_0(ω). Under uniform light band 0 has the smaller variance: at an
    open texel all paths bring the same, and it has none. One path's square is added to both, so
    that a few paths that agree do not claim certainty.
    """
    # As Y_0 = 1 / √(4π), this is the second moment of X Y_0; the mean over m of that of X Y_1m is
    # the same.
    square = second / np.sqrt(4.0 * np.pi)
    more = square / samples
    low = np.maximum(square - mean[:, 0] ** 2, 0.0) + more
    return np.asarray(low / np.maximum(square - (mean[:, 1:4] ** 2).mean(axis=1) + more, 1e-30))


def blend_noise(
    former: np.ndarray, samples: int, latest: np.ndarray, decay: tuple[float, float]
) -> np.ndarray:
    """Return the noise after twice the samples, from the noise before and the noise of the new
    half.

    The variance of the common mean is ``decay`` times their mean, see DECAYS; without samples
    before, it is that of the new ones.
    """
    if samples == 0:
        return latest
    # Average both halves' variances; then reduce band 0 by its factor, and the excess of the bands
    # above by another.
    squares = (former.astype(np.float64) ** 2 + latest**2) / 2.0
    low = squares[:, :1]
    return np.asarray(
        np.sqrt(decay[0] * np.minimum(squares, low) + decay[1] * np.maximum(squares - low, 0.0))
    )


def scatter(wrong: np.ndarray, light: Light, spec: BakeSpec) -> np.ndarray:
    """Return standard errors ``wrong`` of the luminance over the standard deviation of one path;
    both (texels,) float64.

    A texel keeps this ratio as the light turns: ``light_texels`` multiplies it by the deviation
    under the present light.
    """
    return np.asarray(wrong / np.maximum(path_deviation(light, spec), MIN_LUMINANCE * spec.unit))


def path_deviation(light: Light, spec: BakeSpec) -> np.ndarray:
    """Return the standard deviation of one path's luminance, (texels,) float64, a mean square over
    all turns of the light.

    For a randomly rotated light the second moment keeps its first band, and E[(τ·Dℓ)²] = Σ_l Σ_cd
    (τ_c·τ_d)_l (ℓ_c·ℓ_d)_l / (2l + 1) over the channels c, d of all terms. LEAST_SPREAD of the
    second moment is added, as in ``light_texels``.
    """
    terms = spec.terms
    transfer = [light.columns([term]).astype(np.float64) for term in terms]
    # Second moment of one path: the transfer of the squared light.
    second = sum(
        t[:, t.shape[1] // 2, 0] * term.square[0] for t, term in zip(transfer, terms, strict=True)
    )
    mean = np.zeros(len(light))
    # Add up the mean, over all turns, of the square of the mean of all paths: a sum over all pairs
    # of terms.
    for (t, one), (u, other) in product(zip(transfer, terms, strict=True), repeat=2):
        each = powers(one.luminance / spec.unit, other.luminance / spec.unit)
        mean += np.einsum(
            "mcn,mdn,cdn->m", t[:, :, : each.shape[2]], u[:, :, : each.shape[2]], each
        )
    # The rest is the variance of one path; rounding must not make it negative.
    return spec.unit * np.sqrt(
        np.maximum(second - mean, 0.0) + LEAST_SPREAD * np.maximum(second, 0.0)
    )


def powers(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the weight of each τ_c τ_d in E[(τ·D ``one``)(τ·D ``other``)]: (ℓ_c·ℓ_d)_l / (2l + 1);
    (channels, channels, n²).

    The lights are (channels, n²), cut to the lower order; the mean is over all rotations D.
    """
    n = min(one.shape[1], other.shape[1])
    order = math.isqrt(n)
    bands = np.add.reduceat(one[:, None, :n] * other[None, :, :n], np.arange(order) ** 2, axis=2)
    return np.asarray((bands / (2.0 * np.arange(order) + 1.0))[:, :, band_of(order)])


RATE = 1.5
"""Exponent of samples over error: samples grow with 1 / error^RATE, as the error of stratified
points falls about as n^-2/3.
"""


class Effort(NamedTuple):
    """Samples that texels need which are not final.

    - ``unlit``: number of texels without light; ``expected``: samples that they are expected to
      take, 0 if unknown.
    - ``lit``: number of the others; ``taken``: samples that these have together; ``left``: samples
      that they are predicted to take in addition.
    """

    unlit: int
    taken: float
    left: float
    expected: float = 0.0
    lit: float = 0.0

    @classmethod
    def of(cls, error: np.ndarray, samples: np.ndarray, goal: Goal) -> Self:
        """Return the effort of texels for a ``goal``, by their relative ``error`` and their
        ``samples``; void texels do not count.
        """
        one_chunk = np.zeros(len(error), np.intp)
        unlit, *rest = efforts(one_chunk, 1, error, samples, goal)[0].tolist()
        return cls(int(unlit), *rest)


def samples_left(error: np.ndarray, samples: np.ndarray, goal: Goal) -> np.ndarray:
    """Return the samples that texels of this relative ``error`` still take to a ``goal``;
    (texels,) float64.

    They are lit and not final, so that each climbs at least one level.
    """
    return np.asarray(np.maximum(samples_needed(error, samples, goal), 2.0 * samples) - samples)


def samples_needed(error: np.ndarray, samples: np.ndarray, goal: Goal) -> np.ndarray:
    """Return the sample level at which lit texels of this relative ``error`` are good enough for a
    ``goal``; (texels,) float64.
    """
    most = goal.most_samples
    # Predict by the rate of stratified points, and round up to a level.
    needed = np.clip(samples * (error / goal.texel_error) ** RATE, min(MIN_SAMPLES, most), most)
    return np.asarray(2.0 ** np.ceil(np.log2(needed)))


def efforts(
    chunks: np.ndarray,
    count: int,
    error: np.ndarray,
    samples: np.ndarray,
    goal: Goal,
) -> np.ndarray:
    """Return the fields of ``Effort`` for a ``goal``, of the texels of each of ``count`` chunks,
    (count, 5) float64: unlit, taken, left, expected, lit. ``chunks`` holds each texel's chunk.
    """
    # Sum each field over the texels of a chunk. Samples expected of unlit texels are not known, and
    # stay 0; texels with light that are good enough count in no field.
    unlit = samples == 0
    waiting = (samples > 0) & ~good_enough(error, samples, goal)
    left = samples_left(error[waiting], samples[waiting], goal)
    columns = ((unlit, None), (waiting, samples[waiting]), (waiting, left), (waiting, None))
    *sums, lit = (
        np.bincount(chunks[rows], weights=weights, minlength=count) for rows, weights in columns
    )
    return np.stack([*sums, np.zeros(count), lit], axis=1).astype(np.float64)


def expected_samples(
    chunks: np.ndarray,
    count: int,
    error: np.ndarray,
    samples: np.ndarray,
    goal: Goal,
) -> np.ndarray:
    """Predict the samples after which texels are good enough for a ``goal``, summed over each of
    ``count`` chunks; (count,) float64. Samples that texels have already are included.

    ``chunks`` holds each texel's chunk. Lit texels have this relative ``error`` after ``samples``;
    all three are (texels,). Each other texel, void ones too, counts as the mean of the lit ones of
    its chunk. A chunk without lit texels has 0.
    """
    lit = samples > 0
    needed = samples_needed(error[lit], samples[lit], goal)
    sums = np.bincount(chunks[lit], weights=needed, minlength=count)
    known, every = (np.bincount(some, minlength=count) for some in (chunks[lit], chunks))
    return np.asarray(sums * every / np.maximum(known, 1))
