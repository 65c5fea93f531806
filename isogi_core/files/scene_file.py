"""Scene files: the parsed document, changes to it that views may ask for, and its settings, each
checked when it is read.

Parameters of views spell such changes: the shares of rays that pass pinned surfaces, hidden labels,
and the material of the surface.
"""

import math
import sys
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import unquote

from isogi_core.errors import SceneError, advice, readable
from isogi_core.files.packed_files import in_short, read_small, reason_of
from isogi_core.files.spelling import shortest
from isogi_core.files.vector import Vector, triple

CHANGING_PARAMETERS = ("surfaces", "hide", "material")
"""Parameters of views that change a scene's document by more than a setting of the same name."""


def change_document(
    document: Mapping[str, Any],
    surfaces: str | None = None,
    hide: str | None = None,
    material: str | None = None,
) -> Mapping[str, Any]:
    """Return a scene's ``document`` with the changes that are spelled; None changes nothing. Raises
    SceneError.
    """
    if surfaces is not None:
        pinned = tables_in(document, "surfaces")
        document = put_clears(document, pinned, read_clears(surfaces, len(pinned)))
    if hide is not None:
        document = put_hidden(document, read_hidden(hide))
    if material is None:
        return document
    return put_material(document, read_material_text(material))


def tables_in(document: Mapping[str, Any], key: str) -> list[Mapping[str, Any]]:
    """Return the tables that a ``document`` lists under a ``key``; other values are left out."""
    given = document.get(key)
    if isinstance(given, list):
        return [each for each in given if isinstance(each, Mapping)]
    return []


HIDDEN_SURFACE = "off"
"""Stands for a surface that is not shown, in place of the share of rays that passes it."""

Clears = tuple[float | None, ...]
"""The shares of rays that pass pinned surfaces in turn; None of hidden ones."""


def read_clears(text: str, pinned: int) -> Clears:
    """Return the shares of rays that pass each of ``pinned`` surfaces, as ``0.4,off`` spells them;
    None for hidden ones. Raises SceneError.
    """
    try:
        found = tuple(
            None if each.strip() == HIDDEN_SURFACE else float(each) for each in text.split(",")
        )
    except ValueError:
        found = ()
    if not pinned:
        raise SceneError("surfaces is for scenes with [[surfaces]]: leave it out.")
    if len(found) != pinned or not all(each is None or 0.0 <= each <= 1.0 for each in found):
        if pinned > 1:
            asked = f"for each of the {pinned} pinned surfaces, in turn"
        else:
            asked = "for the pinned surface"
        raise SceneError(
            f"surfaces = '{text[:40]}': give {asked}, a number from 0, opaque, to 1, or "
            f"{HIDDEN_SURFACE}."
        )
    return found


def put_clears(
    document: Mapping[str, Any], pinned: Sequence[Mapping[str, Any]], clears: Clears
) -> dict[str, Any]:
    """Return a scene's ``document`` in which the tables of the ``pinned`` surfaces have other
    shares of rays that pass; None leaves a surface out.
    """
    kept = [
        {**table, "clear": clear}
        for table, clear in zip(pinned, clears, strict=True)
        if clear is not None
    ]
    rest = {key: value for key, value in document.items() if key != "surfaces"}
    return rest | ({"surfaces": kept} if kept else {})


NO_LABEL = "none"
"""Word by which a view asks that no label is hidden, also none that its scene hides."""

Hidden = tuple[int, ...]
"""The values of labels that are hidden, ascending."""


def read_hidden(text: str) -> Hidden:
    """Return the labels to hide, as ``3,4`` spells them by their values in any order; empty for
    ``none``. Raises SceneError.
    """
    try:
        if text.strip() == NO_LABEL:
            return ()
        return tuple(sorted({int(each) for each in text.split(",")}))
    except ValueError:
        asked = f"give the values of labels with , between, or {NO_LABEL}"
        raise SceneError(f"hide = '{text[:40]}': {asked}.") from None


