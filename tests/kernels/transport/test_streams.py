"""The table of random numbers: no two purposes draw the same ones, and no other file has numbers of its own."""

import ast
from pathlib import Path

import isogi_core
from isogi_core.kernels.transport import streams

TABLE = Path(streams.__file__)
WORD = 1 << 32


def test_no_two_purposes_of_a_path_draw_the_same_pair() -> None:
    last = 0
    for first, count in streams.PURPOSES:
        assert first >= last and count >= streams.PAIRS_PER_PURPOSE
        last = first + count
    assert last <= WORD


def test_streams_lie_apart_by_all_their_replicas() -> None:
    """A control's halves, a wall's sides and a reference's replicas are numbered from the stream's number on."""
    gaps = [b - a for a, b in zip(streams.STREAMS, streams.STREAMS[1:], strict=False)]
    assert min(gaps) >= 1 << 16 and max(streams.STREAMS) < WORD


def test_every_stream_and_purpose_is_in_its_list() -> None:
    """What a new line of the table forgets to list is not checked by the tests above."""
    sizes = {"PAIRS_PER_PURPOSE", "MAX_CROSSINGS", "MAX_STEPS"}
    given = {name: number for name, number in vars(streams).items() if isinstance(number, int) and name not in sizes}
    purposes = {first for first, _ in streams.PURPOSES}
    shine = {name for name in given if name.startswith("SHINE_") and name != "SHINE_STREAM"}
    assert {number for name, number in given.items() if name not in shine} == purposes | {*streams.STREAMS}


def test_numbers_that_stored_light_was_drawn_by_never_change() -> None:
    assert streams.STREAMS == (0, 1 << 16, 1 << 17, 1 << 18, 1 << 19, 1 << 20, 1 << 21, 1 << 24)
    firsts = [0, 1, 0x7FFF - 65, 0x7FFF - 64, 0x7FFF, 0x8000]
    assert [first / (1 << 16) for first, _ in streams.PURPOSES] == firsts


def test_streams_are_numbered_in_one_file() -> None:
    """No module gives a number to a stream: who adds one sees all others."""
    found = []
    for path in Path(isogi_core.__file__).parent.rglob("*.py"):
        for node in ast.parse(path.read_text()).body:
            names = [each.id for each in getattr(node, "targets", []) if isinstance(each, ast.Name)]
            found += [(path.name, name) for name in names if "STREAM" in name and path != TABLE]
    assert not found
