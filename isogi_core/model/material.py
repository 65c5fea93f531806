"""Materials of isosurfaces, their shine, and pinned surfaces.

A scene may have several isosurfaces: pinned ones stay at their isovalue next to the one that
slides, and may let light through.
"""

import math
from collections.abc import Mapping
from dataclasses import astuple, dataclass, field, fields
from typing import TYPE_CHECKING, Any

from isogi_core.errors import SceneError, ViewError, advice
from isogi_core.files.scene_file import are_numbers, is_number
from isogi_core.files.spelling import shortest
from isogi_core.files.vector import triple
from isogi_core.model.lights import LARGEST_LIGHT, Colour

if TYPE_CHECKING:
    from isogi_core.model.volume import Volume

INDICES = (1.0, 4.0)
"""Range of indices of refraction that a surface may have: from that of its surroundings to that
of germanium.
"""

WINDOW_GLASS = 1.5
"""Index of refraction of glass if a scene gives none."""


@dataclass(frozen=True)
class Material:
    """The material of a surface; ``kind`` is one of MATERIALS.

    - ``index``: index of refraction of glass.
    - ``absorption``: of glass, linear RGB per unit of world length; the share exp(-absorption) of
      light is left after one unit.
    - ``mean_free_path``: of a subsurface, world units; after this distance on average light is
      scattered evenly in all directions, and the surface's albedo is the share that is left.

    Raises SceneError if a number has no meaning.
    """

    kind: str = "diffuse"
    index: float = 1.0
    absorption: Colour = (0.0, 0.0, 0.0)
    mean_free_path: float = math.inf

    def __post_init__(self) -> None:
        low, high = INDICES
        if not low <= self.index <= high:
            raise SceneError(
                f"The index of refraction is {self.index:g}: give a number from {low:g} to "
                f"{high:g}."
            )
        if not all(0.0 <= share <= LARGEST_LIGHT for share in self.absorption):
            given = ", ".join(f"{share:g}" for share in self.absorption)
            raise SceneError(
                f"The absorption is {given}: it must not be less than 0, per unit of length."
            )
        if not self.mean_free_path > 0.0:
            raise SceneError(
                f"The mean free path is {self.mean_free_path:g}: it must be more than 0."
            )

    @property
    def refracts(self) -> bool:
        """True if rays pass through it; its surface then keeps no texels."""
        return self.kind == "glass"

    @property
    def scatters(self) -> bool:
        """True if light enters and leaves elsewhere."""
        return self.kind == "subsurface"

    @property
    def passable(self) -> bool:
        """True if rays enter at all."""
        return self.refracts or self.scatters


MATERIALS = ("diffuse", "glass", "subsurface")
"""Materials that a surface may have."""

DIFFUSE = Material()


SHINE_KINDS = ("plastic", "metal")
"""Kinds of shine. Plastic mirrors 4 % of the light that arrives head on, without changing its
colour; metal mirrors its albedo.
"""

MIN_ROUGHNESS = 0.02
"""Least roughness: such a surface mirrors light within about a twentieth of a degree."""


@dataclass(frozen=True)
class Shine:
    """The shine of a surface: its ``kind``, the ``roughness`` of its microfacets, and its
    ``strength``.

    Roughness is the square root of GGX's α. For metal the strength is the share of the surface that
    is metal; the rest is diffuse. Raises ViewError if a number has no meaning.
    """

    kind: str = "plastic"
    roughness: float = field(
        default=0.3, metadata={"range": (MIN_ROUGHNESS, 1), "help": "Roughness of that shine"}
    )
    strength: float = field(
        default=1.0, metadata={"range": (0, 1), "help": "How much that shine counts"}
    )

    def __post_init__(self) -> None:
        if self.kind not in SHINE_KINDS:
            raise ViewError(
                f"A surface cannot shine as '{self.kind}': choose {' or '.join(SHINE_KINDS)}."
            )
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
"""Least and greatest value of each number of a shine."""

SHINE_HELP: dict[str, str] = {
    each.name: each.metadata["help"] for each in fields(Shine) if "help" in each.metadata
}
"""Help text of each number of a shine, without its full stop."""

SHINE_KNOBS = {"shine" if each.name == "kind" else each.name: each.name for each in fields(Shine)}
"""Parameters of views that change the shine, and the fields of Shine that they set."""

DULL = Shine(strength=0.0)
"""The shine of views that ask for diffuse light alone."""


def shine_from_mapping(table: Mapping[str, Any]) -> Shine:
    """Read the shine of a scene's ``[shine]`` table. Raises SceneError if a key is unknown or a
    value has no meaning.
    """
    known = {
        each.name: "a number" if each.name in SHINE_RANGES else "a word" for each in fields(Shine)
    }
    for key, value in table.items():
        if key not in known:
            raise SceneError(f"Shine has no '{key}': {advice(key, known)}")
        if not (isinstance(value, str) if key == "kind" else is_number(value)):
            raise SceneError(f"The {key} of shine is {value!r}: give {known[key]}.")
    try:
        return Shine(**table)
    except ViewError as error:
        raise SceneError(str(error)) from None


MOST_PINNED = 3
"""Most isosurfaces next to the one that slides: every ray is cast at each of them."""

