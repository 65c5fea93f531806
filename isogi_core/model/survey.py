"""A survey of a grid: what its values are, found slab by slab, and from that the voxels of its volume."""

import hashlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from isogi_core.errors import VolumeError
from isogi_core.files.grid import Grid
from isogi_core.model.core import find_core, sample_layers, sample_step
from isogi_core.model.units import count_steps, normalise, offset_and_scale

LEAST_SPACING, MOST_SPACING = 1e-30, 1e30
"""World units per voxel: positions are told in float32."""

STAGES = 3
"""Times that all layers are gone through where a copy is made: for the range, the voxels and their histogram."""

Tell = Callable[[int, int], object]
"""Is told how much of long work is done, and of how much."""


def tell_nobody(done: int, total: int) -> None:
    """Take no notice."""


@dataclass(frozen=True, eq=False)
class Survey:
    """What there is to know of a ``grid`` before its voxels are made; see ``Volume``.

    ``marks`` are the values that stand for nothing, in the grid's own type, and ``holes`` how many voxels have none.
    ``value_range`` and ``core`` are exact Python numbers.
    """

    grid: Grid
    spacing: tuple[float, float, float]
    solid: str
    marks: np.ndarray
    value_range: tuple[float, float]
    holes: int
    core: tuple[float, float]
    offset: float
    scale: float

    def planes(self) -> Iterator[np.ndarray]:
        """The normalised voxels, plane by plane along z; (ny, nx) float32 each, NaN for holes."""
        for slab in self.grid.slabs():
            for plane in usable(slab):
                voxels = normalise(plane, self.offset, self.scale).astype(np.float32)
                if self.holes:
                    voxels[~present(plane, self.marks)] = np.nan
                yield voxels

    def pour(self, write: Callable[[np.ndarray], object], tell: Tell = tell_nobody) -> str:
        """Hand the ``planes`` over to ``write``, one after the other; the digest of the volume that they make."""
        digest = begin_digest(self.grid.shape, self.spacing, self.offset, self.scale)
        for z, voxels in enumerate(self.planes()):
            digest.update(voxels.data)
            write(voxels)
            tell(len(self.grid) + z + 1, STAGES * len(self.grid))
        return digest.hexdigest()

    def facts(self, name: str, digest: str) -> dict[str, Any]:
        """All of a Volume besides its voxels."""
        return {
            "spacing": self.spacing,
            "offset": self.offset,
            "scale": self.scale,
            "solid": self.solid,
            "name": name,
            "dtype": self.grid.dtype.name,
            "digest": digest,
            "value_range": (float(self.value_range[0]), float(self.value_range[1])),
            "core": (float(self.core[0]), float(self.core[1])),
            "steps": count_steps(*self.core, usable_type(self.grid.dtype)),
            "holes": self.holes,
        }


def survey(grid: Grid, solid: str, missing: Sequence[float] = (), tell: Tell = tell_nobody) -> Survey:
    """Look at all values of a ``grid`` once; those equal to one of ``missing`` are holes.

    Raises VolumeError where it is complex, not 3-D, thinner than two voxels or without a finite value, and where a
    spacing is no positive number of a usable size.
    """
    check(grid, solid)
    spacing = checked_spacing(grid.spacing)
    marks = find_marks(missing, usable_type(grid.dtype))
    low, high, holes, some = look_over(grid, marks, tell)
    ends = np.array([low, high], usable_type(grid.dtype))
    core = find_core(np.union1d(some[present(some, marks)], ends))
    return Survey(grid, spacing, solid, marks, (low, high), holes, core, *offset_and_scale(*core, solid))


def begin_digest(shape: Sequence[int], spacing: Sequence[float], offset: float, scale: float) -> "hashlib.blake2b":
    """A digest over a volume's shape (z, y, x), spacing and units; its voxels are to follow."""
    units = f"{tuple(shape)} {[step.hex() for step in spacing]} {offset.hex()} {scale.hex()}"
    return hashlib.blake2b(units.encode(), digest_size=16)


def check(grid: Grid, solid: str) -> None:
    """VolumeError where the grid is no real 3-D field, or ``solid`` no side."""
    if solid not in ("above", "below"):
        raise VolumeError(f"solid is '{solid}': say which side of the isovalue is solid, 'above' or 'below'.")
    if grid.dtype.kind not in "biuf":
        raise VolumeError(f"The volume holds {grid.dtype} values: give one real number per voxel.")
    if len(grid.shape) != 3:
        raise VolumeError(f"The volume has {len(grid.shape)} dimensions, not 3: choose one scalar field of it.")
    if min(grid.shape) < 2:
        sides = " × ".join(str(n) for n in grid.shape[::-1])
        raise VolumeError(f"A volume of {sides} voxels has no cells: every side needs at least 2 voxels.")


def checked_spacing(spacing: Sequence[float]) -> tuple[float, float, float]:
    """Spacing as three floats; VolumeError where one is missing, too small or too large."""
    steps = [float(step) for step in spacing]
    if len(steps) != 3 or not all(LEAST_SPACING <= step <= MOST_SPACING for step in steps):
        given = ", ".join(f"{step:g}" for step in steps)
        wanted = f"three positive numbers, from {LEAST_SPACING:g} to {MOST_SPACING:g}"
        raise VolumeError(f"The spacing ({given}) must be {wanted}: set spacing in the scene.")
    return steps[0], steps[1], steps[2]


def usable_type(dtype: np.dtype[Any]) -> np.dtype[Any]:
    """The type in which values are looked at: integers or floats of at most 64 bits."""
    if dtype.kind == "b":
        return np.dtype(np.uint8)
    return dtype if dtype.itemsize <= 8 else np.dtype(np.float64)


def usable(slab: np.ndarray) -> np.ndarray:
    """The values in their ``usable_type``."""
    if slab.dtype.kind == "b":
        return slab.view(np.uint8)
    with np.errstate(over="ignore"):
        return slab.astype(usable_type(slab.dtype), copy=False)


def find_marks(missing: Sequence[float], dtype: np.dtype[Any]) -> np.ndarray:
    """The ``missing`` values as the type holds them; none for a number that it cannot hold."""
    if dtype.kind == "f":
        with np.errstate(over="ignore"):
            return np.array(missing, np.float64).astype(dtype)
    info = np.iinfo(dtype)
    return np.array([int(mark) for mark in missing if info.min <= mark <= info.max and mark == int(mark)], dtype)


def present(values: np.ndarray, marks: np.ndarray) -> np.ndarray:
    """Which values are finite and none of the marks of what is missing; bool."""
    finite = np.isfinite(values)
    for mark in marks:
        finite &= values != mark
    return np.asarray(finite)


def look_over(grid: Grid, marks: np.ndarray, tell: Tell) -> tuple[float, float, int, np.ndarray]:
    """Minimum and maximum of what is there (exact Python numbers), how many values are not, and ``sample_values``."""
    lows, highs, some = [], [], []
    z, count, step = 0, 0, sample_step(grid.shape)
    for slab in map(usable, grid.slabs()):
        some.append(sample_layers(slab, step, z))
        for plane in slab:
            there = plane[present(plane, marks)]
            count += there.size
            if there.size:
                lows.append(there.min().item())
                highs.append(there.max().item())
            z += 1
            tell(z, STAGES * len(grid))
    if not lows:
        raise VolumeError("The volume has no finite value: every voxel is NaN, infinite or missing.")
    return min(lows), max(highs), grid.size - count, np.unique(np.concatenate(some))
