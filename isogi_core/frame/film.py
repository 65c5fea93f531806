"""Developing a frame: from linear light to a picture of eight bits, with the marks of state over it if asked."""

from functools import cache

import numpy as np

from isogi_core.frame.frame import Frame
from isogi_core.kernels.film import develop_rows, fill_curve

BACKGROUND = (0.0103, 0.0123, 0.0160)
"""Linear RGB behind the surface: a quiet, almost black blue."""

MARK = (0.95, 0.42, 0.05)
"""Linear RGB of the overlay's hatching: amber, which no grey surface has."""

LEVELS = 4096


@cache
def tone_table() -> np.ndarray:
    """The sRGB curve as a table of LEVELS uint8 codes, linear level i / (LEVELS - 1)."""
    table = np.empty(LEVELS, np.uint8)
    fill_curve(table)
    return table


def develop(frame: Frame, exposure: float, overlay: bool = False) -> np.ndarray:
    """The picture of a frame, (h, w, 3) uint8 sRGB. ``exposure`` multiplies the light.

    ``overlay`` hatches what is not final: broad where provisional, fine where converging.
    """
    picture = np.empty(frame.radiance.shape, np.uint8)
    colours = np.array([BACKGROUND, MARK], np.float32)
    develop_rows(frame.radiance, frame.state, 0, exposure, colours, overlay, tone_table(), picture)
    return picture
