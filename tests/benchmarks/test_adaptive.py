"""Adaptive against uniform samples: the arithmetic, and that both ways bake the same light."""

import json

import pytest
from click.testing import CliRunner

from benchmarks import adaptive
from benchmarks.adaptive import Point, rows


def test_errors_are_told_at_equal_cost_where_both_are_lit() -> None:
    uniform = [Point(1.0, 16.0, 0.8, True), Point(2.0, 32.0, 0.4, True), Point(4.0, 64.0, 0.2, True)]
    other = [Point(1.0, 8.0, 0.9, False), Point(1.5, 16.0, 0.4, True), Point(6.0, 64.0, 0.1, True)]
    second, third = rows(uniform, other)
    assert (second.samples, third.samples) == (32, 64)
    assert second.adaptive == pytest.approx(0.4 * (1.5 / 2.0))
    assert second.at_equal_time == pytest.approx(2.0 / 1.5)
    assert third.at_equal_paths == pytest.approx(0.2 / 0.1)


def test_it_prints_both_ways() -> None:
    arguments = ["demo:casting", "--size", "16", "--samples", "64", "--target", "0.1", "--json"]
    done = CliRunner().invoke(adaptive.main, arguments, catch_exceptions=False)
    found = json.loads(done.stdout.splitlines()[-1])
    assert found["lit"]["uniform"] > 0.0 and found["lit"]["adaptive"] > 0.0
    for row in found["rows"]:
        assert 0.0 < row["adaptive"] < 1.0 and 0.1 < row["at_equal_paths"] < 10.0