SURFACE_KEYS = ("isovalue", "albedo", "transmission", "clear", "name")
"""Keys of a ``[[surfaces]]`` table."""

OPAQUE: Colour = (0.0, 0.0, 0.0)
"""Transmission of a surface that gives none."""

SHARE_ROUNDING = 1e-9
"""Tolerance for light that leaves a surface above the light that falls on it, as sums of
decimals round.
"""


@dataclass(frozen=True)
class PinnedSurface:
    """An isosurface that stays at its ``isovalue``, in the units of the volume's file.

    - ``albedo``: of both sides, linear RGB.
    - ``clear``: share of rays that pass straight through it.
    - ``transmission``: share of the light falling on one side that leaves the other evenly in all
      directions, linear RGB.
    - ``name``: for display.
    """

    isovalue: float
    albedo: Colour = (0.7, 0.7, 0.7)
    clear: float = 0.0
    name: str = ""
    transmission: Colour = OPAQUE

    @property
    def facts(self) -> tuple[Any, ...]:
        """Everything that light depends on; a transmission of 0 is left out."""
        return astuple(self)[:3] + (self.transmission if any(self.transmission) else ())

    @property
    def leaving(self) -> Colour:
        """Share of light that leaves it on either side if equal light falls on both."""
        return leaving(self.albedo, self.transmission)

    @property
    def table(self) -> dict[str, Any]:
        """The surface as a ``[[surfaces]]`` table."""
        table: dict[str, Any] = {
            "isovalue": self.isovalue,
            "albedo": list(self.albedo),
            "clear": self.clear,
            "name": self.name,
        }
        if any(self.transmission):
            table["transmission"] = list(self.transmission)
        return table


def leaving(albedo: Colour, transmission: Colour) -> Colour:
    """Return the share of light that leaves a surface on either side if equal light falls on
    both: albedo plus transmission, at most 1.
    """
    return triple(
        min(back + through, 1.0) for back, through in zip(albedo, transmission, strict=True)
    )


def refuse_gain(albedo: Colour, transmission: Colour, surface: str) -> None:
    """Raise SceneError if more light leaves a ``surface``, as messages name it, than falls on
    it.
    """
    most = max(back + through for back, through in zip(albedo, transmission, strict=True))
    if most > 1.0 + SHARE_ROUNDING:
        raise SceneError(
            f"{surface} has albedo + transmission = {most:g}: lower one, to 1 at most in each "
            "colour."
        )


def pinned_from_mapping(table: Mapping[str, Any], volume: "Volume") -> PinnedSurface:
    """Read the surface of a ``volume`` from a ``[[surfaces]]`` table. Raises SceneError if it
    has no meaning.
    """
    if unknown := sorted(set(table) - set(SURFACE_KEYS)):
        raise SceneError(f"A surface has no '{unknown[0]}': {advice(unknown[0], SURFACE_KEYS)}")
    low, high = volume.value_range
    isovalue = table.get("isovalue", math.nan)
    clear = table.get("clear", 0.0)
    name = table.get("name", "")
    if not is_number(isovalue) or not low <= isovalue <= high:
        given = table.get("isovalue")
        raise SceneError(
            f"A surface's isovalue is {given!r}: give a number from {shortest(low)} to "
            f"{shortest(high)}."
        )
    if not is_number(clear) or not 0.0 <= clear <= 1.0:
        raise SceneError(
            f"The surface at {shortest(isovalue)} has clear = {clear!r}: give a number from 0, "
            "opaque, to 1."
        )
    if not isinstance(name, str) or not (name == "" or name.isprintable()):
        raise SceneError(
            f"The surface at {shortest(isovalue)} is named {name!r}: give it a word or a few."
        )
    # No more light may leave the surface than falls on it.
    albedo = _colour(table, "albedo", 0.7)
    transmission = _colour(table, "transmission", 0.0)
    refuse_gain(albedo, transmission, f"The surface at {shortest(isovalue)}")
    return PinnedSurface(float(isovalue), albedo, float(clear), name.strip(), transmission)


def _colour(table: Mapping[str, Any], key: str, fallback: float) -> Colour:
    """Read one share for all channels, or three. Raises SceneError if it is neither."""
    given = table.get(key, fallback)
    listed = [given] * 3 if is_number(given) else given
    if not are_numbers(listed, 3) or not all(0.0 <= share <= 1.0 for share in listed):
        at = f"The surface at {shortest(table['isovalue'])}"
        raise SceneError(f"{at} has {key} {given!r}: give a number from 0 to 1, or three.")
    return triple(listed)


def pinned_surfaces(tables: list[Mapping[str, Any]], volume: "Volume") -> tuple[PinnedSurface, ...]:
    """Read pinned surfaces from their tables. Raises SceneError if one has no meaning, or two
    are at the same isovalue.
    """
    if len(tables) > MOST_PINNED:
        raise SceneError(
            f"The scene has {len(tables)} [[surfaces]] next to the one that slides: give "
            f"at most {MOST_PINNED}."
        )
    found = tuple(pinned_from_mapping(table, volume) for table in tables)
    # Isovalues that differ in the file may be equal once normalised.
    levels = [volume.normalise_isovalue(each.isovalue) for each in found]
    if len(set(levels)) < len(levels):
        raise SceneError("Two [[surfaces]] have the same isovalue: leave one of them out.")
    return found
