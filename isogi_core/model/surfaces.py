"""Several isosurfaces: those that are pinned beside the one that slides, and how much passes straight through each."""

import math
from collections.abc import Mapping
from dataclasses import astuple, dataclass
from typing import Any

from isogi_core.errors import SceneError
from isogi_core.files.scene_file import is_number
from isogi_core.model.lights import Colour
from isogi_core.model.volume import Volume

MOST_PINNED = 3
"""Most isosurfaces beside the one that slides: every ray is cast at each of them."""

KEYS = ("isovalue", "albedo", "clear", "name")
"""What a ``[[surfaces]]`` table may have."""


@dataclass(frozen=True)
class PinnedSurface:
    """An isosurface that stays: its ``isovalue`` in the units of the volume's file, the ``albedo`` of both its sides,
    linear RGB, and the share of rays that passes straight through it, ``clear``. Its ``name`` is for display.
    """

    isovalue: float
    albedo: Colour = (0.7, 0.7, 0.7)
    clear: float = 0.0
    name: str = ""

    @property
    def facts(self) -> tuple[Any, ...]:
        """All that light depends on."""
        return astuple(self)[:3]

    @property
    def table(self) -> dict[str, Any]:
        """It as a ``[[surfaces]]`` table."""
        return {"isovalue": self.isovalue, "albedo": list(self.albedo), "clear": self.clear, "name": self.name}


def pinned_from_mapping(table: Mapping[str, Any], volume: Volume) -> PinnedSurface:
    """The surface of a ``volume`` that a ``[[surfaces]]`` table describes. SceneError where it has no meaning."""
    if unknown := sorted(set(table) - set(KEYS)):
        raise SceneError(f"A surface has no '{unknown[0]}': choose from {', '.join(KEYS)}.")
    low, high = volume.value_range
    isovalue, clear, name = table.get("isovalue", math.nan), table.get("clear", 0.0), table.get("name", "")
    if not is_number(isovalue) or not low <= isovalue <= high:
        given = table.get("isovalue")
        raise SceneError(f"A surface's isovalue is {given!r}: give a number from {low:g} to {high:g}.")
    if not is_number(clear) or not 0.0 <= clear <= 1.0:
        raise SceneError(f"The surface at {isovalue:g} has clear = {clear!r}: give a number from 0, opaque, to 1.")
    if not isinstance(name, str) or not (name == "" or name.isprintable()):
        raise SceneError(f"The surface at {isovalue:g} is named {name!r}: give it a word or a few.")
    return PinnedSurface(float(isovalue), _albedo(table, isovalue), float(clear), name.strip())


def _albedo(table: Mapping[str, Any], isovalue: float) -> Colour:
    given = table.get("albedo", 0.7)
    listed = [given] * 3 if is_number(given) else given
    if not isinstance(listed, list) or len(listed) != 3 or not all(is_number(v) and 0.0 <= v <= 1.0 for v in listed):
        raise SceneError(f"The surface at {isovalue:g} has albedo {given!r}: give a number from 0 to 1, or three.")
    red, green, blue = (float(v) for v in listed)
    return red, green, blue


def pinned_surfaces(tables: list[Mapping[str, Any]], volume: Volume) -> tuple[PinnedSurface, ...]:
    """The pinned surfaces that tables describe. SceneError where one has no meaning, or two are the same."""
    if len(tables) > MOST_PINNED:
        raise SceneError(f"The scene has {len(tables)} [[surfaces]] beside the one that slides: give {MOST_PINNED}.")
    found = tuple(pinned_from_mapping(table, volume) for table in tables)
    levels = [volume.normalise_isovalue(each.isovalue) for each in found]
    if len(set(levels)) < len(levels):
        raise SceneError("Two [[surfaces]] have the same isovalue: leave one of them out.")
    return found
