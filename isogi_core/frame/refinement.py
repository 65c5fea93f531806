"""What refines a picture at rest once its texels' light is final: walls and glass, then shine, then its pixels."""

from typing import Protocol

from isogi_core.frame.frame import Frame
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.rays.picture_plan import Prices
from isogi_core.frame.tiles import Tiles


class Refinement(Protocol):
    """A kind of light that pictures take more paths for, step by step, and show as far as it has come."""

    def step(self, frame: Frame, light: RotatedLight, target: float, tiles: Tiles, prices: Prices) -> bool:
        """Bring a ``frame`` in a ``light`` a step nearer to the ``target``; whether there was a step to take.

        Ways to the target are weighed at these ``prices``. Raises Cancelled.
        """
