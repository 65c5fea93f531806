"""Scenes made over: in other light, cut open, at another time, smoothed, with other surfaces
beside, with labels hidden, of another material, or in finer light: more texels and more bands, for
views whose control pixels ask for it.

Each is a scene like any other, by another id. What it has in common with the first it shares.

The light on either side of each of several surfaces is that of a scene, too: there this surface is
the one that slides, and the others are pinned beside it, the one that slides at the isovalue which
is shown. Of inner sides the volume is turned inside out, so that they are outer ones.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from isogi_core.errors import LightError, SceneError
from isogi_core.files.formats.opening import split_part
from isogi_core.files.scene_file import (
    DEFAULT_DEMO,
    VOXEL_SETTINGS,
    Clears,
    Hidden,
    MaterialSettings,
    put_clears,
    put_hidden,
    put_material,
)
from isogi_core.kernels.tracing.peels import MAX_SURFACES
from isogi_core.kernels.transport.harmonics import MAX_ORDER
from isogi_core.model.material import MATERIALS, PinnedSurface
from isogi_core.model.scene_plan import GLOW_KIND, Layer, ScenePlan
from isogi_core.model.value_survey import no_progress
from isogi_core.model.volume import Isovalue, Volume
from isogi_core.plan.assembly import build_scene
from isogi_core.plan.planner import complete
from isogi_core.plan.scene import Scene
from isogi_core.plan.starts import both_signs
from isogi_core.plan.volumes.masks import cut_away, voxels_left


def remade(
    scene: Scene, document: dict[str, Any], volume: Volume | None, name: str | None = None
) -> Scene:
    """The scene that another ``document`` makes of it, with its colours where a ``volume`` is open:
    see build_scene.

    It has another id where there is a ``name``. The same light is as bright in pictures of both.
    """
    bare = {
        key: value for key, value in document.items() if volume is None or key not in VOXEL_SETTINGS
    }
    known = (scene.surfaces.colours, scene.lighting.glowing.bits) if volume else (None, None)
    made = build_scene(replace(scene.source, document=bare), no_progress, volume, *known)
    source = replace(scene.source, document=document)
    return replace(made, source=source, id=name or made.id, exposed_for=scene.seen)


def under(scene: Scene, environment: str, name: str) -> Scene:
    """The scene in the light of an ``environment``, as a scene file names it, by another id,
    ``name``.

    It replaces all of the scene's [[lights]]; walls stay, and their luminaires. The volume is
    shared. Raises SceneError where the scene's own choices do not fit that light, and LightError.
    """
    document = {**scene.source.document, "environment": environment}
    if isinstance(
        document.get("view"), Mapping
    ):  # an exposure is for the light that it was found in
        document["view"] = {
            key: value for key, value in document["view"].items() if key != "exposure"
        }
    return remade(scene, document, scene.volume, name)


def cut_open(scene: Scene, cut: str, name: str, volume: Volume | None = None) -> Scene:
    """The scene with a ``cut`` in addition to its own, by another id, ``name``: see ``cut_away``.

    Where there is a ``volume`` that is cut so, it is taken.

    Raises SceneError and VolumeError.
    """
    own = scene.source.document.get("cut")
    both = f"{own};{cut}" if own else cut
    voxels_left(scene.volume, both)  # each by itself may leave something
    left = volume or cut_away(scene.volume, cut)
    return remade(scene, {**scene.source.document, "cut": both}, left, name)


def at_time(scene: Scene, time: int, name: str, volume: Volume | None = None) -> Scene:
    """The scene at another step of its series in time, by another id, ``name``; of a ``volume``
    where it is open.

    It starts at the same isovalue, as far as there is such. Raises SceneError for a step that is
    not there.
    """
    steps = scene.volume.moment[1]
    if not 0 <= time < steps:
        if steps > 1:
            last = f"is one of {steps} steps, 0 to {steps - 1}"
        else:
            last = "is no series in time: leave time out"
        raise SceneError(f"time = {time}: the volume '{scene.volume.name}' {last}.")
    place, chosen = split_part(str(scene.source.document["volume"]))
    rest = "&".join(
        value if key == "part" else f"{key}={value}"
        for key, value in chosen.items()
        if key != "time"
    )
    document = {
        **scene.source.document,
        "volume": f"{place}#{rest}" if rest else place,
        "time": time,
    }
    other = remade(scene, document, volume, name)
    low, high = other.isovalues
    return replace(other, isovalue=min(max(scene.isovalue, low), high))


def smoothed_by(scene: Scene, sigma: float, name: str, volume: Volume | None = None) -> Scene:
    """The scene with its volume smoothed by a Gaussian of ``sigma`` voxels in place of its own, by
    another id, ``name``; of a ``volume`` where it is open.

    Its range of isovalues stays. Raises SceneError and VolumeError.
    """
    other = remade(scene, {**scene.source.document, "smooth": sigma}, volume, name)
    return replace(other, isovalue=scene.isovalue, isovalues=scene.isovalues)


def with_clears(scene: Scene, clears: Clears, name: str) -> Scene:
    """The scene with other shares of rays that pass its pinned surfaces, and without surfaces of
    None, by another id.

    The volume is shared. Raises as ``build_scene`` does.
    """
    document = put_clears(
        scene.source.document, [each.table for each in scene.surfaces.pinned], clears
    )
    return remade(scene, document | {"rotating": scene.lighting.rotating}, scene.volume, name)


def at_both_signs(scene: Scene, isovalue: float) -> Scene:
    """The scene of a field of both signs at another ``isovalue``, and with the other sign's surface
    at minus that; any other scene as it is. Raises as ``build_scene`` does.
    """
    document = scene.source.document
    started = both_signs(scene.isovalue)["surfaces"]
    low, high = scene.volume.value_range
    if document.get("surfaces") != started or not isovalue or not low <= -isovalue <= high:
        return scene
    return remade(scene, {**document, **both_signs(isovalue)}, scene.volume)


def with_hidden(scene: Scene, hidden: Hidden, name: str, like: Scene | None = None) -> Scene:
    """The scene of a segmentation with these labels ``hidden`` in place of its own, by another id,
    ``name``.

    It is another volume, which is read again unless a scene ``like`` it has it. Raises SceneError
    and VolumeError.
    """
    document = put_hidden(scene.source.document, hidden)
    if like is None:
        return remade(scene, document, None, name)
    coloured = replace(
        scene,
        surfaces=replace(scene.surfaces, colours=like.surfaces.colours),
        exposed_for=scene.seen,
    )
    return remade(coloured, document, like.volume, name)


def with_material(scene: Scene, settings: MaterialSettings, name: str) -> Scene:
    """The scene of another material, by these ``settings`` of its surface, by another id, ``name``.

    What only reflects is left behind: albedos of glass, and a range of them of a subsurface. The
    volume is shared. Raises as ``build_scene`` does.
    """
    return remade(scene, put_material(scene.source.document, settings), scene.volume, name)


def made_of(scene: Scene, settings: MaterialSettings) -> bool:
    """Whether a scene says these ``settings`` of its surface already."""
    return put_material(scene.source.document, settings) == scene.source.document


def find_materials(scene: Scene) -> dict[str, Scene | str]:
    """The scene of each of MATERIALS, with the numbers that it has by itself; a sentence that says
    why where the scene cannot be of it.
    """
    return {
        kind: scene if kind == scene.surfaces.material.kind else _of_material(scene, kind)
        for kind in MATERIALS
    }


def _of_material(scene: Scene, kind: str) -> Scene | str:
    try:
        return with_material(scene, {"material": kind}, scene.id)
    except (SceneError, LightError) as error:
        return str(error)


MAX_FINENESS = 4.0
"""Texels per voxel along each axis, at most."""

FINER_FACTOR = 2.0
"""How many times as many texels finer light has along each axis."""

FURTHER = 2
"""Bands of harmonics that finer light has besides, of light that turns."""


def has_finer(scene: Scene) -> bool:
    """Whether there is finer light of a ``scene``: not beyond MAX_FINENESS, and not among walls,
    which have light of their own, nor of several surfaces.
    """
    return (
        FINER_FACTOR * scene.settings.lattice <= MAX_FINENESS
        and not scene.lighting.room.any
        and not scene.surfaces.several
    )


def finer(scene: Scene) -> Scene:
    """The ``scene`` with finer light."""
    lattice = FINER_FACTOR * scene.settings.lattice
    source = replace(scene.source, document={**scene.source.document, "lattice": lattice})
    plan = complete(further(scene.plan), scene.inputs, scene.settings.overrides)
    return replace(scene.with_settings(lattice=lattice), source=source, plan=plan)


def further(plan: ScenePlan) -> ScenePlan:
    """A ``plan`` with more bands of light that turns; any other as it is."""
    if plan.representation != "transfer":
        return plan
    layers = tuple(further_layer(layer) for layer in plan.layers)
    return replace(plan, layers=layers, order=max(layer.order for layer in layers))


def further_layer(layer: Layer) -> Layer:
    """A ``layer`` with more bands; what glows keeps none."""
    if layer.kind == GLOW_KIND:
        return layer
    return replace(layer, order=min(layer.order + FURTHER, MAX_ORDER))


@dataclass(frozen=True)
class Side:
    """One side of a surface of a scene: its ``number``, 0 of the one that slides and k of the
    pinned one k - 1, and whether it is the ``inner`` one, which faces what is solid.
    """

    number: int
    inner: bool = False

    @property
    def peeled(self) -> int:
        """The number of the side among all sides, as of ``Peeled``."""
        return 2 * self.number + self.inner


OUTER = Side(0)
"""The side whose light is that of the scene itself."""

WALLS_SIDE = Side(MAX_SURFACES)
"""Stands for the sides of the walls about the surfaces."""


def surfaces_of(scene: Scene, shown: float) -> tuple[PinnedSurface, ...]:
    """All surfaces of a scene that shows the isovalue ``shown``, the one that slides first."""
    return (
        PinnedSurface(
            shown,
            scene.surfaces.albedo,
            scene.surfaces.clear,
            transmission=scene.surfaces.transmission,
        ),
        *scene.surfaces.pinned,
    )


def sides_of(scene: Scene) -> tuple[Side, ...]:
    """Both sides of all surfaces of a ``scene``."""
    return tuple(
        Side(number, inner)
        for number in range(1 + len(scene.surfaces.pinned))
        for inner in (False, True)
    )


def scene_of_side(scene: Scene, side: Side, shown: float) -> Scene:
    """The scene whose light is that on a ``side``, where the one that slides shows the isovalue
    ``shown``.

    Raises as ``build_scene`` does.
    """
    if side == OUTER:
        return scene
    every = surfaces_of(scene, shown)
    own = every[side.number]
    if side.number:
        others = every
    else:
        others = scene.surfaces.pinned
    others = distinct_surfaces((own, *others), scene)[1:]
    document: dict[str, Any] = {
        key: value for key, value in scene.source.document.items() if key not in SIDE_SETTINGS
    }
    document |= {key: value for key, value in own.table.items() if key != "name"} | lying(
        scene, side
    )
    document |= {"isovalues": [own.isovalue] * 2 if side.number else list(scene.isovalues)}
    if others:
        document |= {"surfaces": [each.table for each in others]}
    return remade(scene, document, scene.volume.inside_out if side.inner else scene.volume)


def distinct_surfaces(
    surfaces: tuple[PinnedSurface, ...], scene: Scene
) -> tuple[PinnedSurface, ...]:
    """The ``surfaces`` without any that lies at the isovalue of one before it."""
    found: dict[Isovalue, PinnedSurface] = {}
    for each in surfaces:
        found.setdefault(scene.volume.normalise_isovalue(each.isovalue), each)
    return tuple(found.values())


def lying(scene: Scene, side: Side) -> dict[str, Any]:
    """Which side of its isosurfaces is solid in the scene of a ``side``: what a process that opens
    it is to know.
    """
    document = scene.source.document
    turned = document.get("inside_out", False)
    if str(document.get("volume", DEFAULT_DEMO)).startswith("demo:"):
        return {"inside_out": turned != side.inner}
    if turned:
        solid = {"above": "below", "below": "above"}[scene.solid]
    else:
        solid = scene.solid
    return {"inside_out": turned != side.inner, "solid": solid}


SIDE_SETTINGS = ("isovalue", "isovalues", "presets", "albedo", "transmission", "clear", "surfaces")
"""What each side's scene has for itself."""
