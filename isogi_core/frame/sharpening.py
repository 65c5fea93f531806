"""Sharpening: texels on the isosurface that a view shows, read in place of those that lie on their own.

A cache that serves every isovalue lights each texel on the isosurface through its own point. Where that is far from the
one in the picture, the texel is lit a second time, moved onto it (see ``kernels.moves``), and kept beside the first by
the isovalue. What cannot be moved is read as before.
"""

import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from isogi_core.bake.effort import Effort, efforts
from isogi_core.bake.recipe import Index, Recipe
from isogi_core.cache.loader import Loader
from isogi_core.cache.pages import Held, PagePool
from isogi_core.errors import StoreError
from isogi_core.frame.reading import Reading, in_chunks
from isogi_core.frame.texels import Demand, ViewTexels
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.lattice import BURIED, UNLIT, VOID
from isogi_core.kernels.moves import judge_texels
from isogi_core.kernels.planes import CONVERGING, FINAL, Planes

log = logging.getLogger("isogi.frame")

STEEPNESS = 0.08
"""Relative error of a pixel's light for each voxel that its texels' isosurfaces are away from its own.

Texels that are nearer than the target error over this are left as they are. Under constant light at 2 % that is a
quarter of a voxel; moving the others too changes the interpolation error from 0.39 to 0.34 % (engine at 180), from 0.77
to 0.40 % (at 170), and takes half as many texels again (``docs/accuracy-interpolation.md``).
"""

PIECE = 16384
"""Texels that one thread judges in one go."""


@dataclass(frozen=True, eq=False)
class Ways:
    """How far texels are from the isosurface that is shown, ``voxels`` (texels,) float32, as estimated."""

    voxels: np.ndarray

    @property
    def nbytes(self) -> int:
        """Bytes that it takes."""
        return self.voxels.nbytes

    @property
    def errors(self) -> np.ndarray:
        """What interpolation is expected to err by for want of moving each texel; (texels,) float32, relative."""
        return np.asarray(STEEPNESS * self.voxels)

    def steep(self, target: float) -> np.ndarray:
        """Which texels that is more of than the ``target`` error; (texels,) bool."""
        return np.asarray(self.errors > target)


def find_ways(texels: ViewTexels, recipe: Recipe, tiles: Tiles) -> Ways:
    """Judge a view's texels."""
    places, ways = texels.positions, np.empty(len(texels.places))
    isovalue = texels.gbuffer.isovalue

    def _piece(a: int, b: int) -> None:
        judge_texels(recipe.field, recipe.step, isovalue, places[a:b], ways[a:b])

    tiles.run(_piece, len(places), PIECE)
    return Ways(ways.astype(np.float32))


@dataclass(frozen=True, eq=False)
class Sharpened(Reading):
    """A reading of ``base`` and ``sharp`` light as one, the latter in a ``pool`` of its own.

    ``rows`` are those of the base, UNLIT where sharp light is read in its place: ``sharp_rows`` are of the other pool,
    and UNLIT elsewhere. ``wanted`` (texels,) are the texels that are to be sharp and can be, ``unmoved`` those that
    cannot.
    """

    base: Reading
    sharp: Reading
    pool: PagePool
    sharp_rows: np.ndarray
    wanted: np.ndarray
    unmoved: np.ndarray

    @property
    def whole(self) -> bool:
        """Whether every texel holds light."""
        return not ((self.rows < 0) & (self.sharp_rows < 0)).any()

    @property
    def moved(self) -> np.ndarray:
        """Which texels are read on the isosurface that is shown."""
        return np.asarray(self.sharp_rows >= 0)

    @property
    def own(self) -> Reading:
        """What the texels hold that lie on their own isosurfaces, those that are read sharp among them."""
        return self.base

    def sources(self, pool: PagePool) -> tuple[tuple[np.ndarray, PagePool], ...]:
        """Rows of light, and the pools that they are of, of which ``pool`` is the base's."""
        return (self.rows, pool), (self.sharp_rows, self.pool)

    def asking(self, asked: np.ndarray) -> "Sharpened":
        """The same of a view that wants no more than the texels ``asked`` (texels,) for, of both."""
        base, wanted = self.base.asking(asked), self.wanted & asked
        short = base.short | in_chunks(wanted & (self.sharp.grade < FINAL), self.bounds)
        unmoved = self.unmoved & asked
        return replace(self, asked=asked, short=short, base=base, wanted=wanted, unmoved=unmoved)

    def demands(self, texels: ViewTexels, wide: np.ndarray, planes: Planes) -> tuple[Demand, ...]:
        """What the view still wants of texels on their own isosurfaces."""
        return self.base.demands(texels, wide, planes)

    def sharp_demands(self, texels: ViewTexels, wide: np.ndarray, planes: Planes) -> tuple[Demand, ...]:
        """What it wants of sharp light: nothing until all other light is final."""
        if self.base.short.any() or not self.short.any():
            return ()
        weights = texels.weights(planes, wide).tolist()
        return tuple(self._sharp_demand(texels, i, weights[i]) for i in np.flatnonzero(self.short).tolist())

    def _sharp_demand(self, texels: ViewTexels, i: int, weight: float) -> Demand:
        """What it wants of the sharp light of chunk ``i``."""
        own = slice(*self.bounds[i : i + 2].tolist())
        wanted = self.wanted[own]
        lacking = wanted & (self.sharp.grade[own] < FINAL)
        told = self.sharp.error[own][lacking], self.sharp.samples[own][lacking], self.target
        effort = Effort(*efforts(np.zeros(len(told[0]), np.int64), 1, *told)[0].tolist())
        return Demand(texels.chunks[i], texels.offsets[i][wanted], weight, effort, texels.footprints[i][wanted])


