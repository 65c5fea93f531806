"""Sections of a report: results as tables, plots and pictures, as documents for JSON, and as text
of cells.

Sections do not depend on how they are drawn. Values that JSON lacks (NaN, ∞) are null there. Each
column of a table is written in one unit, which its head names, with as many digits as its numbers
justify.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any, Literal

import numpy as np

Cell = str | float | None
"""A cell of a table: words, a number in its column's unit,
or None if it does not apply or was not measured.
"""

Unit = Literal["text", "count", "share", "seconds", "bytes", "number"]
"""Unit of a column or an axis. A ``share`` is a ratio, 1 for all of it;
``seconds`` are of the processor, all threads together.
"""


@dataclass(frozen=True)
class Column:
    """The head of a column."""

    name: str
    unit: Unit = "text"


@dataclass(frozen=True)
class Table:
    """Rows of cells under ``columns``."""

    caption: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]


@dataclass(frozen=True)
class Curve:
    """Points of a plot, in the order of ``x``."""

    name: str
    x: tuple[float, ...]
    y: tuple[float, ...]


@dataclass(frozen=True)
class Plot:
    """Curves over one axis, with the names of both axes, which are logarithmic."""

    caption: str
    x: Column
    y: Column
    curves: tuple[Curve, ...]


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture of a view, by its ``kind``.

    - "radiance": ``pixels`` (h, w, 3) float32 are linear RGB, 0 off the surface.
    - "error": ``pixels`` (h, w) float32 are signed errors of the luminance relative to the
      reference's mean luminance, NaN off the surface.
    """

    caption: str
    kind: str
    pixels: np.ndarray


@dataclass(frozen=True, eq=False)
class Section:
    """One question of a report and its answer.

    ``about`` explains the measurement and the results in a few sentences.
    """

    key: str
    title: str
    about: str
    tables: tuple[Table, ...] = ()
    plots: tuple[Plot, ...] = ()
    pictures: tuple[Picture, ...] = ()


Document = dict[str, Any]


def document_of(section: Section) -> Document:
    """Return a section as a document, without its pictures' pixels."""
    return {
        "key": section.key,
        "title": section.title,
        "about": section.about,
        "tables": [plain(asdict(table)) for table in section.tables],
        "plots": [plain(asdict(plot)) for plot in section.plots],
        "pictures": [
            {"caption": picture.caption, "kind": picture.kind} for picture in section.pictures
        ],
    }


def section_of(document: Mapping[str, Any], pixels: Sequence[np.ndarray]) -> Section:
    """Make a section of a ``document`` from ``document_of`` and of ``pixels``, the arrays of its
    pictures in their order.

    Numbers that were not finite come back as NaN in plots, and as None in tables. Raises KeyError,
    TypeError or ValueError if the document is damaged.
    """
    pictures = [
        Picture(**each, pixels=array)
        for each, array in zip(document["pictures"], pixels, strict=True)
    ]
    return Section(
        document["key"],
        document["title"],
        document["about"],
        tuple(map(table_of, document["tables"])),
        tuple(map(plot_of, document["plots"])),
        tuple(pictures),
    )


def table_of(document: Mapping[str, Any]) -> Table:
    """Return a table from its document."""
    columns = tuple(Column(**column) for column in document["columns"])
    return Table(document["caption"], columns, tuple(map(tuple, document["rows"])))


def plot_of(document: Mapping[str, Any]) -> Plot:
    """Return a plot from its document; points without a value are NaN."""
    curves = tuple(
        Curve(curve["name"], tuple(map(number, curve["x"])), tuple(map(number, curve["y"])))
        for curve in document["curves"]
    )
    x, y = Column(**document["x"]), Column(**document["y"])
    return Plot(document["caption"], x, y, curves)


def number(value: float | None) -> float:
    """Return a number from JSON; NaN for null."""
    return math.nan if value is None else value


