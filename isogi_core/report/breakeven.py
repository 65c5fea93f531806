"""The break-even of baked light: after how many pictures it is cheaper than paths from each pixel of each."""

import math
from bisect import bisect_left
from collections.abc import Iterable

from isogi_core.report.sections import Cell, Column, Curve, Table

NEAR = 1.1
"""How many times the error that a curve ends at its point may have that stands for the whole bake."""

COLUMNS = (
    Column("way"),
    Column("relative RMSE", "share"),
    Column("bake", "seconds"),
    Column("a traced picture of that error", "seconds"),
    Column("pictures until the bake pays", "count"),
)


def evens(baked: Iterable[Curve], traced: Curve, size: str) -> Table:
    """The break-even of each ``baked`` curve of seconds and errors against the ``traced`` one; ``size`` in words."""
    rows = tuple(even(curve, traced) for curve in baked)
    return Table(f"When baked light pays, {size}", COLUMNS, rows)


def even(baked: Curve, traced: Curve) -> tuple[Cell, ...]:
    """A way's row of the table, of its cheapest point that is nearly as good as its last one."""
    seconds, error = next((x, y) for x, y in zip(baked.x, baked.y, strict=True) if y <= NEAR * baked.y[-1])
    picture = seconds_at(traced, error)
    pictures = None if picture is None else math.ceil(seconds / picture)
    return baked.name, error, seconds, picture, pictures


def seconds_at(curve: Curve, error: float) -> float | None:
    """The seconds after which a curve has come to an error, linear in their logarithms between its points.

    Beyond its first and last point the line through the nearest two goes on. None where that never meets the error:
    the curve has a single point, does not fall, or its error is 0.
    """
    if len(curve.x) < 2 or min(error, *curve.y) <= 0.0:
        return None
    i = min(max(bisect_left([-y for y in curve.y], -error), 1), len(curve.x) - 1)
    (x0, x1), (y0, y1) = ([math.log(v) for v in values[i - 1 : i + 1]] for values in (curve.x, curve.y))
    if y1 >= y0 or x1 <= x0:
        return None
    return math.exp(x0 + (math.log(error) - y0) * (x1 - x0) / (y1 - y0))
