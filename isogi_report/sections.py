"""Sections of a report: what was measured, as tables, plots and pictures, and as documents for JSON.

They know nothing of how they are drawn. What has no value in JSON (NaN, ∞) is null there.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

Cell = str | float | None
"""What stands in a table: words, a number in its column's unit, or nothing (it does not apply, or was not measured)."""

COLUMN_UNITS = ("text", "count", "share", "seconds", "bytes", "number")
"""Units of columns and axes. A ``share`` is a ratio, 1 for all of it; ``seconds`` are of the processor, all threads."""


@dataclass(frozen=True)
class Column:
    """The head of a column; its ``unit`` is one of COLUMN_UNITS."""

    name: str
    unit: str = "text"


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
    """Curves over one axis, and what the axes are; both are logarithmic."""

    caption: str
    x: Column
    y: Column
    curves: tuple[Curve, ...]


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture of a view, by its ``kind``.

    "radiance": ``pixels`` (h, w, 3) float32 linear RGB, 0 off the surface. "error": (h, w) float32 signed errors
    of the luminance over the mean luminance of the reference, NaN off the surface.
    """

    caption: str
    kind: str
    pixels: np.ndarray


@dataclass(frozen=True, eq=False)
class Section:
    """One question of a report and its answer. ``about`` says in a few sentences what was done and what is seen."""

    key: str
    title: str
    about: str
    tables: tuple[Table, ...] = ()
    plots: tuple[Plot, ...] = ()
    pictures: tuple[Picture, ...] = ()


Document = dict[str, Any]


def document_of(section: Section) -> Document:
    """Everything in a section but its pictures' pixels."""
    return {
        "key": section.key,
        "title": section.title,
        "about": section.about,
        "tables": [plain(asdict(table)) for table in section.tables],
        "plots": [plain(asdict(plot)) for plot in section.plots],
        "pictures": [{"caption": picture.caption, "kind": picture.kind} for picture in section.pictures],
    }


def section_of(document: Mapping[str, Any], pixels: Sequence[np.ndarray]) -> Section:
    """The section that a document and its pictures' pixels were made of."""
    pictures = [Picture(**each, pixels=array) for each, array in zip(document["pictures"], pixels, strict=True)]
    return Section(
        document["key"],
        document["title"],
        document["about"],
        tuple(map(table_of, document["tables"])),
        tuple(map(plot_of, document["plots"])),
        tuple(pictures),
    )


def table_of(document: Mapping[str, Any]) -> Table:
    """A table from its document."""
    columns = tuple(Column(**column) for column in document["columns"])
    return Table(document["caption"], columns, tuple(map(tuple, document["rows"])))


def plot_of(document: Mapping[str, Any]) -> Plot:
    """A plot from its document; points that have no value are NaN."""
    curves = tuple(
        Curve(curve["name"], tuple(map(number, curve["x"])), tuple(map(number, curve["y"])))
        for curve in document["curves"]
    )
    x, y = Column(**document["x"]), Column(**document["y"])
    return Plot(document["caption"], x, y, curves)


def number(value: float | None) -> float:
    """A number as JSON has it; NaN for null."""
    return math.nan if value is None else value


def plain(value: Any) -> Any:
    """``value`` in types that JSON has: NumPy's numbers as Python's, None for what is not finite."""
    if isinstance(value, Mapping):
        return {str(key): plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [plain(each) for each in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    return None if isinstance(value, float) and not math.isfinite(value) else value
