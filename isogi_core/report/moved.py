"""Texels on the isosurface that is shown, in place of each on its own; and other weights for the pixels that read them.

What is tried: texels moved along the gradient (see ``kernels.moves``), all or those alone that are far; weights by how
texels' normals agree with a pixel's, and by how near their isovalues are; and light carried as a share of what would
arrive without shadows.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from isogi_core.frame.surroundings import Turned
from isogi_core.kernels.moves import judge_texels
from isogi_core.kernels.shares import DOUBLINGS, LEAST, LEAST_COSINE
from isogi_core.plan.projection import evaluate_harmonics
from isogi_core.report import interpolation
from isogi_core.report.bench import Bench
from isogi_core.report.interpolation import Neighbourhood, carry, neighbourhood, texels_around, trilinear
from isogi_core.report.metrics import luminance, map_of, mean_of, spread_of
from isogi_core.report.points import Lit, own_light, straight_light
from isogi_core.report.sections import Column, Picture, Section, Table

KEY, TITLE = "moved", "Texels on the shown isosurface"

WAYS_OFF = (0.25, 0.5)
"""Voxels from the shown isosurface beyond which texels are moved where not all are."""

POWER = 2.0**DOUBLINGS
"""Of the cosine between a texel's normal and a pixel's, as a weight; see ``kernels.shares``."""

COLUMNS = (
    Column("texels"),
    Column("relative RMSE", "share"),
    Column("99th percentile", "share"),
    Column("bias", "share"),
    Column("texels moved", "share"),
)

ABOUT = """\
The cell's eight corners, in single floats, carried to the pixels and compared with light at the pixels' own points, \
so that nothing but interpolation differs; the RMSE is less the noise of both sides. Moved texels are lit on the \
picture's own isosurface, at the foot of the gradient through them; those that cannot be stay on their own. Of the \
corners, {failed:.2%} cannot be moved. Frames carry light as shares, weighed by normals, of moved texels where the \
scene sharpens; under light that is the same from all sides, and without that, as the first row says."""


@dataclass(frozen=True, eq=False)
class Sides:
    """The texels about a view's pixels on their ``own`` isosurfaces, and ``moved`` onto the picture's.

    ``ways`` (t,) are how far from it they are, in voxels, as estimated; ``normals`` (m, 3) are the pixels'. ``bare``
    tells unshadowed luminance by normals (n, 3).
    """

    own: Neighbourhood
    moved: Neighbourhood
    ways: np.ndarray
    normals: np.ndarray
    bare: Callable[[np.ndarray], np.ndarray]

    def beyond(self, way: float) -> Neighbourhood:
        """Texels moved where they are farther than a ``way`` and can be, and the others on their own isosurfaces."""
        there = self.far(way)
        fields = ("light", "noise", "apart", "lit")
        picked = {name: np.where(there, getattr(self.moved, name), getattr(self.own, name)) for name in fields}
        normals = np.where(there[:, None], self.moved.normals, self.own.normals)
        return replace(self.own, **picked, normals=normals)

    def far(self, way: float) -> np.ndarray:
        """Which texels are farther than a ``way``, and can be moved; (t,) bool."""
        return np.asarray(self.moved.lit & (self.ways > way))

    @cached_property
    def corners(self) -> np.ndarray:
        """Which texels are a corner of a pixel's cell; (t,) bool."""
        corner = np.zeros(len(self.ways), np.bool_)
        corner[self.own.numbers[:, interpolation.CORNERS]] = True
        return corner

    def share(self, there: np.ndarray) -> float:
        """The share of the corners that are among the texels ``there`` (t,) bool."""
        return float(there[self.corners].mean())


def study(bench: Bench) -> Section:
    """Errors of each way."""
    sides, own = sides_of(bench), own_light(bench)
    straight, mean, rows, pictures = straight_light(bench), mean_of(own.light), [], []
    for name, (way, weigh) in WAYS.items():
        carried = weigh(sides, sides.beyond(way))
        wrong = carried.light + straight - own.light
        spread = spread_of(wrong, carried.noise + own.noise, mean)
        rows.append((name, spread.rmse, spread.p99, spread.bias, sides.share(sides.far(way))))
        pictures.append(Picture(name, "error", map_of(wrong, bench.best.on, mean)))
    table = Table("Interpolation against light at the pixels' own points", COLUMNS, tuple(rows))
    about = ABOUT.format(failed=sides.share(~sides.moved.lit))
    return Section(KEY, TITLE, about, (table,), (), (pictures[0], pictures[1]))


