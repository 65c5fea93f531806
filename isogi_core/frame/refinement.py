"""Refinement: how each kind of light in a picture converges, step after step, while its view
rests.
"""

import threading
from abc import ABC, abstractmethod
from typing import Generic, Protocol, TypeVar

from isogi_core.frame.frame import Frame
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.rays.picture_plan import Prices
from isogi_core.frame.tiles import Tiles


class Converging(Protocol):
    """Light of one view that is kept between steps. Only the thread that holds the ``lock`` changes
    it.
    """

    lock: threading.Lock

    def is_shown(self, frame: Frame) -> bool:
        """Whether a ``frame`` shows this light as far as it has come."""


Light = TypeVar("Light", bound=Converging)


class Refinement(ABC, Generic[Light]):
    """A kind of light that converges: texels of walls, views through glass, shine, or pixels that a
    check chooses.

    Any thread may take a step, and each step brings a picture nearer to a target error.
    """

    def step(
        self, frame: Frame, light: RotatedLight, target: float, tiles: Tiles, prices: Prices
    ) -> bool:
        """Bring a ``frame`` in a ``light`` a step nearer to the ``target``; whether there was a
        step to take.

        Ways to the target are weighed at these ``prices``. If another thread took a step since the
        frame was drawn, that was the step. Raises Cancelled.
        """
        found = self.of(frame, light, target, tiles)
        if found is None:
            return False
        with found.lock:
            return not found.is_shown(frame) or self.advance(found, frame, target, tiles, prices)

    @abstractmethod
    def of(self, frame: Frame, light: RotatedLight, target: float, tiles: Tiles) -> Light | None:
        """The light of this kind in a ``frame``, as far as it has come; None if the frame has none
        of it.
        """

    @abstractmethod
    def advance(
        self, found: Light, frame: Frame, target: float, tiles: Tiles, prices: Prices
    ) -> bool:
        """Have the light ``found`` in a ``frame``, and locked, take more paths; False if it needs
        none.
        """
