"""The material of a scene's surface, read from its file, and the keys that a scene of it cannot
have.
"""

from isogi_core.errors import SceneError
from isogi_core.files.scene_file import MATERIAL_NUMBERS, MaterialSettings, Settings
from isogi_core.model.lights import LARGEST_LIGHT, Colour, Lamp, Light
from isogi_core.model.material import DIFFUSE, INDICES, MATERIALS, WINDOW_GLASS, Material
from isogi_core.model.scene_plan import LeftOut, Saving
from isogi_core.model.volume import Volume

DEFAULT_FREE_PATH = 0.02
"""Mean free path of a subsurface whose scene gives none, over the radius of its volume."""

EXCLUDED_SETTINGS = {
    "glass": {"albedo": "it reflects no diffuse light"}
    | dict.fromkeys(("clear", "transmission"), "it lets light pass by its index already"),
    "subsurface": dict.fromkeys(("clear", "transmission"), "it lets light in already"),
}
"""Keys that a scene of each material cannot have, and the reason."""

EXCLUDED_BY_BOTH = {
    "albedos": "its light is baked for one colour",
    "shine": "it shines by no lobe",
    "glow": "glow is not seen through it",
    "surfaces": "it lies alone",
    "volumes": "it has one colour",
    "labels": "it has one colour",
}
"""Keys that no scene can have if rays pass its surface, glass or subsurface, and the reason."""

MIN_SUBSURFACE_ALBEDO = 0.01
"""Least albedo of a subsurface: its texels keep light divided by the albedo."""


def read_material(settings: Settings, volume: Volume) -> Material:
    """Read the material of the scene's surface.

    Raises SceneError if a value has no meaning, a number belongs to another material, or the scene
    has a key that its material excludes.
    """
    kind = settings.choice("material", MATERIALS) or MATERIALS[0]
    given = settings.source.document
    index = settings.number("index", WINDOW_GLASS, *INDICES)
    absorption = _material_colour(settings, "absorption")
    path = settings.number("mean_free_path", DEFAULT_FREE_PATH * volume.radius, 0.0, LARGEST_LIGHT)
    # Refuse numbers of other materials, which would change nothing.
    for key, of in MATERIAL_NUMBERS.items():
        if key in given and of != kind:
            raise SceneError(
                f'{key} belongs to {of}: add material = "{of}" to the scene, or leave {key} out.'
            )
    if kind == "diffuse":
        return DIFFUSE
    # Refuse keys that do not go with this material.
    for key, why in (EXCLUDED_BY_BOTH | EXCLUDED_SETTINGS[kind]).items():
        if key in given:
            raise SceneError(f"The surface is {kind}, and {why}: leave {key} out.")
    if kind == "glass":
        return Material(kind, index, absorption)
    if min(settings.colour("albedo", 0.7)) < MIN_SUBSURFACE_ALBEDO:
        raise SceneError(
            "The albedo of a subsurface is the share that scattering leaves: "
            f"give {MIN_SUBSURFACE_ALBEDO:g} or more of each colour."
        )
    return Material(kind, mean_free_path=path)


def material_settings(material: Material) -> MaterialSettings:
    """Return the scene keys that make a surface of this ``material``, with all of its numbers."""
    given = {
        name: getattr(material, name)
        for name, kind in MATERIAL_NUMBERS.items()
        if kind == material.kind
    }
    if "absorption" in given and len({*given["absorption"]}) == 1:
        given["absorption"] = given["absorption"][0]
    return {"material": material.kind, **given}


def refuse_lamps(material: Material, lights: tuple[Light, ...]) -> None:
    """Raise SceneError if there are lamps and the ``material`` scatters: paths inside it cannot
    meet lamps.
    """
    if material.scatters and any(isinstance(light, Lamp) for light in lights):
        raise SceneError(
            "Lamps do not reach inside a subsurface: make them walls with radiance, or an "
            "environment."
        )


def _material_colour(settings: Settings, key: str) -> Colour:
    """Read one number for all three channels, or three numbers; 0 if the ``key`` is not given.
    Raises SceneError for any other count.
    """
    given = tuple(float(value) for value in settings.listed(key)) or (0.0,)
    if len(given) not in (1, 3):
        raise SceneError(
            f"{key} in the scene '{settings.source.name}' has {len(given)} numbers: give one, "
            "or three."
        )
    red, green, blue = given * 3 if len(given) == 1 else given
    return red, green, blue


def unrefracted(material: Material, lights: tuple[Light, ...], sharp: bool) -> tuple[LeftOut, ...]:
    """List the things that a surface of this ``material`` leaves out: its texels, and caustics of
    lamps that no ray can meet.

    ``sharp`` says that the environment has bright parts, which few rays meet.
    """
    if not material.refracts:
        return ()
    texels = "Glass keeps no light: the light seen through it is on walls, or comes from outside."
    found = [LeftOut("texels of the isosurface", texels, (Saving(100, "percent of all texels"),))]
    # Only shadow rays find lamps, and these do not pass glass.
    names = sorted({light.name for light in lights if isinstance(light, Lamp)})
    if names:
        why = (
            "No ray that is refracted meets it, so that glass casts a shadow: make it a wall "
            "with radiance."
        )
        found.append(LeftOut(f"caustics of the light '{', '.join(names)}'", why))
    if sharp:
        why = (
            "Few rays that are refracted meet its bright parts: their caustics stay noisy for long."
        )
        found.append(LeftOut("a smooth caustic of the environment", why))
    return tuple(found)
