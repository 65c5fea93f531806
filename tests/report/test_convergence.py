"""Error against run time: curves that fall, and the break-even against curves whose time follows from the error."""

import pytest

from isogi_report import studies
from isogi_report.bench import Bench
from isogi_report.sections import Curve
from isogi_report.studies import EQUAL_ERROR_COLUMNS, even, evens, seconds_at
from tests.toil import PACE, measure_toil

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
    assert len(table.rows[0]) == len(EQUAL_ERROR_COLUMNS)


@pytest.mark.slow
def test_curves_fall_with_time(under_sky: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each point of baked light has cost all samples up to its own, each of traced paths its own alone."""
    measure_toil(monkeypatch)
    monkeypatch.setattr(studies, "CURVE_SAMPLES", (16, 64))
    monkeypatch.setattr(studies, "CURVE_PIXELS", 12)
    (plot,) = studies.study_convergence(under_sky).plots
    assert [curve.x for curve in plot.curves[3:]] == [(16 * 12 * 12 / PACE, 64 * 12 * 12 / PACE)]
    for curve in plot.curves:
        assert 0 < curve.x[0] == curve.x[1] / 4
        assert curve.y[1] < 1.2 * curve.y[0]
