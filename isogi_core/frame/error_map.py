"""Relative errors as colours: viridis over a logarithmic scale, which eyes that mix up red and green read as well."""

from functools import cache

import numpy as np

SCALE = (0.001, 1.0)
"""Relative errors at the ends of the scale; what lies beyond has the colour of the end."""

COLOURS = (
    *("#440154", "#472d7b", "#3b528b", "#2c728e", "#21918c"),
    *("#28ae80", "#5ec962", "#addc30", "#fde725"),
)
"""sRGB at equal steps of the logarithm, from little error to much: viridis (Smith and van der Walt 2015), of even
steps to the eye, at nine places."""

LEVELS = 256


@cache
def colour_table() -> np.ndarray:
    """COLOURS and what is between them, (LEVELS, 3) uint8 sRGB."""
    anchors = np.array([list(bytes.fromhex(colour[1:])) for colour in COLOURS], float)
    place, at = np.linspace(0.0, 1.0, LEVELS), np.linspace(0.0, 1.0, len(COLOURS))
    return np.stack([np.interp(place, at, channel) for channel in anchors.T], axis=1).round().astype(np.uint8)


def colours_of(error: np.ndarray) -> np.ndarray:
    """The colours of relative errors (n,): (n, 3) uint8 sRGB."""
    low, high = SCALE
    share = np.log(np.clip(error, low, high) / low) / np.log(high / low)
    return colour_table()[(share * (LEVELS - 1) + 0.5).astype(np.intp)]
