"""Directions that views of a prewarm look from."""

from __future__ import annotations

import math

GOLDEN = 180.0 * (3.0 - math.sqrt(5.0))
"""The golden angle, degrees."""

Direction = tuple[float, float]
"""Azimuth and elevation, degrees."""


def all_sides(count: int) -> list[Direction]:
    """So many points spread evenly over a sphere: a Fibonacci lattice."""
    heights = (1.0 - (2 * n + 1) / count for n in range(count))
    return [(n * GOLDEN % 360.0, math.degrees(math.asin(height))) for n, height in enumerate(heights)]


def orbit(count: int, elevation: float) -> list[Direction]:
    """So many azimuths around the object, from 0 on, at one elevation."""
    return [(360.0 * n / count, elevation) for n in range(count)]
