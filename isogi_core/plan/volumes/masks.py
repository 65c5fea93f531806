"""Masks and cuts of a volume.

Masks are volumes of a scene's world, in grids of their own; outside of them there is no surface.

Cuts take parts of a volume away, so that light comes in. The rest is a volume like any other.
Voxels that are taken away hold CUT_AWAY_VALUE, outside of every isosurface. Between them and the
rest the field falls so steeply that each isosurface has a face at the last voxels left: flat, and
at the same place for all isovalues.
"""

import hashlib
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial, reduce
from typing import Any

import numpy as np

from isogi_core.errors import SceneError, ViewError, VolumeError
from isogi_core.files.grid import Grid, gathered
from isogi_core.files.mappings import UNMAPPED_SHARE, budget, require_memory
from isogi_core.files.scene_file import Settings
from isogi_core.files.volume_copies import Draft, get_copy
from isogi_core.model.value_survey import check, find_marks, survey, usable, usable_type
from isogi_core.model.view import Plane, read_window
from isogi_core.model.volume import CUT_AWAY_VALUE, UNMEASURED_FIELDS, Volume

MAX_VOLUME_TABLES = 8
"""Most tables [[volumes]] of a scene."""

BEYOND_ALL_VOXELS = 1 << 40
"""An index beyond any voxel."""

MASK_USES = ("mask", "colour")
"""Uses that a volume next to the first can have."""


@dataclass(frozen=True)
class MaskTable:
    """A table [[volumes]]: the mask's ``file``, and the values in it that are inside; if none
    are given, all but zero.
    """

    file: str
    labels: tuple[float, ...]


def read_tables(settings: Settings) -> list[MaskTable]:
    """Read the tables [[volumes]] of a scene that are masks; those of colour are read by
    ``plan.volumes.colours``. Raises SceneError, also for unknown keys.
    """
    return [
        _read_table(table)
        for table in settings.nested("volumes", MAX_VOLUME_TABLES)
        if table.source.document.get("use") != "colour"
    ]


def _read_table(table: Settings) -> MaskTable:
    """Read one table of a mask. Raises SceneError."""
    file = table.text("file", "")
    use = table.choice("use", MASK_USES)
    labels = table.listed("labels")
    table.refuse_unknown()
    if not file or use is None:
        raise SceneError(
            f"A table in the scene '{table.source.name}' lacks 'file' or use = 'mask' or "
            "'colour': give both."
        )
    return MaskTable(file, labels)


@dataclass(frozen=True, eq=False)
class Mask:
    """A mask's ``grid``, with the ``matrix`` (3, 4) from a volume's voxel indices x, y, z to
    its voxel indices.
    """

    table: MaskTable
    grid: Grid
    matrix: np.ndarray

    @property
    def stamp(self) -> list[Any]:
        """The state that the mask's voxels follow from."""
        return [self.grid.stamp(), self.table.labels, self.matrix.tolist()]

    @cached_property
    def _inside(self) -> np.ndarray:
        """True for the voxels of the mask that are inside, (nz, ny, nx) bool. Raises
        VolumeError if they are too many.
        """
        require_memory(self.grid.size, f"The mask '{self.table.file}' takes", "give a coarser one")
        is_inside = (
            partial(is_one_of, labels=self.table.labels) if self.table.labels else _is_something
        )
        return gathered(self.grid.shape, bool, map(is_inside, self.grid.slabs()))

    def layer(self, z: int, shape: Sequence[int]) -> np.ndarray:
        """Return which voxels of layer ``z`` of a volume of ``shape`` are inside, by the
        nearest voxel of the mask; (ny, nx) bool.
        """
        ny, nx = shape[1:]
        return nearest_layer(self._inside, self.matrix, (np.arange(nx), np.arange(ny)[:, None]), z)


def nearest_layer(
    voxels: np.ndarray, matrix: np.ndarray, steps: tuple[np.ndarray, np.ndarray], z: int
) -> np.ndarray:
    """Return the nearest ``voxels`` of places x (nx,) and y (ny, 1), the ``steps``, in layer ``z``
    of another grid.

    ``matrix`` (3, 4) maps that grid's voxel indices x, y, z to those of ``voxels``. Returns (ny,
    nx), zero beyond the voxels.
    """
    sides = voxels.shape[::-1]
    found = [_nearest(row, steps, z) for row in matrix]
    reached = reduce(
        np.logical_and, [(index >= 0) & (index < n) for index, n in zip(found, sides, strict=True)]
    )
    x, y, z_index = (np.clip(index, 0, n - 1) for index, n in zip(found, sides, strict=True))
    values = np.where(reached, voxels[z_index, y, x], voxels.dtype.type(0))
    return np.broadcast_to(values, (steps[1].size, steps[0].size))


