"""Scene assembly: make a scene with checked settings and a plan from a scene file, a volume or
a demo.
"""

import math
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from isogi_core.errors import SceneError
from isogi_core.files.scene_file import DEFAULT_DEMO, SceneSource, Settings, find_source, is_number
from isogi_core.kernels.shading.lattice import DEFAULT_CHUNK_SIDE
from isogi_core.kernels.tracing.field import RAY_OFFSET_VOXELS
from isogi_core.kernels.transport.harmonics import MAX_ORDER
from isogi_core.model.choices import PROJECTIONS
from isogi_core.model.colours import SurfaceColours
from isogi_core.model.demo import DEMOS
from isogi_core.model.first_view import read_first_view
from isogi_core.model.material import leaving
from isogi_core.model.scene_plan import REPRESENTATIONS
from isogi_core.model.value_survey import Progress, no_progress
from isogi_core.model.volume import HISTOGRAM_BINS, Volume
from isogi_core.plan.inputs import PlanInputs, PlanOverrides
from isogi_core.plan.isovalue_presets import read_presets
from isogi_core.plan.lighting import SceneLighting, read_lighting
from isogi_core.plan.lobe_choice import MANY_LOBES_SEARCHED as MOST_LOBES
from isogi_core.plan.planner import plan_scene
from isogi_core.plan.scene import CHUNK_SIDES, NORMAL_KINDS, Scene, SceneSettings
from isogi_core.plan.starts import Start, both_signs, find_start
from isogi_core.plan.surfaces import SceneSurfaces, read_surfaces
from isogi_core.plan.volumes.colours import colours_of_labels, find_table, read_colours
from isogi_core.plan.volumes.labels import ALL_LABELS, LABEL_ISOVALUE, find_labels
from isogi_core.plan.volumes.masks import cut_away
from isogi_core.plan.volumes.opening import open_volume

INSIDE_OUT = 0.6
"""Share of a volume's border above the isovalue from which the object is taken to be below it.
Seventeen volumes of objects in air had 0 to 0.11 of their border above; a ramp has half.
"""


def load_scene(target: str | Path | None = None, **settings: Any) -> Scene:
    """Load a scene file (.toml), a volume (.nrrd, .nhdr, .zarr) or a demo ("demo:casting", also the
    default).

    ``settings`` replace those of the scene, by their names in a scene file. Raises SceneError,
    VolumeError and LightError.
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

    ``progress`` is called while a copy of a large volume is made. Variants of an open scene give
    the parts that they share with it: a ``volume`` replaces the one that the scene names,
    ``colours`` those that would be read, and ``glow_bits`` the masks of its glows. Raises
    SceneError, VolumeError or LightError.
    """
    settings = Settings(source)
    # The key is known even if the volume was opened in another way.
    settings.text("volume", DEFAULT_DEMO)
    cut = settings.text("cut", "")
    whole = None
    # Open the volume, find the colours of all of it, and then cut it.
    if volume is None:
        settings, whole = open_whole(settings, progress)
        colours = colours or colours_by_data(settings, whole)
        volume = cut_away(whole, cut) if cut else whole
    else:
        settings = renewed_start(settings, volume)
    if settings.flag("inside_out", False):
        volume = volume.inside_out
    scene = scene_around(volume, settings, colours, glow_bits)
    settings.refuse_unknown()
    # A cut does not change how bright the rest is shown: keep the exposure of the whole.
    if whole is not None and cut:
        return replace(scene, exposed_for=replace(scene, volume=whole).seen)
    return scene


def open_whole(settings: Settings, progress: Progress) -> tuple[Settings, Volume]:
    """Open the volume that a scene names, before it is cut. Return the settings, which then
    name a segmentation as such, and the volume.
    """
    whole = open_volume(settings, progress)
    settings = with_labels(settings, whole)
    settings, start = with_start(settings, whole)
    whole = right_side_out(settings, whole, progress)
    if start is not None:
        notes = (*whole.orientation.notes, start.why)
        whole = replace(whole, orientation=replace(whole.orientation, notes=notes))
    return settings, whole