def put_hidden(document: Mapping[str, Any], hidden: Hidden) -> dict[str, Any]:
    """Return a scene's ``document`` with these labels ``hidden``, and no others. Raises SceneError
    if it has no labels.
    """
    if not document.get("labels"):
        raise SceneError("hide is for scenes of labels: leave it out.")
    listed = tables_in(document, "labels")
    known = [{**table, "hidden": table.get("value") in hidden} for table in listed]
    values = {table.get("value") for table in listed}
    found = known + [{"value": value, "hidden": True} for value in hidden if value not in values]
    return {**document, "labels": found or document["labels"]}


MaterialSettings = Mapping[str, Any]
"""The settings of a scene for the material of its surface: its name, and those of its numbers that
are given.
"""

MATERIAL_NUMBERS = {"index": "glass", "absorption": "glass", "mean_free_path": "subsurface"}
"""Settings that are numbers of a material, and of which."""

REFLECTION_SETTINGS = {"glass": ("albedo", "albedos"), "subsurface": ("albedos",)}
"""Settings of reflection at a surface. They are dropped if a view asks for one of these materials,
which have none.
"""


def read_material_text(text: str) -> MaterialSettings:
    """Return the settings of a material, as ``glass,index=1.3,absorption=0.1,0.2,0.3`` spells them.
    Raises SceneError.
    """
    kind, *rest = (each.strip() for each in text.split(","))
    found: dict[str, list[float]] = {}
    name = ""
    try:
        for each in rest:
            key, _, value = each.rpartition("=")
            name = key.strip() or name
            found.setdefault(name, []).append(float(value))
    except ValueError:
        name = ""
    if (
        not kind.isalpha()
        or (rest and name not in found)
        or not found.keys() <= MATERIAL_NUMBERS.keys()
    ):
        numbers = ", ".join(MATERIAL_NUMBERS)
        raise SceneError(
            f"material = '{text[:40]}': give a word, and {numbers} of it, such as glass,index=1.3."
        )
    for name in found:
        if MATERIAL_NUMBERS[name] != kind:
            raise SceneError(f"{name} is of {MATERIAL_NUMBERS[name]}, not of {kind}: leave it out.")
    return {
        "material": kind,
        **{name: given if len(given) > 1 else given[0] for name, given in found.items()},
    }


def write_material_text(settings: MaterialSettings) -> str:
    """Return the text that ``read_material_text`` reads as these ``settings``; equal settings have
    the same text.
    """
    given = {name: settings[name] for name in MATERIAL_NUMBERS if name in settings}
    listed = {
        name: value if isinstance(value, list | tuple) else [value] for name, value in given.items()
    }
    spelled = [f"{name}={','.join(map(_text_of, numbers))}" for name, numbers in listed.items()]
    return ",".join([settings["material"], *spelled])


def _text_of(number: float) -> str:
    """Return a number without a plus, which addresses read as a blank."""
    return repr(float(number)).replace("+", "")


def put_material(document: Mapping[str, Any], settings: MaterialSettings) -> dict[str, Any]:
    """Return a scene's ``document`` with another material; with the same one, numbers that are not
    given stay.
    """
    kind = settings["material"]
    if document.get("material", "diffuse") == kind:
        return {
            **document,
            **{name: value for name, value in settings.items() if name in MATERIAL_NUMBERS},
        }
    left = (*MATERIAL_NUMBERS, *REFLECTION_SETTINGS.get(kind, ()))
    return {**{name: value for name, value in document.items() if name not in left}, **settings}


DEFAULT_DEMO = "demo:casting"

ZARR_METADATA = ("zarr.json", ".zgroup", ".zarray", ".zattrs")
"""Metadata files of Zarr; every group and array has one of them."""


@dataclass(frozen=True)
class SceneSource:
    """A scene's document: enough for another process to build the same scene.

    ``document`` is the parsed TOML; paths in it are relative to the folder ``base``. ``found`` is
    True if isogi chose its isovalue, and a second surface with it: see ``with_start``.
    """

    name: str
    document: Mapping[str, Any] = field(hash=False)
    base: Path
    found: bool = False


Target = str | Path | SceneSource | None
"""A scene as callers name it: a path, a URL, a demo, a document, or None for the default demo."""


