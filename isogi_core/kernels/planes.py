"""The planes of a frame: what is kept of each pixel, and how good it is."""

from typing import Any, NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel, record

PROVISIONAL, CONVERGING, FINAL = 1, 2, 3
"""States of a pixel that shows the surface; 0 where none is seen."""

RED, GREEN, BLUE = np.float32(0.2126), np.float32(0.7152), np.float32(0.0722)


class Planes(NamedTuple):
    """Flat planes: ``radiance`` (pixels, 3) linear RGB, ``state`` (pixels,), relative ``error`` (pixels,)."""

    radiance: Any
    state: Any
    error: Any


PLANES = record(Planes, types.float32[:, ::1], types.uint8[::1], types.float32[::1])


@kernel()
def luminance(r, g, b):
    """Relative luminance of linear RGB (ITU-R BT.709)."""
    return RED * r + GREEN * g + BLUE * b


@kernel()
def put_pixel(planes, pixel, light, state, error):
    """Write one pixel; ``light`` is linear RGB."""
    planes.radiance[pixel, 0], planes.radiance[pixel, 1], planes.radiance[pixel, 2] = light
    planes.state[pixel] = state
    planes.error[pixel] = error


@kernel(types.void(PLANES, types.int64[::1], types.float64[::1]))
def tally(planes, counts, sums):
    """Add up the surface pixels: ``counts`` (4,) by state, ``sums`` (2,) of luminance and of (luminance · error)²."""
    for i in range(planes.state.shape[0]):
        counts[planes.state[i]] += 1
        if planes.state[i]:
            light = np.float64(luminance(planes.radiance[i, 0], planes.radiance[i, 1], planes.radiance[i, 2]))
            sums[0] += light
            sums[1] += (light * planes.error[i]) ** 2
