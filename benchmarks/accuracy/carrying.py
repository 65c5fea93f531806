"""Distances to take light from texels to a pixel: nearest, closest isovalue, trilinear, tricubic
(S1, figure 6).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from isogi_core.bake.refine import locate
from isogi_core.bake.texel_light import Light
from isogi_core.cache.page_pool import fill_rows, new_rows, reflected_share
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.noise_rescaling import scatter_at, weights_between
from isogi_core.kernels.shading.lattice import LIGHT_NUMBERS, light_texels
from isogi_core.kernels.tracing.field import bspline
from isogi_report.bench import Bake, Bench
from isogi_report.exact import Lit, own_light, straight_light, unrounded
from isogi_report.metrics import Spread, luminance_of, mean_of, spread_of

SAMPLES = 256
"""Samples of each texel."""

TAPS = np.stack(np.meshgrid(*[np.arange(-1, 3)] * 3, indexing="ij"), axis=-1).reshape(64, 3)
"""Texels about a lattice cell's lowest corner, (64, 3; z, y, x)."""

CORNERS = np.flatnonzero(((TAPS >= 0) & (TAPS <= 1)).all(axis=1))
"""Those of TAPS that are corners of the cell."""


@dataclass(frozen=True, eq=False)
class Neighbourhood:
    """The 4×4×4 texels about each of m pixels' points.

    ``numbers`` (m, 64) of texels in the order of TAPS; ``fractions`` (m, 3; z, y, x) within the
    cell; of each texel ``light`` (t,) its luminance, of which so much is ``reflected`` (t,),
    ``noise`` (t,) the variance of that, ``lit`` (t,) whether it holds any light, ``apart`` (t,) how
    far its isovalue is from the picture's, and ``normals`` (t, 3) those that it is lit about.
    """

    numbers: np.ndarray
    fractions: np.ndarray
    light: np.ndarray
    reflected: np.ndarray
    noise: np.ndarray
    lit: np.ndarray
    apart: np.ndarray
    normals: np.ndarray


def errors_of_ways(bench: Bench) -> dict[str, Spread]:
    """Errors of WAYS beside light at the pixels' own points, by name. Pixels without lit texels
    count as dark.
    """
    around = neighbourhood(bench, SAMPLES)
    own = own_light(bench)
    straight = straight_light(bench)
    return {
        name: compared(carry(around, weigh(around)), straight, own) for name, weigh in WAYS.items()
    }


def compared(carried: Lit, straight: np.ndarray, own: Lit) -> Spread:
    """Carried light, with what comes ``straight`` from lobes, beside the pixels' ``own``."""
    return spread_of(
        carried.light + straight - own.light, carried.noise + own.noise, mean_of(own.light)
    )


def neighbourhood(bench: Bench, samples: int, projected: bool = False) -> Neighbourhood:
    """The texels about the pixels of the bench's view and their light, ``projected`` onto its
    isosurface or not.
    """
    found: Neighbourhood = bench.once(
        ("texels", samples, projected), lambda: make_neighbourhood(bench, samples, projected)
    )
    return found


def make_neighbourhood(bench: Bench, samples: int, projected: bool) -> Neighbourhood:
    """Find and bake them."""
    texels, numbers, fractions = texels_around(bench)
    return Neighbourhood(numbers, fractions, **light_of(bench, texels, samples, projected))


def light_of(
    bench: Bench, texels: np.ndarray, samples: int, projected: bool
) -> dict[str, np.ndarray]:
    """What a ``Neighbourhood`` tells of ``texels`` (t, 3; z, y, x) int32, baked with so many
    ``samples``.
    """
    renderer = bench.renderer(bench.scene)
    view = bench.view
    level = renderer.gbuffer(view).isovalue
    spec = replace(renderer.caches.spec(view.shading), shown=level if projected else None)
    levels = np.full(len(texels), level if projected else np.nan)
    bake = Bake(bench.tiles, spec, tuple(map(unrounded, spec.plan.layers)), texels, levels)
    bake.grow(samples)
    _, _, normals, isovalues = locate(texels, renderer.prepared, spec.shown)[0]
    lit, held = lit_texels(bake.light, RotatedLight(spec, view))
    return {
        "light": luminance_of(lit[:, :3]),
        "reflected": luminance_of(lit[:, 4:]),
        "noise": lit[:, 3].astype(np.float64) ** 2,
        "lit": held,
        "apart": np.abs(isovalues - level),
        "normals": normals.T,
    }


