"""What clients prefer, what a frame's response says about itself, and binary answers, compressed
part by part.
"""

import re
import time
import zlib
from pathlib import Path

import numpy as np
import pytest

from isogi_core.frame.known_blocks import Part
from isogi_core.frame.tiles import Stopwatch
from isogi_server.api.headers import (
    STAGES,
    Preferences,
    cache_status,
    coverage_header,
    matches,
    preferences,
    server_timing,
    time_left_header,
)
from isogi_server.api.routes.card import gzipped
from isogi_server.parameters import FrameParams
from isogi_worker.progress import TimeLeft

ROOT = Path(__file__).resolve().parents[3]


@pytest.mark.parametrize(
    ("header", "matched"),
    [
        *[(header, True) for header in ('"a"', 'W/"a"', '"b", "a"', "*")],
        *[(header, False) for header in (None, '"b"', "a", "")],
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
def test_coverage_never_says_all_where_some_is_missing(
    final: float, provisional: float, text: str
) -> None:
    assert coverage_header({"provisional": provisional, "final": final, "converging": 0.0}) == text


def test_server_timing_is_in_milliseconds() -> None:
    watch = Stopwatch(time.perf_counter() - 2.0, {"primary": 0.0125, "encode": 1})
    stages = dict(stage.split(";dur=") for stage in server_timing(watch).split(", "))
    assert float(stages.pop("total")) == pytest.approx(2000.0, abs=100.0)
    assert stages == {"primary": "12.50", "encode": "1000.00"}
    assert stages.keys() < STAGES.keys()


def test_every_stage_that_is_timed_is_explained() -> None:
    sources = [path for room in ("isogi_core", "server") for path in (ROOT / room).rglob("*.py")]
    timed = {
        name
        for path in sources
        for name in re.findall(r'stage\("(\w+)"', path.read_text(encoding="utf-8"))
    }
    assert {"primary", "lobes", "encode"} <= timed <= STAGES.keys()


def test_time_left_is_in_seconds() -> None:
    assert time_left_header(TimeLeft(1.26, 20.0, 41.04)) == "low=1.3, likely=20.0, high=41.0"
    assert time_left_header(TimeLeft(0.004, 0.01, 0.04)) == "low=0.0, likely=0.0, high=0.1"


@pytest.mark.parametrize(
    ("light", "said"),
    [
        ((0, 0, False), "hit"),
        ((3, 3, False), "hit"),
        ((3, 1, False), "fwd=partial"),
        ((3, 0, False), "fwd=miss"),
        ((0, 0, True), "fwd=bypass"),
    ],
)
def test_cache_status_tells_what_the_store_had(light: tuple[int, int, bool], said: str) -> None:
    assert cache_status(*light) == f"isogi-light; {said}"


@pytest.mark.parametrize(
    ("headers", "wanted"),
    [
        *[([header], Preferences(5)) for header in ("wait=5", "Wait = 5", 'wait="5"')],
        *[
            (headers, Preferences(5, True))
            for headers in (["respond-async, wait=5"], ["respond-async", "wait=5"])
        ],
        *[(headers, Preferences(3)) for headers in (["wait=3, wait=5"], ["wait=3", "wait=5"])],
        *[([header], Preferences(10)) for header in ("wait=11", "wait=" + "9" * 5000)],
        *[
            ([header], Preferences(None, True))
            for header in ("respond-async; hurry=1", "wait=nan, respond-async")
        ],
        (["wait=0"], Preferences(0)),
        (["return=minimal; foo, handling=strict, wait=2"], Preferences(2)),
        (['lang="a \\", wait=4", wait=2'], Preferences(2)),
        *[(headers, Preferences()) for headers in ([], ["", "  "])],
        *[
            ([header], Preferences())
            for header in ('lang="a, respond-async, b"', 'lang="no end, respond-async')
        ],
        *[([f"wait{value}"], Preferences()) for value in ("", "=", "=-1", "=1.5", "=1e3", "=٣")],
        ([',,;=,"\\'], Preferences()),
    ],
)
def test_preferences_are_read_by_the_rfc_and_nonsense_ignored(
    headers: list[str], wanted: Preferences
) -> None:
    assert preferences(headers) == wanted


@pytest.mark.parametrize(
    "text", ['"' * 30_000, "\\" * 30_000, 'a="' + "\\" * 30_000, ("a," * 15_000)[:-1], "=;" * 9000]
)
def test_no_header_takes_long_to_read(text: str) -> None:
    assert preferences([text]) == Preferences()


def test_a_wait_is_that_of_the_parameter_where_there_is_one() -> None:
    plain = FrameParams()
    given = FrameParams(wait_ms=70)
    filled, applied = Preferences(5).fill(plain)
    assert (filled.wait_ms, applied) == (5000, {"Preference-Applied": "wait=5"})
    assert Preferences(5).fill(given) == (given, {})
    assert Preferences().fill(plain) == (plain, {})


RNG = np.random.default_rng(1)


def noise(size: int) -> bytes:
    """Bytes that hardly compress."""
    return RNG.integers(0, 256, size, np.uint8).tobytes()


@pytest.mark.parametrize(
    "data", [[], [b""], [b"light"], [noise(70_000), b"", bytes(70_000), noise(3)]]
)
def test_parts_are_one_member_of_gzip(data: list[bytes]) -> None:
    """Browsers read no second member; a reader checks the sum and the size at the end."""
    packed = gzipped([Part(each) for each in data])
    reader = zlib.decompressobj(16 + zlib.MAX_WBITS)
    assert reader.decompress(packed) + reader.flush() == b"".join(data)
    assert reader.eof and reader.unused_data == b""


def test_a_part_is_compressed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[int] = []
    pack = zlib.compressobj

    def counting(*options: int) -> object:
        made.append(1)
        return pack(*options)

    monkeypatch.setattr(zlib, "compressobj", counting)
    part = Part(bytes(1000))
    other = Part(noise(1000))
    assert len(gzipped([part, other])) > len(gzipped([part, part])) and len(made) == 2
    assert part.digest == Part(bytes(1000)).digest != other.digest
