"""Progress of long work on the terminal: bars that show the time left, and scenes opened with
one.
"""

import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, Self

import click
from tqdm import tqdm

from isogi_core.files.scene_file import find_source
from isogi_core.kernels._compilation import KernelProgress
from isogi_core.plan.assembly import build_scene
from isogi_core.plan.scene import Scene
from server.settings import Settings
from server.values import span
from worker.progress import TimeLeft

ITEMS = "{desc}: {percentage:3.0f}%|{bar}| {n_fmt}/{total_fmt} {unit}s, {elapsed}{postfix}"
WEIGHTED_BAR_FORMAT = "{desc}: {percentage:3.0f} %|{bar}| {elapsed}{postfix}"

REDRAW_SECONDS = 1.0
"""Seconds between two drawings of a bar whose clock runs while a piece of work is done."""


CLOCK = "{desc}, {elapsed}"


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


class Progress:
    """A bar on stderr, drawn with the first progress; it begins again with each new name. Close it
    by ``with``.

    Its clock runs while nothing is reported.
    """

    def __init__(self, what: str = "", unit: str = "step") -> None:
        """Draw nothing yet: ``what`` is done, counted in ``unit``s; without a name they are not
        counted.
        """
        self._what = what
        self._unit = unit
        self._begun = time.monotonic()
        self._bar: Any = None
        self._clock = ExitStack()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Draw no more, until there is progress again."""
        self._clock.close()
        if self._bar is not None:
            self._bar.close()
            self._bar = None

    def name(self, what: str, unit: str) -> None:
        """From now on ``what`` is done: a new bar, where that is another than before."""
        if what != self._what:
            self.close()
            self._what = what
            self._unit = unit
            self._begun = time.monotonic()

    def begin(self, what: str) -> None:
        """Draw at once that ``what`` is done now, with a clock: how much there is of it is not
        known.
        """
        self.name(what, "")
        self._open(CLOCK, 0)

    def show(self, done: int, total: int, left: TimeLeft | None = None, note: str = "") -> None:
        """Draw how much is done, a note, and the time that is left."""
        self._draw(
            done, total, " ".join(filter(None, (note, "" if left is None else left_text(left))))
        )

    def count(self, done: int, total: int) -> None:
        """Draw how much is done, and the time left at the mean pace so far."""
        left = (time.monotonic() - self._begun) * (total - done) / max(done, 1)
        self._draw(done, total, about_left(left))

    def _draw(self, done: int, total: int, postfix: str) -> None:
        if self._bar is None:
            self._open(ITEMS if self._unit else WEIGHTED_BAR_FORMAT, total)
        self._bar.total = total
        self._bar.n = done
        self._bar.set_postfix_str(postfix, refresh=False)
        self._bar.refresh()

    def _open(self, form: str, total: int) -> None:
        self._bar = tqdm(desc=self._what, unit=self._unit, total=total, bar_format=form)
        self._clock.enter_context(ticking(self._bar.refresh))


@contextmanager
def compiling(progress: Callable[[], KernelProgress | None]) -> Iterator[None]:
    """Draw, while other work is done, how far kernels are compiled; nothing where there are none to
    compile.
    """
    with Progress("compiling, once on this machine", "kernel") as bar:

        def draw() -> None:
            now = progress()
            if now is None:
                bar.close()
            else:
                bar.show(now.done, now.total, note=about_left(now.seconds))

        with ticking(draw):
            yield


def say(line: str) -> None:
    """Print a line to stdout, above a bar where one is drawn."""
    with tqdm.external_write_mode():
        click.echo(line)


def about_left(seconds: float | None) -> str:
    """Seconds that are left, for a person; empty where they are not known."""
    if seconds is None:
        return ""
    return f"about {span(max(seconds, 1.0), digits=2)} left"


def left_text(left: TimeLeft) -> str:
    """The time left for a person, such as ``about 20 s left (12 s to 41 s)``."""
    low, likely, high = (span(seconds, digits=2) for seconds in (left.low, left.likely, left.high))
    return f"about {likely} left ({low} to {high})"


def open_scene(
    target: str | Path | None, settings: Settings | None = None, **overrides: Any
) -> Scene:
    """The scene at ``target``, as ``load_scene`` has it, its volume kept as the ``settings`` say.

    Raises SceneError, VolumeError or LightError.
    """
    if settings is not None:
        pass_to_core(settings)
    with Progress("reading the volume") as bar:
        return build_scene(find_source(target, overrides), bar.count)


def pass_to_core(settings: Settings) -> None:
    """Have this process, and those that it starts, keep volumes as the settings say: by way of the
    environment.
    """
    os.environ["ISOGI_VOLUME_MB"] = str(settings.volume_mb)
    os.environ["ISOGI_VOLUME_CACHE_MB"] = str(settings.volume_cache_mb)
    if settings.volume_cache is not None:
        os.environ["ISOGI_VOLUME_CACHE"] = settings.volume_cache
