"""Grids: the values of a volume at their source, read slab by slab, as they need not fit into
memory.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from typing import Any

import numpy as np

from isogi_core.errors import VolumeError
from isogi_core.files.vector import Vector, triple

Shape = tuple[int, ...]

MAX_VOXELS = 2**33
"""Most voxels: more mean a damaged header (32 GiB as float32)."""

SLAB_BYTES = 1 << 25
"""Approximate bytes of a slab, if the source leaves the choice."""


PATIENT_AXES = "RAS"
"""Letters of a world whose axes point to a patient's right, anterior and superior."""


@dataclass(frozen=True)
class Affine:
    """The map from voxels to the world: ``world = matrix · (x, y, z) + origin`` of a voxel's
    indices.

    ``matrix`` is three rows. ``letters`` name the directions of the world's axes: PATIENT_AXES if
    it is a patient's, else empty.
    """

    matrix: tuple[Vector, Vector, Vector]
    origin: Vector
    letters: str = ""

    @classmethod
    def of(cls, matrix: Any, letters: str = "") -> "Affine":
        """Return the affine map of an array (3, 4) or (4, 4), whose last column is the origin."""
        rows = np.asarray(matrix, np.float64)[:3]
        x, y, z = (triple(row) for row in rows[:, :3])
        return cls((x, y, z), triple(rows[:, 3]), letters)

    @property
    def array(self) -> np.ndarray:
        """The matrix with the origin as its last column, (3, 4) float64."""
        return np.column_stack([np.array(self.matrix), np.array(self.origin)])


@dataclass(frozen=True)
class LabelName:
    """The entry of a label in a segmentation's file: its ``value``, ``name`` and ``colour``, sRGB
    ``#rrggbb``. Name and colour are empty if the file has none.
    """

    value: int
    name: str = ""
    colour: str = ""


def srgb_bytes(linear: np.ndarray) -> np.ndarray:
    """Return linear RGB as sRGB bytes (IEC 61966-2-1)."""
    share = np.clip(linear, 0.0, 1.0)
    curve = np.where(share <= 0.0031308, 12.92 * share, 1.055 * share ** (1.0 / 2.4) - 0.055)
    return np.asarray(curve * 255.0 + 0.5, np.uint8)


Periodic = tuple[bool, bool, bool]
"""For each of x, y, z, True if the grid is one period of a field that repeats along that axis."""

APERIODIC: Periodic = (False, False, False)

SINGLE_MOMENT = (0, 1)
"""The moment of a field that is no series in time."""


