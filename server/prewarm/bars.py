"""Progress of a prewarm on the terminal: a bar for each thing that it does."""

from __future__ import annotations

from typing import Any, Self

from server.prewarm.desk import Step
from server.progress import progress_bar, show


class Bars:
    """Shows steps; one bar is open at a time. Usable as a context manager, which closes it."""

    def __init__(self) -> None:
        """Show nothing yet."""
        self._what = ""
        self._bar: Any = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._close()

    def show(self, step: Step) -> None:
        """Show a step on its bar."""
        if step.what != self._what or self._bar is None:
            self._close()
            self._what, self._bar = step.what, progress_bar(step.what.lower(), step.unit, step.total)
        show(self._bar, step.done, step.total, step.left)

    def _close(self) -> None:
        if self._bar is not None:
            self._bar.close()
            self._bar = None
