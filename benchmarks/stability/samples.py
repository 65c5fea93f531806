"""Cases of few and of many samples: sums that do not drift, and means that rounding does not hold up."""

import math
from contextlib import AbstractContextManager
from dataclasses import replace
from functools import cache

import numpy as np

from benchmarks.stability.case import Outcome, Size, case
from benchmarks.stability.lighting import lit, solid
from benchmarks.stability.pictures import faults
from benchmarks.stability.stage import view_bake, view_of
from isogi_core.bake.light import Light
from isogi_core.bake.noise import luminance
from isogi_core.bake.precision import FIRST_RUNG, round_light
from isogi_core.bake.refine import add_to_mean, locate, refine, sample_transfer
from isogi_core.frame.paths import Paths
from isogi_core.frame.surroundings import Turned
from isogi_core.model.plan import MOST, Layer
from isogi_core.plan.budget import BYTE, HALF_ONE
from isogi_core.report.bake import NEVER, ViewBake

GROUP = "few and many samples"

TOLD = {"half floats": HALF_ONE, "bytes": BYTE, "single floats": 1e-7}
"""What the planner expects rounding to err by, of one number, by how it is kept."""


def under_half_a_sky(pixels: int) -> AbstractContextManager[ViewBake]:
    """A body under half a sky that turns, nothing of it baked."""
    half = np.zeros((8, 16, 3))
    half[:4] = 1.0
    scene = lit(solid(), 0.5, half, bounces=2)
    return view_bake(scene, view_of(scene, pixels))


@case(GROUP, "sums of paths", "the sum of a pixel's paths is that of exact addition", 1e-12, "relative")
def sums_of_paths(size: Size) -> Outcome:
    """The kernel's sum of all paths, beside ``math.fsum`` of one at a time."""
    count = size.pick(1 << 9, 1 << 14, 1 << 20)
    with under_half_a_sky(3) as bake:
        gbuffer, tiles = bake.renderer.gbuffer(bake.view), bake.renderer.tiles
        paths = Paths(Turned(bake.look, bake.view), gbuffer, tiles)
        together = np.zeros((len(gbuffer.points), 1, 3))
        paths.add(together, 0, 0, count)
        ones = np.zeros((count, *together.shape))
        for sample, one in enumerate(ones):
            paths.add(one, 0, sample, 1)
    exact = np.array([math.fsum(pixel) for pixel in ones.reshape(count, -1).T])
    return Outcome(float((np.abs(together.ravel() - exact) / exact).max()), f"{count} paths")


@case(
    GROUP,
    "means of a million",
    "means that are rounded whenever their samples double err by no more than is told",
    1,
    "of the told error",
)
def means_of_a_million(size: Size) -> Outcome:
    """Rung by rung to 2^20 samples, beside means that were not rounded; root mean squares."""
    off = {kept: off_by(kept, size) for kept in TOLD}
    shares = {kept: math.sqrt(float((error**2).mean())) / TOLD[kept] for kept, error in off.items()}
    return Outcome(max(shares.values()), ", ".join(f"{kept} {share:.2f}" for kept, share in shares.items()))


@case(GROUP, "drift of means", "that rounding pulls means neither up nor down", 0.1, "of the told error")
def drift_of_means(size: Size) -> Outcome:
    """The same, and the mean over all texels."""
    shares = {kept: abs(float(off_by(kept, size).mean())) / told for kept, told in TOLD.items()}
    return Outcome(max(shares.values()), ", ".join(f"{kept} {share:.4f}" for kept, share in shares.items()))


@cache
def off_by(kept: str, size: Size) -> np.ndarray:
    """Relative errors of means of 2^20 samples that were rounded after each rung, (texels,) float64."""
    layer = Layer("direct", 2, half=kept != "single floats", coarse=1 if kept == "bytes" else None)
    random = np.random.default_rng(3)
    texels = size.pick(20_000, 200_000)
    true = np.exp(random.uniform(-6.0, 0.0, texels)) * random.choice([-1.0, 1.0], texels)
    mean, total, samples = np.zeros((texels, 4), np.float32), np.zeros(texels), 0
    while samples < MOST:
        count = max(samples, FIRST_RUNG)
        added = count * true + math.sqrt(count) * 0.3 * true * random.normal(size=texels)
        light = np.repeat(added[:, None], 4, axis=1)
        mean = round_light(add_to_mean(mean, samples, light, samples + count), layer)
        total, samples = total + added, samples + count
    return np.asarray(mean[:, 3] * samples / total - 1.0)


@case(GROUP, "texels of a million", "the light of a texel after 2^20 samples is their mean", 0.002, "relative")
def texels_of_a_million(size: Size) -> Outcome:
    """Baked rung by rung, as it is kept, beside one sum of the same paths; luminance, over the mean of it."""
    count = size.pick(1 << 12, 1 << 16, MOST)
    with under_half_a_sky(3) as bake:
        texels, look = bake.texels[:8], bake.look
        kept, exact = (Light.dark(look.plan, len(texels)) for _ in range(2))
        refine(kept, texels, look, count, NEVER)
        place, void = locate(texels, look.recipe)
        layers = look.plan.layers
        for part, (halves, _) in zip(exact.parts, sample_transfer(layers, place, void, look, 0, count), strict=True):
            part.coefficients[:] = halves.sum(axis=1)[:, :, : part.layer.order**2] / count
        one, other = (luminance(light, look)[~void] for light in (kept, exact))
    return Outcome(float(np.abs(one - other).max() / other.mean()), f"{count} samples of {len(texels)} texels")


@case(GROUP, "one sample", "frames of one path per pixel are finite, and tell an error from 0 to 1", 0, "numbers")
def one_sample(size: Size) -> Outcome:
    """Of the path tracer."""
    with under_half_a_sky(size.pick(16, 64)) as bake:
        frame = bake.renderer.render(replace(bake.view, shading="path_traced", samples=1))
    return Outcome(faults(frame), f"{frame.surface} pixels")
