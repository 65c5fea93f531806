"""Progress of long work on the terminal: bars that show the time left, and scenes that are
opened with one.
"""

import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any, Self

import click
from tqdm import tqdm

from isogi_core.files.scene_file import Target, find_source
from isogi_core.kernels._compilation import KernelProgress
from isogi_core.plan.assembly import build_scene
from isogi_core.plan.scene import Scene
from isogi_server import clocks
from isogi_server.clocks import CLOCK, ticking
from isogi_server.settings import Settings
from isogi_server.values import span
from isogi_worker.progress import Promise, TimeLeft

ITEMS = "{desc}: {percentage:3.0f}%|{bar}| {n_fmt}/{total_fmt} {unit}s, {elapsed}{postfix}"
WEIGHTED_BAR_FORMAT = "{desc}: {percentage:3.0f} %|{bar}| {elapsed}{postfix}"


class Progress:
    """A progress bar on stderr, drawn with the first progress and restarted with each new name.
    Close it by ``with``.

    Its clock runs while nothing is reported, and the time left decreases: see ``Promise``.
    """

    def __init__(self, what: str = "", unit: str = "step", soon: str = "") -> None:
        """Draw nothing yet. ``what`` names the work, counted in ``unit``s; without a unit the bar
        shows no counts.

        If ``soon`` is given, and nothing is drawn for REDRAW_SECONDS, a clock with this text is
        drawn on a terminal.
        """
        self._what = what
        self._unit = unit
        self._begun = time.monotonic()
        self._bar: Any = None
        self._form = ""
        self._note = ""
        self._promise = Promise(time.monotonic)
        self._clock = ExitStack()
        self._opening = threading.RLock()
        # A timer draws the clock for work that is silent at first.
        self._later = threading.Timer(clocks.REDRAW_SECONDS, self._begin_late, (soon,))
        self._later.daemon = True
        if soon and clocks.watched():
            self._later.start()

    def __enter__(self) -> Self:
        """Return the bar."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the bar."""
        self.close()

    def close(self) -> None:
        """Remove the bar until there is progress again."""
        self._later.cancel()
        self._clear()

    def _clear(self) -> None:
        """Remove the bar and stop its clock."""
        with self._opening:
            bar = self._bar
            clock = self._clock.pop_all()
            self._bar = None
        # Close the clock without the lock: it waits for its thread, which may be drawing.
        clock.close()
        if bar is not None:
            bar.close()

    def end(self) -> None:
        """Remove a bar with counts; a clock goes on."""
        if self._form != CLOCK:
            self._clear()

    def name(self, what: str, unit: str) -> None:
        """Start a new bar if the work is called differently from now on."""
        if what != self._what:
            self.close()
            self._what = what
            self._unit = unit
            self._begun = time.monotonic()
            self._note = ""
            self._promise = Promise(time.monotonic)

    def begin(self, what: str) -> None:
        """Draw a clock for work ``what`` of unknown amount."""
        self.name(what, "")
        self._open(what, CLOCK, 0)

    def show(self, done: int, total: int, left: TimeLeft | None = None, note: str = "") -> None:
        """Draw the amount that is done, a note, and the time left."""
        self._note = note
        if left is not None:
            self._promise.kept(left)
        self._open(self._what, ITEMS if self._unit else WEIGHTED_BAR_FORMAT, total)
        self._bar.total = total
        self._bar.n = done
        self._redraw()

    def count(self, done: int, total: int) -> None:
        """Draw the amount that is done, and the time left at the mean pace so far."""
        left = (time.monotonic() - self._begun) * (total - done) / max(done, 1)
        self.show(done, total, TimeLeft(left, left, left) if done else None)

    def _redraw(self) -> None:
        """Draw the bar with the time left now."""
        bar = self._bar
        left = self._promise.now
        said = "" if left is None else left_text(left)
        if bar is not None:
            bar.set_postfix_str(" ".join(filter(None, (self._note, said))), refresh=False)
            bar.refresh()

    def _begin_late(self, what: str) -> None:
        """Draw a clock, unless there was progress meanwhile."""
        with self._opening:
            if self._bar is None and not self._later.finished.is_set():
                self._open(what, CLOCK, 0)

    def _open(self, what: str, form: str, total: int) -> None:
        """Draw a new bar of a ``form``, unless there is one of that form."""
        if self._bar is not None and form != self._form:
            self.close()
        with self._opening:
            if self._bar is None:
                self._form = form
                kept = form != CLOCK
                self._bar = tqdm(
                    desc=what, unit=self._unit, total=total, bar_format=form, leave=kept
                )
                self._clock.enter_context(ticking(self._redraw))


@contextmanager
def compiling(progress: Callable[[], KernelProgress | None], soon: str = "") -> Iterator[None]:
    """For the block, draw the progress of compiling kernels. If none is compiled within a
    second, draw a clock with the text ``soon``, if given.
    """
    with Progress("compiling, once on this machine", "kernel", soon) as bar:

        def draw() -> None:
            now = progress()
            if now is None:
                bar.end()
            else:
                seconds = now.seconds
                left = None if seconds is None else TimeLeft(seconds, seconds, seconds)
                bar.show(now.done, now.total, left)

        with ticking(draw):
            yield


def say(line: str) -> None:
    """Print a line to stdout, above the bar if one is drawn."""
    with tqdm.external_write_mode():
        click.echo(line)


def about_left(seconds: float | None) -> str:
    """Return seconds left as text for a person; empty if they are unknown."""
    if seconds is None:
        return ""
    return f"about {span(max(seconds, 1.0), digits=2)} left"


def left_text(left: TimeLeft) -> str:
    """Return the time left as text for a person, such as ``about 20 s left (12 s to 41 s)``."""
    low, likely, high = (
        span(max(seconds, 1.0), digits=2) for seconds in (left.low, left.likely, left.high)
    )
    # Leave the range out if it rounds to one value.
    if low == high:
        text = f"about {likely} left"
    else:
        text = f"about {likely} left ({low} to {high})"
    if left.overdue:
        return f"longer than expected, {text}"
    return text


def open_scene(target: Target, settings: Settings | None = None, **overrides: Any) -> Scene:
    """Build the scene at ``target`` as ``load_scene`` does, and draw progress; its volume is kept
    as the ``settings`` say.

    Raises SceneError, VolumeError or LightError.
    """
    if settings is not None:
        pass_to_core(settings)
    with Progress("reading the volume", soon="reading the scene") as bar:
        return build_scene(find_source(target, overrides), bar.count)


def pass_to_core(settings: Settings) -> None:
    """Set environment variables so that this process and its children keep volumes as the
    settings say.
    """
    os.environ["ISOGI_VOLUME_MB"] = str(settings.volume_mb)
    os.environ["ISOGI_VOLUME_CACHE_MB"] = str(settings.volume_cache_mb)
    if settings.volume_cache is not None:
        os.environ["ISOGI_VOLUME_CACHE"] = settings.volume_cache
