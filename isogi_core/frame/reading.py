"""A reading of the cache: where the light of a view's texels is in the pool now, and how good it is."""

import hashlib
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from isogi_core.bake.effort import Effort, efforts
from isogi_core.bake.noise import good_enough
from isogi_core.cache.pages import PagePool
from isogi_core.cache.rows import fewest_samples
from isogi_core.frame.texels import Demand, ViewTexels
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.chunks import find_rows
from isogi_core.kernels.lattice import BURIED, BURIED_ROW, PARTIAL, UNBAKED, UNLIT, VOID, VOID_ROW
from isogi_core.kernels.planes import CONVERGING, FINAL, Planes

PIECE = 16384
"""Texels that are looked up, and digested, together; the same on any number of threads."""


@dataclass(frozen=True, eq=False)
class Reading:
    """What a view's texels hold, (texels,) each; it is good until the pool changes.

    ``rows`` int32 are those of the pool, negative where there is no light; ``grade`` uint8 is
    UNBAKED, PARTIAL, CONVERGING, FINAL, BURIED or VOID. ``version`` tells how far each texel is baked: a
    texel's light follows from its numbers of samples; ``samples`` int32 are the fewest of any part, ``error``
    float32 is relative. Texels of chunk i are ``bounds[i]`` … ``bounds[i + 1]``; ``short`` (chunks,) says which chunks
    are not final at the relative error ``target``. A view may want those texels alone that are ``asked`` (texels,) for,
    and chunks are short of these then.
    """

    rows: np.ndarray
    grade: np.ndarray
    version: bytes
    samples: np.ndarray
    error: np.ndarray
    bounds: np.ndarray
    short: np.ndarray
    target: float
    asked: np.ndarray | None = field(default=None, kw_only=True)

    @property
    def nbytes(self) -> int:
        """Bytes that it takes, without the bounds."""
        return sum(each.nbytes for each in (self.rows, self.grade, self.samples, self.error, self.short))

    @cached_property
    def efforts(self) -> np.ndarray:
        """What the texels of each chunk that are not final have taken and will: see ``Effort``; (chunks, 3) float64."""
        rows = np.flatnonzero(self.grade < FINAL if self.asked is None else (self.grade < FINAL) & self.asked)
        chunks = np.repeat(np.arange(len(self.short)), np.diff(self.bounds))
        return efforts(chunks[rows], len(self.short), self.error[rows], self.samples[rows], self.target)

    @property
    def whole(self) -> bool:
        """Whether every texel holds light."""
        return not (self.rows < 0).any()

    @property
    def moved(self) -> np.ndarray:
        """Which texels are read on the isosurface that is shown, and not on their own; (texels,) bool."""
        return np.zeros(len(self.rows), np.bool_)

    @property
    def own(self) -> "Reading":
        """What the texels hold that lie on their own isosurfaces."""
        return self

    def sources(self, pool: PagePool) -> tuple[tuple[np.ndarray, PagePool], ...]:
        """Rows of light, and the pools that they are of: all of them of the ``pool`` that was read."""
        return ((self.rows, pool),)

    def asking(self, asked: np.ndarray) -> "Reading":
        """The same of a view that wants no more than the texels ``asked`` (texels,) for.

        What it reads follows from its target, too, which its version tells.
        """
        short, version = in_chunks((self.grade < FINAL) & asked, self.bounds), self.version + repr(self.target).encode()
        return replace(self, asked=asked, short=short, version=version)

    @property
    def needed(self) -> int:
        """Chunks that the view wants something of."""
        return len(self.short) if self.asked is None else int(in_chunks(self.asked, self.bounds).sum())

    def demands(self, texels: ViewTexels, wide: np.ndarray, planes: Planes) -> tuple[Demand, ...]:
        """What the view still wants, ``planes`` being its picture, of which ``wide`` (points,) ones were read wide."""
        if not self.short.any():
            return ()
        weights = texels.weights(planes, wide).tolist()
        return tuple(self._demand(texels, i, weights[i]) for i in np.flatnonzero(self.short).tolist())

    def _demand(self, texels: ViewTexels, i: int, weight: float) -> Demand:
        """What it wants of chunk ``i``."""
        own = ... if self.asked is None else self.asked[slice(*self.bounds[i : i + 2].tolist())]
        effort = Effort(*self.efforts[i].tolist())
        return Demand(texels.chunks[i], texels.offsets[i][own], weight, effort, texels.footprints[i][own])


def read_texels(texels: ViewTexels, slots: np.ndarray, pool: PagePool, target: float, tiles: Tiles) -> Reading:
    """Look a view's texels up in the pool; ``slots`` are those of its chunks, ``target`` is final light's error."""
    places = texels.places
    rows, grade = np.empty(len(places), np.int32), np.empty(len(places), np.uint8)
    samples, error = np.empty(len(places), np.int32), np.empty(len(places), np.float32)
    digests: dict[int, bytes] = {}

    def _piece(a: int, b: int) -> None:
        stamp = np.empty(b - a, np.float32)
        find_rows(texels.lattice, places[a:b], slots, pool.table, pool.error, pool.stamp, rows[a:b], error[a:b], stamp)
        samples[a:b] = fewest_samples(stamp, len(pool.look.plan.layers))
        grade[a:b] = grade_rows(rows[a:b], error[a:b], samples[a:b], target)
        digests[a] = hashlib.sha256(stamp.data).digest()

    tiles.run(_piece, len(places), PIECE)
    short = in_chunks(grade < FINAL, texels.bounds)
    version = b"".join(digests[a] for a in sorted(digests))
    return Reading(rows, grade, version, samples, error, texels.bounds, short, target)


def in_chunks(which: np.ndarray, bounds: np.ndarray) -> np.ndarray:
    """Whether any of some texels (texels,) is in each chunk, whose texels begin at ``bounds`` (chunks + 1,); bool."""
    return np.asarray(np.logical_or.reduceat(which, bounds[:-1])) if len(which) else np.zeros(0, np.bool_)


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
