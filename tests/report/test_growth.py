"""Growth of a reference: its rounds, and where it stops."""

from types import SimpleNamespace
from typing import Any

import pytest

from isogi_core import reference
from isogi_core.reference import Goal, grow_reference


def make(samples: int) -> Any:
    """A reference whose noise is the inverse of its samples."""
    return SimpleNamespace(samples=samples, noise=1.0 / samples)


@pytest.fixture(autouse=True)
def tracer(monkeypatch: pytest.MonkeyPatch) -> None:
    """A tracer that takes a second for each sample, on a clock of its own."""
    clock = SimpleNamespace(now=0.0)

    def trace(_: Any, __: Any, samples: int, former: Any, *more: Any) -> Any:
        rounded = -(-samples // 8) * 8
        clock.now += rounded - (former.samples if former else 0)
        return make(rounded)

    monkeypatch.setattr(reference, "trace_reference", trace)
    monkeypatch.setattr(reference, "time", SimpleNamespace(monotonic=lambda: clock.now))


def rounds(goal: Goal, former: Any = None) -> list[int]:
    return [each.samples for each in grow_reference(None, None, goal, former)]  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("goal", "expected"),
    [
        (Goal(samples=100), [16, 32, 64, 104]),
        (Goal(samples=5), [8]),
        (Goal(noise=1 / 64), [16, 32, 64]),
        (Goal(noise=1 / 65), [16, 32, 64, 128]),
        (Goal(seconds=100.0), [16, 32, 64, 96]),
        (Goal(seconds=0.0), [16]),
        (Goal(samples=64, seconds=1000.0), [16, 32, 64]),
    ],
)
def test_rounds_double_up_to_the_goal(goal: Goal, expected: list[int]) -> None:
    assert rounds(goal) == expected


@pytest.mark.parametrize(
    ("goal", "expected"), [(Goal(samples=64), []), (Goal(samples=65), [72]), (Goal(seconds=200.0), [128, 256, 264])]
)
def test_it_goes_on_from_what_there_is(goal: Goal, expected: list[int]) -> None:
    assert rounds(goal, make(64)) == expected


def test_what_is_still_to_come_is_foreseen() -> None:
    assert Goal(samples=100).foresee(make(16)) == 100
    assert Goal(noise=1 / 64).foresee(make(64)) == 64
    assert Goal(noise=1 / 128).foresee(make(64)) == 256, "64 · 2^1.75, and rounds double"
    assert Goal(seconds=3.0).foresee(make(64)) is None
