"""Presets: isovalues that have names, told by a scene or found in its volume."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from isogi_core.errors import SceneError
from isogi_core.model.settings import Settings, is_number

MOST = 24
"""Presets that a scene may tell: a person finds one among these at a glance."""

LONGEST = 40
"""Characters that a preset's name may have."""


@dataclass(frozen=True)
class Preset:
    """An isovalue with a name, in the volume's own units; ``suggested`` where nobody told it."""

    name: str
    isovalue: float
    suggested: bool = False


def read_presets(settings: Settings, isovalues: tuple[float, float]) -> tuple[Preset, ...]:
    """The scene's own presets, in its order; SceneError where one has no name or lies outside ``isovalues``."""
    entries = settings.tables("presets", MOST)
    presets = tuple(_preset(entry, isovalues) for entry in entries)
    if len({preset.name for preset in presets}) < len(presets):
        raise SceneError("Two presets of the scene have the same name: give each its own.")
    return presets


def suggested_presets(values: tuple[float, ...]) -> tuple[Preset, ...]:
    """Presets that are named by their isovalues."""
    return tuple(Preset(f"{value:.6g}", value, suggested=True) for value in values)


def _preset(entry: Mapping[str, Any], isovalues: tuple[float, float]) -> Preset:
    if set(entry) != {"name", "isovalue"}:
        given = ", ".join(sorted(map(str, entry))) or "nothing"
        raise SceneError(f"A preset of the scene has {given}: give it name and isovalue, and no more.")
    name, isovalue = entry["name"], entry["isovalue"]
    if not isinstance(name, str) or not name.strip() or len(name) > LONGEST or not name.isprintable():
        raise SceneError(f"A preset's name is {name!r}: give it a word or a few, of {LONGEST} characters at most.")
    low, high = isovalues
    if not is_number(isovalue) or not low <= isovalue <= high:
        raise SceneError(f"The preset '{name}' has isovalue {isovalue!r}, not a number from {low:g} to {high:g}.")
    return Preset(name.strip(), float(isovalue))
