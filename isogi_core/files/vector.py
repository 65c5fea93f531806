"""Vectors of three numbers, for data without arrays."""

from collections.abc import Iterable

Vector = tuple[float, float, float]


def triple(row: Iterable[float]) -> Vector:
    """Return three numbers as floats."""
    x, y, z = (float(value) for value in row)
    return x, y, z
