"""Footprints: how much of a picture's noise is of each texel that it reads."""

from numba import types

from isogi_core.kernels._jit import kernel
from isogi_core.kernels.lattice import CORNERS, LATTICE, POINTS, WIDE, fractions, trilinear


@kernel(types.void(LATTICE, POINTS, CORNERS, WIDE, types.float64[::1]))
def add_footprints(lattice, points, corners, wide, seen):
    """Add to ``seen`` (texels,) the squares of a texel's shares in the points.

    ``corners`` (points, 8), x fastest, are those of ``wide`` (points,) cells or of others.

    Shares are those of ``carry_light`` where all texels hold light: their noises are independent, and so a point's
    variance is the sum of w² times theirs. Where ``carry_shares`` weighs them by normals too they are near enough, as
    footprints tell what to bake first and no more.
    """
    for m in range(points.shape[0]):
        fz, fy, fx = fractions(lattice, points, m, wide[m])
        for c in range(8):
            seen[corners[m, c]] += trilinear(c, fz, fy, fx) ** 2
