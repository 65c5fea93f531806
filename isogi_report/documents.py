"""Sections as documents of plain values, for JSON, and back: what has no value there (NaN, ∞) is null."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from isogi_report.sections import Column, Curve, Picture, Plot, Section, Table

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
