"""The lighting of a scene: its lights, walls and glows, read from its file."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any
from weakref import WeakValueDictionary

import numpy as np

from isogi_core.errors import LightError, SceneError, ViewError
from isogi_core.files.mappings import require_memory
from isogi_core.files.probes import read_probe
from isogi_core.files.scene_file import Settings
from isogi_core.model.choices import MAX_GLOW_STRENGTH
from isogi_core.model.environment import (
    Environment,
    Lamps,
    environment_image,
    gather_lamps,
    pixel_directions,
    resample,
    sky_image,
    solid_angles,
)
from isogi_core.model.glow import NO_BITS, NO_GLOW, Glow, Glowing, glow_from_mapping, place_glows
from isogi_core.model.lights import (
    ConstantLight,
    EnvironmentLight,
    Lamp,
    Light,
    ProbeLight,
    SkyLight,
    light_from_mapping,
    light_named,
)
from isogi_core.model.room import NO_ROOM, ROOMS, Room, cornell_room, place_walls, wall_from_mapping
from isogi_core.model.view import NO_TURN, quaternion_from_angles, rotation_matrix
from isogi_core.model.volume import Volume
from isogi_core.plan.materials import refuse_lamps
from isogi_core.plan.surfaces import SceneSurfaces
from isogi_core.plan.volumes.colours import volume_grids
from isogi_core.plan.volumes.masks import MaskTable, place
from isogi_core.plan.volumes.opening import open_beside

SKY_SIZE = (512, 1024)
"""Rows and columns of the image that a sky is computed on."""


@dataclass(frozen=True, eq=False)
class SceneLighting:
    """The lights of a scene, and the walls that light meets.

    - ``lights``: as the scene names them.
    - ``environment``: the sum of all lights that are infinitely far away.
    - ``lamps``: the other lights, and the luminaires of the ``room``.
    - ``rotating``: True if views may turn the light, and it is kept so that they can.
    - ``turnable``: True if views may turn light that is kept as it falls; it is then baked for each
      turn.
    - ``glowing``: glows in the volume.
    """

    lights: tuple[Light, ...]
    environment: Environment
    lamps: Lamps
    rotating: bool
    room: Room = NO_ROOM
    glowing: Glowing = NO_GLOW
    turnable: bool = False

    @property
    def baked_by_turn(self) -> bool:
        """True if views may turn the light, which is baked for each turn, and it is not the same
        from all sides.
        """
        return self.turnable and bool(self.environment.image.any())

    @property
    def sources(self) -> list[Any]:
        """The part of digests that describes the lights."""
        return [self.environment.digest, self.lamps.digest]

    @property
    def walls(self) -> list[Any]:
        """The part of digests that describes the walls; empty if there are none."""
        if self.room.any:
            return ["walls", self.room.digest]
        return []

    @property
    def glow(self) -> list[Any]:
        """The part of digests that describes the glows; empty if there are none."""
        if self.glowing.any:
            return ["glow", self.glowing.digest, self.glowing.radiances.tolist()]
        return []

    def glow_for(self, asked: float) -> float:
        """Return the strength of glows, over the scene's, that a view has ``asked`` for. Raises
        ViewError if it is out of range, or nothing glows and it is not 1.
        """
        if asked == 1.0 or (self.glowing.any and 0.0 <= asked <= MAX_GLOW_STRENGTH):
            return asked
        if self.glowing.any:
            raise ViewError(
                f"glow must be from 0 to {MAX_GLOW_STRENGTH:g} times the scene's, not {asked:g}."
            )
        raise ViewError(
            "glow is for scenes in which something glows: leave it out, or give the scene a "
            "[[glow]] table."
        )


def read_lighting(
    settings: Settings, volume: Volume, surfaces: SceneSurfaces, glow_bits: np.ndarray | None
) -> SceneLighting:
    """Read the scene's lighting. ``glow_bits`` are the masks of its glows, if they were read
    before.

    Raises SceneError, VolumeError and LightError if a value has no meaning, or the ``surfaces``
    cannot be lit by such lights.
    """
    room = read_room(settings, volume)
    glowing = read_glow(settings, volume, glow_bits)
    lights = read_lights(settings, room)
    refuse_lamps(surfaces.material, lights)
    lamps = gather_lamps((*lights, *room.lamps), volume.orientation)
    environment = assemble_environment(lights)
    rotating = may_rotate(settings, lamps, room, surfaces.light_passes)
    # Turn the environment as the scene says. Light that views do not turn is kept in the axes of
    # the volume's box, and so is baked without a rotation.
    angles = settings.numbers("turned", 3) or NO_TURN
    matrix = rotation_matrix(quaternion_from_angles(*angles)).T
    if not rotating:
        matrix = matrix @ volume.orientation.matrix
    if angles != NO_TURN or (volume.orientation.turned and not rotating):
        environment = turned_environment(environment, matrix)
    # Lamps stay where they are, and all other light with them.
    turnable = not (rotating or lamps.any) and settings.flag("rotating", True)
    return SceneLighting(lights, environment, lamps, rotating, room, glowing, turnable)


def turned_environment(environment: Environment, matrix: np.ndarray) -> Environment:
    """Return an ``environment`` as seen in axes whose rotation to its own is ``matrix`` (3, 3).
    Scenes in the same turn share it.
    """
    digest = environment.turned_digest(matrix)
    known = ASSEMBLED.get(digest)
    if known is not None:
        return known
    return ASSEMBLED.setdefault(digest, environment.turned(matrix))


def read_lights(settings: Settings, room: Room) -> tuple[Light, ...]:
    """Read the scene's lights: the environment that it names, or else its [[lights]].

    Raises SceneError, and LightError if a value has no meaning.
    """
    tables = settings.lights(room.lamps)
    base = settings.source.base
    named = settings.text("environment", "")
    if named:
        return (light_named(named, base),)
    return tuple(light_from_mapping(entry, base) for entry in tables)


def read_room(settings: Settings, volume: Volume) -> Room:
    """Read the scene's walls: those of a whole room that it names, and its [[walls]]. Raises
    SceneError if one has no meaning.
    """
    if settings.choice("room", ROOMS):
        named = cornell_room(volume)
    else:
        named = ()
    return place_walls((*named, *map(wall_from_mapping, settings.tables("walls"))), volume)


def read_glow(settings: Settings, volume: Volume, bits: np.ndarray | None) -> Glowing:
    """Read the glows of the volume; ``bits`` are their masks, if they were read before. Raises
    SceneError if a table has no meaning, and VolumeError if a mask cannot be used.
    """
    glows = [glow_from_mapping(table) for table in settings.tables("glow")]
    return place_glows(
        glows, volume, read_glow_masks(glows, settings, volume) if bits is None else bits
    )


def read_glow_masks(glows: Sequence[Glow], settings: Settings, volume: Volume) -> np.ndarray:
    """Return, for each voxel of a ``volume``, one bit for each of the ``glows`` whose mask holds
    it, as in ``Glowing.bits``.

    Raises SceneError and VolumeError if a mask cannot be used.
    """
    if not any(glow.mask for glow in glows):
        return NO_BITS
    # Place each mask in the volume's grid, and set its bit layer by layer.
    require_memory(volume.voxels.size, "Masks of glows take a byte a voxel,", "leave them out")
    whole, straight = volume_grids(settings, volume)
    bits = np.zeros(volume.shape, np.uint8)
    for number, glow in enumerate(glows):
        if glow.mask:
            mask = place(
                MaskTable(glow.mask, glow.labels), open_beside(settings, glow.mask), whole, straight
            )
            for z in range(len(bits)):
                bits[z] |= mask.layer(z, volume.shape).astype(np.uint8) << np.uint8(number)
    return bits


def may_rotate(settings: Settings, lamps: Lamps, room: Room, passed: bool) -> bool:
    """Return True if views may turn the light, as the scene says, or by default.

    It is False if there are lamps or walls, or if light has ``passed`` surfaces. Raises SceneError
    if the scene then asks for light that turns.
    """
    rotating = settings.flag("rotating", not (lamps.any or room.any or passed))
    # Refuse light that the scene asks to turn, but that is baked in place.
    for what, there in (("walls", room.any), ("lamps", lamps.any)):
        if rotating and there:
            raise SceneError(
                f"{what.capitalize()} stay where they are: leave out rotating = true, or the "
                f"{what}."
            )
    if rotating and passed:
        raise SceneError(
            "Light that passes through surfaces is baked in place: leave out rotating = true."
        )
    return rotating


ASSEMBLED: WeakValueDictionary[Sequence[Light] | str, Environment] = WeakValueDictionary()
"""Environments in use: scenes under the same lights share one, as each takes megabytes. Those
without a file are found by their lights, others by their digest, as a file may have changed, and
turned ones too.
"""


def assemble_environment(lights: Sequence[Light]) -> Environment:
    """Sum the lights that are not lamps. Images are resampled to the largest grid without a change
    of energy.

    Raises LightError if a probe cannot be read, or holds a negative or non-finite radiance.
    """
    around = tuple(light for light in lights if not isinstance(light, Lamp))
    if any(isinstance(light, ProbeLight) for light in around):  # its file may have changed
        read = _sum(around)
        return ASSEMBLED.setdefault(read.digest, read)
    known = ASSEMBLED.get(around)
    if known is not None:
        return known
    return ASSEMBLED.setdefault(around, _sum(around))


def _sum(around: Sequence[ConstantLight | SkyLight | ProbeLight | EnvironmentLight]) -> Environment:
    """Sum lights that are not lamps into one environment."""
    constant = np.zeros(3)
    images = []
    for light in around:
        if isinstance(light, ConstantLight):
            constant += light.radiance
        else:
            images.append(_image(light))
    # Bring all images to the grid of the largest, and add them.
    height = max((image.shape[0] for image in images), default=1)
    width = max((image.shape[1] for image in images), default=1)
    total = np.zeros((height, width, 3))
    for image in images:
        total += resample(image, height, width)
    with np.errstate(over="ignore"):
        total = _checked(total.astype(np.float32), "The sum of all lights")
    digest = hashlib.blake2b(f"{constant.tolist()} {total.shape}".encode(), digest_size=16)
    digest.update(total.data)
    name = " + ".join(light.name for light in around) or "no light"
    return Environment(constant, total, digest.hexdigest(), name)


def _image(light: SkyLight | ProbeLight | EnvironmentLight) -> np.ndarray:
    """Return the lat-long image (h, w, 3) of a sky, a probe or an environment by formula."""
    if isinstance(light, ProbeLight):
        return light.scale * _checked(read_probe(light.file), f"The probe '{light.file}'").astype(
            np.float64
        )
    return _sky(light)


@lru_cache(maxsize=4)
def _sky(light: SkyLight | EnvironmentLight) -> np.ndarray:
    """Compute the image of a light by formula, read-only. It is kept, so that a scene that is
    planned again finds it.
    """
    grid = pixel_directions(*SKY_SIZE), solid_angles(*SKY_SIZE)
    if isinstance(light, SkyLight):
        image = sky_image(light, *grid)
    else:
        image = environment_image(light, *grid)
    image.flags.writeable = False
    return image


def _checked(image: np.ndarray, what: str) -> np.ndarray:
    """Return the ``image``. Raises LightError if a radiance is not finite or negative; ``what``
    names the light.
    """
    bad = int((~(np.isfinite(image) & (image >= 0.0))).any(axis=-1).sum())
    if bad:
        raise LightError(
            f"{what} has {bad} pixels of negative or non-finite radiance: give another light."
        )
    return image