@contextmanager
def brought(loader: Loader, chunks: Sequence[Index]) -> Iterator[Held | None]:
    """The chunks of sharp light that there are, which stay while the block runs; None where memory cannot hold them."""
    try:
        if loader.store.made:
            loader.ensure(chunks)
    except StoreError as error:
        log.info("a view is not sharpened: %s", error)
        yield None
    else:
        with loader.pool.hold(chunks) as held:
            yield held


def joined(base: Reading, sharp: Reading, ways: Ways, pool: PagePool) -> Sharpened:
    """What a view reads where the ``pool`` has some ``sharp`` light.

    That is taken once its own error is less than what interpolation is expected to err by without it.
    """
    steep = ways.steep(base.target)
    wanted = steep & (sharp.grade != VOID)
    fit = (sharp.grade == FINAL) | (wanted & (sharp.grade == CONVERGING) & (sharp.error <= ways.errors))
    buried = wanted & (sharp.grade == BURIED)
    pending = wanted & (sharp.grade < FINAL)
    grade = np.where(fit | buried, sharp.grade, base.grade)
    grade[pending & (grade == FINAL)] = CONVERGING
    return Sharpened(
        rows=np.where(fit, UNLIT, base.rows).astype(np.int32),
        grade=grade,
        version=base.version + sharp.version + repr(base.target).encode(),
        samples=np.where(fit, sharp.samples, base.samples),
        error=np.where(fit, sharp.error, base.error),
        bounds=base.bounds,
        short=base.short | in_chunks(pending, base.bounds),
        target=base.target,
        base=base,
        sharp=sharp,
        pool=pool,
        sharp_rows=np.where(fit, sharp.rows, UNLIT).astype(np.int32),
        wanted=wanted,
        unmoved=steep & (sharp.grade == VOID),
    )


@dataclass(frozen=True, eq=False)
class Sharpness:
    """How far a view is sharpened: its ``texels``, their ``reading``, and the ``planes`` of its picture.

    Of that ``wide`` (points,) points were read from wide cells.
    """

    texels: ViewTexels
    reading: Sharpened
    wide: np.ndarray
    planes: Planes

    @cached_property
    def demands(self) -> tuple[Demand, ...]:
        """The sharp light that the view lacks; see ``Sharpened``."""
        return self.reading.sharp_demands(self.texels, self.wide, self.planes)

    @property
    def shares(self) -> dict[str, float]:
        """Shares of what is asked for: ``moved`` texels that are read sharp, ``near`` enough, ``pending``, ``unmoved``.

        The latter two are read on their own isosurfaces, for a while or for good.
        """
        reading = self.reading
        asked = np.ones(len(reading.rows), np.bool_) if reading.asked is None else reading.asked
        moved, unmoved = reading.moved & asked, reading.unmoved
        pending = reading.wanted & ~moved
        counts = {"moved": moved, "near": asked & ~(moved | unmoved | pending), "pending": pending, "unmoved": unmoved}
        total = max(int(np.count_nonzero(asked)), 1)
        return {name: float(np.count_nonzero(each)) / total for name, each in counts.items()}

    @cached_property
    def unmoved(self) -> np.ndarray:
        """Which pixels read a texel that is to be sharp and cannot be; (h, w) bool."""
        gbuffer = self.texels.gbuffer
        shown = np.zeros(gbuffer.shape, np.bool_)
        shown.flat[gbuffer.pixels] = self.reading.unmoved[self.texels.read(self.wide)].any(axis=1)
        return shown
