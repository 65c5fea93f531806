"""What clients prefer: how it is read, and what it changes in an answer."""

import pytest

from server.api.headers import Preferences, preferences
from server.parameters import FrameParams


@pytest.mark.parametrize(
    ("headers", "wanted"),
    [
        ([], Preferences()),
        (["wait=5"], Preferences(5)),
        (["Wait = 5"], Preferences(5)),
        (['wait="5"'], Preferences(5)),
        (["wait=0"], Preferences(0)),
        (["respond-async, wait=5"], Preferences(5, True)),
        (["respond-async", "wait=5"], Preferences(5, True)),
        (["respond-async; hurry=1"], Preferences(None, True)),
        (["wait=3, wait=5"], Preferences(3)),
        (["wait=3", "wait=5"], Preferences(3)),
        (["wait=11"], Preferences(10)),
        (["wait=" + "9" * 5000], Preferences(10)),
        (["return=minimal; foo, handling=strict, wait=2"], Preferences(2)),
        (['lang="a, respond-async, b"'], Preferences()),
        (['lang="a \\", wait=4", wait=2'], Preferences(2)),
        (['lang="no end, respond-async'], Preferences()),
        (["wait"], Preferences()),
        (["wait="], Preferences()),
        (["wait=-1"], Preferences()),
        (["wait=1.5"], Preferences()),
        (["wait=1e3"], Preferences()),
        (["wait=٣"], Preferences()),
        (["wait=nan, respond-async"], Preferences(None, True)),
        ([',,;=,"\\'], Preferences()),
        (["", "  "], Preferences()),
    ],
)
def test_preferences_are_read_by_the_rfc_and_nonsense_ignored(headers: list[str], wanted: Preferences) -> None:
    assert preferences(headers) == wanted


@pytest.mark.parametrize(
    "text", ['"' * 30_000, "\\" * 30_000, 'a="' + "\\" * 30_000, ("a," * 15_000)[:-1], "=;" * 9000]
)
def test_no_header_takes_long_to_read(text: str) -> None:
    assert preferences([text]) == Preferences()


def test_a_wait_is_that_of_the_parameter_where_there_is_one() -> None:
    plain, given = FrameParams(), FrameParams(wait_ms=70)
    filled, applied = Preferences(5).fill(plain)
    assert (filled.wait_ms, applied) == (5000, {"Preference-Applied": "wait=5"})
    assert Preferences(5).fill(given) == (given, {})
    assert Preferences().fill(plain) == (plain, {})
