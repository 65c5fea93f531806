"""Numbers, rows of numbers, words and spans of time, as people write them."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from isogi_server.values import Choice, Row, Span, finite, seconds_of, seconds_of_age, shown, span

HOSTILE = [
    *(
        "nan",
        "NaN",
        "inf",
        "-inf",
        "Infinity",
        "1e999",
        "-1e999",
        "1_0",
        "1__0",
        "0x10",
        "1e",
        "e5",
        ".",
    ),
    *(
        "",
        " ",
        " 1",
        "1 ",
        "1,0",
        "1;2",
        "+",
        "--1",
        "٣",
        "１",
        "½",
        "1e5e5",
        "None",
        "true",
        "\x00",
        "1\n",
    ),
    "9" * 70,
]


@pytest.mark.parametrize("text", HOSTILE)
def test_hostile_text_is_no_number(text: str) -> None:
    with pytest.raises(ValueError, match="must be a number from -10 to 10"):
        Span(-10, 10).read(text)
    with pytest.raises(ValueError, match="must be a whole number from 1 to 512"):
        Span(1, 512, whole=True).read(text)


def test_half_a_surrogate_pair_can_be_told() -> None:
    assert shown("a\ud800").encode() == b"'a\\ud800'"


@pytest.mark.parametrize("value", [None, True, [], {}, object(), b"1", math.inf, 10**400])
def test_other_things_are_no_number(value: object) -> None:
    assert math.isnan(finite(value))


@pytest.mark.parametrize(
    ("text", "number"), [("1", 1), ("-.5", -0.5), ("+2.", 2), ("1e-3", 0.001), ("0010", 10)]
)
def test_plain_numbers(text: str, number: float) -> None:
    assert Span(-10, 10).read(text) == number


@given(st.floats(-1e9, 1e9))
def test_every_written_float_comes_back(number: float) -> None:
    assert Span(-1e9, 1e9).read(repr(number)) == number
    assert Span(-1e9, 1e9).read(number) == number


@pytest.mark.parametrize("text", ["10.000001", "-10.1", "1e3"])
def test_the_complaint_has_range_and_what_was_given(text: str) -> None:
    with pytest.raises(ValueError, match=rf"^must be a number from -10 to 10, not '{text}'\.$"):
        Span(-10, 10).read(text)


@pytest.mark.parametrize("text", ["1.0", "1e2", "0", "513", "1.5", "-1"])
def test_whole_numbers_are_whole(text: str) -> None:
    with pytest.raises(ValueError, match="whole number from 1 to 512"):
        Span(1, 512, whole=True).read(text)


def test_what_was_given_is_cut_short() -> None:
    with pytest.raises(ValueError, match="…") as caught:
        Span(0, 1).read("x" * 10_000)
    assert len(str(caught.value)) < 120


def test_a_row_of_numbers() -> None:
    assert Row(("x", "y", "z")).read("1,-2.5,3e2") == (1.0, -2.5, 300.0)
    assert Row(("x", "y", "z")).read([1, -2.5, 300]) == (1.0, -2.5, 300.0)


@pytest.mark.parametrize(
    "text", ["", "1,2", "1,2,3,4", "1,2,", "1, 2,3", "1,nan,3", "1,2,inf", "1,2,1e13", None, 5]
)
def test_a_row_that_is_none(text: object) -> None:
    with pytest.raises(ValueError, match="must be 3 finite numbers x,y,z"):
        Row(("x", "y", "z")).read(text)


def test_a_choice_of_words() -> None:
    assert Choice(("png", "npy")).read("npy") == "npy"
    with pytest.raises(ValueError, match=r"^must be one of png, npy, not 'PNG'\.$"):
        Choice(("png", "npy")).read("PNG")


SPANS = {"90": 90, "90s": 90, "10m": 600, "1.5h": 5400, "1h": 3600, "0": 0, "12h": 43200}
AGES = {"30d": 2592000, "1.5d": 129600, "2w": 1209600, "12h": 43200}


@pytest.mark.parametrize("text", SPANS)
def test_a_span_of_time_is_read(text: str) -> None:
    assert seconds_of(text) == SPANS[text]


@pytest.mark.parametrize("text", AGES)
def test_ages_may_be_told_in_days_and_weeks(text: str) -> None:
    assert seconds_of_age(text) == AGES[text]


@pytest.mark.parametrize(
    "text", ["", "-1", "soon", "10 m", "1d", "nan", "inf", "1_0s", "m", "9e99h", "1" * 50]
)
def test_what_is_no_span_of_time_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="such as 90, 90s, 10m or 1h"):
        seconds_of(text)


@pytest.mark.parametrize(
    ("seconds", "digits", "text"),
    [
        *[
            (0.0, 3, "0 s"),
            (1e-5, 3, "0 s"),
            (0.0176, 3, "17.6 ms"),
            (0.2, 3, "200 ms"),
            (1, 3, "1 s"),
        ],
        *[
            (12.345, 3, "12.3 s"),
            (90, 3, "1.5 min"),
            (200, 2, "3.3 min"),
            (3600, 3, "1 h"),
            (7.2e6, 3, "2,000 h"),
        ],
    ],
)
def test_a_span_of_time_is_told(seconds: float, digits: int, text: str) -> None:
    assert span(seconds, digits) == text


@pytest.mark.parametrize("text", ["", "d", "-1d", "-1h", "1dd", "soon", "1e99999999999d" * 5])
def test_what_is_no_age_is_told(text: str) -> None:
    with pytest.raises(ValueError, match="30d"):
        seconds_of_age(text)