@dataclass(frozen=True, eq=False)
class Grid:
    """A value for each voxel, from any source.

    - ``shape``: voxels along z, y, x; ``dtype``: the source's type; ``spacing``: (x, y, z), as the
      source gives it.
    - ``slabs``: iterates from the beginning on each call: arrays (layers, ny, nx) that make up the
      whole from z = 0 on. It raises VolumeError if the source is damaged.
    - ``stamp``: names the source's state, as far as sizes and times of files show it.
    - ``affine``: the map from voxels to the world, None if the source gives the spacing alone;
      ``unit``: unit of lengths, empty if unknown.
    - ``notes``: sentences on the steps by which this field was made of the source.
    - ``moment``: the step of a series in time, and the number of its steps; ``unchosen``: True if
      the first step was taken because none was chosen.
    - ``labels``: named labels of a segmentation, None if the file does not say that it is one.
    - ``read_as``: a line on how the source was read; see the function of that name.
    - ``periodic``: along these axes the grid is one cell of a field that repeats: the voxel after
      the last one is the first.
    - ``level``: an isovalue that the source names; ``deviations``: number of standard deviations
      above the mean at which maps of this kind are shown; None without one.
    """

    shape: Shape
    dtype: np.dtype[Any]
    spacing: Sequence[float]
    slabs: Callable[[], Iterator[np.ndarray]]
    stamp: Callable[[], str] = str
    affine: Affine | None = None
    unit: str = ""
    notes: tuple[str, ...] = ()
    moment: tuple[int, int] = SINGLE_MOMENT
    unchosen: bool = False
    labels: tuple[LabelName, ...] | None = None
    read_as: str = ""
    periodic: Periodic = APERIODIC
    level: float | None = None
    deviations: float | None = None

    @classmethod
    def of(cls, array: np.ndarray, spacing: Sequence[float] = (1.0, 1.0, 1.0)) -> "Grid":
        """Return the grid of an array in memory; the array is its only slab."""
        return cls(array.shape, array.dtype, spacing, lambda: iter((array,)))

    def __len__(self) -> int:
        """Return the number of layers along z."""
        return self.shape[0]

    @property
    def size(self) -> int:
        """The number of voxels."""
        return math.prod(self.shape)

    def cropped(self, region: "Region") -> "Grid":
        """Return the grid of a ``region``, at the same place in the world. Raises VolumeError if
        the grid does not contain it.
        """
        check_region(region, self.shape)
        (x, x_end), (y, y_end), (z, z_end) = region
        if self.affine is None:
            rows = _straight(self.spacing)
        else:
            rows = self.affine.array
        rows[:, 3] += rows[:, :3] @ (float(x), float(y), float(z))
        words = ", ".join(
            f"{axis} {low} to {high - 1}" for axis, (low, high) in zip("xyz", region, strict=True)
        )
        note = f"A region is shown, voxels {words} of {' × '.join(map(str, self.shape[::-1]))}."
        return replace(
            self,
            shape=(z_end - z, y_end - y, x_end - x),
            slabs=partial(_cropped, self.slabs, region),
            stamp=partial(_of_region, self.stamp, region),
            affine=Affine.of(rows, self.affine.letters if self.affine else ""),
            notes=(*self.notes, note),
            periodic=APERIODIC,
        )

    def raw(self, region: "Region | None") -> "Grid":
        """Return the grid without its place in the world; if it is only a ``region``, at the
        region's place among the voxels of the whole.
        """
        if region is None:
            return replace(self, affine=None)
        rows = _straight(self.spacing)
        rows[:, 3] = rows[:, :3] @ [float(low) for low, _ in region]
        return replace(self, affine=Affine.of(rows))

    def loaded(self) -> "Grid":
        """Return the grid with all values in memory."""
        array = self.whole()
        return replace(self, slabs=lambda: iter((array,)))

    def whole(self) -> np.ndarray:
        """Return all values in memory; (nz, ny, nx). It is the source's own array if that is its
        only slab.
        """
        slabs = self.slabs()
        first = next(slabs, None)
        if first is not None and first.shape == self.shape and first.dtype == self.dtype:
            next(slabs, None)  # what is wrong with the whole is told at its end
            return first
        return gathered(self.shape, self.dtype, chain(() if first is None else (first,), slabs))


def gathered(shape: Shape, dtype: Any, slabs: Iterable[np.ndarray]) -> np.ndarray:
    """Return the array of a ``shape`` and a type that ``slabs`` of layers, one after the other,
    make up.
    """
    array = np.empty(shape, dtype)
    z = 0
    for slab in slabs:
        array[z : z + len(slab)] = slab
        z += len(slab)
    return array


Region = tuple[tuple[int, int], tuple[int, int], tuple[int, int]]
"""The first voxels along x, y, z, and those after the last."""


def _straight(spacing: Sequence[float]) -> np.ndarray:
    """Return the map from voxel indices to these times the ``spacing``; (3, 4)."""
    return np.column_stack([np.diag(spacing), np.zeros(3)])


def check_region(region: Region, shape: Shape) -> None:
    """Raise VolumeError if a ``region`` reaches beyond a ``shape`` (z, y, x), or is less than two
    voxels wide.
    """
    for axis, (low, high), n in zip("xyz", region, shape[::-1], strict=True):
        if not 0 <= low < high - 1 < n:
            there = f"of 0 to {n}, and at least two voxels"
            raise VolumeError(
                f"The region has [{low}, {high}] along {axis}: give first and end {there}."
            )


