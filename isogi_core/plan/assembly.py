"""Scene assembly: from a scene file, a volume or a demo to a scene with checked settings and a plan."""

import hashlib
import math
import re
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any
from weakref import WeakValueDictionary

import numpy as np

from isogi_core.errors import LightError, SceneError
from isogi_core.files.radiance import read_hdr
from isogi_core.files.scene_file import DEFAULT_DEMO, SceneSource, Settings, find_source
from isogi_core.kernels.shading.lattice import CHUNK
from isogi_core.kernels.tracing.field import OFFSET
from isogi_core.kernels.transport.harmonics import MAX_ORDER
from isogi_core.model.colours import SurfaceColours
from isogi_core.model.demo import DEMOS
from isogi_core.model.environment import Environment, Lamps, gather_lamps
from isogi_core.model.environments import environment_image
from isogi_core.model.glow import Glowing, glow_from_mapping, place_glows
from isogi_core.model.latlong import pixel_directions, resample, solid_angles
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
from isogi_core.model.room import ROOMS, Room, cornell_room, place_walls, wall_from_mapping
from isogi_core.model.scene_plan import REPRESENTATIONS
from isogi_core.model.shine import Shine, shine_from_mapping
from isogi_core.model.sky import sky_image
from isogi_core.model.surfaces import leaving
from isogi_core.model.value_survey import Progress, no_progress
from isogi_core.model.view import PROJECTIONS
from isogi_core.model.volume import BINS, Volume
from isogi_core.plan.inputs import PlanInputs, PlanOverrides
from isogi_core.plan.isovalue_presets import read_presets
from isogi_core.plan.lobe_choice import MANY_LOBES_SEARCHED as MOST_LOBES
from isogi_core.plan.materials import read_material, refuse_lamps
from isogi_core.plan.planner import plan_scene
from isogi_core.plan.scene import CHUNKS, NORMALS, Scene
from isogi_core.plan.several import read_clear, read_pinned, read_transmission
from isogi_core.plan.volumes.colours import find_table, read_colours
from isogi_core.plan.volumes.cuts import cut_away
from isogi_core.plan.volumes.glow_masks import read_glow_masks
from isogi_core.plan.volumes.label_colours import colours_of_labels
from isogi_core.plan.volumes.labels import ALL, HALF, find_labels
from isogi_core.plan.volumes.opening import open_volume

SKY_SIZE = (512, 1024)
"""Rows and columns of the grid on which a sky is laid out."""

BARE = (0.0, 1.0)
"""The albedos that views may ask for where nothing is reflected."""

INSIDE_OUT = 0.6
"""Share of a volume's border above the isovalue from which the volume is taken as inside out. Seventeen volumes with
their objects in air had 0 to 0.11 of it there, a ramp has half."""


def load_scene(target: str | Path | None = None, **settings: Any) -> Scene:
    """Load a scene file (.toml), a volume (.nrrd, .nhdr, .zarr) or a demo ("demo:casting", also the default).

    ``settings`` replace those of the scene, by their names in a scene file. Raises SceneError, VolumeError and
    LightError.
    """
    return build_scene(find_source(target, settings))