def sides_of(bench: Bench) -> Sides:
    """Bake a view's texels on both isosurfaces."""
    renderer, samples = bench.renderer(bench.scene), interpolation.SAMPLES
    recipe, gbuffer = renderer.recipe, renderer.gbuffer(bench.view)
    own, moved = neighbourhood(bench, samples), neighbourhood(bench, samples, moved=True)
    texels, ways = texels_around(bench)[0], np.empty(len(own.light))
    judge_texels(recipe.field, recipe.step, gbuffer.isovalue, texels, ways)
    normals = gbuffer.normals(recipe, bench.tiles, bench.cancelled).astype(np.float64)
    return Sides(own, moved, ways, normals, bare_light(Turned(renderer.caches.look(bench.view.shading), bench.view)))


def bare_light(turned: Turned) -> Callable[[np.ndarray], np.ndarray]:
    """The luminance that unshadowed surfaces with normals (n, 3) have under ``turned`` lights, as frames have it; but
    by harmonics, each colour LEAST of its mean at least, and the mean of lobes."""
    sky, mean = turned.sky, turned.albedo * turned.mean / turned.look.unit
    reflected = mean - sky.light[:, 0] / math.sqrt(4.0 * math.pi)

    def bare(normals: np.ndarray) -> np.ndarray:
        theta, phi = np.arccos(np.clip(normals[:, 2], -1.0, 1.0)), np.arctan2(normals[:, 1], normals[:, 0])
        light = (sky.lobe * sky.light) @ evaluate_harmonics(sky.order, theta, phi)
        return luminance(np.maximum(light.T, LEAST * mean) + reflected)

    return bare


def plain(sides: Sides, around: Neighbourhood) -> Lit:
    """Trilinear weights."""
    return carry(around, trilinear(around))


def by_normals(sides: Sides, around: Neighbourhood) -> Lit:
    """Trilinear weights times the cosine between normals to its POWER."""
    return carry(around, trilinear(around) * agreement(sides, around))


def by_isovalues(sides: Sides, around: Neighbourhood) -> Lit:
    """Trilinear weights over how far texels' isovalues are, in units of the field's own change within a cell."""
    apart = np.where(around.apart > 0.0, sides.ways, 0.0)[around.numbers]
    return carry(around, trilinear(around) / (0.1 + np.minimum(apart, 1e6)))


def by_shares(sides: Sides, around: Neighbourhood) -> Lit:
    """Trilinear weights of what texels have of unshadowed light about their normals, put under the pixel's own."""
    return shared(sides, around, trilinear(around))


def by_shares_and_normals(sides: Sides, around: Neighbourhood) -> Lit:
    """Both."""
    return shared(sides, around, trilinear(around) * agreement(sides, around))


def agreement(sides: Sides, around: Neighbourhood) -> np.ndarray:
    """The cosine between texels' normals and their pixels', to its POWER; (m, 64), positive."""
    cosines = np.einsum("mkc,mc->mk", around.normals[around.numbers], sides.normals)
    return np.asarray(np.maximum(cosines, LEAST_COSINE) ** POWER)


def shared(sides: Sides, around: Neighbourhood, weights: np.ndarray) -> Lit:
    """Light by ``weights`` (m, 64) of shares of unshadowed light."""
    over, under = sides.bare(around.normals), sides.bare(sides.normals)
    shares = carry(replace(around, light=around.light / over, noise=around.noise / over**2), weights)
    return Lit(shares.light * under, shares.noise * under**2)


WAYS: Mapping[str, tuple[float, Callable[[Sides, Neighbourhood], Lit]]] = {
    "on their own isosurfaces": (math.inf, plain),
    "moved": (0.0, plain),
    **{f"moved beyond {way:g} voxels": (way, plain) for way in WAYS_OFF},
    "own, weighed by normals": (math.inf, by_normals),
    "own, weighed by isovalues": (math.inf, by_isovalues),
    "own, as shares of unshadowed light": (math.inf, by_shares),
    "own, as shares, weighed by normals": (math.inf, by_shares_and_normals),
    "moved, weighed by normals": (0.0, by_normals),
    "moved, as shares of unshadowed light": (0.0, by_shares),
    "moved, as shares, weighed by normals": (0.0, by_shares_and_normals),
}
"""From which way on texels are moved, and how they are weighed, by a row's name."""