def scene_around(
    volume: Volume, settings: Settings, colours: SurfaceColours | None, glow_bits: np.ndarray | None
) -> Scene:
    """Make the scene of an open ``volume`` by its ``settings``, with ``colours`` of the surface
    and masks of glows if they are known.
    """
    isovalues = settings.interval("isovalues", volume.value_range, volume.core)
    overrides = plan_overrides(settings)
    surfaces = read_surfaces(settings, volume, colours, overrides)
    lighting = read_lighting(settings, volume, surfaces, glow_bits)
    inputs = plan_inputs(volume, surfaces, lighting, overrides, settings.target_error)
    return Scene(
        id=re.sub(r"[^a-z0-9_-]+", "-", settings.source.name.lower()).strip("-")[:64] or "scene",
        source=settings.source,
        volume=volume,
        isovalue=start_isovalue(settings, volume, isovalues),
        isovalues=isovalues,
        target_error=settings.target_error,
        settings=read_settings(settings, isovalues, overrides),
        surfaces=surfaces,
        lighting=lighting,
        inputs=inputs,
        plan=plan_scene(inputs, overrides),
    )


def read_settings(
    settings: Settings, isovalues: tuple[float, float], overrides: PlanOverrides
) -> SceneSettings:
    """Read the settings of texels, rays and views. Raises SceneError if a value has no meaning."""
    return SceneSettings(
        lattice=settings.number("lattice", 1.0, 0.125, 4.0),
        chunk=settings.choice("chunk", CHUNK_SIDES) or DEFAULT_CHUNK_SIDE,
        normals=settings.choice("normals", NORMAL_KINDS) or NORMAL_KINDS[0],
        offset=settings.number("offset", RAY_OFFSET_VOXELS, 0.0, 2.0),
        projected=settings.flag("projected", None),
        presets=read_presets(settings, isovalues),
        projection=settings.choice("projection", PROJECTIONS) or PROJECTIONS[0],
        first=read_first_view(settings),
        overrides=overrides,
    )


def plan_inputs(
    volume: Volume,
    surfaces: SceneSurfaces,
    lighting: SceneLighting,
    overrides: PlanOverrides,
    target_error: float,
) -> PlanInputs:
    """Collect the facts of a scene that its plan depends on."""
    # Plan for the most light that may leave the surface: that of the highest albedo that views may
    # ask for; if they may not, the scene's albedo plus its transmission.
    if overrides.albedos is None:
        albedo = leaving(surfaces.albedo, surfaces.transmission)
    else:
        albedo = (overrides.albedos[1],) * 3
    colours = surfaces.colours
    return PlanInputs(
        lighting.environment,
        lighting.lamps,
        volume.centre,
        volume.radius,
        lighting.rotating,
        albedo,
        target_error,
        walls=(*lighting.room.albedos, *surfaces.met),
        coloured=colours is not None and not colours.grey,
        by_data=colours is not None,
        glows=len(lighting.glowing.glows),
    )


def with_labels(settings: Settings, whole: Volume) -> Settings:
    """Return the settings with ``labels = "all"`` if the ``whole`` volume was opened as a
    segmentation because its file says so, and the scene lists no labels itself.

    If the scene has a setting that labels do not have, such as an isovalue, its volume was opened
    by its values: see ``are_labels``.
    """
    source = settings.source
    if not whole.segmented or source.document.get("labels"):
        return settings
    return Settings(
        replace(source, document={**source.document, "labels": ALL_LABELS}), settings.known
    )


ONE_SURFACE_SETTINGS = (
    *("surfaces", "albedo", "albedos", "clear", "transmission", "material", "shine", "rotating"),
    *("labels", "solid", "representation", "order", "indirect_order", "bounces", "lobes"),
)
"""Settings of a scene that says itself how its surface is: no second one is pinned then."""


