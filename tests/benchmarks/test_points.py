"""Low-discrepancy against random points: its arithmetic, and that random points are random."""

import json
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from benchmarks import points
from benchmarks.points import Point, error, random, ratios
from isogi_core.report.reference import STREAM


def test_ratios_are_at_equal_time() -> None:
    """Random errors 8 t^-1/2; the others have 2, 1, 0.5 at times of their own, within and beyond the others'."""
    found = ratios(
        [Point(1, 2.0, 1.0, 8.0, 1.0), Point(2, 1.0, 2.0, 4.0, 4.0), Point(3, 0.5, 64.0, 2.0, 16.0)],
    )
    assert found == pytest.approx([4.0, 8.0 / np.sqrt(2.0), 2.0])


def test_errors_are_without_the_noise_of_the_reference() -> None:
    rng = np.random.default_rng(1)
    true = 2.0 + rng.normal(size=(20000, 8))
    light = 2.0 + 0.3 * rng.normal(size=20000)
    assert error(light, true) == pytest.approx(0.15, rel=0.03)


class Coins:
    """Surfels whose sequences all have one random number, twice as many times as points."""

    def light(self, stream: int, sequences: int, points: int) -> np.ndarray:
        assert points == 1 and stream >= 2 * STREAM
        return np.random.default_rng(stream).normal(size=(4000, sequences))


@pytest.mark.parametrize("samples", [16, 256])
def test_random_points_have_the_error_of_independent_ones(samples: int) -> None:
    assert random(Coins(), samples).std() == pytest.approx(samples**-0.5, rel=0.05)


def test_it_prints_both_kinds_of_places() -> None:
    done = CliRunner().invoke(
        points.main, ["demo:orbital", "--size", "16", "--samples", "16", "--json"], catch_exceptions=False
    )
    lines: list[dict[str, Any]] = [json.loads(line) for line in done.stdout.splitlines()]
    assert [line["what"].split(": ")[-1] for line in lines] == ["texels", "pixels"]
    for line in lines:
        (row,) = line["points"]
        assert row["samples"] == 16 and 0.3 < row["at_equal_samples"] < 10.0
        assert 0.0 < row["error"] < 1.0 and 0.0 < row["random_error"] < 2.0
