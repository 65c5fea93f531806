"""Spans of time, read and written."""

import pytest

from server.values import seconds_of, seconds_of_age, span


@pytest.mark.parametrize(
    ("text", "seconds"), [("90", 90), ("90s", 90), ("10m", 600), ("1.5h", 5400), ("1h", 3600), ("0", 0)]
)
def test_a_span_of_time_is_read(text: str, seconds: float) -> None:
    assert seconds_of(text) == seconds


@pytest.mark.parametrize("text", ["", "-1", "soon", "10 m", "1d", "nan", "inf", "1_0s", "m", "9e99h", "1" * 50])
def test_what_is_no_span_of_time_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="such as 90, 90s, 10m or 1h"):
        seconds_of(text)


@pytest.mark.parametrize(
    ("seconds", "digits", "text"),
    [
        (0.0, 3, "0 s"),
        (1e-5, 3, "0 s"),
        (0.0176, 3, "17.6 ms"),
        (0.2, 3, "200 ms"),
        (1, 3, "1 s"),
        (12.345, 3, "12.3 s"),
        (90, 3, "1.5 min"),
        (200, 2, "3.3 min"),
        (3600, 3, "1 h"),
        (7.2e6, 3, "2,000 h"),
    ],
)
def test_a_span_of_time_is_told(seconds: float, digits: int, text: str) -> None:
    assert span(seconds, digits) == text


@pytest.mark.parametrize(
    ("text", "seconds"), [("30d", 2592000.0), ("1.5d", 129600.0), ("2w", 1209600.0), ("12h", 43200.0)]
)
def test_ages_may_be_told_in_days_and_weeks(text: str, seconds: float) -> None:
    assert seconds_of_age(text) == seconds


@pytest.mark.parametrize("text", ["", "d", "-1d", "-1h", "1dd", "soon", "1e99999999999d" * 5])
def test_what_is_no_age_is_told(text: str) -> None:
    with pytest.raises(ValueError, match="30d"):
        seconds_of_age(text)