def _cropped(slabs: Callable[[], Iterator[np.ndarray]], region: Region) -> Iterator[np.ndarray]:
    """Yield the part of slabs that is in a region; read no slab after it."""
    (x, x_end), (y, y_end), (z, z_end) = region
    at = 0
    for slab in slabs():
        part = slab[max(z - at, 0) : max(z_end - at, 0), y:y_end, x:x_end]
        at += len(slab)
        if len(part):
            yield part
        if at >= z_end:
            return


def _of_region(stamp: Callable[[], str], region: Region) -> str:
    return f"{stamp()} {region}"


UNPLACED = "it does not say where it lies"
"""How ``read_as`` ends for a source that gives no place and no spacing."""


def read_as(
    kind: str, stored: np.dtype[Any], placed: str = "", slope: float = 1.0, intercept: float = 0.0
) -> str:
    """Return a line on how a source was read: its ``kind``, the type of ``stored`` numbers, how
    these become values, and the metadata by which its voxels are ``placed``, empty if nothing
    places them.
    """
    if stored.byteorder == ">" and stored.itemsize > 1:
        order = ", big-endian"
    else:
        order = ""
    if (slope, intercept) == (1.0, 0.0):
        values = ""
    else:
        values = f", values {slope:g} · stored {intercept:+g}"
    if placed:
        lies = f"placed by {placed}"
    else:
        lies = UNPLACED
    return f"{kind} of {stored.name}{order}{values}; {lies}"


