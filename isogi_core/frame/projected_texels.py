"""Projected texels: lit on the isosurface that a view shows, and read in place of texels on
their own isosurfaces.
"""

import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from isogi_core.bake.noise import Goal
from isogi_core.bake.texel_light import FIRST_LEVEL
from isogi_core.cache.page_pool import Held, PagePool
from isogi_core.cache.scene_caches import Loader
from isogi_core.errors import StoreError
from isogi_core.frame.demand import Demand
from isogi_core.frame.texel_reading import Lacking, Reading, Stage
from isogi_core.frame.tiles import Tiles
from isogi_core.frame.view_texels import ViewTexels
from isogi_core.kernels.shading.framebuffer import CONVERGING, FINAL, Framebuffer
from isogi_core.kernels.shading.lattice import BURIED_GRADE, UNLIT_ROW, VOID_GRADE
from isogi_core.kernels.transport.transfer import measure_distances
from isogi_core.model.volume import Isovalue
from isogi_core.prepared.prepared_scene import Index, PreparedScene

log = logging.getLogger("isogi.frame")

STEEPNESS = 0.08
"""Relative error of a pixel's light for each voxel of distance between the isosurfaces of its
texels and its own.

Texels nearer than the target error over this are left as they are. Under constant light at 2 % that
is a quarter of a voxel; projecting the others too changes the interpolation error from 0.39 to 0.34
% (engine at 180), from 0.77 to 0.40 % (at 170), and takes half as many texels again
(``python -m benchmarks.accuracy interpolation``).
"""

TEXELS_A_PIECE = 16384
"""Texels whose distances one thread estimates in one go."""


@dataclass(frozen=True, eq=False)
class Distances:
    """Estimated distances of texels from the isosurface of a view, in ``voxels``; (texels,)
    float32.
    """

    voxels: np.ndarray

    @property
    def nbytes(self) -> int:
        """The size of its arrays in bytes."""
        return self.voxels.nbytes

    @property
    def errors(self) -> np.ndarray:
        """The relative error of interpolation that is expected of each texel if it is not
        projected; (texels,) float32.
        """
        return np.asarray(STEEPNESS * self.voxels)

    def beyond(self, target: float) -> np.ndarray:
        """Mark the texels whose error is above the ``target``; (texels,) bool."""
        return np.asarray(self.errors > target)


def find_distances(texels: ViewTexels, prepared: PreparedScene, tiles: Tiles) -> Distances:
    """Estimate how far a view's texels are from its isosurface."""
    return distances_of(texels.positions, texels.gbuffer.isovalue, prepared, tiles)


def distances_of(
    positions: np.ndarray, isovalue: Isovalue, prepared: PreparedScene, tiles: Tiles
) -> Distances:
    """Estimate how far the texels at ``positions`` (m, 3; z, y, x) are from an isosurface."""
    voxels = np.empty(len(positions))

    def _piece(a: int, b: int) -> None:
        measure_distances(prepared.field, prepared.step, isovalue, positions[a:b], voxels[a:b])

    tiles.run(_piece, len(positions), TEXELS_A_PIECE)
    return Distances(voxels.astype(np.float32))


@dataclass(frozen=True, eq=False)
class ProjectedReading(Reading):
    """A reading of ``base`` texels on their own isosurfaces and of ``projected`` ones, as one.

    - ``rows``: rows of the base, UNLIT_ROW if the projected texel is read instead.
    - ``projected_rows``: rows of the other ``pool``, UNLIT_ROW if the base is read.
    - ``wanted`` (texels,) bool: texels that are to be projected, and can be.
    - ``unreachable`` (texels,) bool: texels that are to be projected, and cannot be.
    - ``dark`` (texels,) bool: projected texels in closed hollows, where no light arrives.
    - ``distances``: of all texels from the isosurface.
    """

    base: Reading
    projected: Reading
    pool: PagePool
    projected_rows: np.ndarray
    wanted: np.ndarray
    unreachable: np.ndarray
    dark: np.ndarray
    distances: Distances

    @property
    def whole(self) -> bool:
        """True if every texel holds light."""
        return not ((self.rows < 0) & (self.projected_rows < 0)).any()

    @property
    def on_surface(self) -> np.ndarray:
        """Mark texels that are read on the isosurface of the view; (texels,) bool."""
        return np.asarray((self.projected_rows >= 0) | self.dark)

    @property
    def projects(self) -> bool:
        """True: texels are projected."""
        return True

    def sources(self, pool: PagePool) -> tuple[tuple[np.ndarray, PagePool], ...]:
        """Return rows of light, and the pool that each of these is in; ``pool`` is the base's."""
        return (self.rows, pool), (self.projected_rows, self.pool)

    def demands(self, lacking: Lacking) -> tuple[Demand, ...]:
        """Return the light that the view would still lack if it read all texels on their own
        isosurfaces.
        """
        return self.base.demands(lacking)

    def projected_demands(self, lacking: Lacking) -> tuple[Demand, ...]:
        """Return the light of projected texels that the view lacks."""
        shown = lacking.texels.gbuffer.isovalue
        return lacking.of(self.projected, self.pending, self.wanted, shown, like=self.base)

    def stages(self, lacking: Lacking) -> tuple[Stage, ...]:
        """Return the light that a picture lacks, in three stages: first light of all texels on
        their own isosurfaces, light of projected texels, and the rest.

        Light that projected texels soon replace need not become any better.
        """
        base = self.base
        # Where light has only begun, all texels get their first samples; those to be projected get
        # no more.
        first = Goal.checked(self.goal.error)
        unlit = (base.grade < FINAL) & (base.samples < FIRST_LEVEL)
        rest = lacking.of(base, (base.grade < FINAL) & ~self.wanted, ~self.wanted)
        return (
            Stage(lacking.of(base, unlit, samples=FIRST_LEVEL), first),
            Stage(self.projected_demands(lacking), self.goal),
            Stage(rest, self.goal),
        )

    @property
    def pending(self) -> np.ndarray:
        """Mark projected texels that are not final; (texels,) bool."""
        return np.asarray(self.wanted & (self.projected.grade < FINAL))


