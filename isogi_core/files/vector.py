"""Vectors: three numbers, of what has no arrays."""

from collections.abc import Iterable

Vector = tuple[float, float, float]


def triple(row: Iterable[float]) -> Vector:
    """Three numbers as floats."""
    x, y, z = (float(value) for value in row)
    return x, y, z
