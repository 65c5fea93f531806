"""Refinement: how each kind of light in a picture converges, step by step, while the view rests."""

import threading
from abc import ABC, abstractmethod
from typing import Generic, Protocol, TypeVar

from isogi_core.frame.frame import Frame
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.rays.picture_plan import Prices
from isogi_core.frame.tiles import Tiles


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

    def step(
        self, frame: Frame, light: RotatedLight, target: float, tiles: Tiles, prices: Prices
    ) -> bool:
        """Take one step that brings a ``frame`` under a ``light`` nearer to the ``target``, a
        relative error; return False if there is no step to take.

        Return True without a step if another thread has taken one since the frame was drawn.
        ``prices`` are the costs of texels in paths of pixels, by which a check chooses between
        both. Raises Cancelled.
        """
        found = self.of(frame, light, target, tiles)
        if found is None:
            return False
        # If the frame is older than the light, another thread has taken a step since it was drawn.
        # That step counts: the next frame shows it.
        with found.lock:
            return not found.is_shown(frame) or self.advance(found, frame, target, tiles, prices)

    @abstractmethod
    def of(self, frame: Frame, light: RotatedLight, target: float, tiles: Tiles) -> Light | None:
        """Return the light of this kind in a ``frame``, as far as it has converged; None if the
        frame has none of it.
        """

    @abstractmethod
    def advance(
        self, found: Light, frame: Frame, target: float, tiles: Tiles, prices: Prices
    ) -> bool:
        """Trace more paths for the light ``found`` in a ``frame``; return False if it needs
        none. The caller holds its lock.
        """