def find_source(target: Target, overrides: Mapping[str, Any]) -> SceneSource:
    """Read a scene's document, without opening its volume; ``overrides`` replace keys of it."""
    if isinstance(target, SceneSource):
        # An isovalue that is given replaces the one that isogi chose.
        found = target.found and "isovalue" not in overrides
        return replace(target, document={**target.document, **overrides}, found=found)
    text, lying = split_settings(str(target or DEFAULT_DEMO))
    changes = {key: lying.pop(key) for key in CHANGING_PARAMETERS if key in lying}
    source = source_at(text, {**overrides, **lying})
    return replace(source, document=change_document(source.document, **changes))


def source_at(text: str, overrides: Mapping[str, Any]) -> SceneSource:
    """Return the source of a target that has no settings after its #."""
    if text.startswith("demo:"):
        return SceneSource(text.removeprefix("demo:"), {"volume": text, **overrides}, Path.cwd())
    if "://" in text:
        return SceneSource(name_of(Path(text)), {"volume": text, **overrides}, Path.cwd())
    try:
        whole_name, mark, part = split_name(text)
        path = Path(whole_name).resolve()
    except (
        OSError,
        RuntimeError,
        ValueError,
    ) as error:  # a link to itself, a name that no system can hold
        raise SceneError(
            f"There is no file {in_short(text)}: check its path, and its links."
        ) from error
    if path.suffix != ".toml":
        whole = next((each for each in path.parents if each.suffix == ".zarr"), path)
        name = name_of(path)
        place = f"{path.relative_to(whole.parent)}{mark}{part}"
        return SceneSource(name, {"volume": place, **overrides}, whole.parent)
    try:
        document = tomllib.loads(read_small(path, MOST_BYTES).decode())
        check_values(document)
    except OSError as error:
        raise SceneError(f"Cannot read the scene {path}: {reason_of(error)}.") from error
    except (
        ValueError
    ) as error:  # of bytes that are no text, text that is no TOML, and integers of too many digits
        raise SceneError(
            f"The scene {path} is not valid TOML: {str(error).partition(';')[0]}."
        ) from error
    except RecursionError:
        raise SceneError(
            f"The scene {path} has lists or tables in each other beyond all use: write it again."
        ) from None
    name = readable(path.stem)
    document = with_research(document, name)
    return SceneSource(name, labels_as_volume({**document, **overrides}, name), path.parent)


RESEARCH_KEYS = (
    "chunk",
    "indirect_order",
    "lobes",
    "normals",
    "offset",
    "order",
    "precision",
    "representation",
)
"""Keys of a scene file that stand in its table [research]: the plan decides them for everybody
else.
"""


