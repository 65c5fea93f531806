"""Refinement: how each kind of light in a picture converges, step by step, while the view rests."""

import threading
from abc import ABC, abstractmethod
from typing import Generic, NamedTuple, Protocol, TypeVar

from isogi_core.frame.frame import Frame
from isogi_core.frame.rays.picture_plan import Prices
from isogi_core.frame.shot import Shot


class PathsLeft(NamedTuple):
    """Paths that a picture still has to take after the present samples of its texels: of
    ``pixels``, or of texels of walls, and of ``texels``. The picture is drawn ``times`` times on
    the way.

    ``pace`` is the number of seconds that a path of a pixel takes; None if it is unknown.
    """

    pixels: float = 0.0
    texels: float = 0.0
    times: int = 0
    pace: float | None = None


class Converging(Protocol):
    """Light of one view that is kept between steps. Only the thread that holds the ``lock``
    changes it.
    """

    lock: threading.Lock

    def is_shown(self, frame: Frame) -> bool:
        """Return True if a ``frame`` shows this light as far as it has converged."""


Light = TypeVar("Light", bound=Converging)


class Refinement(ABC, Generic[Light]):
    """A kind of light that converges: texels of walls, views through glass, shine, or pixels that a
    check chooses.

    Each step brings a picture nearer to a target error. Safe to use from many threads.
    """

    def step(self, frame: Frame, shot: Shot, prices: Prices) -> bool:
        """Take one step that brings the ``frame`` of a ``shot`` nearer to its goal; return False if
        there is no step to take.

        Return True without a step if another thread has taken one since the frame was drawn.
        ``prices`` are the costs of texels in paths of pixels, by which a check chooses between
        both. Raises Cancelled.
        """
        found = self.of(shot)
        if found is None:
            return False
        # If the frame is older than the light, another thread has taken a step since it was drawn.
        # That step counts: the next frame shows it.
        with found.lock:
            return not found.is_shown(frame) or self.advance(found, frame, shot, prices)

    @abstractmethod
    def of(self, shot: Shot) -> Light | None:
        """Return the light of this kind in a ``shot``, as far as it has converged; None if it has
        none of it.
        """

    @abstractmethod
    def advance(self, found: Light, frame: Frame, shot: Shot, prices: Prices) -> bool:
        """Trace more paths for the light ``found`` in the ``frame`` of a ``shot``; return False if
        it needs none. The caller holds its lock.
        """