def is_one_of(slab: np.ndarray, labels: Sequence[float]) -> np.ndarray:
    """Return which values of a ``slab`` equal one of the ``labels``, compared in the values'
    type, which distinguishes whole numbers of 64 bits.
    """
    return np.isin(usable(slab), find_marks(labels, usable_type(slab.dtype)))


def _is_something(slab: np.ndarray) -> np.ndarray:
    """Return which values are neither zero nor NaN."""
    return np.asarray((slab != 0) & ~np.isnan(slab))


def _nearest(row: np.ndarray, steps: tuple[np.ndarray, np.ndarray], z: int) -> np.ndarray:
    """Return one index of the nearest voxels, by one ``row`` of the matrix. Its shape
    broadcasts to the layer: an axis that does not change the index is left out, which saves
    time on aligned grids.
    """
    place: Any = row[3] + row[2] * z
    for factor, along in zip(row, steps, strict=False):
        if abs(factor) * along.size > 1e-6:
            place = place + factor * along
    return np.clip(np.floor(np.asarray(place) + 0.5), -1, BEYOND_ALL_VOXELS).astype(np.int64)


@dataclass(frozen=True, eq=False)
class Masked:
    """A ``grid`` whose voxels outside of any of the ``masks`` are set to the value farthest from
    the solid side.

    That is the least value of the volume, or the greatest if ``solid`` is "below"; ``missing``
    values do not count.
    """

    grid: Grid
    masks: tuple[Mask, ...]
    solid: str
    missing: tuple[float, ...]

    @cached_property
    def _outermost(self) -> float:
        """The value of voxels outside."""
        low, high = survey(self.grid, self.solid, self.missing).value_range
        return low if self.solid == "above" else high

    def slabs(self) -> Iterator[np.ndarray]:
        """Yield the slabs. Raises VolumeError if no voxel is inside."""
        z = 0
        kept = False
        for slab in self.grid.slabs():
            # Write to a copy: the slab may belong to its source.
            filled = np.array(slab)
            for layer in filled:
                inside = np.logical_and.reduce(
                    [mask.layer(z, self.grid.shape) for mask in self.masks]
                )
                layer[~inside] = self._outermost
                kept |= bool(inside.any())
                z += 1
            yield filled
        if not kept:
            names = ", ".join(f"'{mask.table.file}'" for mask in self.masks)
            raise VolumeError(
                f"No voxel of the volume is inside {names}: check its labels, and where it lies."
            )

    def stamp(self) -> str:
        """Return the state of the volume's source and of those of its masks."""
        return repr([self.grid.stamp(), *(mask.stamp for mask in self.masks)])


def cut_out(grid: Grid, masks: Sequence[Mask], solid: str, missing: tuple[float, ...]) -> Grid:
    """Return a volume's ``grid`` without any surface outside of its ``masks``. Only the headers
    of files are read now.
    """
    masked = Masked(grid, tuple(masks), solid, missing)
    notes = tuple(f"Outside of '{mask.table.file}' there is no surface." for mask in masks)
    return replace(grid, slabs=masked.slabs, stamp=masked.stamp, notes=(*grid.notes, *notes))


def place(table: MaskTable, grid: Grid, whole: Grid, volume: Grid) -> Mask:
    """Place the mask in a ``grid`` for a ``volume`` on right angles, made from the file's grid
    ``whole``.

    Raises SceneError, and VolumeError if the mask cannot be used; see ``matrix_into``.
    """
    return Mask(table, grid, matrix_into(f"mask '{table.file}'", grid, whole, volume))


