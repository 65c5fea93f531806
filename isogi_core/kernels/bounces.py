"""Diffuse rays from where other rays hit: what a bake casts most, for measuring how fast that goes."""

from numba import types

from isogi_core.kernels._jit import kernel
from isogi_core.kernels.field import FIELD, to_index
from isogi_core.kernels.integrator import about, facing_normal, launch
from isogi_core.kernels.packets import ORIGINS, SIDES, VECTOR
from isogi_core.kernels.sampling import sample_cosine_hemisphere
from isogi_core.kernels.vec import column, madd, put_column


@kernel(types.void(FIELD, VECTOR, ORIGINS, ORIGINS, VECTOR, SIDES, ORIGINS))
def bounce_rays(field, isovalues, origins, directions, t, came, numbers):
    """Turn rays ``origins`` + t · ``directions`` (3, n) that hit, in place, into cosine rays from there.

    ``isovalues`` (n,) of the surfaces; ``t`` and ``came`` (n,) as ``cast_rays`` writes them; ``numbers``
    (2, n) in [0, 1). They start off the surface as a path's do. Source: S1, section 4.1.
    """
    for m in range(origins.shape[1]):
        d = column(directions, m)
        p = madd(column(origins, m), t[m], d)
        n = facing_normal(field, p, int(came[m]), d)
        w = about(n, sample_cosine_hemisphere(numbers[0, m], numbers[1, m]))
        put_column(origins, m, launch(field, isovalues[m], p, n, int(came[m])))
        put_column(directions, m, to_index(w, field.spacing))
