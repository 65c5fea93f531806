"""Remove pieces of a volume that are too small to be shown, at every isovalue at the same time."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from isogi_core.errors import VolumeError
from isogi_core.files.grid import Grid
from isogi_core.files.mappings import UNMAPPED_SHARE, budget
from isogi_core.kernels.tracing.pieces import open_by_size
from isogi_core.model.value_survey import are_measured, find_marks, usable, usable_type

MOST_PIECE = 2**31 - 1
"""Greatest size in voxels below which pieces may be removed."""

PIECES_NOTE = "Pieces of fewer than {least} voxels are not shown."
BYTES_PER_VOXEL = 32
"""Bytes per voxel, about, that finding pieces takes: values, their order, ranks and parents."""


def without_small_pieces(grid: Grid, least: int, solid: str, missing: Sequence[float] = ()) -> Grid:
    """Return a ``grid`` in which, at every isovalue, each piece of the ``solid`` side has at least
    ``least`` voxels; see ``open_by_size``.

    Holes, and values equal to one of ``missing``, stay and belong to no piece. Values that stay are
    exactly the file's. Raises VolumeError if the volume is too large.
    """
    if BYTES_PER_VOXEL * grid.size > max(8.0 * UNMAPPED_SHARE * budget(), 1 << 30):
        raise VolumeError(
            "pieces takes the whole volume in memory, and this one is too large for that: leave "
            "it out, or show a region."
        )
    given = grid.stamp
    return replace(
        grid,
        slabs=partial(_opened, grid, least, solid, tuple(missing)),
        stamp=lambda: f"{given()} pieces {least} {solid} {list(missing)}",
        notes=(*grid.notes, PIECES_NOTE.format(least=least)),
    )


def _opened(grid: Grid, least: int, solid: str, missing: tuple[float, ...]) -> Iterator[np.ndarray]:
    """Yield the whole grid without small pieces, as its only slab."""
    whole = grid.whole()
    values = usable(whole).ravel()
    there = np.flatnonzero(are_measured(values, find_marks(missing, usable_type(grid.dtype))))
    # Sort the voxels from the most solid on, and rank equal values alike.
    rising = there[np.argsort(values[there], kind="stable")]
    order = rising[::-1].copy() if solid == "above" else rising
    some = values[order]
    ranks = np.zeros(values.size, np.int32)
    ranks[order[1:]] = -np.cumsum(some[1:] != some[:-1], dtype=np.int32)
    # Each voxel takes the value of the voxel that its piece is merged into.
    sources = np.empty(values.size, np.int64)
    open_by_size(ranks, order, whole.shape, least, sources)
    opened = whole.reshape(-1).copy()
    opened[order] = opened[sources[order]]
    yield opened.reshape(whole.shape)
