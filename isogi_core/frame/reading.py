"""A reading of the cache: where the light of a view's texels is in the pool now, and how good it is."""

import hashlib
from dataclasses import dataclass

import numpy as np

from isogi_core.bake.noise import good_enough
from isogi_core.cache.pages import PagePool
from isogi_core.frame.texels import Demand, ViewTexels
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.lattice import UNLIT, VOID, VOID_ROW, find_rows
from isogi_core.kernels.planes import CONVERGING, FINAL, PROVISIONAL

PIECE = 16384
"""Texels that are looked up, and digested, together; the same on any number of threads."""


@dataclass(frozen=True, eq=False)
class Reading:
    """What a view's texels hold, (texels,) each; it is good until the pool changes.

    ``rows`` int32 are those of the pool, negative where there is no light; ``grade`` uint8 is
    PROVISIONAL, CONVERGING, FINAL or VOID. ``version`` tells how far each texel is baked: a texel's
    light follows from its number of samples. ``short`` (chunks,) says which chunks are not final.
    """

    rows: np.ndarray
    grade: np.ndarray
    version: bytes
    short: np.ndarray

    @property
    def nbytes(self) -> int:
        """Bytes that it takes."""
        return self.rows.nbytes + self.grade.nbytes + self.short.nbytes

    @property
    def whole(self) -> bool:
        """Whether every texel holds light."""
        return not (self.rows < 0).any()

    def demands(self, texels: ViewTexels) -> tuple[Demand, ...]:
        """What the view still wants."""
        if not self.short.any():
            return ()
        return tuple(demand for demand, wanted in zip(texels.demands, self.short, strict=True) if wanted)


def read_texels(texels: ViewTexels, slots: np.ndarray, pool: PagePool, target: float, tiles: Tiles) -> Reading:
    """Look a view's texels up in the pool; ``slots`` are those of its chunks, ``target`` is final light's error."""
    places = texels.places
    rows, grade = np.empty(len(places), np.int32), np.empty(len(places), np.uint8)
    digests: dict[int, bytes] = {}

    def _piece(a: int, b: int) -> None:
        error, samples = np.empty((2, b - a), np.float32)
        find_rows(places[a:b], slots, pool.table, pool.error, pool.samples, rows[a:b], error, samples)
        grade[a:b] = grade_rows(rows[a:b], error, samples, target)
        digests[a] = hashlib.sha256(samples.data).digest()

    tiles.run(_piece, len(places), PIECE)
    short = np.minimum.reduceat(grade, texels.bounds[:-1]) < FINAL if len(grade) else np.zeros(0, np.bool_)
    return Reading(rows, grade, b"".join(digests[a] for a in sorted(digests)), short)


def grade_rows(rows: np.ndarray, error: np.ndarray, samples: np.ndarray, target: float) -> np.ndarray:
    """How good the light in each row is: PROVISIONAL without light, CONVERGING, FINAL, or VOID; (texels,) uint8."""
    grade = good_enough(error, samples, target).view(np.uint8)
    grade += CONVERGING
    if (rows < 0).any():
        grade[rows == UNLIT] = PROVISIONAL
        grade[rows == VOID_ROW] = VOID
    return grade
