"""The view that a scene is first seen with: camera, light and picture, as its table ``[view]``
says.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from isogi_core.errors import SceneError
from isogi_core.files.packed_files import in_short
from isogi_core.files.scene_file import Settings, TableReaders, is_number, read_table, read_vector
from isogi_core.files.vector import Vector

GROUNDS = ("light", "dark", "transparent")
"""Backgrounds that have names."""


@dataclass(frozen=True)
class FirstView:
    """The first view of a scene, in the parameters of views; None leaves a parameter to be found
    from the surface.

    Angles are in degrees. ``distance`` is in radii of the volume from the ``target``, a point of
    the world. ``background`` is one of GROUNDS, or sRGB as ``#rrggbb``.
    """

    azimuth: float | None = None
    elevation: float | None = None
    distance: float | None = None
    target: Vector | None = None
    fov: float | None = None
    yaw: float | None = None
    pitch: float | None = None
    roll: float | None = None
    exposure: float | None = None
    background: str | None = None

    @property
    def given(self) -> dict[str, Any]:
        """The parameters that the scene gives."""
        return {name: value for name, value in asdict(self).items() if value is not None}

    @property
    def placed(self) -> bool:
        """True if the camera's place is given; it is then not fitted to the surface."""
        return self.distance is not None or self.target is not None


def read_first_view(settings: Settings) -> FirstView:
    """Read the first view of a scene from its table ``[view]``. Raises SceneError if a key is
    unknown or a value has no meaning.
    """
    table: Mapping[str, Any] | None = settings.table("view")
    if table is None:
        return FirstView()
    return FirstView(**read_table(table, "The view", VIEW_READERS))


def _number_reader(low: float, high: float) -> Callable[[str, Any], float]:
    """Return a function that reads a number from ``low`` to ``high``, as TableReaders need it."""

    def read(name: str, value: Any) -> float:
        """Return a number. Raises SceneError if it is none, or out of range."""
        if not is_number(value) or not low <= value <= high:
            raise SceneError(
                f"{name} is {in_short(value)}: give a number from {low:g} to {high:g}."
            )
        return float(value)

    return read


def _ground(name: str, value: Any) -> str:
    """Read a background. Raises SceneError if it is none."""
    text = str(value).lower()
    if text not in GROUNDS and not re.fullmatch("#[0-9a-f]{6}", text):
        raise SceneError(
            f"{name} is {in_short(value)}: give {', '.join(GROUNDS)}, or a colour such as #ffffff."
        )
    return text


VIEW_READERS: TableReaders = {
    "azimuth": _number_reader(-360.0, 360.0),
    "elevation": _number_reader(-90.0, 90.0),
    "distance": _number_reader(0.01, 1e7),
    "target": read_vector,
    "fov": _number_reader(0.01, 179.0),
    "yaw": _number_reader(-360.0, 360.0),
    "pitch": _number_reader(-360.0, 360.0),
    "roll": _number_reader(-360.0, 360.0),
    "exposure": _number_reader(1e-36, 1e36),
    "background": _ground,
}
"""Readers of the keys of ``[view]``."""
