"""The material of a scene's surface: its keys, and what it cannot be together with."""

from isogi_core.errors import SceneError
from isogi_core.files.scene_file import Settings
from isogi_core.model.lights import Colour, Lamp, Light
from isogi_core.model.material import DIFFUSE, INDICES, MATERIALS, WINDOW_GLASS, Material
from isogi_core.model.scene_plan import LeftOut, Saving

GLASS_KEYS = ("index", "absorption")
"""Keys that say what glass is like."""

BESIDE_GLASS = {
    "albedo": "it reflects no diffuse light",
    "albedos": "it reflects no diffuse light",
    "shine": "it mirrors by its index already",
    "glow": "glow is not seen through it",
    "surfaces": "it lies alone",
    "clear": "it lets light pass by its index already",
    "volumes": "it has no colours of its own",
    "labels": "it has no colours of its own",
}
"""What a scene of glass cannot have, and why."""


def read_material(settings: Settings) -> Material:
    """What the scene's surface is made of. SceneError where a value has no meaning, or the scene has what it cannot."""
    kind, given = settings.choice("material", MATERIALS) or MATERIALS[0], settings.source.document
    index = settings.number("index", WINDOW_GLASS, *INDICES)
    absorption = _colour(settings, "absorption")
    if kind != "glass":
        for key in GLASS_KEYS:
            if key in given:
                raise SceneError(f'{key} is of glass: add material = "glass" to the scene, or leave {key} out.')
        return DIFFUSE
    for key, why in BESIDE_GLASS.items():
        if key in given:
            raise SceneError(f"The surface is glass, and {why}: leave {key} out.")
    return Material(kind, index, absorption)


def _colour(settings: Settings, key: str) -> Colour:
    """A number for all three channels, or three; 0 where it is left out."""
    given = tuple(float(value) for value in settings.listed(key)) or (0.0,)
    if len(given) not in (1, 3):
        raise SceneError(f"{key} in the scene '{settings.source.name}' has {len(given)} numbers: give one, or three.")
    red, green, blue = given * 3 if len(given) == 1 else given
    return red, green, blue


def unrefracted(material: Material, lights: tuple[Light, ...], sharp: bool) -> tuple[LeftOut, ...]:
    """What a surface of this ``material`` leaves out: texels, and caustics of lamps that no ray can meet.

    The environment may be ``sharp``: a sun or another bright part of it is met by few rays.
    """
    if not material.refracts:
        return ()
    texels = "Glass has no light of its own: what is seen through it is on the walls, or outside."
    found = [LeftOut("texels of the isosurface", texels, (Saving(100, "percent of all texels"),))]
    names = sorted({light.name for light in lights if isinstance(light, Lamp)})
    if names:
        why = "No ray that is refracted meets it, so that glass casts a shadow: make it a wall with radiance."
        found.append(LeftOut(f"caustics of the light '{', '.join(names)}'", why))
    if sharp:
        why = "Few rays that are refracted meet its bright parts: their caustics stay noisy for long."
        found.append(LeftOut("a smooth caustic of the environment", why))
    return tuple(found)
