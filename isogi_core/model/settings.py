"""The settings of a scene document, checked one by one as they are asked for."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from isogi_core.errors import SceneError
from isogi_core.model.source import SceneSource


class Settings:
    """The settings of a scene document, each asked for once and checked; SceneError names the setting."""

    def __init__(self, source: SceneSource) -> None:
        """Begin reading ``source``."""
        self.source = source
        self.known: set[str] = set()

    def _get(self, key: str) -> Any:
        self.known.add(key)
        return self.source.document.get(key)

    def _wrong(self, key: str, wanted: str) -> SceneError:
        given = self.source.document.get(key)
        return SceneError(f"{key} = {given!r} in the scene '{self.source.name}' is not {wanted}.")

    def text(self, key: str, fallback: str) -> str:
        """A string."""
        value = self._get(key)
        if value is None:
            return fallback
        if not isinstance(value, str):
            raise self._wrong(key, "a string")
        return value

    def choice(self, key: str, among: Sequence[str]) -> str | None:
        """One of some words, or None where the scene leaves it to the plan."""
        value = self._get(key)
        if value is not None and value not in among:
            raise self._wrong(key, f"one of {', '.join(among)}")
        return None if value is None else str(value)

    def flag(self, key: str, fallback: bool) -> bool:
        """True or false."""
        value = self._get(key)
        if value is None:
            return fallback
        if not isinstance(value, bool):
            raise self._wrong(key, "true or false")
        return value

    def number(self, key: str, fallback: float, low: float, high: float) -> float:
        """A number in [low, high]."""
        value = self._get(key)
        if value is None:
            return float(fallback)
        if not is_number(value) or not low <= value <= high:
            raise self._wrong(key, f"a number from {low:g} to {high:g}")
        return float(value)

    def count(self, key: str, high: int, low: int = 0) -> int | None:
        """A whole number in [low, high], or None where the scene leaves it to the plan."""
        value = self._get(key)
        if value is None:
            return None
        if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
            raise self._wrong(key, f"a whole number from {low} to {high}")
        return value

    def numbers(self, key: str, length: int) -> tuple[float, ...] | None:
        """A list of ``length`` finite numbers, or None."""
        value = self._get(key)
        if value is None:
            return None
        if not isinstance(value, list | tuple) or len(value) != length or not all(map(is_number, value)):
            raise self._wrong(key, f"a list of {length} numbers")
        return tuple(float(v) for v in value)

    def interval(self, key: str, within: tuple[float, float]) -> tuple[float, float]:
        """Two ascending numbers inside ``within``, which is also what it is when left out."""
        value = self.numbers(key, 2)
        if value is None:
            return within
        if not within[0] <= value[0] <= value[1] <= within[1]:
            raise self._wrong(key, f"two ascending numbers from {within[0]:g} to {within[1]:g}, the volume's range")
        return value[0], value[1]

    def colour(self, key: str, fallback: float) -> tuple[float, float, float]:
        """A number or [r, g, b], each in [0, 1]."""
        value = self._get(key)
        if value is None:
            value = fallback
        listed = [value] * 3 if is_number(value) else value
        if not isinstance(listed, list) or len(listed) != 3 or not all(is_number(v) and 0 <= v <= 1 for v in listed):
            raise self._wrong(key, "a number from 0 to 1, or three of them")
        r, g, b = (float(v) for v in listed)
        return r, g, b

    def lights(self) -> list[Mapping[str, Any]]:
        """The [[lights]] tables; a sky with a sun where the scene has none."""
        value = self._get("lights")
        if value is None:
            return [{"type": "sky"}]
        if not isinstance(value, list) or not value or not all(isinstance(entry, Mapping) for entry in value):
            raise self._wrong("lights", "a list of [[lights]] tables")
        return value

    def refuse_unknown(self) -> None:
        """Raise SceneError for settings that nobody asked for: a typing error is not passed over."""
        unknown = sorted(set(self.source.document) - self.known)
        if unknown:
            known = ", ".join(sorted(self.known))
            raise SceneError(f"The scene '{self.source.name}' sets {', '.join(unknown)}, unknown here; known: {known}.")


def is_number(value: Any) -> bool:
    """Whether ``value`` is a finite real number (and not a bool)."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
