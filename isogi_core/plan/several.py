"""Several isosurfaces, as scenes have them: their tables, and what they cannot be together with."""

from isogi_core.errors import SceneError
from isogi_core.files.scene_file import Settings
from isogi_core.model.colours import SurfaceColours
from isogi_core.model.lights import Colour
from isogi_core.model.surfaces import PinnedSurface, pinned_surfaces, refuse_gain
from isogi_core.model.volume import Volume


def read_pinned(settings: Settings, volume: Volume, colours: SurfaceColours | None) -> tuple[PinnedSurface, ...]:
    """The scene's [[surfaces]]. SceneError where one has no meaning, or the scene cannot have any."""
    found = pinned_surfaces(settings.tables("surfaces"), volume)
    if found:
        refuse_company(settings, colours, "[[surfaces]]")
    return found


def read_clear(settings: Settings, colours: SurfaceColours | None) -> float:
    """The share of rays that passes the surface which slides. SceneError as ``read_pinned``."""
    clear = settings.number("clear", 0.0, 0.0, 1.0)
    if clear > 0.0:
        refuse_company(settings, colours, "clear")
    return clear


def read_transmission(settings: Settings, albedo: Colour, colours: SurfaceColours | None) -> Colour:
    """The share of light that gets through the surface which slides, of this ``albedo``, diffuse, linear RGB.

    SceneError as ``read_pinned``, and where more light would leave than falls on it.
    """
    transmission = settings.colour("transmission", 0.0)
    if any(transmission):
        refuse_company(settings, colours, "transmission")
        refuse_gain(albedo, transmission, f"The surface of the scene '{settings.source.name}'")
    return transmission


def refuse_company(settings: Settings, colours: SurfaceColours | None, what: str) -> None:
    """Raise SceneError where the scene has what several surfaces are not lit with yet."""
    beside = {"colours by data": colours is not None}
    beside |= {"a shine": settings.table("shine") is not None}
    beside |= {"albedos that views choose": settings.span("albedos", 0.0, 1.0) is not None}
    for each, there in beside.items():
        if there:
            raise SceneError(f"The scene '{settings.source.name}' has {what} and {each}: leave one of them out.")
