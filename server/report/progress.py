"""The bar of a report: studies by their weights, and the time that is left, told from those that are done."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

from tqdm import tqdm

BAR = "{desc}: {percentage:3.0f} %|{bar}| {elapsed}{postfix}"

TICK = 1.0
"""Seconds between two looks at the clock."""


class Progress:
    """Counts ``total`` weight, of which some was done ``before``; all must end within ``limit`` seconds."""

    def __init__(self, total: float, before: float, limit: float) -> None:
        """Show the bar."""
        self.end = time.monotonic() + limit
        self.rest, self.done, self.taken, self.begun = total - before, 0.0, 0.0, time.monotonic()
        self._bar = tqdm(desc="report", total=total, initial=before, bar_format=BAR)

    @property
    def left(self) -> float:
        """Seconds that the rest takes by what was done, the time at the limit at most; infinite where none is known."""
        now = time.monotonic()
        pace = self.taken / self.done if self.done else float("inf")
        rest = max(self.rest * pace - (now - self.begun), 0.0) if self.rest else 0.0
        return min(rest, max(self.end - now, 0.0))

    def begin(self, name: str) -> None:
        """A piece of the work is at hand."""
        self.begun = time.monotonic()
        self._bar.set_description_str(name)

    def finish(self, weight: float) -> None:
        """The piece at hand is done; that was so much of the ``weight``."""
        now = time.monotonic()
        self.rest -= weight
        self.done += weight
        self.taken += now - self.begun
        self.begun = now
        self._bar.update(weight)

    def show(self) -> None:
        """Draw the bar with the time that is left now."""
        left = self.left
        self._bar.set_postfix_str(f"{tqdm.format_interval(left)} left" if left < float("inf") else "")

    def close(self) -> None:
        """Leave the bar as it is."""
        self.show()
        self._bar.close()


@contextmanager
def ticking(progress: Progress) -> Iterator[Progress]:
    """Have the bar's clock go while work is done, and close it in the end."""
    ended = threading.Event()

    def tick() -> None:
        while not ended.wait(TICK):
            progress.show()

    thread = threading.Thread(target=tick, name="progress", daemon=True)
    thread.start()
    try:
        yield progress
    finally:
        ended.set()
        thread.join()
        progress.close()
