"""What a frame's response says about itself."""

import re
import time
from pathlib import Path

import pytest

from isogi_core.frame.tiles import Stopwatch
from server.api.headers import STAGES, cache_status, coverage_header, matches, server_timing, time_left_header
from worker.progress import TimeLeft

ROOT = Path(__file__).resolve().parents[3]


@pytest.mark.parametrize(
    ("header", "matched"),
    [
        (None, False),
        ('"a"', True),
        ('W/"a"', True),
        ('"b", "a"', True),
        ("*", True),
        ('"b"', False),
        ("a", False),
        ("", False),
    ],
)
def test_if_none_match(header: str | None, matched: bool) -> None:
    assert matches(header, '"a"') is matched


@pytest.mark.parametrize(
    ("final", "provisional", "text"),
    [
        (1.0, 0.0, "final=1.000, converging=0.000, provisional=0.000"),
        (0.99999, 0.00001, "final=0.999, converging=0.000, provisional=0.001"),
        (0.25, 0.75, "final=0.250, converging=0.000, provisional=0.750"),
    ],
)
def test_coverage_never_says_all_where_some_is_missing(final: float, provisional: float, text: str) -> None:
    assert coverage_header({"provisional": provisional, "final": final, "converging": 0.0}) == text


def test_server_timing_is_in_milliseconds() -> None:
    watch = Stopwatch(time.perf_counter() - 2.0, {"primary": 0.0125, "encode": 1})
    stages = dict(stage.split(";dur=") for stage in server_timing(watch).split(", "))
    assert float(stages.pop("total")) == pytest.approx(2000.0, abs=100.0)
    assert stages == {"primary": "12.50", "encode": "1000.00"}
    assert stages.keys() < STAGES.keys()


def test_every_stage_that_is_timed_is_explained() -> None:
    sources = [path for room in ("isogi_core", "server") for path in (ROOT / room).rglob("*.py")]
    timed = {name for path in sources for name in re.findall(r'stage\("(\w+)"', path.read_text(encoding="utf-8"))}
    assert {"primary", "lobes", "encode"} <= timed <= STAGES.keys()


def test_time_left_is_in_seconds() -> None:
    assert time_left_header(TimeLeft(1.26, 20.0, 41.04)) == "low=1.3, likely=20.0, high=41.0"
    assert time_left_header(TimeLeft(0.004, 0.01, 0.04)) == "low=0.0, likely=0.0, high=0.1"


@pytest.mark.parametrize(
    ("needed", "final", "said"), [(0, 0, "hit"), (3, 3, "hit"), (3, 1, "fwd=partial"), (3, 0, "fwd=miss")]
)
def test_cache_status_tells_what_the_store_had(needed: int, final: int, said: str) -> None:
    assert cache_status(needed, final) == f"isogi-light; {said}"