@contextmanager
def held_chunks(loader: Loader, chunks: Sequence[Index]) -> Iterator[Held | None]:
    """Hold the ``chunks`` of projected texels in the pool while the block runs; yield None if
    memory has no room for them.
    """
    try:
        if loader.chunk_store.made:
            loader.ensure(chunks)
    except StoreError as error:
        log.info("a view is read without projected texels: %s", error)
        yield None
    else:
        with loader.pool.hold(chunks) as held:
            yield held


def join_readings(
    base: Reading, projected: Reading, distances: Distances, pool: PagePool
) -> ProjectedReading:
    """Join the readings of ``base`` texels and of the ``projected`` ones in a ``pool``: read each
    texel from the one of the two that has the smaller error.

    The base has an error of interpolation, by its distance from the isosurface, and one of noise; a
    projected texel has noise alone. If it is final it is always read, even at texels near enough to
    do without.
    """
    # Only texels that are far from the isosurface are projected, unless they cannot be: void.
    beyond = distances.beyond(base.goal.error)
    grade = projected.grade
    wanted = beyond & (grade != VOID_GRADE)
    # Compare the noise of each with interpolation and noise of the base.
    without = np.hypot(distances.errors, np.where(base.samples > 0, base.error, 1.0))
    fit = (grade == FINAL) | (wanted & (grade == CONVERGING) & (projected.error <= without))
    # Buried ones are moved into closed hollows, and are known to be dark.
    dark = wanted & (grade == BURIED_GRADE)
    pending = wanted & (grade < FINAL)
    grade = np.where(fit, grade, base.grade)
    grade[dark] = FINAL
    # A pixel is not final while a projected texel of it is not.
    grade[pending & (grade == FINAL)] = CONVERGING
    # Mark the chunks with texels that lack light, of either kind.
    lacks = pending | (base.grade < FINAL) & ~wanted
    if len(grade):
        short = np.logical_or.reduceat(lacks, base.bounds[:-1])
    else:
        short = base.short
    return ProjectedReading(
        rows=np.where(fit | dark, UNLIT_ROW, base.rows).astype(np.int32),
        grade=grade,
        version=base.version + projected.version + repr(tuple(base.goal)).encode(),
        samples=np.where(fit, projected.samples, base.samples),
        error=np.where(fit, projected.error, base.error),
        bounds=base.bounds,
        short=short,
        goal=base.goal,
        rough=base.rough,
        base=base,
        projected=projected,
        pool=pool,
        projected_rows=np.where(fit, projected.rows, UNLIT_ROW).astype(np.int32),
        wanted=wanted,
        unreachable=beyond & (projected.grade == VOID_GRADE),
        dark=dark,
        distances=distances,
    )


@dataclass(frozen=True, eq=False)
class Projection:
    """How far a view's texels are projected, by their ``reading``; ``planes`` is the
    framebuffer of the picture.
    """

    texels: ViewTexels
    reading: ProjectedReading
    planes: Framebuffer

    @cached_property
    def demands(self) -> tuple[Demand, ...]:
        """The light of projected texels that the view lacks."""
        return self.reading.projected_demands(Lacking(self.texels, self.reading, self.planes))

    @property
    def shares(self) -> dict[str, float]:
        """Shares of the texels: ``projected``, ``near`` enough as they are, ``pending`` and
        ``unreachable``.

        The latter two are read on their own isosurfaces, for a while or for good.
        """
        projected = self.reading.on_surface
        unreachable = self.reading.unreachable
        pending = self.reading.wanted & ~projected
        # All texels that are in no other state are near enough.
        near = ~(projected | unreachable | pending)
        total = max(len(projected), 1)
        counts = {
            "projected": projected,
            "near": near,
            "pending": pending,
            "unreachable": unreachable,
        }
        return {name: float(np.count_nonzero(each)) / total for name, each in counts.items()}

    @cached_property
    def unreachable(self) -> np.ndarray:
        """Mark pixels that read a texel which is to be projected and cannot be; (h, w) bool."""
        gbuffer = self.texels.gbuffer
        shown = np.zeros(gbuffer.shape, np.bool_)
        shown.flat[gbuffer.pixels] = self.reading.unreachable[self.texels.corners].any(axis=1)
        return shown
