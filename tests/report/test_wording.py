"""What a report writes and shows: cells by their column's unit, where its view stands, and the time
left.
"""

import math
import time
from types import SimpleNamespace

import pytest

from isogi_core.model.view import Camera, orbit, orthographic
from isogi_report import measuring
from isogi_report.heading import standpoint
from isogi_report.measuring import Pieces
from isogi_report.sections import Cell, Column, Table, text_column, text_columns
from isogi_server import clocks


@pytest.mark.parametrize(
    ("unit", "cells", "head", "texts"),
    [
        ("text", ["as it is"], "x", ["as it is"]),
        ("share", [0.0971, 1.5, None], "x, %", ["9.7", "150.0", "–"]),
        (
            "share",
            [0.0041, -0.0123, 0.00002, -0.00002, 0.0],
            "x, %",
            ["0.41", "−1.23", "< 0.01", "> −0.01", "0.00"],
        ),
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
def test_a_column_is_told_in_one_unit(
    unit: str, cells: list[Cell], head: str, texts: list[str]
) -> None:
    column = text_column(Column("x", unit), cells)
    assert (column.head.replace("\u00a0", " "), list(column.cells)) == (head, texts)
    assert column.numeric is (unit != "text")


def test_a_table_is_told_column_by_column() -> None:
    table = Table("", (Column("who"), Column("error", "share")), (("a", 0.5), ("b", None)))
    assert [column.cells for column in text_columns(table)] == [("a", "b"), ("50.0", "–")]


RADIUS = 20.0


@pytest.fixture
def camera() -> Camera:
    return orbit((10.0, 10.0, 10.0), RADIUS, 90.0, 0.0, 3.0, 30.0)


def test_a_camera_in_perspective_says_where_it_stands(camera: Camera) -> None:
    assert standpoint(camera) == "from 10, 70, 10, 30 degrees high"


def test_an_orthographic_camera_says_where_it_looks(camera: Camera) -> None:
    """Its eye, ten million radii away, is of no use to a person."""
    height = 2.0 * 60.0 * math.tan(math.radians(15.0))
    told = standpoint(orthographic(camera, RADIUS))
    assert told.startswith("orthographic, along ") and told.endswith(
        f" to 10, 10, 10, {height:.4g} high there"
    )
    assert "-1," in told


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """A clock that stands at its one number; of this module alone, as servers of other tests live
    by the true one.
    """
    now = [100.0]
    monkeypatch.setattr(measuring, "time", SimpleNamespace(monotonic=lambda: now[0]))
    return now


def test_time_left_is_told_from_what_was_done(clock: list[float]) -> None:
    bar = Pieces("report", 10.0, 2.0, math.inf)
    assert bar.left == math.inf
    bar.begin("two of eight")
    clock[0] += 6.0
    bar.finish(2.0)
    assert bar.left == pytest.approx(18.0)
    clock[0] += 5.0
    assert bar.left == pytest.approx(13.0)
    clock[0] += 50.0
    assert bar.left == 0.0, "later than thought, and still at work"


def test_time_left_is_never_more_than_the_limit(clock: list[float]) -> None:
    bar = Pieces("report", 10.0, 0.0, 20.0)
    assert bar.left == 20.0
    bar.begin("a tenth")
    clock[0] += 5.0
    bar.finish(1.0)
    assert bar.left == 15.0


def test_the_bar_shows_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(clocks, "REDRAW_SECONDS", 0.01)
    with Pieces("report", 2.0, 0.0, 3600.0).ticking() as bar:
        bar.begin("half of it")
        time.sleep(0.2)
        bar.finish(1.0)
    error = capsys.readouterr().err
    assert "half of it: " in error and "59:59 left" in error and "50 %" in error