def with_research(document: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Return the document of a scene file with the keys of its table [research] among the others.

    Raises SceneError if such a key stands elsewhere, or if another key stands in the table.
    """
    for key in RESEARCH_KEYS:
        if key in document:
            raise SceneError(
                f"The scene '{name}' sets {key} among its own keys: write it under [research], at "
                "the file's end."
            )
    research = document.get("research", {})
    if not isinstance(research, Mapping):
        raise SceneError(
            f"The scene '{name}' has research = {research!r}: write a table [research]."
        )
    for key in research:
        if key not in RESEARCH_KEYS:
            raise SceneError(
                f"The scene '{name}' sets {key} under [research]: {advice(key, RESEARCH_KEYS)}"
            )
    return {**{key: value for key, value in document.items() if key != "research"}, **research}


def as_written(document: Mapping[str, Any]) -> dict[str, Any]:
    """Return a document as scene files have it, with the keys of RESEARCH_KEYS under [research]."""
    plain = {key: value for key, value in document.items() if key not in RESEARCH_KEYS}
    research = {key: value for key, value in document.items() if key in RESEARCH_KEYS}
    return {**plain, "research": research} if research else plain


def split_name(text: str) -> tuple[str, str, str]:
    """Return a volume's name, the # after it, and the choice that follows; a file may have a # in
    its name.
    """
    name, mark, part = text.rpartition("#")
    if not mark or not name or "://" in text or Path(text).exists():
        return text, "", ""
    if Path(name).exists():
        return (name, mark, part)
    return text.partition("#")


MOST_BYTES = 1 << 20
MOST_TEXT = 4096
MOST_ENTRIES = 4096
"""Bytes of a scene file, characters of a text in it, and entries of a list, such as lights, at
most.
"""

MOST_BITS = 1024
"""Bits of a whole number, at most: floats hold none that is larger."""


def check_values(value: Any, key: str = "The document") -> None:
    """Raise SceneError, which names the ``key``, if a text, a number or a list in a scene is longer
    than any setting can be, or if a text has a null character.

    It looks into tables and lists. Whatever is read later may rely on these limits.
    """
    if isinstance(value, str) and (len(value) > MOST_TEXT or "\0" in value):
        raise SceneError(
            f"{key} in the scene is a text of {len(value)} characters, {in_short(value)}: "
            "nothing has it."
        )
    if isinstance(value, int) and value.bit_length() > MOST_BITS:
        raise SceneError(
            f"{key} in the scene is a whole number of more than 300 digits: give a smaller one."
        )
    if isinstance(value, list) and len(value) > MOST_ENTRIES:
        raise SceneError(
            f"{key} in the scene has {len(value)} entries: give {MOST_ENTRIES} at most."
        )
    if isinstance(value, Mapping):
        for name, each in value.items():
            check_values(name, "A name")
            check_values(each, name)
    for each in value if isinstance(value, list) else ():
        check_values(each, key)


def labels_as_volume(document: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    """Return a scene's ``document``. If it has no volume, but a table [[volumes]] with use =
    "labels", that table names the volume, and all its labels are shown. Raises SceneError if there
    are more volumes then.
    """
    listed = tables_in(document, "volumes")
    found = [each for each in listed if each.get("use") == "labels"]
    if not found:
        return document
    if len(found) > 1 or "volume" in document or set(found[0]) != {"file", "use"}:
        wanted = "give the file and use of one such table of [[volumes]], and no volume"
        raise SceneError(f"In the scene '{name}' labels are the volume itself: {wanted}.")
    others = [each for each in listed if each is not found[0]]
    rest = {key: value for key, value in document.items() if key != "volumes"}
    return {
        "labels": "all",
        **rest,
        "volume": found[0]["file"],
        **({"volumes": others} if others else {}),
    }


LYING = (
    *("axes", "spacing", "solid", "smooth", "pieces", "labels", "raw", "environment", "cut"),
    *("periodic", "repeat"),
    *CHANGING_PARAMETERS,
)
"""Settings that may follow the # of a target: the place of its volume and the distances of its
voxels, the solid side of the isovalue, smoothing, labels, light, cuts, repetition, and changes as
views make them.
"""

NUMBERS_LYING = ("smooth", "pieces")
"""Settings of LYING that are numbers."""

LISTS_LYING = ("periodic", "repeat", "spacing")
"""Settings of LYING that are lists of TOML, written with or without brackets."""


def split_settings(target: str) -> tuple[str, dict[str, Any]]:
    """Return a target without the settings of LYING that follow its #, and these settings."""
    place, mark, part = target.rpartition("#")
    if not mark or Path(target).exists():
        return target, {}
    told: dict[str, Any] = {
        key: unquote(value)
        for key, _, value in (each.partition("=") for each in part.split("&"))
        if key in LYING
    }
    for key in (each for each in NUMBERS_LYING if each in told):
        with suppress(ValueError):  # a text stays, which the setting refuses
            told[key] = int(told[key]) if told[key].isdecimal() else float(told[key])
    for key in (each for each in LISTS_LYING if each in told):
        told[key] = [_lying_element(each.strip()) for each in told[key].strip("[]").split(",")]
    rest = "&".join(each for each in part.split("&") if each.partition("=")[0] not in LYING)
    return f"{place}#{rest}" if rest else place, told


def _lying_element(text: str) -> bool | float | str:
    """Read an element of a list in a target: a text stays a text, which the setting refuses."""
    if text in ("true", "false"):
        return text == "true"
    if text.isascii() and text.isdecimal() and len(text) < MAX_DIGITS:
        return int(text)
    try:
        return float(text)
    except ValueError:
        return text


MAX_DIGITS = 10
"""Digits of a whole number in a list of a target, fewer than."""

PART_SETTINGS = ("level", "channel", "time", "series", "raw", "region")
"""Settings of a scene that choose a part of its volume's file, or describe the file."""

VOXEL_SETTINGS = (
    "cut",
    "solid",
    "inside_out",
    "spacing",
    "missing",
    "smooth",
    "pieces",
    "axes",
    "periodic",
    "repeat",
    "volumes",
    *PART_SETTINGS,
)
"""Settings of a scene that its volume's voxels already contain."""


def is_zarr(path: Path) -> bool:
    """Return True if a volume at ``path`` is read as Zarr: a folder that is one, or a path inside
    one that ends in .zarr.
    """
    if path.is_dir() and any((path / name).is_file() for name in ZARR_METADATA):
        return True
    return not path.is_file() and any(each.suffix == ".zarr" for each in (path, *path.parents))


def name_of(path: Path) -> str:
    """Return the display name of the volume at ``path``: the file's name, and the part that is
    chosen of a Zarr hierarchy.
    """
    whole = next((each for each in path.parents if each.suffix == ".zarr"), path)
    if whole.suffix == ".gz":
        stem = Path(whole.name.removesuffix(".gz")).stem
    else:
        stem = whole.stem
    return readable("-".join([stem, *path.relative_to(whole).parts]))


Word = TypeVar("Word", str, int)
Fallback = TypeVar("Fallback", bool, None)

FORMER: Mapping[str, str] = {
    "sharpen": (
        "it is called projected now, and the plan decides it. Leave the key out, or set "
        "projected = false."
    ),
    "adaptive": (
        "the adaptive lattice is gone, as it saved too little. Leave the key out: "
        "baked light stays good."
    ),
}
"""Former keys of scenes, each with the advice that ends the sentence which refuses it."""


LEAST_TARGET = 1e-4
"""The least target error that a scene may have."""


class Settings:
    """Reads and checks the settings of a scene's document. Methods raise SceneError, which names
    the setting.
    """

    def __init__(self, source: SceneSource, known: Iterable[str] = ()) -> None:
        """Begin reading ``source``, of which some keys are ``known`` already."""
        self.source = source
        self.known = set(known)

    def _get(self, key: str) -> Any:
        self.known.add(key)
        return self.source.document.get(key)

    def _wrong(self, key: str, wanted: str) -> SceneError:
        given = in_short(self.source.document.get(key))
        return SceneError(f"{key} = {given} in the scene '{self.source.name}' is not {wanted}.")

    def _read(self, key: str, fits: Callable[[Any], bool], wanted: str) -> Any:
        """Return a value, or None if it is left out. Raises SceneError, which says what is
        ``wanted``, if it does not fit.
        """
        value = self._get(key)
        if value is not None and not fits(value):
            raise self._wrong(key, wanted)
        return value

    def text(self, key: str, fallback: str) -> str:
        """Return a string."""
        value: str | None = self._read(key, lambda value: isinstance(value, str), "a string")
        return fallback if value is None else value

    def choice(self, key: str, among: Sequence[Word]) -> Word | None:
        """Return one of some words or numbers, or None if the scene leaves it to the plan."""
        value = self._read(
            key, lambda value: value in among, f"one of {', '.join(map(str, among))}"
        )
        if value is None:
            return None
        return among[among.index(value)]

    def flag(self, key: str, fallback: Fallback) -> bool | Fallback:
        """Return True or False."""
        value: bool | None = self._read(key, lambda value: isinstance(value, bool), "true or false")
        return fallback if value is None else value

    def number(self, key: str, fallback: float, low: float, high: float) -> float:
        """Return a number in [low, high]."""
        wanted = f"a number from {shortest(low)} to {shortest(high)}"
        value = self._read(key, lambda value: is_number(value) and low <= value <= high, wanted)
        return float(fallback if value is None else value)

    @property
    def target_error(self) -> float:
        """The relative error at which pixels are final."""
        return self.number("target_error", 0.02, LEAST_TARGET, 1.0)

    def count(self, key: str, high: int, low: int = 0) -> int | None:
        """Return a whole number in [low, high], or None if the scene leaves it to the plan."""
        wanted = f"a whole number from {low} to {high}"
        value: int | None = self._read(
            key, lambda value: type(value) is int and low <= value <= high, wanted
        )
        return value

    def numbers(self, key: str, length: int) -> tuple[float, ...] | None:
        """Return a list of ``length`` finite numbers; None if it is left out."""
        value = self._read(
            key, lambda value: are_numbers(value, length), f"a list of {length} numbers"
        )
        if value is None:
            return None
        return tuple(map(float, value))

    def flags(self, key: str, length: int) -> tuple[bool, ...] | None:
        """Return a list of ``length`` times true or false; None if it is left out."""
        value = self._read(
            key,
            lambda value: _is_list(value, length) and all(isinstance(each, bool) for each in value),
            f"a list of {length} times true or false",
        )
        return None if value is None else tuple(value)

    def counts(self, key: str, length: int, high: int) -> tuple[int, ...] | None:
        """Return a list of ``length`` whole numbers from 1 to ``high``; None if it is left out."""
        value = self._read(
            key,
            lambda value: (
                _is_list(value, length)
                and all(type(each) is int and 1 <= each <= high for each in value)
            ),
            f"a list of {length} whole numbers from 1 to {high}",
        )
        return None if value is None else tuple(value)

    def spans(self, key: str, length: int) -> tuple[tuple[int, int], ...] | None:
        """Return a list of ``length`` pairs of whole numbers from 0 on, the second of each above
        its first; None if it is left out.
        """
        wanted = f"a list of {length} pairs of ascending whole numbers from 0 on, such as [0, 64]"
        value = self._read(
            key, lambda value: _is_list(value, length) and all(map(is_span, value)), wanted
        )
        if value is None:
            return None
        return tuple((low, high) for low, high in value)

    def listed(self, key: str) -> tuple[float, ...]:
        """Return a number or a list of numbers as a tuple, as written (integers stay integers);
        empty if it is left out.
        """
        value = self._get(key)
        if value is None:
            given = []
        elif isinstance(value, list):
            given = value
        else:
            given = [value]
        if not all(map(is_number, given)):
            raise self._wrong(key, "a number, or a list of numbers")
        return tuple(given)

    def interval(
        self, key: str, within: tuple[float, float], fallback: tuple[float, float]
    ) -> tuple[float, float]:
        """Return two numbers in the volume's range ``within``, the second at or above the first;
        the ``fallback`` if they are left out.
        """
        value = self.numbers(key, 2) or fallback
        if not within[0] <= value[0] <= value[1] <= within[1]:
            raise self._wrong(
                key,
                f"two numbers from {shortest(within[0])} to {shortest(within[1])}, the volume's "
                "range, the second not below the first",
            )
        return value[0], value[1]

    def span(self, key: str, low: float, high: float) -> tuple[float, float] | None:
        """Return two numbers in [low, high], the second above the first; None if they are left out.
        Equal ones are refused.
        """
        value = self.numbers(key, 2)
        if value is not None and not low <= value[0] < value[1] <= high:
            ends = f" from {shortest(low)} to {shortest(high)}" if math.isfinite(high - low) else ""
            raise self._wrong(key, f"two ascending numbers{ends}")
        if value is None:
            return None
        return (value[0], value[1])

    def colour(self, key: str, fallback: float) -> tuple[float, float, float]:
        """Return a number or [r, g, b], each in [0, 1], as three numbers."""
        value = self._get(key)
        if value is None:
            value = fallback
        listed = [value] * 3 if is_number(value) else value
        if not are_numbers(listed, 3) or not all(0 <= share <= 1 for share in listed):
            raise self._wrong(key, "a number from 0 to 1, or three of them")
        return triple(listed)

    def lights(self, others: Sequence[Any] = ()) -> list[Mapping[str, Any]]:
        """Return the [[lights]] tables; a sky with a sun if the scene has none, nor any ``others``
        that are lights.
        """
        return self.tables("lights") or ([] if others else [{"type": "sky"}])

    def tables(self, key: str, most: int | None = None) -> list[Mapping[str, Any]]:
        """Return the tables of a list, ``most`` at most; none if it is left out."""
        value = self._get(key)
        if value is None:
            return []
        if (
            not isinstance(value, list)
            or not value
            or not all(isinstance(entry, Mapping) for entry in value)
        ):
            raise self._wrong(key, f"a list of [[{key}]] tables")
        if most is not None and len(value) > most:
            raise self._wrong(key, f"a list of at most {most} [[{key}]] tables")
        return value

    def nested(self, key: str, most: int | None = None) -> "list[Settings]":
        """Return the ``tables`` of a list, each as settings to be read."""
        name = f"{self.source.name}: [[{key}]]"
        return [
            Settings(SceneSource(name, table, self.source.base)) for table in self.tables(key, most)
        ]

    def table(self, key: str) -> Mapping[str, Any] | None:
        """Return a table, or None if it is left out."""
        value: Mapping[str, Any] | None = self._read(
            key, lambda value: isinstance(value, Mapping), f"a table [{key}]"
        )
        return value

    def refuse_unknown(self) -> None:
        """Raise SceneError for settings that were not read, such as typing errors. For former ones
        it says what to do.
        """
        unknown = sorted(set(self.source.document) - self.known)
        for key in unknown:
            if key in FORMER:
                raise SceneError(f"The scene '{self.source.name}' sets {key}: {FORMER[key]}")
        if unknown:
            first = f"The scene '{self.source.name}' sets {unknown[0]}, unknown here"
            raise SceneError(f"{first}: {advice(unknown[0], sorted(self.known))}")


def is_span(value: Any) -> bool:
    """Return True if ``value`` is a pair of whole numbers from 0 on, the second above the first."""
    return (
        _is_list(value, 2) and all(type(each) is int for each in value) and 0 <= value[0] < value[1]
    )


def is_number(value: Any) -> bool:
    """Return True if ``value`` is a finite real number (and not a bool) that floats hold."""
    return (
        isinstance(value, int | float)
        and not isinstance(value, bool)
        and abs(value) <= sys.float_info.max
    )


TableReaders = Mapping[str, Callable[[str, Any], Any]]
"""Functions that read the values of a table, by their keys: from the name of the value in messages,
and the value.
"""


def read_table(
    table: Mapping[str, Any], what: str, readers: TableReaders, needed: Iterable[str] = ()
) -> dict[str, Any]:
    """Return the values of a scene's ``table`` by its keys. Messages name the table by ``what``,
    such as "A wall".

    Raises SceneError if a key is unknown, one that is ``needed`` is missing, or a value is of the
    wrong kind.
    """
    unknown = next((key for key in table if key not in readers), None)
    if unknown is not None:
        raise SceneError(f"{what} has no '{unknown}': {advice(unknown, readers)}")
    missing = next((key for key in needed if key not in table), None)
    if missing is not None:
        raise SceneError(f"{what} lacks its '{missing}': add it to the scene.")
    return {key: readers[key](f"{what}'s {key}", value) for key, value in table.items()}


def read_number(name: str, value: Any) -> float:
    """Return a number that floats hold. Raises SceneError."""
    if not is_number(value):
        raise SceneError(f"{name} is {in_short(value)}: give a number.")
    return float(value)


def read_colour(name: str, value: Any) -> Vector:
    """Return a number for all three channels, or ``[r, g, b]``. Raises SceneError."""
    given = [value] * 3 if is_number(value) else value
    if not are_numbers(given, 3):
        raise SceneError(f"{name} is {in_short(value)}: give a number or [r, g, b].")
    return triple(given)


def read_vector(name: str, value: Any) -> Vector:
    """Return ``[x, y, z]``. Raises SceneError."""
    if not are_numbers(value, 3):
        raise SceneError(f"{name} is {in_short(value)}: give [x, y, z].")
    return triple(value)


def read_name(name: str, value: Any) -> str:
    """Return the name of a file. Raises SceneError."""
    if not isinstance(value, str) or not value:
        raise SceneError(f"{name} is {in_short(value)}: give the file by its name.")
    return value


def are_numbers(value: Any, count: int) -> bool:
    """Return True if ``value`` is a list of ``count`` numbers."""
    return _is_list(value, count) and all(map(is_number, value))


def _is_list(value: Any, count: int) -> bool:
    return isinstance(value, list | tuple) and len(value) == count
