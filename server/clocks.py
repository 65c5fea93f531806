"""Clocks on the terminal that run while a command is at work; light to import."""

import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from tqdm import tqdm

CLOCK = "{desc}, {elapsed}"
"""A bar of work of which nobody knows how much there is."""

REDRAW_SECONDS = 1.0
"""Seconds between two drawings of a bar whose clock runs while a piece of work is done, and before
the first of work that may be over sooner.
"""


@contextmanager
def ticking(draw: Callable[[], object]) -> Iterator[None]:
    """Call ``draw`` every REDRAW_SECONDS, on a thread of its own."""
    ended = threading.Event()

    def tick() -> None:
        while not ended.wait(REDRAW_SECONDS):
            draw()

    thread = threading.Thread(target=tick, name="progress", daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def watched() -> bool:
    """Whether a person may see what is drawn: stderr is a terminal."""
    return sys.stderr.isatty()


@contextmanager
def waiting(what: str) -> Iterator[None]:
    """Draw a clock of ``what`` is done in the block, after REDRAW_SECONDS, on a terminal."""
    bars: list[Any] = []

    def draw() -> None:
        if not bars and watched():
            bars.append(tqdm(desc=what, bar_format=CLOCK, leave=False))
        for bar in bars:
            bar.refresh()

    with ticking(draw):
        yield
    for bar in bars:
        bar.close()
