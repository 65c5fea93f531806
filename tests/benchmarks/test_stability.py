"""The stability report measures the cases that are asked for, as text and as JSON, and says whether they hold."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from benchmarks.stability import __main__ as stability
from benchmarks.stability.case import Case, Outcome, Size
from benchmarks.stability.ramps import OWN_PLACES


def run(*arguments: str) -> Result:
    """The report's command."""
    return CliRunner().invoke(stability.main, ["--size", "quick", *arguments])


def test_figures_of_some_cases_as_json() -> None:
    done = run("--only", "turned light identity", "--json")
    assert done.exit_code == 0, done.output
    (found,) = json.loads(done.stdout)
    assert (found["group"], found["name"]) == ("turned light", "identity")
    assert found["worst"] == found["most"] == 0
    assert found["holds"] is True and found["known"] == ""


def test_a_text_that_no_case_has_is_refused() -> None:
    done = run("--only", "fog")
    assert done.exit_code == 2
    assert "No case has 'fog' in its group or name." in done.output


def test_all_cases_make_the_page_and_one_that_fails_the_status(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sizes: list[Size] = []

    def measure(size: Size) -> Outcome:
        sizes.append(size)
        return Outcome(2, "of 10")

    ramp = Case("ramps", "a mask", "light", 0.02, "relative", lambda _: Outcome(0.01, "", {OWN_PLACES: 0.03}))
    monkeypatch.setattr(stability, "CASES", [Case("rays", "closed", "no leaks", 0, "leaks", measure), ramp])
    done = run("-o", str(tmp_path / "stability.md"))
    assert (done.exit_code, sizes) == (1, [Size.QUICK])
    assert "DOES NOT HOLD: rays, closed: 2 of 0 leaks of 10" in done.stdout
    text = (tmp_path / "stability.md").read_text()
    assert "**1 of 2 cases hold.** Not: rays, closed." in text
    assert "| a mask | 1.00% | 3.00% |" in text
