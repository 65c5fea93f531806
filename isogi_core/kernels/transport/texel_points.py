"""Where texels are lit: projected along the gradient onto the isosurface that a view shows."""

import math

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel
from isogi_core.kernels.tracing.field import FIELD_RECORD, normal, smooth_gradient, value
from isogi_core.kernels.tracing.plateaus import HALVINGS, STEP_VOXELS, crossing, downhill, point_within
from isogi_core.kernels.tracing.vec import dot, is_zero, length, put_column
from isogi_core.kernels.transport.transfer import REAL_ARRAY, REAL_ROWS, TEXEL_PLACES, hemmed

TEXEL_PROJECTED, TOO_FAR, OTHER_SHEET, NORMAL_TURNED, TEXEL_HEMMED, NO_SURFACE = range(6)
"""What became of a texel: it was projected, or the shown isosurface is not within MAX_SHIFT_VOXELS, or another sheet of
it is; the normal there is turned by more than a right angle; light has no room to arrive there; or its own point has no
normal.
"""

MAX_BACKTRACK = 0.1
"""Share of the way between two isovalues that the field may go back on its way from one to the other."""


@kernel(exact=True)
def strays(voxels, p, d, level, reach):
    """How far the field goes back between ``p`` and ``reach`` along ``d``, over its distance from ``level`` at p."""
    own = value(voxels, p)
    nearest, back, t = abs(own - level), 0.0, STEP_VOXELS
    while t < reach:
        away = abs(value(voxels, point_within(voxels.shape, p, d, t)) - level)
        nearest, back, t = min(nearest, away), max(back, away - nearest), t + STEP_VOXELS
    return back / max(abs(own - level), 1e-300)


@kernel(exact=True)
def way_to(field, p, n, level, halvings=HALVINGS):
    """The way from ``p`` to the isosurface ``level`` along the normal ``n``, that is not zero: (direction, voxels).

    Out of the solid or into it, to where the trilinear field first crosses the level; the direction is of index space,
    a voxel long, and the way, found by ``halvings`` (see ``crossing``), inf where it does not within MAX_SHIFT_VOXELS.
    """
    d = downhill(n, field.spacing, 1.0 if value(field.voxels, p) > level else -1.0)
    return d, crossing(field.voxels, p, d, level, halvings)


@kernel(exact=True)
def project_point(field, p, level):
    """Move ``p`` along the normal onto the isosurface ``level``: (verdict, point, normal there).

    The straight way of ``way_to``; both are those of ``p`` itself where that fails. Verdicts are TEXEL_PROJECTED …
    NO_SURFACE.
    """
    n = normal(field, p)
    if math.isnan(value(field.voxels, p)) or is_zero(n):
        return NO_SURFACE, p, n
    d, t = way_to(field, p, n, level)
    if not t < math.inf:
        return TOO_FAR, p, n
    there = point_within(field.voxels.shape, p, d, t)
    m = normal(field, there)
    if strays(field.voxels, p, d, level, t) > MAX_BACKTRACK:
        return OTHER_SHEET, p, n
    if not dot(n, m) > 0.0:
        return NORMAL_TURNED, p, n
    return (TEXEL_HEMMED, p, n) if hemmed(field, there, m, level) else (TEXEL_PROJECTED, there, m)


@kernel(types.void(FIELD_RECORD, REAL_ARRAY, types.float64, TEXEL_PLACES, REAL_ROWS, REAL_ROWS, types.uint8[::1]))
def project_texels(field, step, level, texels, points, normals, verdicts):
    """Move ``texels`` (m, 3; z, y, x) onto the isosurface ``level``, a voxel-space isovalue.

    ``step`` (3,) voxels per texel along x, y, z. Writes ``points`` and ``normals`` (3, m), and the ``verdicts`` (m,):
    TEXEL_PROJECTED, or why a texel stays where it is.
    """
    for m in range(texels.shape[0]):
        p = (texels[m, 2] * step[0], texels[m, 1] * step[1], texels[m, 0] * step[2])
        verdict, there, n = project_point(field, p, level)
        verdicts[m] = np.uint8(verdict)
        put_column(points, m, there)
        put_column(normals, m, n)


@kernel(types.void(FIELD_RECORD, REAL_ARRAY, types.float64, TEXEL_PLACES, REAL_ARRAY))
def measure_distances(field, step, level, texels, ways):
    """Estimate the ``ways`` (m,), in voxels, from ``texels`` (m, 3; z, y, x) to the isosurface ``level``.

    To first order, |ρ - level| / |∇ρ| with the smoothed gradient; inf where that is zero, and where ρ is not a number.
    """
    for m in range(texels.shape[0]):
        p = (texels[m, 2] * step[0], texels[m, 1] * step[1], texels[m, 0] * step[2])
        away, slope = abs(value(field.voxels, p) - level), length(smooth_gradient(field.voxels, p))
        way = away / slope if slope > 0.0 else math.inf
        ways[m] = math.inf if math.isnan(way) else way
