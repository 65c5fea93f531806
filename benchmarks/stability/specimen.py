"""Specimens: volumes that are hard on a renderer, by name."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

Spacing = tuple[float, float, float]

SPECIMENS: dict[str, "Specimen"] = {}
"""All specimens, in the order in which they were told."""


@dataclass(frozen=True)
class Specimen:
    """A volume (z, y, x) that ``make`` makes, its ``spacing`` (x, y, z), and ``isovalues`` in its own units to look at.

    ``refused`` is a word of the sentence with which the volume is refused, where it is; ``empty`` says that nothing
    is to be seen at any of the isovalues. ``settings`` are more of its scene.
    """

    group: str
    name: str
    make: Callable[[], np.ndarray]
    isovalues: tuple[float, ...]
    spacing: Spacing
    refused: str
    empty: bool
    settings: Mapping[str, Any]


def specimen(
    group: str,
    name: str,
    *isovalues: float,
    spacing: Spacing = (1.0, 1.0, 1.0),
    refused: str = "",
    empty: bool = False,
    **settings: Any,
) -> Callable[[Callable[[], np.ndarray]], Callable[[], np.ndarray]]:
    """Decorator: the function makes this specimen."""

    def tell(make: Callable[[], np.ndarray]) -> Callable[[], np.ndarray]:
        SPECIMENS[name] = Specimen(group, name, make, isovalues, spacing, refused, empty, settings)
        return make

    return tell


def volumes(group: str = "") -> list[Specimen]:
    """The specimens that are not refused, of one group or of all."""
    return [each for each in SPECIMENS.values() if not each.refused and group in ("", each.group)]
