"""Terms: what of a texel's light meets one and the same light, and is multiplied by it."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Term:
    """The sum of some ``layers`` of a plan, by their numbers, under one unturned ``light`` (3, n²), linear RGB.

    Of a layer that is kept for several albedos it is the channel ``node`` alone.
    ``order`` is that of the light; ``luminance`` (channels, n²) is what is reflected of it, see ``to_luminance``, and
    ``square`` (n²,) the square of that luminance in the unit of a look, see ``bake.moments``.
    """

    layers: tuple[int, ...]
    order: int
    light: np.ndarray
    luminance: np.ndarray
    square: np.ndarray
    node: int | None = None
