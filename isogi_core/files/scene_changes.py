"""Changes of a scene's document that views may ask for, as their parameters spell them: what its pinned surfaces let
pass, which labels are hidden, and what its surface is made of.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from isogi_core.errors import SceneError

CHANGING_PARAMETERS = ("surfaces", "hide", "material")
"""Parameters of views that change a scene's document by more than a setting of the same name."""


def change_document(
    document: Mapping[str, Any], surfaces: str | None = None, hide: str | None = None, material: str | None = None
) -> Mapping[str, Any]:
    """A scene's ``document`` with the changes that are spelled, and without those of None. Raises SceneError."""
    if surfaces is not None:
        pinned = tables_in(document, "surfaces")
        document = put_clears(document, pinned, read_clears(surfaces, len(pinned)))
    if hide is not None:
        document = put_hidden(document, read_hidden(hide))
    return document if material is None else put_material(document, read_material_text(material))


def tables_in(document: Mapping[str, Any], key: str) -> list[Mapping[str, Any]]:
    """The tables that a ``document`` lists under a ``key``; other values are left out."""
    given = document.get(key)
    return [each for each in given if isinstance(each, Mapping)] if isinstance(given, list) else []


HIDDEN_SURFACE = "off"
"""Stands for a surface that is not shown, in place of the share of rays that passes it."""

Clears = tuple[float | None, ...]
"""The shares of rays that pass pinned surfaces in turn; None of hidden ones."""


def read_clears(text: str, pinned: int) -> Clears:
    """The shares of rays that pass so many ``pinned`` surfaces, as ``0.4,off`` spells them; None of hidden ones.

    Raises SceneError.
    """
    try:
        found = tuple(None if each.strip() == HIDDEN_SURFACE else float(each) for each in text.split(","))
    except ValueError:
        found = ()
    if not pinned:
        raise SceneError("surfaces is for scenes with [[surfaces]]: leave it out.")
    if len(found) != pinned or not all(each is None or 0.0 <= each <= 1.0 for each in found):
        asked = f"for each of the {pinned} pinned surfaces, in turn" if pinned > 1 else "for the pinned surface"
        raise SceneError(f"surfaces = '{text[:40]}': give {asked}, a number from 0, opaque, to 1, or {HIDDEN_SURFACE}.")
    return found


def put_clears(document: Mapping[str, Any], pinned: Sequence[Mapping[str, Any]], clears: Clears) -> dict[str, Any]:
    """A scene's ``document`` whose ``pinned`` surfaces, tables, pass other shares of rays; None leaves one out."""
    kept = [{**table, "clear": clear} for table, clear in zip(pinned, clears, strict=True) if clear is not None]
    rest = {key: value for key, value in document.items() if key != "surfaces"}
    return rest | ({"surfaces": kept} if kept else {})


NO_LABEL = "none"
"""Stands for no label that is hidden."""

Hidden = tuple[int, ...]
"""The values of labels that are hidden, ascending."""


def read_hidden(text: str) -> Hidden:
    """The labels that are hidden, as ``3,4`` spells them by their values, or ``none``. Raises SceneError."""
    try:
        return () if text.strip() == NO_LABEL else tuple(sorted({int(each) for each in text.split(",")}))
    except ValueError:
        asked = f"give the values of labels with , between, or {NO_LABEL}"
        raise SceneError(f"hide = '{text[:40]}': {asked}.") from None


def put_hidden(document: Mapping[str, Any], hidden: Hidden) -> dict[str, Any]:
    """A scene's ``document`` with these labels ``hidden``, and no others. SceneError where it has no labels."""
    if not document.get("labels"):
        raise SceneError("hide is for scenes of labels: leave it out.")
    listed = tables_in(document, "labels")
    known = [{**table, "hidden": table.get("value") in hidden} for table in listed]
    values = {table.get("value") for table in listed}
    found = known + [{"value": value, "hidden": True} for value in hidden if value not in values]
    return {**document, "labels": found or document["labels"]}


MaterialSettings = Mapping[str, Any]
"""The settings of a scene that say what its surface is made of: its material, and such numbers of it as are given."""

MATERIAL_NUMBERS = {"index": "glass", "absorption": "glass", "mean_free_path": "subsurface"}
"""Settings that are numbers of a material, and of which."""

REFLECTION_SETTINGS = {"glass": ("albedo", "albedos"), "subsurface": ("albedos",)}
"""Settings of how a surface reflects; they stay behind where a view asks for one of these materials, without them."""


def read_material_text(text: str) -> MaterialSettings:
    """The settings of a material, as ``glass,index=1.3,absorption=0.1,0.2,0.3`` spells them. Raises SceneError."""
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
    if not kind.isalpha() or (rest and name not in found) or not found.keys() <= MATERIAL_NUMBERS.keys():
        numbers = ", ".join(MATERIAL_NUMBERS)
        raise SceneError(f"material = '{text[:40]}': give a word, and {numbers} of it, such as glass,index=1.3.")
    for name in found:
        if MATERIAL_NUMBERS[name] != kind:
            raise SceneError(f"{name} is of {MATERIAL_NUMBERS[name]}, not of {kind}: leave it out.")
    return {"material": kind, **{name: given if len(given) > 1 else given[0] for name, given in found.items()}}


def write_material_text(settings: MaterialSettings) -> str:
    """The text that ``read_material_text`` reads so; equal settings have the same."""
    given = {name: settings[name] for name in MATERIAL_NUMBERS if name in settings}
    listed = {name: value if isinstance(value, list | tuple) else [value] for name, value in given.items()}
    spelled = [f"{name}={','.join(map(_text_of, numbers))}" for name, numbers in listed.items()]
    return ",".join([settings["material"], *spelled])


def _text_of(number: float) -> str:
    """A number without a plus, which addresses read as a blank."""
    return repr(float(number)).replace("+", "")


def put_material(document: Mapping[str, Any], settings: MaterialSettings) -> dict[str, Any]:
    """A scene's ``document`` with another material; with the same one, numbers that are not given stay."""
    kind = settings["material"]
    if document.get("material", "diffuse") == kind:
        return {**document, **{name: value for name, value in settings.items() if name in MATERIAL_NUMBERS}}
    left = (*MATERIAL_NUMBERS, *REFLECTION_SETTINGS.get(kind, ()))
    return {**{name: value for name, value in document.items() if name not in left}, **settings}
