"""The record of points on surfaces, as pictures and the ends of rays have them."""

from typing import Any, NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel, record


class SurfacePoints(NamedTuple):
    """m points on surfaces: ``points`` in index space and world unit ``normals``, float32 (m, 3), one a row.

    ``pixels`` (m,) uint32 are the picture indices that show them, or other numbers of rays: random numbers follow from
    these. Waves of paths have columns in double precision in place of rows, as SIMD takes them: see ``PathStarts``.
    """

    points: Any
    normals: Any
    pixels: Any

    def part(self, some: slice | np.ndarray) -> "SurfacePoints":
        """The points in ``some`` rows."""
        return SurfacePoints(self.points[some], self.normals[some], self.pixels[some])


POINT_ROWS = types.float32[:, ::1]
PIXEL_ARRAY = types.uint32[::1]
SURFACE_POINTS = record(SurfacePoints, POINT_ROWS, POINT_ROWS, PIXEL_ARRAY)


@kernel()
def point_of(vectors, m):
    """Row ``m`` of a float32 (n, 3) array as a tuple of float64."""
    return np.float64(vectors[m, 0]), np.float64(vectors[m, 1]), np.float64(vectors[m, 2])
