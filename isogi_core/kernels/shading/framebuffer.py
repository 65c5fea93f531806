"""The framebuffer: radiance, state and error of each pixel,
and the tone curve to eight bits of sRGB.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel, record

PROVISIONAL = 1
CONVERGING = 2
FINAL = 3
"""States of a pixel that shows a surface, a wall or a face of the window; 0 if it shows none."""

RED_LUMINANCE = np.float32(0.2126)
GREEN_LUMINANCE = np.float32(0.7152)
BLUE_LUMINANCE = np.float32(0.0722)


class Framebuffer(NamedTuple):
    """The light of a picture: ``radiance`` float32 (pixels, 3) linear RGB, ``state`` uint8
    (pixels,), relative ``error`` float32 (pixels,).
    """

    radiance: Any
    state: Any
    error: Any


FRAMEBUFFER = record(Framebuffer, types.float32[:, ::1], types.uint8[::1], types.float32[::1])


@kernel()
def luminance(r, g, b):
    """Return the relative luminance of linear RGB (ITU-R BT.709)."""
    return RED_LUMINANCE * r + GREEN_LUMINANCE * g + BLUE_LUMINANCE * b


@kernel()
def put_pixel(framebuffer, pixel, light, state, error):
    """Write ``light`` (linear RGB), ``state`` and ``error`` to one ``pixel``."""
    (
        framebuffer.radiance[pixel, 0],
        framebuffer.radiance[pixel, 1],
        framebuffer.radiance[pixel, 2],
    ) = light
    framebuffer.state[pixel] = state
    framebuffer.error[pixel] = error


@kernel(types.void(FRAMEBUFFER, types.int64[::1], types.float64[::1]))
def tally(framebuffer, counts, sums):
    """Add the pixels to ``counts`` (4,), by state; add luminance and (luminance · error)² of those
    with a state above 0 to ``sums`` (2,).
    """
    for i in range(framebuffer.state.shape[0]):
        counts[framebuffer.state[i]] += 1
        # Sum in float64: pictures have millions of pixels.
        if framebuffer.state[i]:
            light = np.float64(
                luminance(
                    framebuffer.radiance[i, 0],
                    framebuffer.radiance[i, 1],
                    framebuffer.radiance[i, 2],
                )
            )
            sums[0] += light
            sums[1] += (light * framebuffer.error[i]) ** 2


TONE_GAIN = 1.7
TONE_TOE = 0.16
TONE_SHOULDER = 0.6
"""The tone curve: light below TONE_TOE is darkened, the rest is multiplied by TONE_GAIN, and from
TONE_SHOULDER on it is bent towards 1.

Chosen by eye on ten volumes under sky, probes and studio: daylight leaves their shade near 0.15 and
their sunlit sides near 0.65, which are shown as 0.12 and 0.81.
"""


@kernel()
def tone(x):
    """Return the tone curve at ``x`` ≥ 0: y = TONE_GAIN x²/(x + TONE_TOE) up to s = TONE_SHOULDER,
    then s + (1 - s)(1 - exp(-(y - s)/(1 - s))).

    It is 0 at 0, increases everywhere, has a continuous slope (the second form has the slope 1 in y
    at s), and is never above 1.
    """
    # Far above the toe the factor x/(x + TONE_TOE) is 1; without it, infinite light stays infinite.
    if x < 1e3:
        y = TONE_GAIN * x * (x / (x + TONE_TOE))
    else:
        y = TONE_GAIN * x
    if y <= TONE_SHOULDER:
        return y
    return 1.0 - (1.0 - TONE_SHOULDER) * math.exp((TONE_SHOULDER - y) / (1.0 - TONE_SHOULDER))


@kernel()
def srgb(x):
    """Return the sRGB transfer function (IEC 61966-2-1) of linear ``x`` in [0, 1]."""
    if x <= 0.0031308:
        return 12.92 * x
    return 1.055 * x ** (1.0 / 2.4) - 0.055


@kernel()
def stripe(x, y, period):
    """Return True if pixel (x, y) is on a diagonal stripe; half of each ``period`` is."""
    return (x + y) % period < period // 2


@kernel()
def mark(state, x, y):
    """Return the opacity of the overlay over pixel (x, y): broad hatching if it is provisional,
    fine hatching if it converges.
    """
    if state == PROVISIONAL:
        return 0.55 if stripe(x, y, 12) else 0.15
    if state == CONVERGING:
        return 0.3 if stripe(x, -y, 6) else 0.0
    return 0.0


@kernel()
def place_on(top, light):
    """Return the index of linear ``light`` in a table over [0, 1] whose last index is ``top``;
    0 if the light is not a number.
    """
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
    """Fill ``picture`` (rows, w, 3) uint8 from linear ``radiance`` (rows, w, 3) and ``state``
    (rows, w).

    ``first`` is the number of the first row in the whole picture. ``colours`` (2, 3), linear, are
    the background, which pixels of the state 0 show as it is, and the overlay's mark. ``curve`` is
    the table of ``fill_curve``, sRGB codes of linear levels from 0 to 1.
    """
    rows, width = state.shape
    top = curve.shape[0] - 1
    for y in range(rows):
        for x in range(width):
            # Apply the tone curve to the largest channel, and scale all by the same gain: hues
            # stay.
            peak = exposure * np.float64(
                max(radiance[y, x, 0], radiance[y, x, 1], radiance[y, x, 2])
            )
            if peak > 0.0:
                gain = exposure * (tone(peak) / peak)
            else:
                gain = 0.0
            if overlay:
                veil = mark(state[y, x], x, y + first)
            else:
                veil = 0.0
            for c in range(3):
                if state[y, x]:
                    light = gain * radiance[y, x, c]
                else:
                    light = colours[0, c]
                # Blend the overlay over the light, and look the code up.
                light = (1.0 - veil) * light + veil * colours[1, c]
                picture[y, x, c] = curve[place_on(top, light)]


@kernel("void(uint8[::1])")
def fill_curve(curve):
    """Fill ``curve`` (n,) uint8 with the sRGB code of each linear level i / (n - 1)."""
    for i in range(curve.shape[0]):
        curve[i] = int(255.0 * srgb(i / (curve.shape[0] - 1)) + 0.5)
