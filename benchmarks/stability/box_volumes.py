"""Specimens in extreme boxes: the least, the longest, the flattest, and such as cut the surface."""

import math

import numpy as np

from benchmarks.stability.range_volumes import soft
from benchmarks.stability.shapes import grid
from benchmarks.stability.specimen import specimen

GROUP = "extreme shapes"


def ripples(*sides: int) -> np.ndarray:
    """Waves across a box of ``sides`` (nx, ny, nz) voxels, from 0 to 1."""
    x, y, z = grid(*sides)
    return np.asarray(0.5 + 0.5 * np.cos(0.9 * x + 0.3) * np.cos(0.8 * y) * np.cos(0.7 * z + 0.2))


@specimen(GROUP, "2 × 2 × 2", 0.5)
def least() -> np.ndarray:
    """One cell."""
    return np.array([[[0.0, 1.0], [0.2, 0.9]], [[0.1, 0.4], [0.8, 0.3]]])


@specimen(GROUP, "4096 × 2 × 2", 0.5)
def long() -> np.ndarray:
    """A row of cells."""
    return ripples(4096, 2, 2)


@specimen(GROUP, "2 × 2 × 300", 0.5)
def tall() -> np.ndarray:
    """A column of cells."""
    return ripples(2, 2, 300)


@specimen(GROUP, "64 × 64 × 2", 0.5)
def flat() -> np.ndarray:
    """A layer of cells."""
    return ripples(64, 64, 2)


@specimen(GROUP, "1 × 8 × 8", 0.5, refused="no cells")
def thin() -> np.ndarray:
    """A picture, which has no surface."""
    return ripples(1, 8, 8)


@specimen(GROUP, "cut by the box", 0.5)
def cut() -> np.ndarray:
    """The upper half of the body: its solid is open below."""
    return soft()[16:]


@specimen(GROUP, "solid up to the box", 0.5)
def hollow() -> np.ndarray:
    """The body as a cave: the box is all in the solid."""
    return 1.0 - soft()


@specimen(GROUP, "spacing 1 : 1000", 0.5, spacing=(1.0, 1.0, 1000.0))
def stretched() -> np.ndarray:
    """Voxels like needles."""
    return soft()


@specimen(GROUP, "spacing of 1e-30", 0.5, spacing=(1e-30, 1e-30, 1e-30))
def minute() -> np.ndarray:
    """A volume smaller than anything."""
    return soft()


@specimen(GROUP, "spacing of 1e30", 0.5, spacing=(1e30, 1e30, 1e30))
def immense() -> np.ndarray:
    """A volume larger than the universe."""
    return soft()


for _step in (1e-300, 1e300, 0.0, -1.0, math.nan, math.inf):
    specimen(GROUP, f"spacing of {_step:g}", 0.5, spacing=(1.0, _step, 1.0), refused="spacing")(least)
