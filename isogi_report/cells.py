"""Cells of tables as text: each column in one unit, named in its head, with as many digits as its numbers are worth."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

from isogi_report.sections import Cell, Column, Table

EMPTY_CELL = "–"
"""What stands for a cell that does not apply or was not measured."""

NO_BREAK_SPACE = "\u00a0"
"""A space that no line breaks at."""

PREFIXES: dict[str, tuple[tuple[str, float], ...]] = {
    "seconds": (("ms", 1e-3), ("s", 1.0)),
    "bytes": (("B", 1.0), ("KiB", 2.0**10), ("MiB", 2.0**20), ("GiB", 2.0**30)),
}
"""Names and sizes of what a column of a unit may be written in, from small to large."""


@dataclass(frozen=True)
class TextColumn:
    """A column as it is written: its head, its cells, and whether they are numbers."""

    head: str
    cells: tuple[str, ...]
    numeric: bool


def text_columns(table: Table) -> tuple[TextColumn, ...]:
    """The columns of a table, as text."""
    return tuple(text_column(column, [row[i] for row in table.rows]) for i, column in enumerate(table.columns))


def text_column(column: Column, cells: Sequence[Cell]) -> TextColumn:
    """One column as text: words as they are, numbers alike, a dash for nothing and for what is not finite."""
    numbers = [float(cell) for cell in cells if isinstance(cell, int | float) and math.isfinite(cell)]
    name, size = scale_of(column.unit, max(map(abs, numbers), default=0.0))
    write = writer(column.unit, [number / size for number in numbers])

    def text(cell: Cell) -> str:
        if isinstance(cell, str):
            return cell
        return write(cell / size) if cell is not None and math.isfinite(cell) else EMPTY_CELL

    head = f"{column.name},{NO_BREAK_SPACE}{name}" if name else column.name
    return TextColumn(head, tuple(map(text, cells)), column.unit != "text")


def scale_of(unit: str, largest: float) -> tuple[str, float]:
    """Name and size of what a column's numbers are written in: the last that the ``largest`` reaches."""
    if unit == "share":
        return "%", 0.01
    steps = PREFIXES.get(unit, (("", 1.0),))
    return next((step for step in reversed(steps) if largest >= step[1]), steps[0])


def writer(unit: str, numbers: Sequence[float]) -> Callable[[float], str]:
    """What writes the ``numbers`` of a column: percents with the decimals that the smallest needs, 2 at most.

    Others have three digits each, or, below 1, the decimals that give the largest three.
    """
    if unit == "share":
        return partial(decimal, decimals=2 if any(0.0 < abs(number) < 1.0 for number in numbers) else 1)
    largest = max(map(abs, numbers), default=0.0)
    if unit == "count" or all(number == round(number) for number in numbers):
        return partial(decimal, decimals=0)
    return partial(decimal, decimals=2 - math.floor(math.log10(largest))) if 1e-4 < largest < 1.0 else digits


def decimal(number: float, decimals: int) -> str:
    """A number with so many decimals; "< 0.01" where none of them would show it."""
    least = 10.0**-decimals
    if decimals and 0.0 < abs(number) < least / 2:
        return f"< {least:g}" if number > 0.0 else f"> −{least:g}"
    return signed(f"{number:,.{decimals}f}")


def digits(number: float) -> str:
    """A number with three digits; whole above a hundred, and with a power of ten where it is very small or large."""
    size = abs(number)
    if size >= 1e9 or 0.0 < size < 1e-4:
        return signed(f"{number:.2e}")
    return signed(f"{number:,.0f}" if size >= 99.95 or not size else f"{number:#.3g}")


def signed(text: str) -> str:
    """A number's text with a true minus sign, and none before nothing."""
    return "−" + text[1:] if text[0] == "-" and text.strip("-0.,") else text.removeprefix("-")
