"""Cells of tables as text: each column in one unit, told in its head, with as many digits as its numbers are worth."""

from collections.abc import Sequence
from dataclasses import dataclass

from isogi_core.report.sections import Cell, Column, Table

NOTHING = "–"
"""What stands for a cell that does not apply or was not measured."""

PREFIXES: dict[str, tuple[tuple[str, float], ...]] = {
    "seconds": (("ms", 1e-3), ("s", 1.0)),
    "bytes": (("B", 1.0), ("KiB", 2.0**10), ("MiB", 2.0**20), ("GiB", 2.0**30)),
}
"""Names and sizes of what a column of a unit may be told in, from small to large."""


@dataclass(frozen=True)
class Told:
    """A column as it is written: its head, its cells, and whether they are numbers."""

    head: str
    cells: tuple[str, ...]
    numeric: bool


def told(table: Table) -> tuple[Told, ...]:
    """The columns of a table, as text."""
    return tuple(column_told(column, [row[i] for row in table.rows]) for i, column in enumerate(table.columns))


def column_told(column: Column, cells: Sequence[Cell]) -> Told:
    """One column as text."""
    numbers = [abs(cell) for cell in cells if isinstance(cell, int | float)]
    name, size = scale_of(column.unit, max(numbers, default=0.0))
    fine = column.unit == "share" and any(0.0 < number < 0.01 for number in numbers)
    texts = tuple(cell_text(cell, column.unit, size, 2 if fine else 1) for cell in cells)
    return Told(f"{column.name}, {name}" if name else column.name, texts, column.unit != "text")


def scale_of(unit: str, largest: float) -> tuple[str, float]:
    """Name and size of what a column's numbers are told in: the last that the ``largest`` reaches."""
    if unit == "share":
        return "%", 0.01
    steps = PREFIXES.get(unit, (("", 1.0),))
    return next((step for step in reversed(steps) if largest >= step[1]), steps[0])


def cell_text(cell: Cell, unit: str, size: float, decimals: int) -> str:
    """One cell: words as they are, nothing as a dash, a number over ``size``; shares have ``decimals``."""
    if cell is None:
        return NOTHING
    if isinstance(cell, str):
        return cell
    number = cell / size
    if unit == "share":
        return tiny_or(number, decimals)
    return signed(f"{number:,.0f}" if unit == "count" else digits(number))


def tiny_or(number: float, decimals: int) -> str:
    """A number with so many decimals; "< 0.01" where none of them would show it."""
    least = 10.0**-decimals
    if 0.0 < abs(number) < least / 2:
        return f"< {least:g}" if number > 0.0 else f"> −{least:g}"
    return signed(f"{number:,.{decimals}f}")


def digits(number: float) -> str:
    """A number with three digits; whole above a hundred, and with a power of ten where it is very small or large."""
    size = abs(number)
    if size >= 1e9 or 0.0 < size < 1e-4:
        return f"{number:.2e}"
    if size >= 100 or size == round(size):
        return f"{number:,.0f}"
    return f"{number:.3g}" if size < 0.1 else f"{number:.{2 if size < 10 else 1}f}"


def signed(text: str) -> str:
    """A number's text with a true minus sign, and none before nothing."""
    return "−" + text[1:] if text[0] == "-" and text.strip("-0.,") else text.removeprefix("-")
