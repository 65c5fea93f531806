"""Sections of a report: what was measured, as tables, plots and pictures that know nothing of how they are drawn."""

from dataclasses import dataclass

import numpy as np

Cell = str | float | None
"""What stands in a table: words, a number in its column's unit, or nothing (it does not apply, or was not measured)."""

UNITS = ("text", "count", "share", "seconds", "bytes", "number")
"""Units of columns and axes. A ``share`` is a ratio, 1 for all of it; ``seconds`` are of the processor, all threads."""


@dataclass(frozen=True)
class Column:
    """The head of a column; its ``unit`` is one of UNITS."""

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