def slab_layers(layer_bytes: int) -> int:
    """Return the number of layers of ``layer_bytes`` bytes in a slab, at least one."""
    return max(SLAB_BYTES // max(layer_bytes, 1), 1)


MAX_SKEW_VOXELS = 0.1
"""Most voxels by which a corner may be off, for axes that are not quite at right angles to be taken
as if they were.
"""

OR_RAW = "leave it out by axes = 'raw'"

MAX_GROWTH = 8
"""Most times the voxels that a skewed grid may need once its axes are at right angles."""


def on_right_angles(grid: Grid, spacing: tuple[float, ...] | None = None) -> Grid:
    """Return the field with an affine map that turns a box without mirroring it. Its ``spacing``
    may be given.

    A grid with mirrored axes is read from the other end along x: no value changes. Skewed axes are
    resampled linearly along the layers, and a note says so. A grid without an affine map keeps its
    voxels. Raises VolumeError if axes lie in one plane.
    """
    if grid.affine is None:
        return replace(grid, spacing=spacing or grid.spacing)
    matrix = np.array(grid.affine.matrix)
    origin = np.array(grid.affine.origin)
    lengths = _lengths(matrix)
    if not np.isfinite(matrix).all() or not np.isfinite(origin).all() or min(lengths) <= 0.0:
        raise VolumeError(f"The volume's axes have no direction: mend its affine, or {OR_RAW}.")
    directions = matrix / lengths
    if abs(np.linalg.det(directions)) < 1e-3:
        raise VolumeError(f"The volume's axes lie in one plane: mend its affine, or {OR_RAW}.")
    matrix = directions * (spacing or lengths)
    placed = replace(grid, affine=Affine.of(np.column_stack([matrix, origin]), grid.affine.letters))
    return _set_straight(_right_handed(placed), spacing or lengths)


def _lengths(matrix: np.ndarray) -> tuple[float, ...]:
    """Return the lengths in the world of a step along x, y, z: of the matrix's columns."""
    return tuple(math.hypot(*column) for column in matrix.T.tolist())


def _right_handed(grid: Grid) -> Grid:
    """Return the grid, from the other end along x if its axes are left-handed."""
    assert grid.affine is not None, "on_right_angles has asked"
    array = grid.affine.array
    if np.linalg.det(array[:, :3]) > 0.0:
        return grid
    array[:, 3] += array[:, 0] * (grid.shape[2] - 1)
    array[:, 0] *= -1.0
    return replace(grid, slabs=partial(_turned, grid), affine=Affine.of(array, grid.affine.letters))


def _turned(grid: Grid) -> Iterator[np.ndarray]:
    """Return the slabs of a grid, from the other end along x."""
    return (slab[..., ::-1] for slab in grid.slabs())


def _set_straight(grid: Grid, steps: tuple[float, ...]) -> Grid:
    """Return a right-handed grid with the spacing ``steps``, resampled if its axes are skewed by
    more than MAX_SKEW_VOXELS.
    """
    assert grid.affine is not None, "on_right_angles has asked"
    array = grid.affine.array
    rotation, skewed = decompose(array[:, :3])
    last = np.array(grid.shape[::-1]) - 1.0
    off = np.abs(skewed - np.diag(np.diag(skewed))) @ last / np.diag(skewed)
    if off.max() <= MAX_SKEW_VOXELS:
        affine = Affine.of(
            np.column_stack([rotation * np.array(steps), array[:, 3]]), grid.affine.letters
        )
        return replace(grid, spacing=steps, affine=affine)
    return _resampled(grid, rotation, skewed)


def decompose(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a rotation and an upper triangle with a positive diagonal, whose product is the
    ``matrix``; (3, 3) each.

    The x axis and the plane of the layers keep their directions: a layer is moved, and never
    tilted.
    """
    rotation, triangle = np.linalg.qr(matrix)
    signs = np.where(np.diag(triangle) < 0.0, -1.0, 1.0)
    return rotation * signs, triangle * signs[:, None]


def _resampled(grid: Grid, rotation: np.ndarray, skewed: np.ndarray) -> Grid:
    """Return a ``skewed`` grid, resampled linearly so that its axes are at right angles.

    The grid's matrix is the ``rotation`` times the upper triangle ``skewed``, see ``decompose``:
    rows move along x, and layers along x and y, but no layer is tilted. Voxels of the new grid that
    the old one does not reach are holes. Raises VolumeError if layers would grow more than
    MAX_GROWTH times.
    """
    assert grid.affine is not None, "on_right_angles has asked"
    nz, ny, nx = grid.shape
    steps = np.diag(skewed)
    # Find by how many rows the last layer is moved, and by how many columns the corners are.
    rows = skewed[1, 2] / steps[1] * np.array([0.0, nz - 1.0])
    columns = (
        np.add.outer(
            skewed[0, 1] * np.array([0.0, ny - 1.0]), skewed[0, 2] * np.array([0.0, nz - 1.0])
        )
        / steps[0]
    )
    # Enclose all of them in a box, whose first voxel lies at ``first`` of the old grid.
    first = np.floor([columns.min(), rows.min()])
    width = int(math.ceil(nx - 1 + columns.max()) - first[0]) + 1
    height = int(math.ceil(ny - 1 + rows.max()) - first[1]) + 1
    if width * height > MAX_GROWTH * nx * ny:
        raise VolumeError(f"The volume's axes are too skewed: resample it first, or {OR_RAW}.")
    # Means of numbers of up to 16 bits fit float32.
    wide = grid.dtype.itemsize > 2 and grid.dtype != np.float32
    dtype: np.dtype[Any] = np.dtype(np.float64 if wide else np.float32)
    origin = grid.affine.array[:, 3] + rotation[:, :2] @ (first * steps[:2])
    affine = Affine.of(np.column_stack([rotation * steps, origin]), grid.affine.letters)
    note = "The axes are skewed: the layers were resampled onto right angles, linearly."
    slabs = partial(_moved, grid, skewed, (int(first[0]), int(first[1])), (height, width), dtype)
    return replace(
        grid,
        shape=(nz, height, width),
        dtype=dtype,
        spacing=triple(steps),
        slabs=slabs,
        affine=affine,
        notes=(*grid.notes, note),
        labels=None,  # between two labels is neither
    )


def _moved(
    grid: Grid,
    skewed: np.ndarray,
    first: tuple[int, int],
    size: tuple[int, int],
    dtype: np.dtype[Any],
) -> Iterator[np.ndarray]:
    """Yield the layers of a skewed grid, each moved to its place on right angles; (1, height,
    width) each.
    """
    k = 0
    for slab in grid.slabs():
        for layer in slab:
            rows = np.arange(size[0]) + first[1] - k * skewed[1, 2] / skewed[1, 1]
            shift = (rows * skewed[0, 1] + k * skewed[0, 2]) / skewed[0, 0]
            columns = np.arange(size[1]) + first[0] - shift[:, None]
            flat = layer.astype(np.float64)
            yield _between(flat, on_voxels(rows), on_voxels(columns)).astype(dtype)[None]
            k += 1


VOXEL_TOLERANCE = 1e-6
"""Voxels by which a place may be off a voxel, and is taken as on it."""


def on_voxels(places: np.ndarray) -> np.ndarray:
    """Return real ``places`` along an axis; those next to a voxel are put on it.

    Otherwise rounding would mix a share of 1e-16 of a neighbour into a zero, and make it a value of
    another order.
    """
    nearest = np.round(places)
    return np.where(np.abs(places - nearest) <= VOXEL_TOLERANCE, nearest, places)


def _between(layer: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Interpolate a ``layer`` linearly at real ``rows`` (h,) and their ``columns`` (h, w); NaN
    outside of it.
    """
    ny, nx = layer.shape
    j = np.clip(np.floor(rows), 0, ny - 2).astype(int)
    i = np.clip(np.floor(columns), 0, nx - 2).astype(int)
    down = (rows - j)[:, None]
    right = columns - i
    inside = (down >= 0.0) & (down <= 1.0) & (right >= 0.0) & (right <= 1.0)
    upper = layer[j]
    lower = layer[j + 1]
    corners = [
        np.take_along_axis(row, i + step, axis=1) for row in (upper, lower) for step in (0, 1)
    ]
    return np.where(inside, blended(corners, down, right), np.nan)


def blended(corners: Sequence[np.ndarray], down: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return the bilinear means of four ``corners``, (h, w) each: upper left and right, then lower
    ones.

    ``down`` and ``right`` are the shares of the lower and of the right ones. A corner of weight 0
    does not count, even if it is NaN or infinite: a place on a voxel does not see holes beside it.
    """
    weights = [y * x for y in (1.0 - down, down) for x in (1.0 - right, right)]
    parts = [
        np.where(weight > 0.0, corner, 0.0) for weight, corner in zip(weights, corners, strict=True)
    ]
    upper = parts[0] * (1.0 - right) + parts[1] * right
    lower = parts[2] * (1.0 - right) + parts[3] * right
    return cancelled(upper * (1.0 - down) + lower * down, parts)


ROUNDING = 1e-12
"""Greatest size of a weighted sum, as a share of its greatest part, that is no more than rounding:
doubles are rounded at 1e-16.
"""


def cancelled(values: np.ndarray, parts: Sequence[np.ndarray]) -> np.ndarray:
    """Return the weighted sums ``values`` of some ``parts``, with 0 in place of those that cancel:
    finite ones of at most ROUNDING times their greatest part. All arrays have the same shape.

    The rest that rounding leaves of such a sum is no value of the field, and a survey of a field of
    few values would count it as one. Infinite sums stay: they are holes.
    """
    greatest = np.abs(parts[0])
    for part in parts[1:]:
        np.maximum(greatest, np.abs(part), out=greatest)
    cancel = np.isfinite(values) & (np.abs(values) <= ROUNDING * greatest)
    return np.where(cancel, 0.0, values)
