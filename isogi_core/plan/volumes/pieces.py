"""Remove pieces of a volume that are too small to be shown, at every isovalue at the same time."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from isogi_core.errors import SceneError, VolumeError
from isogi_core.files.grid import Grid
from isogi_core.files.mappings import budget
from isogi_core.files.scene_file import Settings, is_number
from isogi_core.files.spelling import shortest
from isogi_core.kernels.tracing.pieces import open_by_size
from isogi_core.model.value_survey import are_measured, find_marks, usable, usable_type

MOST_PIECE = 2**31 - 1
"""Greatest size in voxels below which pieces may be removed."""

PIECES_NOTE = "Pieces of fewer than {least} voxels are not shown."
LARGEST_NOTE = "Pieces smaller than the largest one at {isovalue} are not shown."
BYTES_PER_VOXEL = 32
"""Bytes per voxel, about, that finding pieces takes: values, their order, ranks and parents."""

LEAST_ROOM = 1 << 30
"""Bytes that finding pieces may take even if the budget of memory is smaller."""


LARGEST_PIECE = "largest"
"""Word of a scene for the least size that leaves one piece at the scene's isovalue."""


class LargestAt(NamedTuple):
    """The least size, in voxels, that leaves one piece at an ``isovalue``."""

    isovalue: float


Least = int | LargestAt
"""Least size of the pieces that are shown, in voxels."""


def read_pieces(settings: Settings) -> Least:
    """Return the least size of pieces that a scene asks for, 0 if it shows all. Raises SceneError
    if it asks for the largest piece and names no isovalue.
    """
    given = settings.source.document
    if given.get("pieces") != LARGEST_PIECE:
        return settings.count("pieces", MOST_PIECE) or 0
    settings.text("pieces", "")
    isovalue: Any = given.get("isovalue")
    if not is_number(isovalue):
        raise SceneError(
            "pieces = 'largest' means the largest at the scene's isovalue: give the scene an "
            "isovalue, or a size in voxels."
        )
    return LargestAt(float(isovalue))


def without_small_pieces(
    grid: Grid, least: Least, solid: str, missing: Sequence[float] = ()
) -> Grid:
    """Return a ``grid`` in which, at every isovalue, each piece of the ``solid`` side has at least
    ``least`` voxels; see ``open_by_size``.

    Holes, and values equal to one of ``missing``, stay and belong to no piece. Values that stay are
    exactly the file's. The pieces are found when slabs are read. Raises VolumeError if that would
    take more memory than the budget and more than LEAST_ROOM.
    """
    if BYTES_PER_VOXEL * grid.size > max(budget(), LEAST_ROOM):
        raise VolumeError(
            "pieces takes the whole volume in memory, and this one is too large for that: leave "
            "it out, or show a region."
        )
    given = grid.stamp
    if isinstance(least, LargestAt):
        note = LARGEST_NOTE.format(isovalue=shortest(least.isovalue))
    else:
        note = PIECES_NOTE.format(least=least)
    return replace(
        grid,
        slabs=partial(_slab_without_pieces, grid, least, solid, tuple(missing)),
        stamp=lambda: f"{given()} pieces {least} {solid} {list(missing)}",
        notes=(*grid.notes, note),
    )


def _slab_without_pieces(
    grid: Grid, least: Least, solid: str, missing: tuple[float, ...]
) -> Iterator[np.ndarray]:
    """Yield the whole grid without small pieces, as its only slab.

    Raises VolumeError if the largest piece alone is to stay, and two are equally large.
    """
    whole = grid.whole()
    values = usable(whole).ravel()
    there = np.flatnonzero(are_measured(values, find_marks(missing, usable_type(grid.dtype))))
    # Sort the voxels from the most solid on. Ranks fall from 0 along this order, whichever side is
    # solid; equal values have equal ranks.
    rising = there[np.argsort(values[there], kind="stable")]
    order = rising[::-1].copy() if solid == "above" else rising
    some = values[order]
    ranks = np.zeros(values.size, np.int32)
    ranks[order[1:]] = -np.cumsum(some[1:] != some[:-1], dtype=np.int32)
    if isinstance(least, LargestAt):
        # The first voxels of the order are the solid ones.
        inside = some > least.isovalue if solid == "above" else some < least.isovalue
        least = _size_above_others(order[: np.count_nonzero(inside)], whole.shape)
    # Each voxel takes the value of the voxel that its piece is merged into.
    sources = np.empty(values.size, np.int64)
    open_by_size(ranks, order, whole.shape, least, sources)
    opened = whole.reshape(-1).copy()
    opened[order] = opened[sources[order]]
    yield opened.reshape(whole.shape)


def _size_above_others(places: np.ndarray, shape: tuple[int, ...]) -> int:
    """Return the size, in voxels, that the largest of the pieces of some voxels reaches alone; 0 if
    there is one piece or none.

    ``places`` are their flat indices in a volume of that ``shape``. Raises VolumeError if the
    largest pieces are equally large.
    """
    # With all voxels on one level, each piece is merged into one voxel.
    sources = np.empty(int(np.prod(shape)), np.int64)
    open_by_size(np.zeros(sources.size, np.int32), places, shape, 1, sources)
    sizes = np.sort(np.unique(sources[places], return_counts=True)[1])[::-1]
    if len(sizes) < 2:
        return 0
    if sizes[0] == sizes[1]:
        raise VolumeError(
            f"The two largest pieces have {sizes[0]} voxels each, so that none is the largest: "
            "give pieces a size in voxels."
        )
    return int(sizes[1]) + 1
