"""Every case of the stability report holds, measured with less of everything."""

import math
from itertools import groupby

import pytest

from benchmarks.stability.case import Case, Outcome, Size
from benchmarks.stability.cases import CASES, GROUPS
from benchmarks.stability.page import figure, page


@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case.group}-{case.name}")
def test_holds(case: Case) -> None:
    outcome = case.measure(Size.QUICK)
    assert case.holds(outcome), f"{case.expected}: {outcome.worst:.3g} {case.unit}, {outcome.got}"


def test_groups_are_told_in_one_piece_each() -> None:
    pieces = [group for group, _ in groupby(case.group for case in CASES)]
    assert sorted(pieces) == sorted(set(pieces)) == sorted(GROUPS)


def test_names_are_told_once() -> None:
    names = [(case.group, case.name) for case in CASES]
    assert len(set(names)) == len(names)


def test_a_figure_that_is_no_number_does_not_hold() -> None:
    some = Case("group", "name", "expected", 1.0, "leaks", lambda _: Outcome(0.0))
    assert some.holds(Outcome(1.0))
    assert not some.holds(Outcome(1.01))
    assert not some.holds(Outcome(math.nan))


def test_page_names_what_does_not_hold_and_what_is_known() -> None:
    right = Case("rays", "closed", "no leaks", 0, "leaks", lambda _: Outcome(0))
    wrong = Case("rays", "thin", "light stays", 0.01, "relative", lambda _: Outcome(0.5), known="walls are thin")
    text = page([(right, Outcome(0, "of 10 rays")), (wrong, Outcome(0.5, "at the wall"))], "slow")
    assert "by `make stability SIZE=slow`" in text
    assert "**1 of 2 cases hold.** Not: rays, thin. Of 1 the limit is not what is expected" in text
    assert "| thin (known) | light stays | at the wall | 50.00% **(more)** | 1.00% |" in text
    assert "- **rays, thin**: walls are thin" in text


def test_figures_that_percentages_would_round_to_nothing_are_told_as_they_are() -> None:
    assert figure(0.0, "relative") == "0.00%"
    assert figure(0.0123, "relative") == "1.23%"
    assert figure(3e-14, "relative") == "3e-14 relative"
    assert figure(3.0, "rays") == "3 rays"
