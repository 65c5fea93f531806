"""The desk: what one prewarm works with, from the command line and in a server alike."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from isogi_core.errors import Cancelled

if TYPE_CHECKING:
    from isogi_core.frame.frame import Frame
    from isogi_core.frame.renderer import Renderer
    from isogi_core.model.scene import Scene
    from isogi_core.model.view import View
    from server.studio import Studio
    from worker.outlook import TimeLeft
    from worker.viewers import Viewer


@dataclass(frozen=True)
class Step:
    """How far a prewarm is: ``done`` of ``total`` ``unit``s of ``what`` it does now, and the time that the rest takes.

    ``share`` is that of all its work.
    """

    what: str
    unit: str
    done: int
    total: int
    share: float
    left: TimeLeft | None = None

    def __str__(self) -> str:
        """For a person."""
        return f"{self.what}: {self.done:,} of {self.total:,} {self.unit}s."


@dataclass(eq=False)
class Desk:
    """Prewarms one ``scene`` of a studio to a ``target`` error, for a ``viewer``.

    ``look`` makes the frame of a view with the light that there is, ``tell`` is told how far it is, and ``cancelled``
    stops it. Baking ends at ``deadline``, and the workers are taken for broken after ``patience`` seconds without
    anything new.
    """

    studio: Studio
    scene: Scene
    target: float
    viewer: Viewer
    look: Callable[[View], Frame]
    tell: Callable[[Step], None]
    deadline: float = math.inf
    patience: float = math.inf
    cancelled: threading.Event = field(default_factory=threading.Event)
    begun: float = field(default_factory=time.monotonic)

    @property
    def renderer(self) -> Renderer:
        """Who renders the scene."""
        return self.studio.renderer(self.scene.id)

    @property
    def bake(self) -> str:
        """The name of the bake."""
        return self.scene.id

    @property
    def seconds(self) -> float:
        """Seconds since it began."""
        return time.monotonic() - self.begun

    @property
    def left(self) -> float:
        """Seconds until the deadline, none once it is over."""
        return max(self.deadline - time.monotonic(), 0.0)

    def check(self) -> None:
        """Raises Cancelled where nobody waits for it any more."""
        if self.cancelled.is_set():
            raise Cancelled("This prewarm was stopped.")
