"""Texels on the isosurface that is shown, in place of each on its own; and other weights for the
pixels that read them.

What is tried: texels projected along the gradient (see ``kernels.transport.texel_points``), all or
only those that are far; weights by how texels' normals agree with a pixel's, and by how near their
isovalues are; and light carried as a ratio to its unshadowed light.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.accuracy import carrying
from benchmarks.accuracy.carrying import (
    Neighbourhood,
    carry,
    compared,
    neighbourhood,
    texels_around,
    trilinear,
)
from isogi_core.frame.lighting import RotatedLight
from isogi_core.kernels.shading.irradiance_ratio import (
    LEAST_COSINE,
    MIN_UNSHADOWED,
    NORMAL_TURN_LIMIT,
)
from isogi_core.kernels.transport.transfer import measure_distances
from isogi_core.plan.bands import evaluate_harmonics
from isogi_report.bench import Bench
from isogi_report.exact import Lit, own_light, straight_light
from isogi_report.metrics import Spread, luminance_of

WAYS_OFF = (0.25, 0.5)
"""Voxels from the shown isosurface beyond which texels are projected where not all are."""


@dataclass(frozen=True, eq=False)
class Sides:
    """The texels about a view's pixels on their ``own`` isosurfaces, and ``projected`` onto the
    picture's.

    ``ways`` (t,) are how far from it they are, in voxels, as estimated; ``normals`` (m, 3) are the
    pixels'. ``bare`` tells unshadowed luminance by normals (n, 3).
    """

    own: Neighbourhood
    projected: Neighbourhood
    ways: np.ndarray
    normals: np.ndarray
    bare: Callable[[np.ndarray], np.ndarray]

    def beyond(self, way: float) -> Neighbourhood:
        """Texels projected where they are farther than a ``way`` and can be, the others on their
        own isosurfaces.
        """
        there = self.far(way)
        fields = ("light", "reflected", "noise", "apart", "lit")
        picked = {
            name: np.where(there, getattr(self.projected, name), getattr(self.own, name))
            for name in fields
        }
        normals = np.where(there[:, None], self.projected.normals, self.own.normals)
        return replace(self.own, **picked, normals=normals)

    def far(self, way: float) -> np.ndarray:
        """Which texels are farther than a ``way``, and can be projected; (t,) bool."""
        return np.asarray(self.projected.lit & (self.ways > way))


def errors_of_moves(bench: Bench) -> dict[str, Spread]:
    """Errors of WAYS beside light at the pixels' own points, by name."""
    sides = sides_of(bench)
    own = own_light(bench)
    straight = straight_light(bench)
    return {
        name: compared(weigh(sides, sides.beyond(way)), straight, own)
        for name, (way, weigh) in WAYS.items()
    }


def sides_of(bench: Bench) -> Sides:
    """Bake a view's texels on both isosurfaces."""
    renderer = bench.renderer(bench.scene)
    samples = carrying.SAMPLES
    prepared = renderer.prepared
    gbuffer = renderer.gbuffer(bench.view)
    own = neighbourhood(bench, samples)
    projected = neighbourhood(bench, samples, projected=True)
    texels = texels_around(bench)[0]
    ways = np.empty(len(own.light))
    measure_distances(prepared.field, prepared.step, gbuffer.isovalue, texels, ways)
    normals = gbuffer.normals(bench.tiles).astype(np.float64)
    return Sides(
        own,
        projected,
        ways,
        normals,
        bare_light(RotatedLight(renderer.caches.spec(bench.view.shading), bench.view)),
    )


def bare_light(turned: RotatedLight) -> Callable[[np.ndarray], np.ndarray]:
    """The luminance that unshadowed surfaces with normals (n, 3) have under ``turned`` lights, as
    frames have it; but by harmonics, each colour MIN_UNSHADOWED of its mean at least."""
    sky = turned.sky
    mean = turned.albedo * turned.mean / turned.spec.unit

    def bare(normals: np.ndarray) -> np.ndarray:
        theta = np.arccos(np.clip(normals[:, 2], -1.0, 1.0))
        phi = np.arctan2(normals[:, 1], normals[:, 0])
        light = (sky.lobe * sky.light) @ evaluate_harmonics(sky.order, theta, phi)
        return luminance_of(np.maximum(light.T, MIN_UNSHADOWED * mean))

    return bare


def plain(sides: Sides, around: Neighbourhood) -> Lit:
    """Trilinear weights."""
    return carry(around, trilinear(around))


def by_normals(sides: Sides, around: Neighbourhood) -> Lit:
    """Trilinear weights times the cosine between normals to its POWER."""
    return carry(around, trilinear(around) * agreement(sides, around))


def by_isovalues(sides: Sides, around: Neighbourhood) -> Lit:
    """Trilinear weights over how far texels' isovalues are, in units of the field's own change
    within a cell.
    """
    apart = np.where(around.apart > 0.0, sides.ways, 0.0)[around.numbers]
    return carry(around, trilinear(around) / (0.1 + np.minimum(apart, 1e6)))


def by_shares(sides: Sides, around: Neighbourhood) -> Lit:
    """Trilinear weights of what texels have of unshadowed light about their normals, put under the
    pixel's own.
    """
    return shared(sides, around, trilinear(around))


def by_shares_and_normals(sides: Sides, around: Neighbourhood) -> Lit:
    """Both."""
    return shared(sides, around, trilinear(around) * agreement(sides, around))


def agreement(sides: Sides, around: Neighbourhood) -> np.ndarray:
    """What texels count by their normals and their pixels'; (m, 64), positive. See
    ``irradiance_ratio.agree``.
    """
    cosines = np.einsum("mkc,mc->mk", around.normals[around.numbers], sides.normals)
    return np.asarray(
        (np.maximum(cosines, LEAST_COSINE) / (1.0 + (1.0 - cosines) / NORMAL_TURN_LIMIT)) ** 2
    )


def shared(sides: Sides, around: Neighbourhood, weights: np.ndarray) -> Lit:
    """Light by ``weights`` (m, 64): direct light as ratios to unshadowed light, reflected light as
    it is.
    """
    over = sides.bare(around.normals)
    under = sides.bare(sides.normals)
    means = {
        name: carry(replace(around, light=light), weights)
        for name, light in (
            ("direct", around.light - around.reflected),
            ("over", over),
            ("reflected", around.reflected),
        )
    }
    brighter = under / np.maximum(means["over"].light, 1e-30)
    return Lit(
        means["direct"].light * brighter + means["reflected"].light,
        means["direct"].noise * brighter**2,
    )


WAYS: Mapping[str, tuple[float, Callable[[Sides, Neighbourhood], Lit]]] = {
    "on their own isosurfaces": (math.inf, plain),
    "projected": (0.0, plain),
    **{f"projected beyond {way:g} voxels": (way, plain) for way in WAYS_OFF},
    "own, weighed by normals": (math.inf, by_normals),
    "own, weighed by isovalues": (math.inf, by_isovalues),
    "own, as shares of unshadowed light": (math.inf, by_shares),
    "own, as shares, weighed by normals": (math.inf, by_shares_and_normals),
    "projected, weighed by normals": (0.0, by_normals),
    "projected, as shares of unshadowed light": (0.0, by_shares),
    "projected, as shares, weighed by normals": (0.0, by_shares_and_normals),
}
"""From which way on texels are projected, and how they are weighed, by a row's name."""
