"""Facing: the normals that texels are lit about, found anew for a view's texels alone, as no store keeps them."""

import math

from numba import types

from isogi_core.kernels._jit import kernel
from isogi_core.kernels.field import FIELD, normal
from isogi_core.kernels.lattice import POINTS
from isogi_core.kernels.moves import way_to
from isogi_core.kernels.plateaus import along
from isogi_core.kernels.transfer import TEXELS, VECTOR
from isogi_core.kernels.vec import is_zero


@kernel(exact=True)
def facing_there(field, p, n, level):
    """The normal where ``p``, whose own is ``n``, comes to on the isosurface ``level``; (0, 0, 0) if out of reach."""
    if is_zero(n):
        return n
    d, t = way_to(field, p, n, level)
    return normal(field, along(field.voxels.shape, p, d, t)) if t < math.inf else (0.0, 0.0, 0.0)


@kernel(types.void(FIELD, VECTOR, types.float64, types.boolean, TEXELS, POINTS))
def face_texels(field, step, level, moved, texels, normals):
    """Fill ``normals`` (m, 3), outward unit world ones, of ``texels`` (m, 3; z, y, x) at their own points.

    Or, where they are ``moved``, of the places that ``move_texels`` brings them to on the isosurface ``level``, a
    voxel-space isovalue; what else may keep them where they are is not asked. ``step`` (3,) voxels per texel along x,
    y, z. Normals are (0, 0, 0) where the field has no gradient or the level is out of reach. Of texels at the edge of a
    plateau, which are lit a voxel or so away along the gradient, they are those of their own points too.
    """
    for m in range(texels.shape[0]):
        p = (texels[m, 2] * step[0], texels[m, 1] * step[1], texels[m, 0] * step[2])
        n = normal(field, p)
        if moved:
            n = facing_there(field, p, n, level)
        normals[m, 0], normals[m, 1], normals[m, 2] = n
