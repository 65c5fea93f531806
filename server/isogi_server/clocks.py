"""Clocks on the terminal that run while a command works; a module that imports fast."""

import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from tqdm import tqdm

CLOCK = "{desc}, {elapsed}"
"""Format of a bar for work of unknown amount."""

REDRAW_SECONDS = 1.0
"""Seconds between two drawings of a running clock, and before the first drawing, so that short
work shows none.
"""


@contextmanager
def ticking(draw: Callable[[], object]) -> Iterator[None]:
    """Call ``draw`` every REDRAW_SECONDS on a thread, for the block."""
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
    """Return True if a person may see the bar: stderr is a terminal."""
    return sys.stderr.isatty()


@contextmanager
def waiting(what: str) -> Iterator[None]:
    """Draw a clock with a text for the block, if the block takes longer than REDRAW_SECONDS and
    stderr is a terminal.
    """
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
