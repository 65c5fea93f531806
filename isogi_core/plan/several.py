"""Several isosurfaces, as scenes have them: their tables, and what they cannot be together with."""

from isogi_core.errors import SceneError
from isogi_core.files.scene_file import Settings
from isogi_core.model.colours import SurfaceColours
from isogi_core.model.room import Room
from isogi_core.model.surfaces import PinnedSurface, pinned_surfaces
from isogi_core.model.volume import Volume


def read_pinned(
    settings: Settings, volume: Volume, room: Room, colours: SurfaceColours | None
) -> tuple[PinnedSurface, ...]:
    """The scene's [[surfaces]]. SceneError where one has no meaning, or the scene cannot have any."""
    found = pinned_surfaces(settings.tables("surfaces"), volume)
    if found:
        refuse_company(settings, room, colours, "[[surfaces]]")
    return found


def read_clear(settings: Settings, room: Room, colours: SurfaceColours | None) -> float:
    """The share of rays that passes the surface which slides. SceneError as ``read_pinned``."""
    clear = settings.number("clear", 0.0, 0.0, 1.0)
    if clear > 0.0:
        refuse_company(settings, room, colours, "clear")
    return clear


HIDDEN = "off"
"""Stands for a surface that is not shown, in place of the share of rays that passes it."""


Clears = tuple[float | None, ...]
"""The shares of rays that pass pinned surfaces in turn; None of hidden ones."""


def read_clears(text: str, pinned: int) -> Clears:
    """The shares of rays that pass so many ``pinned`` surfaces, as ``0.4,off`` spells them; None of hidden ones.

    Raises SceneError.
    """
    try:
        found = tuple(None if each.strip() == HIDDEN else float(each) for each in text.split(","))
    except ValueError:
        found = ()
    if not pinned:
        raise SceneError("surfaces is for scenes with [[surfaces]]: leave it out.")
    if len(found) != pinned or not all(each is None or 0.0 <= each <= 1.0 for each in found):
        asked = f"for each of the {pinned} pinned surfaces, in turn" if pinned > 1 else "for the pinned surface"
        raise SceneError(f"surfaces = '{text[:40]}': give {asked}, a number from 0, opaque, to 1, or {HIDDEN}.")
    return found


def refuse_company(settings: Settings, room: Room, colours: SurfaceColours | None, what: str) -> None:
    """Raise SceneError where the scene has what several surfaces are not lit with yet."""
    beside = {"walls": room.any, "colours by data": colours is not None}
    beside |= {"a shine": settings.table("shine") is not None, "glow": bool(settings.tables("glow"))}
    beside |= {"albedos that views choose": settings.span("albedos", 0.0, 1.0) is not None}
    for each, there in beside.items():
        if there:
            raise SceneError(f"The scene '{settings.source.name}' has {what} and {each}: leave one of them out.")