def matrix_into(what: str, grid: Grid, whole: Grid, volume: Grid) -> np.ndarray:
    """Return the matrix (3, 4) from voxel indices x, y, z of a ``volume`` on right angles, made
    from the file's grid ``whole``, to those of a ``grid``.

    Both lie where their files say. If a file does not say, both must have the same number of
    voxels, which then coincide; if neither says, their first voxels coincide. Raises SceneError if
    this is not so, or if their units differ; ``what`` names the grid in messages.
    """
    try:
        check(grid, "above")
    except VolumeError as error:
        raise VolumeError(f"The {what} cannot be used. {error}") from error
    if grid.unit and whole.unit and grid.unit != whole.unit:
        raise SceneError(
            f"The {what} is in {grid.unit} and the volume in {whole.unit}: convert one."
        )
    # A file that says nothing of its place takes that of the other, if both have the same voxels.
    silent = grid.affine is None or whole.affine is None
    if silent and grid.shape == whole.shape:
        grid = replace(grid, affine=whole.affine, spacing=volume.spacing)
    elif (grid.affine is None) != (whole.affine is None):
        reason = f"Of the {what} and the volume, one does not say where it lies"
        raise SceneError(f"{reason}: give both the same voxels, or axes = 'raw'.")
    # Go from the volume's voxels to the world, and from there to the grid's voxels.
    theirs = _to_world(grid)
    ours = _to_world(volume)
    if abs(np.linalg.det(theirs[:3, :3])) == 0.0 or not np.isfinite(theirs).all():
        raise SceneError(f"The axes of the {what} lie in one plane: correct its affine.")
    return np.asarray((np.linalg.inv(theirs) @ ours)[:3])


def _to_world(grid: Grid) -> np.ndarray:
    """Return the matrix (4, 4) from voxel indices x, y, z to the world."""
    if grid.affine is None:
        rows = np.column_stack([np.diag(grid.spacing), np.zeros(3)])
    else:
        rows = grid.affine.array
    return np.vstack([rows, [0.0, 0.0, 0.0, 1.0]])


AXIS_TOLERANCE = 1e-6
"""Largest deviation of a plane's normal from an axis of the voxels."""

PLANE_TOLERANCE = 1e-6
"""Distance in voxels up to which a voxel counts as lying on a plane."""

NORMAL_REACH = 2.5
"""Distance in voxels from a face within which a texel has another normal than in the whole
volume: four voxels are smoothed.
"""

Ranges = tuple[range, range, range]
"""Ranges of the voxels that are left, along x, y, z."""


def cut_away(volume: Volume, text: str) -> Volume:
    """Cut a ``volume`` by planes; ``text`` is as ``read_window`` takes it, in the world.

    Planes lie along the axes of the voxels; voxels on a plane are left. Raises SceneError if planes
    cannot be read, lie otherwise or leave nothing, and VolumeError if the copy of a large volume
    cannot be kept.
    """
    left = voxels_left(volume, text)
    digest = cut_digest(volume, text)
    if digest == volume.digest:
        return volume
    return kept_of(volume, left, digest)


def cut_cell(volume: Volume, left: Ranges) -> Volume:
    """Show the voxels ``left`` of a ``volume`` alone, as if planes cut the rest away."""
    parts = f"{volume.digest} cell {left} {CUT_AWAY_VALUE}"
    return kept_of(volume, left, hashlib.blake2b(parts.encode(), digest_size=16).hexdigest())


def kept_of(volume: Volume, left: Ranges, digest: str) -> Volume:
    """Return a ``volume`` with CUT_AWAY_VALUE in place of the voxels that are not ``left``; it has
    the new ``digest``.
    """
    # Histogram and core stay those of the whole volume, so that its range of isovalues does.
    known = replace(volume.counted(), digest=digest)
    if volume.voxels.nbytes <= UNMAPPED_SHARE * budget():
        return replace(known, voxels=np.concatenate(list(slabs_left(volume, left))))

    # A large volume is written to a copy on disk, a layer at a time.
    def write(draft: Draft) -> dict[str, Any]:
        """Write the voxels that are left, and return the facts of the volume."""
        for plane in (plane for slab in slabs_left(volume, left) for plane in slab):
            draft.write(plane)
        facts = {
            name: value for name, value in vars(known).items() if name not in UNMEASURED_FIELDS
        }
        draft.seal(volume.shape, facts)
        return facts

    return replace(known, voxels=get_copy(digest, volume.voxels.nbytes, write)[0])


def cut_digest(volume: Volume, text: str) -> str:
    """Return the digest of a ``volume`` that is cut: made plane by plane, so that cuts one
    after another have the digest of both at once.
    """
    digest = volume.digest
    whole = tuple(map(range, volume.size))
    for left in (voxels_left(volume, term) for term in text.split(";")):
        if left != whole:
            digest = hashlib.blake2b(
                f"{digest} {left} {CUT_AWAY_VALUE}".encode(), digest_size=16
            ).hexdigest()
    return digest


