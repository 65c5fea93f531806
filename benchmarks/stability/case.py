"""Cases: what is expected of something stiff or extreme, and how it is measured."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import IntEnum


class Size(IntEnum):
    """How thoroughly cases are measured: QUICK in the tests, FULL for the report, SLOW before a release."""

    QUICK = 0
    FULL = 1
    SLOW = 2

    def pick(self, quick: int, full: int, slow: int | None = None) -> int:
        """The number for this size: how many rays, samples, … ; what is not told for SLOW is as for FULL."""
        return (quick, full, full if slow is None else slow)[self]


@dataclass(frozen=True)
class Outcome:
    """What a case did: its ``worst`` figure, in the case's unit, and a phrase that says what it was of.

    ``figures`` are more of them, by name, for pictures of the report.
    """

    worst: float
    got: str = ""
    figures: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Case:
    """One thing that is ``expected`` of isogi, in a sentence; it holds where the worst figure is ``most`` or less.

    ``unit`` is of both figures: "leaks", "grey levels", "relative", … . ``known`` is empty, or says why the case cannot
    be made right: ``most`` is then what it stays below all the same.
    """

    group: str
    name: str
    expected: str
    most: float
    unit: str
    measure: Callable[[Size], Outcome]
    known: str = ""

    def holds(self, outcome: Outcome) -> bool:
        """Whether the outcome is as expected; a figure that is not a number is not."""
        return outcome.worst <= self.most


Measure = Callable[[Size], Outcome]
CASES: list[Case] = []
"""All cases, group by group once ``cases`` is imported, and within each in the order in which they were told."""


def case(group: str, name: str, expected: str, most: float, unit: str, known: str = "") -> Callable[[Measure], Measure]:
    """Decorator: the function measures this case."""

    def tell(measure: Measure) -> Measure:
        CASES.append(Case(group, name, expected, most, unit, measure, known))
        return measure

    return tell
