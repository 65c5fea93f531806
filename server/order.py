"""Orders: what somebody wants to be shown."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Self

from isogi_core.frame.stopwatch import Stopwatch
from isogi_core.model.view import View

if TYPE_CHECKING:
    from isogi_core.bake.recipe import Index
    from isogi_core.frame.frame import Frame
    from worker.outlook import TimeLeft


@dataclass(frozen=True)
class Order:
    """A picture: a ``view`` of a scene, by its id, whose light is final at the relative error ``target``."""

    scene: str
    view: View
    target: float

    def scaled(self, scale: float) -> Self:
        """The same in a picture of ``scale`` times the width and the height."""
        width, height = (max(round(scale * side), 1) for side in (self.view.width, self.view.height))
        return replace(self, view=replace(self.view, width=width, height=height))


@dataclass(frozen=True, eq=False)
class Shown:
    """What an order is answered with: a ``frame``, the time until it is final, and the ``watch`` of its stages.

    ``coming`` are the chunks that are going to be baked for it, and ``since`` numbers the newest news of light when
    the frame was begun.
    """

    frame: Frame
    time_left: TimeLeft | None
    watch: Stopwatch
    coming: frozenset[Index]
    since: int
