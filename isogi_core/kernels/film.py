"""From linear light to the eight bits that a screen shows: exposure, shoulder, sRGB, and the marks of state."""

import math

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel
from isogi_core.kernels.planes import CONVERGING, PROVISIONAL

SHOULDER = 0.7
"""Where the tone curve leaves the straight line: brighter light is bent towards 1 and never clipped."""


@kernel()
def shoulder(x):
    """The tone curve: x up to SHOULDER, then s + (1 - s)(1 - exp(-(x - s)/(1 - s))); continuous slope."""
    if x <= SHOULDER:
        return x
    return 1.0 - (1.0 - SHOULDER) * math.exp((SHOULDER - x) / (1.0 - SHOULDER))


@kernel()
def srgb(x):
    """The sRGB transfer function (IEC 61966-2-1) of linear ``x`` in [0, 1]."""
    if x <= 0.0031308:
        return 12.92 * x
    return 1.055 * x ** (1.0 / 2.4) - 0.055


@kernel()
def stripe(x, y, period):
    """Whether pixel (x, y) is on a diagonal stripe; half of each ``period`` is."""
    return (x + y) % period < period // 2


@kernel()
def mark(state, x, y):
    """Opacity of the mark that the overlay draws over pixel (x, y): broad hatching provisional, fine converging."""
    if state == PROVISIONAL:
        return 0.55 if stripe(x, y, 12) else 0.15
    if state == CONVERGING:
        return 0.3 if stripe(x, -y, 6) else 0.0
    return 0.0


@kernel()
def place_on(top, light):
    """The place of linear ``light`` on a curve from 0 to 1 that ends at ``top``; 0 for what is no number."""
    if not light > 0.0:
        return 0
    return int(min(light, 1.0) * top + 0.5)


@kernel(
    types.void(
        types.float32[:, :, ::1],
        types.uint8[:, ::1],
        types.int64,
        types.float64,
        types.float32[:, ::1],
        types.boolean,
        types.uint8[::1],
        types.uint8[:, :, ::1],
    )
)
def develop_rows(radiance, state, first, exposure, colours, overlay, curve, picture):
    """Fill ``picture`` (rows, w, 3) uint8 from linear ``radiance`` (rows, w, 3) and ``state`` (rows, w).

    Light times ``exposure`` goes through the tone curve on its largest channel, so that hues stay;
    ``colours`` (2, 3) linear: the background and the overlay's mark; ``curve`` is sRGB as a table.
    """
    rows, width = state.shape
    top = curve.shape[0] - 1
    for y in range(rows):
        for x in range(width):
            peak = exposure * np.float64(max(radiance[y, x, 0], radiance[y, x, 1], radiance[y, x, 2]))
            gain = exposure * shoulder(peak) / peak if peak > 0.0 else 0.0
            veil = mark(state[y, x], x, y + first) if overlay else 0.0
            for c in range(3):
                light = gain * radiance[y, x, c] if state[y, x] else colours[0, c]
                light = (1.0 - veil) * light + veil * colours[1, c]
                picture[y, x, c] = curve[place_on(top, light)]


@kernel("void(uint8[::1])")
def fill_curve(curve):
    """Fill ``curve`` (n,) uint8 with the sRGB code of each linear level i / (n - 1)."""
    for i in range(curve.shape[0]):
        curve[i] = int(255.0 * srgb(i / (curve.shape[0] - 1)) + 0.5)