def with_start(settings: Settings, whole: Volume) -> tuple[Settings, Start | None]:
    """Return the settings with the start that ``find_start`` chooses, and that start.

    The settings get its isovalue if the scene gives none. If the field has both signs and the scene
    does not say how its surface is, they pin the surface at minus the isovalue too. The start is
    None if the scene gives its isovalue, or if Otsu's threshold is a good start. No start is chosen
    for demos, segmentations, series in time, whose steps all start at one isovalue, and scenes that
    give a range of isovalues.
    """
    settings = without_start(settings, whole)
    document = settings.source.document
    demo = settings.text("volume", DEFAULT_DEMO).startswith("demo:")
    left = demo or "isovalues" in document or whole.moment[1] > 1
    if left or find_labels(settings) is not None:
        return settings, None
    start = find_start(whole, otsu(*whole.histogram()))
    if start is None:
        return settings, None
    changes: dict[str, Any] = {}
    if "isovalue" not in document:
        changes["isovalue"] = start.isovalue
    shown = document.get("isovalue", start.isovalue)
    alone = any(key in document for key in ONE_SURFACE_SETTINGS) or not is_number(shown)
    low, high = whole.value_range
    if start.signed and not alone and find_table(settings) is None and low <= -shown <= high:
        changes |= both_signs(float(shown)) if shown else {}
    elif start.signed:
        start = start.one_sign
    if "isovalue" in document:
        return settings_with(settings, {**document, **changes}, settings.source.found), None
    return settings_with(settings, {**document, **changes}, True), start


def renewed_start(settings: Settings, volume: Volume) -> Settings:
    """Return the settings with another start if isogi chose one that lies outside of the values of
    a ``volume``, else as they are: a start is chosen by whole volumes, and this one may be cut.
    """
    if without_start(settings, volume) is settings:
        return settings
    return with_start(settings, volume)[0]


def without_start(settings: Settings, whole: Volume) -> Settings:
    """Return the settings without the start that ``with_start`` chose at an earlier opening, if it
    lies outside of the values of the ``whole`` volume; else the settings as they are.

    A smoothed variant is opened by its scene's document, which holds that start, and its volume has
    a smaller range of values. If the start shows both signs, minus the isovalue must lie among the
    values too.
    """
    source = settings.source
    # The isovalue is the scene's own, or there is none.
    if not source.found:
        return settings
    low, high = whole.value_range
    shown = source.document["isovalue"]
    signed = source.document.get("surfaces") == both_signs(shown)["surfaces"]
    if low <= shown <= high and (not signed or low <= -shown <= high):
        return settings
    # Take out the keys that ``with_start`` has added.
    added = set(both_signs(shown)) if signed else {"isovalue"}
    rest = {key: value for key, value in source.document.items() if key not in added}
    return settings_with(settings, rest, False)


def settings_with(settings: Settings, document: Mapping[str, Any], found: bool) -> Settings:
    """Return the ``settings`` of a scene with another ``document``; ``found`` is True if isogi
    chose its isovalue, see ``SceneSource``.
    """
    source = replace(settings.source, document=document, found=found)
    return Settings(source, settings.known)


def colours_by_data(settings: Settings, whole: Volume) -> SurfaceColours | None:
    """Read the colours of a scene; None if it has one albedo. ``whole`` is its volume before it is
    cut.

    Raises SceneError and VolumeError.
    """
    table = find_table(settings)
    labels = find_labels(settings)
    if labels is not None:
        if table is not None:
            raise SceneError(
                f"Labels of the scene '{settings.source.name}' have colours already: leave the "
                "other volume out."
            )
        return colours_of_labels(labels, settings, whole)
    if table is None:
        return None
    return read_colours(table, settings, whole, start_isovalue(settings, whole, whole.value_range))


def plan_overrides(settings: Settings) -> PlanOverrides:
    """Read the scene's choices for its plan. Raises SceneError if a value has no meaning."""
    return PlanOverrides(
        representation=settings.choice("representation", REPRESENTATIONS),
        order=settings.count("order", MAX_ORDER, 1),
        indirect_order=settings.count("indirect_order", MAX_ORDER, 1),
        bounces=settings.count("bounces", 1000),
        precision=settings.choice("precision", ("bytes", "half", "single")),
        lobes=settings.count("lobes", MOST_LOBES),
        albedos=settings.span("albedos", 0.0, 1.0),
    )


