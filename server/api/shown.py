"""A picture that is asked for, what is shown of it, and what it then waits for."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple, Self

from isogi_core.frame.frame import Frame
from isogi_core.frame.tiles import Stopwatch
from isogi_core.model.view import View
from isogi_core.prepared.prepared_scene import Index
from worker.progress import TimeLeft

ONCE = ("queue", "primary", "texels", "normals", "lobes")  # what they find is kept for a view's next pictures


@dataclass(frozen=True)
class PictureRequest:
    """A picture: a ``view`` of a scene, by its id, which is to reach the relative error ``target``."""

    scene: str
    view: View
    target: float

    def draft(self, scale: float) -> Self:
        """The draft of this view while it moves, in a picture of ``scale`` times the width and the height."""
        width, height = (max(round(scale * side), 1) for side in (self.view.width, self.view.height))
        return replace(self, view=replace(self.view, width=width, height=height, moving=True))


@dataclass(frozen=True, eq=False)
class Shown:
    """The answer to a picture request: a ``frame``, the time until it is final, and the ``watch`` of its stages.

    ``coming`` are the chunks that are going to be baked for it, and ``since`` numbers the newest update of light when
    the frame was begun.
    """

    frame: Frame
    time_left: TimeLeft | None
    watch: Stopwatch
    coming: frozenset[Index]
    since: int


class Wait(NamedTuple):
    """What a picture waits for: the chunks that are ``coming``, newer than the update ``since``; and the ``work`` on
    it, seconds, where it shows light. Parts of it are provisional until the ``dark`` ones have light.
    """

    coming: frozenset[Index]
    since: int
    work: float
    dark: frozenset[Index]

    @classmethod
    def after(cls, shown: Shown) -> Self:
        """What the next picture waits for."""
        if shown.frame.coverage["provisional"] == 1.0:
            return cls(shown.coming, shown.since, 0.0, frozenset())
        return cls(shown.coming, shown.since, work_of(shown), shown.frame.quality.dark & shown.coming)


def work_of(shown: Shown) -> float:
    """Seconds of work on a picture that the next one of its view takes again, without those in the queue."""
    return sum(seconds for stage, seconds in shown.watch.seconds.items() if stage not in ONCE)
