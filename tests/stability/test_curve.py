"""The ramps' curve: a table and a picture of the cases that it is of, and of no other."""

from pathlib import Path

from benchmarks.stability.case import Case, Outcome
from benchmarks.stability.curve import ramp_notes
from benchmarks.stability.ramps import GROUP, OWN_PLACES


def test_errors_of_ramps_are_told_and_drawn(tmp_path: Path) -> None:
    errors = {"8 voxels wide": (0.015, 0.015), "no ramp: a mask": (0.01, 0.052)}
    results = [
        (Case(GROUP, name, "", 1.0, "relative", lambda _: Outcome(0.0)), Outcome(now, "", {OWN_PLACES: own}))
        for name, (now, own) in errors.items()
    ]
    other = Case("rays", "closed", "no leaks", 0, "leaks", lambda _: Outcome(0.0)), Outcome(0.0)
    notes = ramp_notes([other, *results], tmp_path / "stability")
    assert "| 8 voxels wide | 1.50% | 1.50% |" in notes
    assert "| no ramp: a mask | 1.00% | 5.20% |" in notes
    assert "closed" not in notes
    assert "<svg" in (tmp_path / "stability" / "ramps.svg").read_text()
