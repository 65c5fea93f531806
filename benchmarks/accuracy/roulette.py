"""Whether light paths should end by chance (Russian roulette) or after a number of bounces:
variance times rays.

    python -m benchmarks.accuracy roulette [TARGET] [--size 256] [--json]

Paths are baked from texels of the benchmarks' view, and those counted that leave after each bounce.
From these counts follow, for any albedo R, the variance and the rays of a path that carries R^k to
the end, cut off where half of 2 % is left ("cut"), and of one that survives each hit after the
first with the chance R and carries R unchanged ("roulette"; Arvo and Kirk, "Particle Transport and
Image Synthesis", 1990). A figure is variance times rays of roulette over that of cut, of reflected
light under a constant environment: roulette pays where it is below 1.
"""

import click
import numpy as np

from benchmarks.common.measurement import Measurement
from benchmarks.common.scenes import benchmark_scene
from benchmarks.common.suite import part
from benchmarks.speed.paths import view_texels
from isogi_core.bake.refine import by_isovalue, locate
from isogi_core.kernels.transport.paths import SampleRange, TransferRules
from isogi_core.kernels.transport.transfer import bake_texels
from isogi_core.plan.budget import LONGEST_PATH, bounces_for
from isogi_core.prepared.prepared_scene import PreparedScene

ALBEDOS = (0.1, 0.2, 0.3, 0.5, 0.7, 0.9, 0.95, 0.99)
SAMPLES = 1024
MANY = 512
"""Texels whose paths are counted."""


@part(size=256)
@click.argument("target", required=False)
def roulette(target: str | None, size: int) -> Measurement:
    """Whether paths should end by chance or after a number of bounces: variance times rays."""
    scene = benchmark_scene(target, "constant")
    texels = np.concatenate(view_texels(scene, size))
    chosen = np.random.default_rng(1).choice(texels, min(MANY, len(texels)), replace=False)
    left = left_after(PreparedScene(scene), chosen, SAMPLES)
    figures: dict[str, float] = {
        "rays of a path that is never cut": rays_of(left, np.ones(left.shape[1]))
    }
    for albedo in ALBEDOS:
        figures[f"roulette / cut at albedo {albedo}"] = efficiency(left, albedo)
    return Measurement(f"Russian roulette, {scene.name}", figures)


def left_after(prepared: PreparedScene, texels: np.ndarray, samples: int) -> np.ndarray:
    """The share of each texel's paths that leave after k bounces; (m, LONGEST_PATH + 1)."""
    place, void = locate(texels, prepared)
    count = LONGEST_PATH + 1
    sums = np.zeros((len(texels), 2, count, 1))
    shares = np.eye(count, count + 1, 1) * np.sqrt(4.0 * np.pi)
    half = SampleRange(0, samples // 2)
    rules = TransferRules(shares, 1.0, 1)
    orders = np.ones(count, np.int64)
    for bricks, rows in by_isovalue(place[3], void, prepared):
        bake_texels(prepared.field, bricks, place, rows, half, rules, orders, sums)
    return np.asarray(sums.sum(axis=(1, 3))[~void] / samples)


def efficiency(left: np.ndarray, albedo: float) -> float:
    """Variance times rays of roulette over that of cut paths, both means over texels."""
    last = bounces_for((albedo, albedo, albedo), 0.02)
    k = np.arange(left.shape[1])
    cut = np.where(k <= last, albedo**k, 0.0)
    alive = albedo ** np.maximum(k - 1, 0)
    cut[0] = 0.0
    mean = left[:, 1:] @ albedo ** k[1:]
    square = left[:, 1:] @ (albedo**2 * alive[1:])
    of_cut = (left @ cut**2 - (left @ cut) ** 2).mean() * rays_of(left, (k <= last).astype(float))
    return float((square - mean**2).mean() * rays_of(left, alive) / of_cut)


def rays_of(left: np.ndarray, alive: np.ndarray) -> float:
    """Rays of a path whose ray number k is cast with the chance ``alive``, given that it has not
    left before.
    """
    inside = 1.0 - np.cumsum(left, axis=1) + left
    return float((inside @ alive).mean())
