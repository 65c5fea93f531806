"""The reading of a view: where its texels' light is in the page pool, and how good it is."""

import hashlib
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from isogi_core.bake.noise import Effort, efforts, good_enough
from isogi_core.cache.page_pool import PagePool, fewest_samples
from isogi_core.frame.tiles import Tiles
from isogi_core.frame.view_texels import Demand, ViewTexels
from isogi_core.kernels.shading.chunks import Pages, find_rows
from isogi_core.kernels.shading.framebuffer import CONVERGING, FINAL, Framebuffer
from isogi_core.kernels.shading.lattice import BURIED, BURIED_ROW, PARTIAL, UNBAKED, UNLIT, VOID, VOID_ROW

PIECE = 16384
"""Texels that are looked up, and digested, together; the same on any number of threads."""


@dataclass(frozen=True, eq=False)
class Reading:
    """What a view's texels hold, (texels,) each; it is good until the pool changes.

    ``rows`` int32 are those of the pool, negative where there is no light; ``grade`` uint8 is
    UNBAKED, PARTIAL, CONVERGING, FINAL, BURIED or VOID. ``version`` says how far each texel is baked: a
    texel's light follows from its numbers of samples; ``samples`` int32 are the fewest of any part, ``error``
    float32 is relative. Texels of chunk i are ``bounds[i]`` … ``bounds[i + 1]``; ``short`` (chunks,) says which chunks
    are not final at the relative error ``target``.
    """

    rows: np.ndarray
    grade: np.ndarray
    version: bytes
    samples: np.ndarray
    error: np.ndarray
    bounds: np.ndarray
    short: np.ndarray
    target: float

    @property
    def nbytes(self) -> int:
        """Bytes that it takes, without the bounds."""
        return sum(each.nbytes for each in (self.rows, self.grade, self.samples, self.error, self.short))

    @cached_property
    def efforts(self) -> np.ndarray:
        """What the texels of each chunk that are not final have taken and will: see ``Effort``; (chunks, 3) float64."""
        rows = np.flatnonzero(self.grade < FINAL)
        chunks = np.repeat(np.arange(len(self.short)), np.diff(self.bounds))
        return efforts(chunks[rows], len(self.short), self.error[rows], self.samples[rows], self.target)

    @property
    def whole(self) -> bool:
        """Whether every texel holds light."""
        return not (self.rows < 0).any()

    @property
    def noisy(self) -> np.ndarray:
        """Which texels' light is still noisy, whatever else they lack; (texels,) bool."""
        return np.asarray((self.grade == CONVERGING) & ~good_enough(self.error, self.samples, self.target))

    @property
    def on_surface(self) -> np.ndarray:
        """Which texels are read on the isosurface that is shown, and not on their own; (texels,) bool."""
        return np.zeros(len(self.rows), np.bool_)

    def sources(self, pool: PagePool) -> tuple[tuple[np.ndarray, PagePool], ...]:
        """Rows of light, and the pools that they are of: all of them of the ``pool`` that was read."""
        return ((self.rows, pool),)

    def demands(self, texels: ViewTexels, framebuffer: Framebuffer) -> tuple[Demand, ...]:
        """What the view still wants, whose picture is in the ``framebuffer``."""
        if not self.short.any():
            return ()
        weights, seen = texels.weights(framebuffer).tolist(), texels.footprints
        return tuple(
            Demand(texels.chunks[i], texels.offsets[i], weights[i], Effort(*self.efforts[i].tolist()), seen[i])
            for i in np.flatnonzero(self.short)
        )


def read_texels(texels: ViewTexels, slots: np.ndarray, pool: PagePool, target: float, tiles: Tiles) -> Reading:
    """Look a view's texels up in the pool; ``slots`` are those of its chunks, ``target`` is final light's error."""
    places = texels.places
    rows, grade = np.empty(len(places), np.int32), np.empty(len(places), np.uint8)
    samples, error = np.empty(len(places), np.int32), np.empty(len(places), np.float32)
    digests: dict[int, bytes] = {}
    pages = Pages(pool.table, pool.error, pool.stamp)

    def _piece(a: int, b: int) -> None:
        stamp = np.empty(b - a, np.float32)
        find_rows(texels.lattice, places[a:b], slots, pages, rows[a:b], error[a:b], stamp)
        samples[a:b] = fewest_samples(stamp, len(pool.spec.plan.layers))
        grade[a:b] = grade_rows(rows[a:b], error[a:b], samples[a:b], target)
        digests[a] = hashlib.sha256(stamp.data).digest()

    tiles.run(_piece, len(places), PIECE)
    short = np.minimum.reduceat(grade, texels.bounds[:-1]) < FINAL if len(grade) else np.zeros(0, np.bool_)
    version = b"".join(digests[a] for a in sorted(digests))
    return Reading(rows, grade, version, samples, error, texels.bounds, short, target)


@dataclass(frozen=True, eq=False)
class Lacking:
    """What the picture in a ``framebuffer`` still wants of its ``texels``, by their ``reading``."""

    texels: ViewTexels
    reading: Reading
    framebuffer: Framebuffer

    @property
    def demands(self) -> tuple[Demand, ...]:
        """The light that was not final, chunk by chunk."""
        return self.reading.demands(self.texels, self.framebuffer)


GRADES = {UNLIT: UNBAKED, VOID_ROW: VOID, BURIED_ROW: BURIED}
"""Grades of texels that have no row of light."""


def grade_rows(rows: np.ndarray, error: np.ndarray, samples: np.ndarray, target: float) -> np.ndarray:
    """How good the light in each row is, after at least so many ``samples`` in each part; (texels,) uint8."""
    grade = good_enough(error, samples, target).view(np.uint8)
    grade += CONVERGING
    grade[samples == 0] = PARTIAL
    if (rows < 0).any():
        for row, own in GRADES.items():
            grade[rows == row] = own
    return grade
