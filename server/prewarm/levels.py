"""Isovalues as they are asked for: numbers, ranges with a step, and ranges that mean all between."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from server.errors import ParameterError
from server.values import finite, shown

MOST_ISOVALUES = 10_000
"""Isovalues that are told with a step or one by one, at most."""

WANTED = (
    f"a number such as 70, first:last:step such as 60:120:5 with at most {MOST_ISOVALUES} of them, or first:last for"
    " all between"
)


@dataclass(frozen=True)
class Levels:
    """The isovalues that are asked for: ``single`` ones, each once, and ``ranges`` of all from one to another."""

    single: tuple[float, ...] = ()
    ranges: tuple[tuple[float, float], ...] = ()

    @property
    def all(self) -> tuple[float, ...]:
        """The single ones, and the ends of the ranges."""
        return (*self.single, *(end for ends in self.ranges for end in ends))

    @property
    def spans(self) -> tuple[tuple[float, float], ...]:
        """All of it as ranges: a single one goes from itself to itself."""
        return (*((level, level) for level in self.single), *self.ranges)


def levels_of(texts: Sequence[str]) -> Levels:
    """The isovalues that the texts tell; ParameterError for what tells none."""
    single: dict[float, None] = {}
    ranges: dict[tuple[float, float], None] = {}
    for text in texts:
        numbers = numbers_in(text)
        if len(numbers) == 2:
            ranges[numbers[0], numbers[1]] = None
        else:
            single |= dict.fromkeys(float(f"{level:.12g}") for level in stepped(*numbers))
        if len(single) > MOST_ISOVALUES:
            raise ParameterError(f"isovalues are more than {MOST_ISOVALUES:,} together: ask for fewer.", "isovalues")
    return Levels(tuple(single), tuple(ranges))


def numbers_in(text: str) -> list[float]:
    """The one, two or three numbers in a text; ParameterError where they mean nothing."""
    numbers = [finite(part) for part in text.split(":")]
    if all(map(math.isfinite, numbers)) and sensible(numbers):
        return numbers
    raise ParameterError(f"isovalue must be {WANTED}, not {shown(text)}.", "isovalues")


def sensible(numbers: Sequence[float]) -> bool:
    """Whether the numbers are in order, and not too many isovalues."""
    match numbers:
        case [_]:
            return True
        case [first, last]:
            return first <= last
        case [first, last, step]:
            return step > 0.0 and first <= last and (last - first) / step < MOST_ISOVALUES
    return False


def stepped(first: float, last: float | None = None, step: float = 1.0) -> list[float]:
    """The numbers from ``first`` to ``last``; the first alone where no last is told."""
    steps = 0 if last is None else math.floor((last - first) / step + 1e-9)
    return [first + step * n for n in range(steps + 1)]
