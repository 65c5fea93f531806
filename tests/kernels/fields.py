"""Fields, maps and surfaces of small arrays, as the kernels take them."""

import numpy as np
from numba import njit

from isogi_core.kernels.tracing.active_cells import block_ranges, make_active_cells
from isogi_core.kernels.tracing.cast import TracedSurface
from isogi_core.kernels.tracing.field import Field
from isogi_core.kernels.tracing.intersect import cast
from isogi_core.kernels.tracing.macrocells import fill_macrocells, macrocell_shape


def field_of(voxels, spacing=(1.0, 1.0, 1.0)):
    """A field, with its macrocells, of an array (z, y, x) taken as it is."""
    voxels = np.ascontiguousarray(voxels, np.float32)
    low, high = np.empty((2, *macrocell_shape(voxels.shape)), np.float32)
    fill_macrocells(voxels, low, high)
    return Field(voxels, low, high, spacing)


def bare_field(voxels, spacing=(1.0, 1.0, 1.0)):
    """A field without macrocells, which normals do not ask for."""
    none = np.empty((0, 0, 0), np.float32)
    return Field(np.ascontiguousarray(voxels, np.float32), none, none, spacing)


def cells_of(field, lowest, highest=None):
    """The active-cell map of isovalues from ``lowest`` to ``highest``, or of that one."""
    return make_active_cells(
        field.voxels, block_ranges(field.voxels), lowest, lowest if highest is None else highest
    )


def surface_of(field, isovalue):
    """The isosurface of a field."""
    return TracedSurface(field, cells_of(field, isovalue), isovalue)


@njit(cache=True)
def cast_each(field, iso, origins, directions, side):
    """`intersect.cast` for rays (n, 3): t (n,) and the side each came from (n,)."""
    t = np.empty(len(origins))
    came = np.empty(len(origins), np.int64)
    for m in range(len(origins)):
        o = (float(origins[m, 0]), float(origins[m, 1]), float(origins[m, 2]))
        d = (float(directions[m, 0]), float(directions[m, 1]), float(directions[m, 2]))
        t[m], came[m] = cast(field, iso, o, d, side)
    return t, came
