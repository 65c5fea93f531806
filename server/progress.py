"""Progress of long work on the terminal: how much is done, and how long the rest takes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from tqdm import tqdm

from server.durations import span

if TYPE_CHECKING:
    from worker.outlook import TimeLeft

FORMAT = "{desc}: {percentage:3.0f}%|{bar}| {n_fmt}/{total_fmt} {unit}s, {elapsed}{postfix}"

COUNTED = "{desc}: {percentage:3.0f}%|{bar}| {n_fmt}/{total_fmt} {unit}s, {elapsed}, {remaining} left"


def progress_bar(what: str, unit: str, total: int = 0) -> Any:
    """A bar on stderr, which tells the time left as it is told to; see ``show``."""
    return tqdm(desc=what, unit=unit, total=total, bar_format=FORMAT)


def show(bar: Any, done: int, total: int, left: TimeLeft | None) -> None:
    """Put on the bar how much is done, and the time that is left."""
    bar.total, bar.n = total, done
    bar.set_postfix_str("" if left is None else left_text(left), refresh=False)
    bar.refresh()


def left_text(left: TimeLeft) -> str:
    """The time left for a person, such as ``about 20 s left (12 s to 41 s)``."""
    low, likely, high = (span(seconds, digits=2) for seconds in (left.low, left.likely, left.high))
    return f"about {likely} left ({low} to {high})"


@contextmanager
def counting(what: str, unit: str) -> Iterator[Callable[[int, int], None]]:
    """A bar on stderr for work whose items take about as long each: is told how many are done, and of how many."""
    with tqdm(desc=what, unit=unit, total=0, bar_format=COUNTED) as bar:

        def tell(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        yield tell
