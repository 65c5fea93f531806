"""The filter of shine: pixels side by side share what their first rays bring."""

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel
from isogi_core.kernels.shading.picture_noise import BINOMIAL_WEIGHTS, RADIUS

ZERO_F32, ONE_F32 = np.float32(0.0), np.float32(1.0)

SINGLE_ROWS = types.float32[:, ::1]


@kernel(inline=True)
def biweight(normals, n, normal, narrow):
    """What the normal of point ``n`` counts for a ``normal``: Tukey's biweight of the length between both, by the
    inverse of its squared width.
    """
    x, y, z = normals[n, 0] - normal[0], normals[n, 1] - normal[1], normals[n, 2] - normal[2]
    rest = max(ONE_F32 - (x * x + y * y + z * z) * narrow, ZERO_F32)
    return rest * rest


@kernel(
    types.void(
        types.int32[:, ::1],
        types.uint32[::1],
        SINGLE_ROWS,
        types.int64,
        SINGLE_ROWS,
        types.int64,
        types.float32,
        SINGLE_ROWS,
    )
)
def filter_shine(rows, pixels, normals, first, light, step, width, found):
    """Fill ``found`` (k, 4) with the mean ``light`` (m, 4) about the points of a picture from number ``first`` on.

    Light is linear RGB and the variance of its luminance. The mean is that of five by five pixels, a ``step`` apart,
    which count binomially, and by how like their ``normals`` (m, 3) are within a ``width``. ``rows`` and ``pixels`` are
    as of ``pool_noise``. Source: Dammertz and others 2010; Schied and others 2017 on variance.
    """
    (height, across), narrow = rows.shape, ONE_F32 / (width * width)
    for i in range(found.shape[0]):
        m = first + i
        y, x = divmod(np.int64(pixels[m]), across)
        normal = normals[m, 0], normals[m, 1], normals[m, 2]
        red = green = blue = variance = total = ZERO_F32
        for dy in range(-RADIUS, RADIUS + 1):
            v = y + dy * step
            for dx in range(-RADIUS if 0 <= v < height else RADIUS + 1, RADIUS + 1):
                u = x + dx * step
                n = np.int64(rows[v, u]) if 0 <= u < across else -1
                if n >= 0:
                    w = np.float32(BINOMIAL_WEIGHTS[dy + RADIUS] * BINOMIAL_WEIGHTS[dx + RADIUS]) * biweight(
                        normals, n, normal, narrow
                    )
                    red, green, blue = red + w * light[n, 0], green + w * light[n, 1], blue + w * light[n, 2]
                    variance, total = variance + w * w * light[n, 3], total + w
        found[i, 0], found[i, 1], found[i, 2] = red / total, green / total, blue / total
        found[i, 3] = variance / (total * total)
