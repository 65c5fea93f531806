"""Shine: how a surface mirrors light, roughly, besides what it scatters; a coat of plastic, or metal."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

from isogi_core.errors import SceneError, ViewError, advice
from isogi_core.files.scene_file import is_number

SHINE_KINDS = ("plastic", "metal")
"""What a surface may shine as. Plastic mirrors 4 % of what arrives head on, in its own colour; metal its albedo."""

MIN_ROUGHNESS = 0.02
"""The least roughness: such a surface mirrors light within about a twentieth of a degree."""


@dataclass(frozen=True)
class Shine:
    """The shine of a surface: its ``kind``, the ``roughness`` of its facets, and how much it counts, ``strength``.

    Roughness is the square root of GGX's α. Of metal the strength is the share of the surface that is metal; the rest
    is diffuse. Raises ViewError where a number has no meaning.
    """

    kind: str = field(
        default="plastic", metadata={"help": "Of a scene with a shine: plastic or metal; default: the scene's."}
    )
    roughness: float = field(
        default=0.3,
        metadata={"range": (MIN_ROUGHNESS, 1), "help": "Of that shine, 0.02 (a mirror) to 1; default: the scene's."},
    )
    strength: float = field(
        default=1.0, metadata={"range": (0, 1), "help": "How much that shine counts, 0 to 1; default: the scene's."}
    )

    def __post_init__(self) -> None:
        if self.kind not in SHINE_KINDS:
            raise ViewError(f"A surface cannot shine as '{self.kind}': choose {' or '.join(SHINE_KINDS)}.")
        for name, (low, high) in SHINE_RANGES.items():
            if not low <= getattr(self, name) <= high:
                given = f"The {name} of shine is {getattr(self, name):g}"
                raise ViewError(f"{given}: it must be from {low:g} to {high:g}.")

    @property
    def alpha(self) -> float:
        """GGX's α (Burley 2012)."""
        return self.roughness**2


SHINE_RANGES: dict[str, tuple[float, float]] = {
    each.name: each.metadata["range"] for each in fields(Shine) if "range" in each.metadata
}
"""The least and the greatest value of each number of a shine."""

SHINE_KNOBS = {"shine" if each.name == "kind" else each.name: each.name for each in fields(Shine)}
"""Parameters of views that change the shine, and the fields of Shine that they are."""

SHINE_HELP: dict[str, str] = dict(zip(SHINE_KNOBS, (each.metadata["help"] for each in fields(Shine)), strict=True))
"""What each of these parameters does, in a line."""

DULL = Shine(strength=0.0)
"""What views ask for that are to show diffuse light alone."""


def shine_from_mapping(table: Mapping[str, Any]) -> Shine:
    """The shine that a scene's ``[shine]`` table describes. SceneError where a key is unknown or has no meaning."""
    known = {each.name: "a number" if each.name in SHINE_RANGES else "a word" for each in fields(Shine)}
    for key, value in table.items():
        if key not in known:
            raise SceneError(f"Shine has no '{key}': {advice(key, known)}")
        if not (isinstance(value, str) if key == "kind" else is_number(value)):
            raise SceneError(f"The {key} of shine is {value!r}: give {known[key]}.")
    try:
        return Shine(**table)
    except ViewError as error:
        raise SceneError(str(error)) from None
