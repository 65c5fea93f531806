"""Seconds that work takes, of the wall and of the processor, and how figures tell them."""

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass


@dataclass
class Seconds:
    """Seconds that add up. Those of the processor hold where other work is on the machine, those of
    the wall do not.
    """

    wall: float = 0.0
    processor: float = 0.0

    @contextmanager
    def counting(self) -> Iterator[None]:
        """Add what the block takes."""
        wall = time.perf_counter()
        processor = time.process_time()
        yield
        self.wall += time.perf_counter() - wall
        self.processor += time.process_time() - processor

    def __add__(self, other: "Seconds") -> "Seconds":
        return Seconds(self.wall + other.wall, self.processor + other.processor)

    def __mul__(self, times: float) -> "Seconds":
        return Seconds(self.wall * times, self.processor * times)

    def over(self, other: "Seconds") -> "Seconds":
        """How many times as much as the ``other`` it is."""
        return Seconds(self.wall / other.wall, self.processor / other.processor)

    def figures(self, name: str) -> dict[str, float]:
        """Both, under a name; wall first."""
        return {f"{name}, s": self.wall, f"{name}, processor s": self.processor}


def milliseconds(taken: Mapping[str, float]) -> dict[str, float]:
    """Seconds as figures in milliseconds."""
    return {f"{name}_ms": 1000.0 * value for name, value in taken.items()}