def right_side_out(settings: Settings, volume: Volume, progress: Progress) -> Volume:
    """Return the volume, with its solid side below the isovalue if the scene does not say and
    the object has low values, such as a distance field or pores.
    """
    # The scene's word decides; labels and demos have their solid side above.
    given = settings.text("solid", "") or find_labels(settings) is not None
    if given or settings.text("volume", DEFAULT_DEMO).startswith("demo:"):
        return volume
    outside = border_above(volume, start_isovalue(settings, volume, volume.value_range))
    if outside > INSIDE_OUT:
        return open_volume(settings, progress, "below")
    return volume


def border_above(volume: Volume, isovalue: float) -> float:
    """Return the share of the box's border that is above an ``isovalue``. The faces across x
    are left out, as reading them would touch every page of a file.
    """
    voxels = volume.voxels if volume.cell is None else volume.cell.of(volume.voxels)
    level = volume.normalise_isovalue(isovalue)
    faces = (voxels[0], voxels[-1], voxels[:, 0], voxels[:, -1])
    return sum(int((face > level).sum()) for face in faces) / sum(face.size for face in faces)


def start_isovalue(settings: Settings, volume: Volume, within: tuple[float, float]) -> float:
    """Return the isovalue at which views start: the scene's, or the default one moved into the
    range ``within``.
    """
    given = settings.number("isovalue", math.nan, *within)
    if math.isnan(given):
        return min(max(default_isovalue(settings, volume), within[0]), within[1])
    return given


def default_isovalue(settings: Settings, volume: Volume) -> float:
    """Return an isovalue for a scene that gives none: the demo's, that of a segmentation, or
    Otsu's threshold, moved to half-way between the values on its two sides.
    """
    if find_labels(settings) is not None:
        return LABEL_ISOVALUE
    name = settings.text("volume", DEFAULT_DEMO)
    if name.startswith("demo:"):
        return float(DEMOS[name.removeprefix("demo:")].isovalue)
    return halfway(volume, otsu(*volume.histogram()))


SAMPLED_LAYERS = 16
"""Number of layers of a volume whose voxels are read to find the values next to an isovalue."""

NEAR_VALUES_SHARE = 2 / HISTOGRAM_BINS
"""Distance of neighbouring values, over the core's span, up to which they count as dense: they
fill the bins of the histogram.
"""


def halfway(volume: Volume, isovalue: float) -> float:
    """Return the midpoint between the values next to an ``isovalue``, as a mask or a few whole
    numbers need.

    The isovalue itself is returned if values are dense, or all on one side of it. A sample of
    layers is read.
    """
    layers = volume.voxels[:: max(len(volume.voxels) // SAMPLED_LAYERS, 1)]
    level = volume.normalise_isovalue(isovalue)
    low = float(np.max(layers, where=layers < level, initial=-np.inf))
    high = float(np.min(layers, where=layers > level, initial=np.inf))
    least, most = volume.core_span()
    if not NEAR_VALUES_SHARE * (most - least) < high - low < np.inf:
        return isovalue
    return 0.5 * volume.file_value(low) + 0.5 * volume.file_value(high)


def otsu(counts: np.ndarray, edges: np.ndarray) -> float:
    """Return the value that splits a histogram of even bins into the two classes farthest apart: an
    edge, or the middle of the empty bins between the classes.

    Distances are counted in bins, as squares of values may overflow or underflow a double. Source:
    Otsu, "A threshold selection method from gray-level histograms", 1979.
    """
    # For each split: the counts below and above it, and the distance between the means of both.
    middles = np.arange(len(counts)) + 0.5
    below = np.cumsum(counts)[:-1]
    above = counts.sum() - below
    mass = np.cumsum(counts * middles)
    with np.errstate(divide="ignore", invalid="ignore"):
        apart = (mass[-1] - mass[:-1]) / above - mass[:-1] / below
        between = np.nan_to_num(below.astype(float) * above * apart**2)
    # The best split may lie anywhere in a run of empty bins: take its middle.
    first = int(np.argmax(between))
    last = first + int(np.argmax(np.append(counts[first + 1 :] > 0, True)))
    return 0.5 * float(edges[1 + first]) + 0.5 * float(edges[1 + last])
