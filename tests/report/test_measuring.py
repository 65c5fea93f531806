"""The bar of a report: the time left that it shows."""

import math
import time
from types import SimpleNamespace

import pytest

from isogi_report import measuring
from isogi_report.measuring import Pieces
from server import progress


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """A clock that stands at its one number; of this module alone, as servers of other tests live by the true one."""
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


def test_the_bar_shows_it(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(progress, "REDRAW_SECONDS", 0.01)
    with Pieces("report", 2.0, 0.0, 3600.0).ticking() as bar:
        bar.begin("half of it")
        time.sleep(0.2)
        bar.finish(1.0)
    error = capsys.readouterr().err
    assert "half of it: " in error and "59:59 left" in error and "50 %" in error
