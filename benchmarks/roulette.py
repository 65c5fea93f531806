"""Whether light paths should end by chance (Russian roulette) or after a number of bounces: variance times rays.

    python -m benchmarks.roulette [TARGET] [--size 256] [--repeats 1] [--json]

Paths are baked from texels of the benchmarks' view, and those counted that leave after each bounce. From these
counts follow, for any albedo R, the variance and the rays of a path that carries R^k to the end, cut off where
half of 2 % is left ("cut"), and of one that survives each hit after the first with the chance R and carries R
unchanged ("roulette"; Arvo and Kirk, "Particle Transport and Image Synthesis", 1990). A figure is variance times rays
of roulette over that of cut, of reflected light under a constant environment: roulette pays where it is below 1.
"""

import click
import numpy as np

from benchmarks.common import benchmark_scene, options, show
from benchmarks.paths import view_texels
from isogi_core.bake.recipe import Recipe
from isogi_core.bake.refine import by_isovalue, locate
from isogi_core.kernels.transfer import bake_texels
from isogi_core.plan.budget import LONGEST_PATH, bounces_for

ALBEDOS = (0.1, 0.2, 0.3, 0.5, 0.7, 0.9, 0.95, 0.99)
SAMPLES = 1024
MANY = 512
"""Texels whose paths are counted."""


@click.command()
@click.argument("target", required=False)
@options(size=256, repeats=1)
def main(target: str | None, size: int, repeats: int, as_json: bool) -> None:
    """Count paths by bounces and print the ratios."""
    scene = benchmark_scene(target, "constant")
    texels = np.concatenate(view_texels(scene, size))
    chosen = np.random.default_rng(1).choice(texels, min(MANY, len(texels)), replace=False)
    left = left_after(Recipe(scene), chosen, SAMPLES * repeats)
    figures: dict[str, float] = {"rays of a path that is never cut": rays_of(left, np.ones(left.shape[1]))}
    for albedo in ALBEDOS:
        figures[f"roulette / cut at albedo {albedo}"] = efficiency(left, albedo)
    show(f"Russian roulette, {scene.name}", figures, as_json)


def left_after(recipe: Recipe, texels: np.ndarray, samples: int) -> np.ndarray:
    """The share of each texel's paths that leave after k bounces; (m, LONGEST_PATH + 1)."""
    place, void = locate(texels, recipe)
    count = LONGEST_PATH + 1
    sums = np.zeros((len(texels), 2, count, 1))
    shares = np.eye(count, count + 1, 1) * np.sqrt(4.0 * np.pi)
    for bricks, rows in by_isovalue(place[3], void, recipe):
        bake_texels(recipe.field, bricks, place, rows, 0, samples // 2, shares, 1.0, np.ones(count, np.int64), sums)
    return np.asarray(sums.sum(axis=(1, 3))[~void] / samples)


def efficiency(left: np.ndarray, albedo: float) -> float:
    """Variance times rays of roulette over that of cut paths, both means over texels."""
    last = bounces_for((albedo, albedo, albedo), 0.02)
    k = np.arange(left.shape[1])
    cut, alive = np.where(k <= last, albedo**k, 0.0), albedo ** np.maximum(k - 1, 0)
    cut[0] = 0.0
    mean = left[:, 1:] @ albedo ** k[1:]
    square = left[:, 1:] @ (albedo**2 * alive[1:])
    of_cut = (left @ cut**2 - (left @ cut) ** 2).mean() * rays_of(left, (k <= last).astype(float))
    return float((square - mean**2).mean() * rays_of(left, alive) / of_cut)


def rays_of(left: np.ndarray, alive: np.ndarray) -> float:
    """Rays of a path whose ray number k is cast with the chance ``alive``, given that it has not left before."""
    inside = 1.0 - np.cumsum(left, axis=1) + left
    return float((inside @ alive).mean())


if __name__ == "__main__":
    main()
