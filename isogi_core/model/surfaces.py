"""Several isosurfaces: those that are pinned beside the one that slides, and how much light gets through each."""

import math
from collections.abc import Mapping
from dataclasses import astuple, dataclass
from typing import Any

from isogi_core.errors import SceneError, advice
from isogi_core.files.scene_file import is_number
from isogi_core.model.lights import Colour
from isogi_core.model.volume import Volume

MOST_PINNED = 3
"""Most isosurfaces beside the one that slides: every ray is cast at each of them."""

SURFACE_KEYS = ("isovalue", "albedo", "transmission", "clear", "name")
"""What a ``[[surfaces]]`` table may have."""

OPAQUE: Colour = (0.0, 0.0, 0.0)
"""The transmission of a surface that gives none."""

SHARE_ROUNDING = 1e-9
"""How much more than all light may leave a surface: decimals add up to more than 1 by what floats round."""


@dataclass(frozen=True)
class PinnedSurface:
    """An isosurface that stays: its ``isovalue`` in the units of the volume's file, the ``albedo`` of both its sides,
    linear RGB, and the share of rays that passes straight through it, ``clear``. Its ``name`` is for display. Of the
    light that falls on one side its ``transmission``, linear RGB, leaves the other, evenly to all sides.
    """

    isovalue: float
    albedo: Colour = (0.7, 0.7, 0.7)
    clear: float = 0.0
    name: str = ""
    transmission: Colour = OPAQUE

    @property
    def facts(self) -> tuple[Any, ...]:
        """All that light depends on; nothing of a transmission where there is none."""
        return astuple(self)[:3] + (self.transmission if any(self.transmission) else ())

    @property
    def leaving(self) -> Colour:
        """The share of light that leaves it on either side where as much falls on both."""
        return leaving(self.albedo, self.transmission)

    @property
    def table(self) -> dict[str, Any]:
        """The surface as a ``[[surfaces]]`` table."""
        through = {"transmission": list(self.transmission)} if any(self.transmission) else {}
        own = {"isovalue": self.isovalue, "albedo": list(self.albedo), "clear": self.clear, "name": self.name}
        return own | through


def leaving(albedo: Colour, transmission: Colour) -> Colour:
    """The share of light that leaves a surface on either side where as much falls on both: their sum."""
    red, green, blue = (min(back + through, 1.0) for back, through in zip(albedo, transmission, strict=True))
    return red, green, blue


def refuse_gain(albedo: Colour, transmission: Colour, surface: str) -> None:
    """Raise SceneError where more light leaves a ``surface``, as messages name it, than falls on it."""
    most = max(back + through for back, through in zip(albedo, transmission, strict=True))
    if most > 1.0 + SHARE_ROUNDING:
        raise SceneError(f"{surface} has albedo + transmission = {most:g}: lower one, to 1 at most in each colour.")


def pinned_from_mapping(table: Mapping[str, Any], volume: Volume) -> PinnedSurface:
    """The surface of a ``volume`` that a ``[[surfaces]]`` table describes. SceneError where it has no meaning."""
    if unknown := sorted(set(table) - set(SURFACE_KEYS)):
        raise SceneError(f"A surface has no '{unknown[0]}': {advice(unknown[0], SURFACE_KEYS)}")
    low, high = volume.value_range
    isovalue, clear, name = table.get("isovalue", math.nan), table.get("clear", 0.0), table.get("name", "")
    if not is_number(isovalue) or not low <= isovalue <= high:
        given = table.get("isovalue")
        raise SceneError(f"A surface's isovalue is {given!r}: give a number from {low:g} to {high:g}.")
    if not is_number(clear) or not 0.0 <= clear <= 1.0:
        raise SceneError(f"The surface at {isovalue:g} has clear = {clear!r}: give a number from 0, opaque, to 1.")
    if not isinstance(name, str) or not (name == "" or name.isprintable()):
        raise SceneError(f"The surface at {isovalue:g} is named {name!r}: give it a word or a few.")
    albedo, transmission = _colour(table, "albedo", 0.7), _colour(table, "transmission", 0.0)
    refuse_gain(albedo, transmission, f"The surface at {isovalue:g}")
    return PinnedSurface(float(isovalue), albedo, float(clear), name.strip(), transmission)


def _colour(table: Mapping[str, Any], key: str, fallback: float) -> Colour:
    given = table.get(key, fallback)
    listed = [given] * 3 if is_number(given) else given
    if not isinstance(listed, list) or len(listed) != 3 or not all(is_number(v) and 0.0 <= v <= 1.0 for v in listed):
        at = f"The surface at {table['isovalue']:g}"
        raise SceneError(f"{at} has {key} {given!r}: give a number from 0 to 1, or three.")
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
