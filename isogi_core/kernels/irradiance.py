"""Irradiance of texels under a light that stays where it is: one colour per texel, and no harmonics."""

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel
from isogi_core.kernels.bricks import BRICKS
from isogi_core.kernels.field import FIELD
from isogi_core.kernels.lit import SURROUNDINGS, light_paths
from isogi_core.kernels.reals import ABREAST
from isogi_core.kernels.transfer import COLUMNS, TEXELS, VECTOR, start_halves
from isogi_core.kernels.waves import WAVE


@kernel()
def add_gathered(gathered, starts, count, rows, sums):
    """Add what ``light_paths`` gathered, sample by sample, to ``sums`` (m, 2, 3) of the ``rows``' halves."""
    for i in range(starts):
        for s in range(count):
            for c in range(3):
                sums[rows[i // 2], i % 2, c] += gathered[c, s * starts + i]


@kernel()
def light_together(field, bricks, place, rows, first, count, weights, survival, light, sums):
    """``bake_irradiance`` for a few texels whose paths go together."""
    starts = 2 * rows.shape[0]
    levels, here, facing, seeds = start_halves(place, rows)
    step = max(WAVE // starts, 1)
    gathered = np.empty((3, starts * step))
    for begin in range(first, first + count, step):
        samples = min(step, first + count - begin)
        light_paths(field, bricks, levels, here, facing, seeds, begin, samples, weights, survival, light, gathered)
        add_gathered(gathered, starts, samples, rows, sums)


@kernel(
    types.void(
        FIELD,
        BRICKS,
        types.Tuple((TEXELS, COLUMNS, COLUMNS, VECTOR)),
        types.int64[::1],
        types.int64,
        types.int64,
        types.float64[:, ::1],
        types.float64,
        SURROUNDINGS,
        types.float64[:, :, ::1],
    )
)
def bake_irradiance(field, bricks, place, rows, first, count, weights, survival, light, sums):
    """Sums of ``count`` samples of E/π, from sample ``first`` on, for the ``rows`` and each of their two halves.

    ``place`` is what ``locate_texels`` took and wrote, as for ``bake_texels``, whose random numbers these
    are; ``weights`` (bounces + 1, 3) R^k, over the chance to get there (see ``spin``); ``light`` the
    Surroundings. Adds linear RGB, with all bounces, to ``sums`` (m, 2, 3): times the albedo it is the
    radiance that leaves the surface.
    """
    together = max(WAVE // (2 * count), ABREAST)
    for i in range(0, rows.shape[0], together):
        light_together(field, bricks, place, rows[i : i + together], first, count, weights, survival, light, sums)
