"""How figures of a report are written: cells by their column's unit."""

import math

import pytest

from isogi_report.sections import Cell, Column, Table, text_column, text_columns


@pytest.mark.parametrize(
    ("unit", "cells", "head", "texts"),
    [
        ("text", ["as it is"], "x", ["as it is"]),
        ("share", [0.0971, 1.5, None], "x, %", ["9.7", "150.0", "–"]),
        ("share", [0.0041, -0.0123, 0.00002, -0.00002, 0.0], "x, %", ["0.41", "−1.23", "< 0.01", "> −0.01", "0.00"]),
        ("seconds", [12.31, 0.4, 140.2, 2000.0], "x, s", ["12.3", "0.400", "140", "2,000"]),
        ("seconds", [0.0176, 0.9], "x, ms", ["17.6", "900"]),
        ("bytes", [59.0, 300.0], "x, B", ["59", "300"]),
        ("bytes", [2.0**20, 2.0**19], "x, MiB", ["1.00", "0.500"]),
        ("count", [48211.0, 3], "x", ["48,211", "3"]),
        ("number", [0.0456, 0.04, "many", -0.0001], "x", ["0.0456", "0.0400", "many", "−0.0001"]),
        ("number", [0.5, 0.04, 0.0001], "x", ["0.500", "0.040", "< 0.001"]),
        ("number", [1e-7, 2.0], "x", ["1.00e-07", "2.00"]),
        ("number", [4096.0, 2.0], "x", ["4,096", "2"]),
        ("share", [], "x, %", []),
        ("share", [0.5, math.nan, -math.inf], "x, %", ["50.0", "–", "–"]),
        ("seconds", [math.inf, 0.5], "x, ms", ["–", "500"]),
        ("number", [math.nan, 3.0], "x", ["–", "3"]),
    ],
)
def test_a_column_is_told_in_one_unit(unit: str, cells: list[Cell], head: str, texts: list[str]) -> None:
    column = text_column(Column("x", unit), cells)
    assert (column.head.replace("\u00a0", " "), list(column.cells)) == (head, texts)
    assert column.numeric is (unit != "text")


def test_a_table_is_told_column_by_column() -> None:
    table = Table("", (Column("who"), Column("error", "share")), (("a", 0.5), ("b", None)))
    assert [column.cells for column in text_columns(table)] == [("a", "b"), ("50.0", "–")]
