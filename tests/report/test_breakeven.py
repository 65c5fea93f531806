"""The break-even of baked light, against curves whose time follows from the error."""

import pytest

from isogi_core.report.breakeven import COLUMNS, even, evens, seconds_at
from isogi_core.report.sections import Curve

TRACED = Curve("paths", (0.01, 0.04, 0.16, 0.64), (0.08, 0.04, 0.02, 0.01))
"""Seconds are 6.4e-5 over the square of the error."""


@pytest.mark.parametrize("error", [0.5, 0.08, 0.05, 0.02, 0.013, 0.01, 0.001])
def test_seconds_follow_the_law_between_points_and_beyond(error: float) -> None:
    assert seconds_at(TRACED, error) == pytest.approx(6.4e-5 / error**2)


def test_a_curve_that_does_not_get_there_has_no_seconds() -> None:
    assert seconds_at(Curve("level", (1.0, 2.0), (0.1, 0.1)), 0.05) is None
    assert seconds_at(Curve("short", (1.0,), (0.1,)), 0.05) is None
    assert seconds_at(TRACED, 0.0) is None


def test_a_bake_counts_at_its_cheapest_good_point() -> None:
    baked = Curve("baked", (1.0, 3.0, 9.0), (0.1, 0.041, 0.04))
    name, error, seconds, picture, pictures = even(baked, TRACED)
    assert (name, error, seconds) == ("baked", 0.041, 3.0)
    assert picture == pytest.approx(6.4e-5 / 0.041**2)
    assert pictures == 79
    table = evens([baked], TRACED, "4 × 4 pixels")
    assert len(table.rows[0]) == len(COLUMNS)