def build_scene(
    source: SceneSource,
    progress: Progress = no_progress,
    volume: Volume | None = None,
    colours: SurfaceColours | None = None,
    glow_bits: np.ndarray | None = None,
) -> Scene:
    """Open the volume and the lights of ``source``, check every setting, and make the plan.

    ``progress`` is called while a copy of a large volume is made. A ``volume`` that is given replaces the one that the
    scene names, ``colours`` its own, and ``glow_bits`` what is read of the masks of its glows. Raises SceneError,
    VolumeError or LightError.
    """
    settings = Settings(source)
    settings.text("volume", DEFAULT_DEMO)  # named by the scene, also where another way led to it
    cut, whole = settings.text("cut", ""), None
    if volume is None:
        whole = open_volume(settings, source.base, progress)
        source, settings = with_labels(settings, whole)
        whole = right_side_out(settings, whole, source.base, progress)
        colours = colours or colours_by_data(settings, whole)
        volume = cut_away(whole, cut) if cut else whole
    if settings.flag("inside_out", False):
        volume = volume.inside_out
    room, glowing = read_room(settings, volume), read_glow(settings, volume, glow_bits)
    lights = read_lights(settings, room)
    lamps = gather_lamps((*lights, *room.lamps), volume.orientation)
    isovalues = settings.interval("isovalues", volume.value_range, volume.core)
    isovalue = start_isovalue(settings, volume, isovalues)
    albedo, material = read_albedo(settings, colours), read_material(settings, volume)
    overrides = plan_overrides(settings, albedo)
    shine = read_shine(settings, colours)
    pinned, clear = read_pinned(settings, volume, colours), read_clear(settings, colours)
    transmission = read_transmission(settings, albedo, colours)
    target_error = settings.target_error
    refuse_lamps(material, lights)
    several = bool(pinned) or clear > 0.0 or any(transmission) or material.scatters
    light, rotating = assemble_environment(lights), may_rotate(settings, lamps, room, several)
    if volume.orientation.turned and not rotating:
        light = light.turned(volume.orientation.matrix)
    most = leaving(albedo, transmission) if overrides.albedos is None else (overrides.albedos[1],) * 3
    coloured = colours is not None and not colours.grey
    facts = light, lamps, volume.centre, volume.radius, rotating
    met = (*room.albedos, *(share for each in pinned for share in (each.albedo, each.leaving)))
    met += (albedo,) if several else ()
    inputs = PlanInputs(*facts, most, target_error, met, coloured, colours is not None, len(glowing.glows))
    plan = plan_scene(inputs, overrides)
    scene = Scene(
        id=re.sub(r"[^a-z0-9_-]+", "-", source.name.lower()).strip("-")[:64] or "scene",
        source=source,
        volume=volume,
        lights=lights,
        environment=light,
        lamps=lamps,
        room=room,
        isovalue=isovalue,
        isovalues=isovalues,
        albedo=albedo,
        lattice=settings.number("lattice", 1.0, 0.125, 4.0),
        chunk=settings.choice("chunk", CHUNKS) or CHUNK,
        target_error=target_error,
        rotating=rotating,
        normals=settings.choice("normals", NORMALS) or NORMALS[0],
        offset=settings.number("offset", OFFSET, 0.0, 2.0),
        inputs=inputs,
        overrides=overrides,
        plan=plan,
        named=read_presets(settings, isovalues),
        projected=settings.flag("projected", None),
        albedos=overrides.albedos or (BARE if overrides.bounces == 0 and max(albedo) > 0.0 and not colours else None),
        shine=shine,
        material=material,
        colours=colours,
        glowing=glowing,
        camera_projection=settings.choice("projection", PROJECTIONS) or PROJECTIONS[0],
        pinned=pinned,
        clear=clear,
        transmission=transmission,
    )
    settings.refuse_unknown()
    if whole is not None and cut:  # what is cut away does not change how bright the rest is
        vars(scene)["seen"] = scene.altered((), volume=whole).seen
    return scene


def with_labels(settings: Settings, whole: Volume) -> tuple[SceneSource, Settings]:
    """The scene's document, which says from now on that its volume is a segmentation where the file said so."""
    source = settings.source
    if whole.segmented and not source.document.get("labels"):
        source = replace(source, document={**source.document, "labels": ALL})
        settings = Settings(source, settings.known)
    return source, settings


def colours_by_data(settings: Settings, whole: Volume) -> SurfaceColours | None:
    """The colours of a scene, None where it has one albedo; ``whole`` is its volume before it is cut.

    Raises SceneError and VolumeError.
    """
    table, labels = find_table(settings), find_labels(settings)
    if labels is not None:
        if table is not None:
            raise SceneError(f"Labels of the scene '{settings.source.name}' have colours: leave the other volume out.")
        return colours_of_labels(labels, settings, whole)
    if table is None:
        return None
    return read_colours(table, settings, whole, start_isovalue(settings, whole, whole.value_range))


def read_albedo(settings: Settings, colours: SurfaceColours | None) -> tuple[float, float, float]:
    """The albedo of the surface; the most that ``colours`` reflect where it has these. SceneError where both are given,
    or a range of albedos.
    """
    if colours is None:
        return settings.colour("albedo", 0.7)
    for key in ("albedo", "albedos"):
        if key in settings.source.document:
            raise SceneError(f"The surface has its albedo from '{colours.scale.name}': leave out {key}.")
    return colours.brightest


