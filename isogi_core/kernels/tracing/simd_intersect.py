"""SIMD intersection: ``cross_cell`` of ``intersect`` for many rays at once, with the same bits.

It decides plain cases, and leaves slivers, holes and cells whose corners agree to the scalar twin.
The geometry of both is the same source, ``slabs`` and ``cubic``.
"""

import numpy as np

from isogi_core.kernels._jit import kernel
from isogi_core.kernels.simd.maths import f64, i32
from isogi_core.kernels.simd.memory import gather_pair
from isogi_core.kernels.tracing.cubic import cubic_along, first_crossing
from isogi_core.kernels.tracing.intersect import CUBIC_ROUNDING, SLIVER, extent, less
from isogi_core.kernels.tracing.slabs import cut_cell, longest, reciprocals


@kernel()
def corners_of(flat, place, stride):
    """Return the eight corner values, f64×N, x fastest,
    of cells whose lowest corner is at ``place``.
    """
    sy, sz = stride
    a, b = gather_pair(flat, place)
    c, d = gather_pair(flat, place + sy)
    e, f = gather_pair(flat, place + sz)
    g, h = gather_pair(flat, place + (sy + sz))
    return f64(a), f64(b), f64(c), f64(d), f64(e), f64(f), f64(g), f64(h)


@kernel()
def within_cell(o, middle, d, cell, n):
    """Return the mask of rays whose point at ``middle`` is in ``cell``
    along one axis of ``n`` voxels.
    """
    return min(max(i32(o + middle * d), 0), n - 2) == cell


@kernel()
def cross_cells(flat, shape, o, d, place, span, iso, solid):
    """Intersect rays with the surface in the cells at ``place``, which they enter from a ``solid``
    side or not.

    ``place`` is the flat index of the cell's lowest corner; ``span`` (near, far) comes from
    ``clip_box``. Returns (t, distance at which the ray enters the cell, mask of certain hits). Such
    a hit has the t of ``cross_cell``. Rays without one miss the cell, or their case is left to
    ``cross_cell``: call that for both.
    """
    nz, ny, nx = shape
    # Recover the cell's indices from its flat index. Vectors have no division of integers; half a
    # step keeps rounding of the float division away from whole numbers.
    layer = i32((f64(place) + 0.5) / np.float64(nx))
    plane = i32((f64(layer) + 0.5) / np.float64(ny))
    cell = place - layer * nx, layer - plane * ny, plane
    corner = f64(cell[0]), f64(cell[1]), f64(cell[2])
    # Clip the ray to the cell; slivers and points in another cell by rounding are not sure.
    near, far = cut_cell(o, reciprocals(d), corner, span[0], span[1])
    through = far - near
    middle = 0.5 * (near + far)
    sure = within_cell(o[0], middle, d[0], cell[0], nx) & within_cell(
        o[1], middle, d[1], cell[1], ny
    )
    sure = sure & within_cell(o[2], middle, d[2], cell[2], nz) & (through * longest(d) >= SLIVER)
    # Cells without corners on both sides, or with holes, are not sure. A hole is NaN, so that the
    # sum of the corners then compares with nothing.
    c = less(corners_of(flat, place, (nx, nx * ny)), iso)
    low, high, total = extent(c)
    sure = sure & (high > 0.0) & ~(low > 0.0) & ((total <= 0.0) | (total > 0.0))
    a = (
        o[0] + near * d[0] - corner[0],
        o[1] + near * d[1] - corner[1],
        o[2] + near * d[2] - corner[2],
    )
    # Solve the cubic along the ray.
    q = cubic_along(c, a, (d[0] * through, d[1] * through, d[2] * through))
    t, crosses = first_crossing(q, solid, CUBIC_ROUNDING * max(shape) * max(high, -low), sure)
    return near + t * through, near, crosses
