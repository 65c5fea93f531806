"""A view's light from every texel of a lattice, from every second one along each axis, every fourth, and so on.

Lattices of half the density lie within those of twice that, so that coarse light is some of the fine light: it costs
nothing more where the fine light is needed too.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from isogi_core.frame.surroundings import Turned
from isogi_core.kernels.lattice import Lattice
from isogi_core.kernels.moves import judge_texels
from isogi_core.model.view import View
from isogi_core.report.bench import Bench
from isogi_core.report.interpolation import Neighbourhood, carry, light_of
from isogi_core.report.moved import Sides, agreement, bare_light, shared
from isogi_core.report.points import Lit, straight_light

STEPS = np.array([(c >> 2 & 1, c >> 1 & 1, c & 1) for c in range(8)])
"""Corners of a cell, (8, 3; z, y, x)."""


@dataclass(frozen=True, eq=False)
class Cells:
    """The cells that m points lie in: ``corners`` (m, 8), places of texels in the whole lattice, in the order of STEPS.

    ``weights`` (m, 8) are trilinear.
    """

    corners: np.ndarray
    weights: np.ndarray


def cells_of(points: np.ndarray, lattice: Lattice, stride: int) -> Cells:
    """The cells about ``points`` (m, 3; x, y, z, voxels) of every ``stride``-th texel of a lattice.

    The last cell along an axis is a shorter one where the stride does not divide the lattice.
    """
    last = np.array(lattice.shape) - 1
    places = points[:, ::-1].astype(np.float64) * np.array(lattice.density[::-1])
    low = np.clip(np.floor(places / stride).astype(np.int64), 0, (last - 1) // stride) * stride
    high = np.minimum(low + stride, last)
    inside = np.clip((places - low) / (high - low), 0.0, 1.0)[:, None]
    corners = np.where(STEPS == 1, high[:, None], low[:, None])
    weights = np.where(STEPS == 1, inside, 1.0 - inside).prod(axis=-1)
    return Cells(np.ravel_multi_index(tuple(np.moveaxis(corners, -1, 0)), lattice.shape), weights)


@dataclass(frozen=True, eq=False)
class Net:
    """A view's light from every ``stride``-th texel; an ``edge`` of its cells is so many voxels long.

    ``lit`` is what its pixels show, as shares of unshadowed light by weights of normals. Of a pixel's eight texels
    there are the ``spread`` (m,), the deviation of their shares times what the pixel would have without shadows, and
    the ``turn`` (m,), that of their normals from the pixel's times the pixel's light; luminances both.
    """

    stride: int
    edge: float
    lit: Lit
    spread: np.ndarray
    turn: np.ndarray


@dataclass(frozen=True, eq=False)
class Texels:
    """The texels of a view for several ``strides``: ``cells`` of each, and ``numbers`` (strides, m, 8) of texels.

    ``places`` (t, 3; z, y, x) int32 are those of all of them, each told once, and ``ways`` (t,) how far they are from
    the isosurface of the view, in voxels.
    """

    strides: tuple[int, ...]
    cells: tuple[Cells, ...]
    numbers: np.ndarray
    places: np.ndarray
    ways: np.ndarray


def find_texels(bench: Bench, view: View, strides: Sequence[int]) -> Texels:
    """Find the texels of a ``view`` of the bench's scene, without any light."""
    renderer = bench.renderer(bench.scene)
    recipe, gbuffer = renderer.recipe, renderer.gbuffer(view)
    cells = tuple(cells_of(gbuffer.points, recipe.lattice, stride) for stride in strides)
    flat, numbers = np.unique(np.stack([each.corners for each in cells]), return_inverse=True)
    places = np.stack(np.unravel_index(flat, recipe.shape), axis=-1).astype(np.int32)
    ways = np.empty(len(places))
    judge_texels(recipe.field, recipe.step, gbuffer.isovalue, places, ways)
    return Texels(tuple(strides), cells, numbers.reshape(len(cells), -1, 8), places, ways)


@dataclass(frozen=True, eq=False)
class Lights:
    """The light of a view's ``texels`` with so many ``samples``, on their own isosurfaces and moved onto the view's."""

    bench: Bench
    texels: Texels
    samples: int

    @cached_property
    def sides(self) -> Sides:
        """The light, baked when first asked for. Numbers and fractions are of no use there."""
        bench, places = self.bench, self.texels.places
        renderer = bench.renderer(bench.scene)
        normals = renderer.gbuffer(bench.view).normals(renderer.recipe, bench.tiles, bench.cancelled)
        none = np.empty((0, 8), np.int64), np.empty((0, 3))
        own, moved = (Neighbourhood(*none, **light_of(bench, places, self.samples, there)) for there in (False, True))
        bare = bare_light(Turned(renderer.caches.look(bench.view.shading), bench.view))
        return Sides(own, moved, self.texels.ways, normals.astype(np.float64), bare)

    def nets(self, way: float) -> tuple[Net, ...]:
        """The view's light from each of the strides, texels moved where they are farther than a ``way``."""
        return tuple(self._net(k, way) for k in range(len(self.texels.strides)))

    def _net(self, k: int, way: float) -> Net:
        sides, texels, stride = self.sides, self.texels, self.texels.strides[k]
        around = replace(sides.beyond(way), numbers=texels.numbers[k])
        weights = texels.cells[k].weights * agreement(sides, around)
        lit = shared(sides, around, weights)
        edge = stride * float(self.bench.renderer(self.bench.scene).recipe.step.mean())
        whole = Lit(lit.light + straight_light(self.bench), lit.noise)
        turn = turn_of_normals(sides, around, weights) * lit.light
        return Net(stride, edge, whole, spread_of_shares(sides, around, weights), turn)


def spread_of_shares(sides: Sides, around: Neighbourhood, weights: np.ndarray) -> np.ndarray:
    """The deviation of the shares that each pixel reads by ``weights`` (m, 8), as a luminance; (m,)."""
    shares = around.light / sides.bare(around.normals)
    mean, square = (carry(replace(around, light=each), weights).light for each in (shares, shares**2))
    return np.asarray(np.sqrt(np.maximum(square - mean**2, 0.0)) * sides.bare(sides.normals))


def turn_of_normals(sides: Sides, around: Neighbourhood, weights: np.ndarray) -> np.ndarray:
    """How far texels' normals are turned from their pixel's, √(2 - 2 cos) by ``weights`` (m, 8), radians; (m,)."""
    cosines = np.einsum("mkc,mc->mk", around.normals[around.numbers], sides.normals)
    held = weights * around.lit[around.numbers]
    away = (held * (1.0 - cosines)).sum(axis=1) / np.maximum(held.sum(axis=1), 1e-30)
    return np.asarray(np.sqrt(np.maximum(2.0 * away, 0.0)))