def plan_overrides(settings: Settings, albedo: tuple[float, float, float]) -> PlanOverrides:
    """The scene's own choices for its plan. SceneError where its ``albedo`` is not one that views may ask for."""
    albedos = settings.span("albedos", 0.0, 1.0)
    if albedos is not None and not albedos[0] <= min(albedo) <= max(albedo) <= albedos[1]:
        given = f"albedos = [{albedos[0]:g}, {albedos[1]:g}]"
        raise SceneError(f"{given} leaves out the scene's own albedo, {min(albedo):g} to {max(albedo):g}: widen it.")
    return PlanOverrides(
        representation=settings.choice("representation", REPRESENTATIONS),
        order=settings.count("order", MAX_ORDER, 1),
        indirect_order=settings.count("indirect_order", MAX_ORDER, 1),
        bounces=settings.count("bounces", 1000),
        precision=settings.choice("precision", ("bytes", "half", "single")),
        lobes=settings.count("lobes", MOST_LOBES),
        albedos=albedos,
    )


def read_lights(settings: Settings, room: Room) -> tuple[Light, ...]:
    """The scene's lights: the environment that it names, in whose place its [[lights]] are not read, or those.

    Raises SceneError, and LightError where a value has no meaning.
    """
    tables, base = settings.lights(room.lamps), settings.source.base
    named = settings.text("environment", "")
    return (light_named(named, base),) if named else tuple(light_from_mapping(entry, base) for entry in tables)


def read_room(settings: Settings, volume: Volume) -> Room:
    """The scene's walls: those of a whole room that it names, and its own. SceneError where one has no meaning."""
    named = cornell_room(volume) if settings.choice("room", ROOMS) else ()
    return place_walls((*named, *map(wall_from_mapping, settings.tables("walls"))), volume)


def read_glow(settings: Settings, volume: Volume, bits: np.ndarray | None) -> Glowing:
    """What glows in the volume; of masks that were read, the ``bits``. SceneError where a table has no meaning, and
    VolumeError where a mask cannot be used.
    """
    glows = [glow_from_mapping(table) for table in settings.tables("glow")]
    return place_glows(glows, volume, read_glow_masks(glows, settings, volume) if bits is None else bits)


def read_shine(settings: Settings, colours: SurfaceColours | None) -> Shine | None:
    """The scene's shine; None where its surface is diffuse. SceneError where it has no meaning, or none with
    ``colours``.
    """
    table = settings.table("shine")
    shine = None if table is None else shine_from_mapping(table)
    if shine is not None and shine.kind == "metal" and colours is not None:
        raise SceneError("Metal mirrors one albedo, and this surface has colours: choose plastic.")
    return shine


def may_rotate(settings: Settings, lamps: Lamps, room: Room, several: bool) -> bool:
    """Whether the light may be turned: the scene decides, by default yes; never where there are lamps, walls, or
    ``several`` surfaces, or one that light goes into (SceneError).
    """
    rotating = settings.flag("rotating", not (lamps.any or room.any or several))
    for what, there in (("walls", room.any), ("lamps", lamps.any)):
        if rotating and there:
            raise SceneError(f"{what.capitalize()} stay where they are: leave out rotating = true, or the {what}.")
    if rotating and several:
        raise SceneError("Light that passes surfaces is baked as it falls: leave out rotating = true.")
    return rotating


def right_side_out(settings: Settings, volume: Volume, base: Path, progress: Progress) -> Volume:
    """The volume, solid below where the scene does not say and its object is low: a distance field, pores."""
    given = settings.text("solid", "") or find_labels(settings) is not None
    if given or settings.text("volume", DEFAULT_DEMO).startswith("demo:"):
        return volume
    outside = border_above(volume, start_isovalue(settings, volume, volume.value_range))
    return open_volume(settings, base, progress, "below") if outside > INSIDE_OUT else volume


def border_above(volume: Volume, isovalue: float) -> float:
    """The share of the box's border above an ``isovalue``; faces across x are left out: they are all over the file."""
    voxels, level = volume.voxels, volume.normalise_isovalue(isovalue)
    faces = (voxels[0], voxels[-1], voxels[:, 0], voxels[:, -1])
    return sum(int((face > level).sum()) for face in faces) / sum(face.size for face in faces)


def start_isovalue(settings: Settings, volume: Volume, within: tuple[float, float]) -> float:
    """The isovalue where views start: the scene's own, or the default as near as it is to that ``within`` a range."""
    given = settings.number("isovalue", math.nan, *within)
    return min(max(default_isovalue(settings, volume), within[0]), within[1]) if math.isnan(given) else given


