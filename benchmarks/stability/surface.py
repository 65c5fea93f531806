"""The isosurface of a volume, and rays cast at it in each of the two arithmetics."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.ndimage import map_coordinates

from isogi_core.bake.recipe import make_field
from isogi_core.kernels.bricks import Bricks, brick_ranges, make_bricks
from isogi_core.kernels.field import Field
from isogi_core.kernels.intersect import UNKNOWN
from isogi_core.kernels.packets import cast_rays, cast_rays_one_by_one
from isogi_core.model.volume import Volume, make_volume

ARITHMETICS: Mapping[str, Callable[..., None]] = {"float32": cast_rays, "float64": cast_rays_one_by_one}
"""Scouts in float32, whose last word is float64: what frames and bakes cast with; and the scalar caster."""


@dataclass(frozen=True, eq=False)
class Surface:
    """The isosurface of a ``field`` at a normalised isovalue, ``level``; ``bricks`` are its map."""

    field: Field
    bricks: Bricks
    level: float

    def cast(
        self, origins: np.ndarray, directions: np.ndarray, sides: Any = UNKNOWN, by: str = "float32"
    ) -> tuple[np.ndarray, np.ndarray]:
        """Where rays (n, 3) in index space meet it: t (n,), inf where they do not, and the side they came from."""
        count = len(origins)
        t, came = np.empty(count), np.empty(count, np.int8)
        told = np.broadcast_to(np.asarray(sides, np.int8), count).copy()
        levels = np.full(count, self.level)
        columns = (np.ascontiguousarray(v.T, np.float64) for v in (origins, directions))
        ARITHMETICS[by](self.field, self.bricks, levels, *columns, told, t, came)
        return t, came

    def height(self, points: np.ndarray) -> np.ndarray:
        """The trilinear field less the isovalue at points (n, 3), by SciPy, float64: solid above 0."""
        value = map_coordinates(self.field.voxels.astype(np.float64), points.T[::-1], order=1, mode="nearest")
        return value - self.level


def surface_of(array: np.ndarray, isovalue: float, **changes: Any) -> Surface:
    """The isosurface of a volume (z, y, x), its isovalue in its own units; ``changes`` are of the Field."""
    return surface_in(make_volume(array), isovalue, **changes)


def surface_in(volume: Volume, isovalue: float, **changes: Any) -> Surface:
    """The isosurface of a volume that is made."""
    level = volume.normalise_isovalue(isovalue)
    bricks = make_bricks(volume.voxels, brick_ranges(volume.voxels), level, level)
    return Surface(make_field(volume)._replace(**changes), bricks, level)