def plain(value: Any) -> Any:
    """Return ``value`` in types that JSON has:
    NumPy's numbers as Python's, None for numbers that are not finite.
    """
    if isinstance(value, Mapping):
        return {str(key): plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [plain(each) for each in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


EMPTY_CELL = "–"
"""Text of a cell that does not apply or was not measured."""

NO_BREAK_SPACE = "\u00a0"
"""A space at which no line breaks."""

PREFIXES: dict[str, tuple[tuple[str, float], ...]] = {
    "seconds": (("ms", 1e-3), ("s", 1.0)),
    "bytes": (("B", 1.0), ("KiB", 2.0**10), ("MiB", 2.0**20), ("GiB", 2.0**30)),
}
"""Names and sizes of the units that a column may be written in, from small to large."""


@dataclass(frozen=True)
class TextColumn:
    """A column as text: its head, its cells, and ``numeric``, True if they are numbers."""

    head: str
    cells: tuple[str, ...]
    numeric: bool


def text_columns(table: Table) -> tuple[TextColumn, ...]:
    """Return the columns of a table as text."""
    return tuple(
        text_column(column, [row[i] for row in table.rows])
        for i, column in enumerate(table.columns)
    )


def text_column(column: Column, cells: Sequence[Cell]) -> TextColumn:
    """Return one column as text: words as they are, numbers in one unit,
    a dash for None and for numbers that are not finite.
    """
    numbers = [
        float(cell) for cell in cells if isinstance(cell, int | float) and math.isfinite(cell)
    ]
    # One unit and one number of digits for the whole column, so that its numbers can be compared.
    name, size = scale_of(column.unit, max(map(abs, numbers), default=0.0))
    write = writer(column.unit, [number / size for number in numbers])

    def text(cell: Cell) -> str:
        """Return a cell as text."""
        if isinstance(cell, str):
            return cell
        if cell is not None and math.isfinite(cell):
            return write(cell / size)
        return EMPTY_CELL

    if name:
        head = f"{column.name},{NO_BREAK_SPACE}{name}"
    else:
        head = column.name
    return TextColumn(head, tuple(map(text, cells)), column.unit != "text")


def scale_of(unit: str, largest: float) -> tuple[str, float]:
    """Return name and size of the unit of a column's numbers:
    the largest that ``largest`` reaches.
    """
    if unit == "share":
        return "%", 0.01
    steps = PREFIXES.get(unit, (("", 1.0),))
    return next((step for step in reversed(steps) if largest >= step[1]), steps[0])


def writer(unit: str, numbers: Sequence[float]) -> Callable[[float], str]:
    """Return the function that writes the ``numbers`` of a column.

    Percents have one decimal, or two if any is below 1. Other numbers have three digits each or,
    below 1, the decimals that give the largest of them three.
    """
    if unit == "share":
        small = any(0.0 < abs(number) < 1.0 for number in numbers)
        return partial(decimal, decimals=2 if small else 1)
    largest = max(map(abs, numbers), default=0.0)
    if unit == "count" or all(number == round(number) for number in numbers):
        return partial(decimal, decimals=0)
    # The decimals that give the largest number three digits.
    if 1e-4 < largest < 1.0:
        return partial(decimal, decimals=2 - math.floor(math.log10(largest)))
    return digits


def decimal(number: float, decimals: int) -> str:
    """Return a number with this many decimals; "< 0.01" if none of them would show it."""
    # A small number must not look like zero.
    least = 10.0**-decimals
    if decimals and 0.0 < abs(number) < least / 2:
        if number > 0.0:
            return f"< {least:g}"
        return f"> −{least:g}"
    return signed(f"{number:,.{decimals}f}")


def digits(number: float) -> str:
    """Return a number with three digits: whole above a hundred,
    with a power of ten if it is very small or large.
    """
    size = abs(number)
    if size >= 1e9 or 0.0 < size < 1e-4:
        return signed(f"{number:.2e}")
    if size >= 99.95 or not size:
        return signed(f"{number:,.0f}")
    return signed(f"{number:#.3g}")


def signed(text: str) -> str:
    """Return a number's text with a true minus sign, and none before zero."""
    if text[0] == "-" and text.strip("-0.,"):
        return "−" + text[1:]
    return text.removeprefix("-")