def default_isovalue(settings: Settings, volume: Volume) -> float:
    """An isovalue for a scene that gives none: the demo's, that of a segmentation, or Otsu's threshold, half-way
    between the values on its two sides.
    """
    if find_labels(settings) is not None:
        return HALF
    name = settings.text("volume", DEFAULT_DEMO)
    if name.startswith("demo:"):
        return float(DEMOS[name.removeprefix("demo:")][1])
    return halfway(volume, otsu(*volume.histogram()))


LAYERS = 16
"""Layers of a volume whose voxels are looked at for values beside an isovalue."""

NEAR_VALUES_SHARE = 2 / BINS
"""Share of the core's span up to which values are near each other: they fill the histogram's bins."""


def halfway(volume: Volume, isovalue: float) -> float:
    """The middle between the values next to an ``isovalue``, as in a mask or few whole numbers; itself where values
    are near each other, or on one side alone. Some layers are looked at.
    """
    layers = volume.voxels[:: max(len(volume.voxels) // LAYERS, 1)]
    level = volume.normalise_isovalue(isovalue)
    low = float(np.max(layers, where=layers < level, initial=-np.inf))
    high = float(np.min(layers, where=layers > level, initial=np.inf))
    least, most = volume.core_span()
    if not NEAR_VALUES_SHARE * (most - least) < high - low < np.inf:
        return isovalue
    return 0.5 * volume.file_value(low) + 0.5 * volume.file_value(high)


def otsu(counts: np.ndarray, edges: np.ndarray) -> float:
    """The value that splits a histogram of even bins into the two classes farthest apart (Otsu 1979): an edge, or
    half-way over the empty bins between the classes.

    Distances are counted in bins, as squares of values may overflow or underflow a double.
    """
    middles = np.arange(len(counts)) + 0.5
    below = np.cumsum(counts)[:-1]
    above = counts.sum() - below
    mass = np.cumsum(counts * middles)
    with np.errstate(divide="ignore", invalid="ignore"):
        apart = (mass[-1] - mass[:-1]) / above - mass[:-1] / below
        between = np.nan_to_num(below.astype(float) * above * apart**2)
    first = int(np.argmax(between))
    last = first + int(np.argmax(np.append(counts[first + 1 :] > 0, True)))
    return 0.5 * float(edges[1 + first]) + 0.5 * float(edges[1 + last])


ASSEMBLED: WeakValueDictionary[Sequence[Light] | str, Environment] = WeakValueDictionary()
"""The environments in use: scenes under the same lights share one, which takes megabytes. Those that come from no file
are found by their lights, others by their digest."""


def assemble_environment(lights: Sequence[Light]) -> Environment:
    """Sum the lights that are no lamps. Images are resampled to the largest grid without change of energy.

    Raises LightError where a probe cannot be read or holds a negative or non-finite radiance.
    """
    around = tuple(light for light in lights if not isinstance(light, Lamp))
    if any(isinstance(light, ProbeLight) for light in around):  # its file may have changed
        read = _sum(around)
        return ASSEMBLED.setdefault(read.digest, read)
    known = ASSEMBLED.get(around)
    return known if known is not None else ASSEMBLED.setdefault(around, _sum(around))


def _sum(around: Sequence[ConstantLight | SkyLight | ProbeLight | EnvironmentLight]) -> Environment:
    """The sum of lights that are no lamps."""
    constant = np.zeros(3)
    images = []
    for light in around:
        if isinstance(light, ConstantLight):
            constant += light.radiance
        else:
            images.append(_image(light))
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
    """The lat-long image (h, w, 3) of a sky, a probe or an environment by formula."""
    if isinstance(light, ProbeLight):
        return light.scale * _checked(read_hdr(light.file), f"The probe '{light.file}'").astype(np.float64)
    return _sky(light)


@lru_cache(maxsize=4)
def _sky(light: SkyLight | EnvironmentLight) -> np.ndarray:
    """The image of light by formula, read-only: scenes that are planned again have the sky they had."""
    grid = pixel_directions(*SKY_SIZE), solid_angles(*SKY_SIZE)
    image = sky_image(light, *grid) if isinstance(light, SkyLight) else environment_image(light, *grid)
    image.flags.writeable = False
    return image


def _checked(image: np.ndarray, what: str) -> np.ndarray:
    """Return the image; LightError where a radiance is not finite or is negative."""
    bad = int((~(np.isfinite(image) & (image >= 0.0))).any(axis=-1).sum())
    if bad:
        raise LightError(f"{what} has {bad} pixels of negative or non-finite radiance: give another light.")
    return image