def voxels_left(volume: Volume, text: str) -> Ranges:
    """Return the voxels of a ``volume`` that planes leave. Raises SceneError, see ``cut_away``."""
    try:
        planes = read_window(text).in_box(volume.orientation).planes
    except ViewError as error:
        raise SceneError(f"cut = '{text}' cannot be read. {error}") from None
    left = [range(n) for n in volume.size]
    # Each plane shortens the range of voxels along its axis, from the end that its normal points
    # away from.
    for plane in planes:
        axis = _axis_of(plane, text)
        # The plane's place in voxels; a voxel on it stays.
        place = -plane[3] / plane[axis] / volume.spacing[axis]
        first, last = left[axis].start, left[axis].stop
        if plane[axis] > 0.0:
            first = max(first, math.ceil(min(place - PLANE_TOLERANCE, last)))
        else:
            last = min(last, math.floor(max(place + PLANE_TOLERANCE, -1.0)) + 1)
        left[axis] = range(first, max(last, first))
    if not all(left):
        raise SceneError(
            f"cut = '{text}' leaves nothing of the volume '{volume.name}': take less away."
        )
    x, y, z = left
    return x, y, z


def _axis_of(plane: Plane, text: str) -> int:
    """Return the axis that a plane's normal points along. Raises SceneError if there is none."""
    axis = int(np.argmax(np.abs(plane[:3])))
    if 1.0 - abs(plane[axis]) > AXIS_TOLERANCE:
        raise SceneError(
            f"cut = '{text}' lies across the voxels: cut along their axes, or look through a "
            "window=."
        )
    return axis


def box_left(left: Ranges, size: tuple[int, int, int]) -> np.ndarray:
    """Return the box within which surfaces are the same as in the whole volume, of this ``size``:
    NORMAL_REACH from all faces.

    (2, 3) float64, its least and greatest corner in index space; infinite on sides from which
    nothing is taken.
    """
    low = [each.start + NORMAL_REACH if each.start else -np.inf for each in left]
    high = [
        each.stop - 1 - NORMAL_REACH if each.stop < n else np.inf
        for each, n in zip(left, size, strict=True)
    ]
    return np.array([low, high])


def values_beyond(volume: Volume, box: np.ndarray) -> tuple[float, float]:
    """Return the least and the greatest voxel of a ``volume`` at cells that are not completely
    within a ``box``, see ``box_left``.

    Isosurfaces outside of this range do not leave the box; the range is (inf, -inf) if the box
    holds all cells.
    """
    size = np.array(volume.size)
    # Voxels from ``first`` to before ``end`` belong to cells within the box alone; all others
    # count.
    first = np.clip(np.ceil(box[0]) + 1, 0, size).astype(int)
    end = np.clip(np.floor(box[1]), 0, size).astype(int)
    low = np.inf
    high = -np.inf
    z = 0
    for slab in volume.slabs():
        a, b = (int(np.clip(each[2] - z, 0, len(slab))) for each in (first, end))
        across = slab[a:b]
        rows = slab[a:b, first[1] : end[1]]
        parts = slab[:a], slab[max(a, b) :], across[:, : first[1]], across[:, end[1] :]
        for part in (*parts, rows[:, :, : first[0]], rows[:, :, end[0] :]):
            low = float(np.fmin.reduce(part, axis=None, initial=low))
            high = float(np.fmax.reduce(part, axis=None, initial=high))
        z += len(slab)
    return low, high


def is_within(points: np.ndarray, box: np.ndarray) -> np.ndarray:
    """Return which ``points`` (m, 3) lie in a ``box`` (2, 3), as of ``box_left``; (m,) bool."""
    return np.asarray(((points >= box[0]) & (points <= box[1])).all(axis=1))


def slabs_left(volume: Volume, left: Ranges) -> Iterator[np.ndarray]:
    """Yield the slabs of a ``volume``, with CUT_AWAY_VALUE in place of the voxels that are not
    ``left``.
    """
    z = 0
    inside = tuple(slice(each.start, each.stop) for each in (left[1], left[0]))
    for slab in volume.slabs():
        cut = np.full_like(slab, CUT_AWAY_VALUE)
        first, last = (min(max(end - z, 0), len(slab)) for end in (left[2].start, left[2].stop))
        cut[(slice(first, last), *inside)] = slab[(slice(first, last), *inside)]
        z += len(slab)
        yield cut
