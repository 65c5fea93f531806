"""Fields that repeat, of scenes: cells side by side, closed across their faces."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from isogi_core.errors import SceneError
from isogi_core.files.cells import (
    ASIDE_NOTE,
    MOST_REPEATED,
    ONCE,
    Cells,
    axes_of,
    set_side_by_side,
)
from isogi_core.files.grid import APERIODIC, Grid, Periodic, on_right_angles
from isogi_core.files.scene_file import Settings
from isogi_core.model.volume import Cell, Volume
from isogi_core.plan.starts import is_signed
from isogi_core.plan.volumes.masks import cut_cell

CUT_MARGIN = 1
"""Voxels around cells that are taken away: a face lies between them and the last voxels left."""


def read_cells(settings: Settings, grid: Grid) -> Cells:
    """How cells of a ``grid`` are shown: as the scene says, else its file. Raises SceneError."""
    given = settings.flags("periodic", 3)
    repeat = settings.counts("repeat", 3, MOST_REPEATED) or ONCE
    x, y, z = grid.periodic if given is None else given
    periodic: Periodic = (x, y, z)
    for axis, along, count in zip("xyz", periodic, repeat, strict=True):
        if count > 1 and not along:
            raise SceneError(
                f"The field does not repeat along {axis}: give the scene periodic = "
                "[true, true, true], or repeat 1 there."
            )
    return Cells(periodic, (repeat[0], repeat[1], repeat[2]))


def repeated_beside(settings: Settings, grid: Grid, margin: int) -> Grid:
    """A ``grid`` of another volume of a scene: side by side as the scene's own cells are, and a
    ``margin`` of voxels farther, if its file says that it repeats and the scene does not deny that.
    """
    if settings.flags("periodic", 3) == APERIODIC or not any(grid.periodic):
        return grid
    x, y, z = settings.counts("repeat", 3, MOST_REPEATED) or ONCE
    repeat = tuple(n if along else 1 for n, along in zip((x, y, z), grid.periodic, strict=True))
    cells = Cells(grid.periodic, (repeat[0], repeat[1], repeat[2]), margin)
    return set_side_by_side(grid.loaded(), cells) or grid


def are_faced(grid: Grid) -> bool:
    """Whether faces close the cells of a ``grid`` where its solid reaches them. The solid of the
    negative surface of a field of both signs is all that lies above it: such cells stay open.
    """
    values = grid.whole()
    finite = values[np.isfinite(values)].astype(np.float64)
    return not (finite.size and np.ptp(finite) > 0.0 and is_signed(finite))


def upright(
    grid: Grid, cells: Cells, spacing: Sequence[float] | None, reach: int = 0
) -> tuple[Grid, Cells | None]:
    """A ``grid`` on right angles, as ``cells`` if it repeats, and these with a margin of what is to
    be cut and ``reach`` voxels more; None in place of them if it is one box.
    """
    steps = None if spacing is None else tuple(spacing)
    if not any(cells.periodic):
        return on_right_angles(replace(grid, periodic=APERIODIC), steps), None
    loaded = grid.loaded()
    cells = replace(cells, margin=CUT_MARGIN * are_faced(loaded) + reach)
    side_by_side = set_side_by_side(loaded, cells, steps)
    if side_by_side is not None:
        return side_by_side, cells
    note = ASIDE_NOTE.format(axes=axes_of(cells.periodic))
    aside = replace(grid, periodic=APERIODIC, notes=(*grid.notes, note))
    return on_right_angles(aside, steps), None


def trimmed(grid: Grid, cells: Cells, reach: int) -> tuple[Grid, Cells]:
    """A ``grid`` of ``cells`` with ``reach`` voxels less of their margin."""
    if not reach:
        return grid, cells
    x, y, z = (
        (reach, n - reach) if along else (0, n)
        for n, along in zip(grid.shape[::-1], cells.periodic, strict=True)
    )
    part = replace(grid.cropped((x, y, z)), notes=grid.notes)
    return part, replace(cells, margin=cells.margin - reach)


def closed(volume: Volume, cells: Cells) -> Volume:
    """A ``volume`` of ``cells``, their margin cut away, which knows where one of them is."""
    left = cells.left(volume.shape)
    if cells.margin:
        volume = cut_cell(volume, left)
    x, y, z = (
        (span.start, span.start + (len(span) - 1) // repeat + 1)
        for span, repeat in zip(left, cells.repeat, strict=True)
    )
    return replace(volume, cell=Cell((x, y, z), cells.periodic))