def texels_around(bench: Bench) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Texels and numbers as ``texels_about`` tells them of the cells that a bench's pixels lie in,
    and the fractions.

    The latter are (m, 3; z, y, x).
    """
    renderer = bench.renderer(bench.scene)
    lattice = renderer.prepared.lattice
    points = renderer.gbuffer(bench.view).points
    places = points[:, ::-1].astype(np.float64) * np.array(lattice.density[::-1])
    cells = np.clip(np.floor(places).astype(np.int64), 0, np.array(lattice.shape) - 2)
    return *texels_about(cells, lattice.shape), np.clip(places - cells, 0.0, 1.0)


def texels_about(cells: np.ndarray, shape: tuple[int, int, int]) -> tuple[np.ndarray, np.ndarray]:
    """The texels (t, 3) int32 about lattice ``cells`` (m, 3), and their numbers (m, 64); the
    border's repeat.
    """
    around = np.clip(cells[:, None] + TAPS, 0, np.array(shape) - 1)
    flat = np.ravel_multi_index(tuple(np.moveaxis(around, -1, 0)), shape)
    found, numbers = np.unique(flat, return_inverse=True)
    texels = np.stack(np.unravel_index(found, shape), axis=-1).astype(np.int32)
    return texels, numbers.reshape(flat.shape)


def lit_texels(light: Light, turned: RotatedLight) -> tuple[np.ndarray, np.ndarray]:
    """Each texel's light under ``turned`` lights, as ``light_texels`` has it; (t, LIT).

    And whether the texel holds any light, (t,) bool.
    """
    spec = turned.spec
    lit = np.empty((len(light), LIGHT_NUMBERS), np.float32)
    numbers = np.arange(len(light), dtype=np.int32)
    rows = new_rows(spec, len(light))
    held = fill_rows(rows, numbers, light, spec) >= 0
    scatter = rows.scatter
    if spec.plan.nodes and turned.seen is not spec:
        weights = weights_between(turned.seen, spec)
        scatter = scatter_at(
            weights, scatter, reflected_share(light, spec), rows.transfer[:, 0, spec.firsts]
        )
    light_texels(numbers, rows.transfer, scatter, *turned.in_units, lit)
    return lit * spec.unit, held


def carry(around: Neighbourhood, weights: np.ndarray) -> Lit:
    """The pixels' light by ``weights`` (m, 64) of their texels, of which those that hold none are
    left out.
    """
    held = weights * around.lit[around.numbers]
    held /= np.maximum(held.sum(axis=1, keepdims=True), 1e-30)
    light = (held * around.light[around.numbers]).sum(axis=1)
    return Lit(light, (held**2 * around.noise[around.numbers]).sum(axis=1))


def nearest(around: Neighbourhood) -> np.ndarray:
    """All weight on the nearest corner that holds light."""
    away = TAPS[CORNERS] - around.fractions[:, None]
    return least(around, (away**2).sum(axis=-1))


def closest_isovalue(around: Neighbourhood) -> np.ndarray:
    """All weight on the corner that holds light whose own isosurface is closest to the
    picture's.
    """
    return least(around, around.apart[around.numbers[:, CORNERS]])


def least(around: Neighbourhood, cost: np.ndarray) -> np.ndarray:
    """All weight on the corner, of those that hold light, with the least ``cost`` (m, 8)."""
    best = np.where(around.lit[around.numbers[:, CORNERS]], cost, np.inf).argmin(axis=1)
    weights = np.zeros(around.numbers.shape)
    weights[np.arange(len(best)), CORNERS[best]] = 1.0
    return weights


def trilinear(around: Neighbourhood) -> np.ndarray:
    """The cell's eight corners (S1, section 4.2)."""
    f = around.fractions.T
    none = np.zeros_like(f)
    return product(np.stack([none, 1.0 - f, f, none], axis=1))


def tricubic(around: Neighbourhood) -> np.ndarray:
    """The cubic B-spline along each axis."""
    return product(np.array([bspline(f) for f in around.fractions.T]))


def product(along: np.ndarray) -> np.ndarray:
    """Weights (m, 64) from those ``along`` each axis, (3, 4, m)."""
    return np.einsum("im,jm,km->mijk", *along).reshape(along.shape[2], len(TAPS))


WAYS: Mapping[str, Callable[[Neighbourhood], np.ndarray]] = {
    "nearest": nearest,
    "closest isovalue": closest_isovalue,
    "trilinear": trilinear,
    "tricubic B-spline": tricubic,
}
"""How texels are weighed, by a way's name. The B-spline smooths: it does not pass through the
texels' own light.
"""
