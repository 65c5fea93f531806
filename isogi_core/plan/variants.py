"""Variants of a scene: in other or turned light, cut open, at another time, smoothed, with other
surfaces next to it, with labels hidden, of another material, or in finer light, with more texels
and bands for views whose control pixels ask for it.

A variant is a scene like any other, by another id, and shares with the original the parts that both
have.

Light on each side of several surfaces is that of a variant too: there this surface is the one that
slides, and the others are pinned, the original's sliding one at the isovalue that is shown. For an
inner side the volume is turned inside out, so that the side becomes an outer one.
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
from isogi_core.model.view import (
    NO_TURN,
    Turn,
    angles_of,
    quaternion_from_angles,
    quaternion_of,
    rotation_matrix,
)
from isogi_core.model.volume import Isovalue, Volume
from isogi_core.plan.assembly import build_scene
from isogi_core.plan.planner import complete
from isogi_core.plan.scene import Scene
from isogi_core.plan.starts import both_signs
from isogi_core.plan.volumes.masks import cut_away, voxels_left


def remade(
    scene: Scene, document: dict[str, Any], volume: Volume | None, name: str | None = None
) -> Scene:
    """Make the scene that another ``document`` describes, with the ``volume`` if it is open, else
    by opening it; see ``build_scene``.

    It has the id ``name`` if one is given. Colours and masks of glows are shared with ``scene`` if
    the volume is. The same light is equally bright in pictures of both.
    """
    # Settings that change voxels are done already in an open volume.
    bare = {
        key: value for key, value in document.items() if volume is None or key not in VOXEL_SETTINGS
    }
    known = (scene.surfaces.colours, scene.lighting.glowing.bits) if volume else (None, None)
    made = build_scene(replace(scene.source, document=bare), no_progress, volume, *known)
    # The document keeps the start that was chosen anew if the former one is outside of the values.
    done = {key: value for key, value in document.items() if key not in bare}
    source = replace(made.source, document={**done, **made.source.document})
    return replace(made, source=source, id=name or made.id, exposed_for=scene.seen, turn=scene.turn)


def under(scene: Scene, environment: str, name: str) -> Scene:
    """Make the scene in the light of an ``environment``, named as in a scene file, by the id
    ``name``.

    It replaces all of the scene's [[lights]]; walls stay, and their luminaires. The volume is
    shared. Raises LightError, and SceneError if the scene's choices do not fit that light.
    """
    document = {**scene.source.document, "environment": environment}
    # An exposure is for the light that it was chosen in.
    if isinstance(document.get("view"), Mapping):
        document["view"] = {
            key: value for key, value in document["view"].items() if key != "exposure"
        }
    return remade(scene, document, scene.volume, name)


def turned_by(scene: Scene, turn: Turn, name: str) -> Scene:
    """Make the scene with its environment turned by ``turn`` in the world, for views with this turn
    of the light. Its id is ``name``. The ``scene`` itself must not be such a variant.

    Walls stay, and the volume is shared. The exposure stays too, so that pictures keep their
    brightness while light turns. Raises as ``build_scene`` does.
    """
    # A scene may have turned its environment itself: the turn of the views comes after that.
    own = rotation_matrix(quaternion_from_angles(*scene.source.document.get("turned", NO_TURN)))
    matrix = rotation_matrix(quaternion_from_angles(*turn)) @ own
    document = {
        **scene.source.document,
        "turned": list(angles_of(quaternion_of(matrix))),
        "view": {**scene.source.document.get("view", {}), "exposure": scene.default_exposure},
    }
    return replace(remade(scene, document, scene.volume, name), turn=turn)


def cut_open(scene: Scene, cut: str, name: str, volume: Volume | None = None) -> Scene:
    """Make the scene with a ``cut`` in addition to its own, by the id ``name``; see ``cut_away``.

    A ``volume`` that is cut in this way is used if it is given. Raises SceneError and VolumeError.
    """
    former = scene.source.document.get("cut")
    both = f"{former};{cut}" if former else cut
    # Each cut by itself may leave something, and both together nothing.
    voxels_left(scene.volume, both)
    left = volume or cut_away(scene.volume, cut)
    return remade(scene, {**scene.source.document, "cut": both}, left, name)


def at_time(scene: Scene, time: int, name: str, volume: Volume | None = None) -> Scene:
    """Make the scene at another step of its series in time, by the id ``name``, with its ``volume``
    if it is open.

    It starts at the same isovalue, moved into its range. Raises SceneError if there is no such
    step.
    """
    steps = scene.volume.moment[1]
    if not 0 <= time < steps:
        if steps > 1:
            last = f"is one of {steps} steps, 0 to {steps - 1}"
        else:
            last = "is no series in time: leave time out"
        raise SceneError(f"time = {time}: the volume '{scene.volume.name}' {last}.")
    # The step of the variant replaces one that the name of the file may choose.
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
    # Each step has a range of values, in which views start as near to the scene's as they can.
    low, high = other.isovalues
    return replace(other, isovalue=min(max(scene.isovalue, low), high))


def smoothed_by(scene: Scene, sigma: float, name: str, volume: Volume | None = None) -> Scene:
    """Make the scene with its volume smoothed by a Gaussian of ``sigma`` voxels in place of the
    scene's own, by the id ``name``, with the smoothed ``volume`` if it is open.

    Its range of isovalues stays. Raises SceneError and VolumeError.
    """
    other = remade(scene, {**scene.source.document, "smooth": sigma}, volume, name)
    return replace(other, isovalue=scene.isovalue, isovalues=scene.isovalues)


def with_clears(scene: Scene, clears: Clears, name: str) -> Scene:
    """Make the scene with other shares of rays that pass its pinned surfaces, and without the
    surfaces that ``clears`` has as None, by the id ``name``.

    The volume is shared. Raises as ``build_scene`` does.
    """
    document = put_clears(
        scene.source.document, [each.table for each in scene.surfaces.pinned], clears
    )
    return remade(scene, document, scene.volume, name)


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
    """Make the scene of a segmentation with the labels ``hidden`` in place of its own choice, by
    the id ``name``.

    Its volume is another one, which is read again unless it is that of ``like``, a scene with the
    same labels hidden. Raises SceneError and VolumeError.
    """
    document = put_hidden(scene.source.document, hidden)
    if like is None:
        return remade(scene, document, None, name)
    # Share the volume and the colours of the labels.
    coloured = replace(
        scene,
        surfaces=replace(scene.surfaces, colours=like.surfaces.colours),
        exposed_for=scene.seen,
    )
    return remade(coloured, document, like.volume, name)


def with_material(scene: Scene, settings: MaterialSettings, name: str) -> Scene:
    """Make the scene of another material, by ``settings`` of its surface, by the id ``name``.

    Keys that the material excludes are dropped: albedos for glass, and a range of albedos for a
    subsurface. The volume is shared. Raises as ``build_scene`` does.
    """
    return remade(scene, put_material(scene.source.document, settings), scene.volume, name)


def made_of(scene: Scene, settings: MaterialSettings) -> bool:
    """Return True if the scene's file says these ``settings`` of its surface already."""
    return put_material(scene.source.document, settings) == scene.source.document


def find_materials(scene: Scene) -> dict[str, Scene | str]:
    """Return the scene of each of MATERIALS, with default numbers; or, if the scene cannot be
    of it, a sentence that says why.
    """
    return {
        kind: scene if kind == scene.surfaces.material.kind else _of_material(scene, kind)
        for kind in MATERIALS
    }


def _of_material(scene: Scene, kind: str) -> Scene | str:
    """Return the scene of a material, or the message of the error that refuses it."""
    try:
        return with_material(scene, {"material": kind}, scene.id)
    except (SceneError, LightError) as error:
        return str(error)


MAX_FINENESS = 4.0
"""Most texels per voxel along each axis."""

FINER_FACTOR = 2.0
"""Factor on the number of texels along each axis in finer light."""

FURTHER = 2
"""Number of bands that finer light has in addition, if light turns."""


def has_finer(scene: Scene) -> bool:
    """Return True if a ``scene`` can have finer light: not beyond MAX_FINENESS, not among
    walls, whose light is in texels of theirs, and not of several surfaces.
    """
    return (
        FINER_FACTOR * scene.settings.lattice <= MAX_FINENESS
        and not scene.lighting.room.any
        and not scene.surfaces.several
    )


def finer(scene: Scene) -> Scene:
    """Return the ``scene`` with finer light: FINER_FACTOR times the texels along each axis, and
    FURTHER bands.
    """
    lattice = FINER_FACTOR * scene.settings.lattice
    source = replace(scene.source, document={**scene.source.document, "lattice": lattice})
    plan = complete(further(scene.plan), scene.inputs, scene.settings.overrides)
    return replace(scene.with_settings(lattice=lattice), source=source, plan=plan)


def further(plan: ScenePlan) -> ScenePlan:
    """Return a ``plan`` with more bands if its light turns; any other plan as it is."""
    if plan.representation != "transfer":
        return plan
    layers = tuple(further_layer(layer) for layer in plan.layers)
    return replace(plan, layers=layers, order=max(layer.order for layer in layers))


def further_layer(layer: Layer) -> Layer:
    """Return a ``layer`` with more bands, at most MAX_ORDER; a layer of glow has none."""
    if layer.kind == GLOW_KIND:
        return layer
    return replace(layer, order=min(layer.order + FURTHER, MAX_ORDER))


@dataclass(frozen=True)
class Side:
    """One side of a surface of a scene.

    ``number`` is 0 for the sliding surface and k for pinned surface k - 1; ``inner`` is True for
    the side that faces the solid.
    """

    number: int
    inner: bool = False

    @property
    def peeled(self) -> int:
        """The number of the side among all sides, as in ``Peeled``."""
        return 2 * self.number + self.inner


OUTER = Side(0)
"""The side whose light is that of the scene itself."""

WALLS_SIDE = Side(MAX_SURFACES)
"""Stands for the sides of the walls around the surfaces."""


def surfaces_of(scene: Scene, shown: float) -> tuple[PinnedSurface, ...]:
    """Return all surfaces of a scene that shows the isovalue ``shown``, the sliding one first."""
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
    """Return both sides of all surfaces of a ``scene``."""
    return tuple(
        Side(number, inner)
        for number in range(1 + len(scene.surfaces.pinned))
        for inner in (False, True)
    )


def scene_of_side(scene: Scene, side: Side, shown: float) -> Scene:
    """Return the scene whose light is that of a ``side`` while the sliding surface shows the
    isovalue ``shown``.

    Raises as ``build_scene`` does.
    """
    if side == OUTER:
        return scene
    # The surface of the side slides in its scene, and all others are pinned there.
    every = surfaces_of(scene, shown)
    sliding = every[side.number]
    if side.number:
        others = every
    else:
        others = scene.surfaces.pinned
    # Of surfaces at one isovalue only the first counts.
    others = distinct_surfaces((sliding, *others), scene)[1:]
    # Write the document of that scene: the keys of its surface, its solid side, its range and the
    # other surfaces.
    document: dict[str, Any] = {
        key: value for key, value in scene.source.document.items() if key not in SIDE_SETTINGS
    }
    document |= {key: value for key, value in sliding.table.items() if key != "name"}
    document |= solid_keys(scene, side)
    if side.number:
        document["isovalues"] = [sliding.isovalue] * 2
    else:
        document["isovalues"] = list(scene.isovalues)
    if others:
        document["surfaces"] = [each.table for each in others]
    if side.inner:
        return remade(scene, document, scene.volume.inside_out)
    return remade(scene, document, scene.volume)


def distinct_surfaces(
    surfaces: tuple[PinnedSurface, ...], scene: Scene
) -> tuple[PinnedSurface, ...]:
    """Return the ``surfaces`` without any at the isovalue of an earlier one."""
    found: dict[Isovalue, PinnedSurface] = {}
    for each in surfaces:
        found.setdefault(scene.volume.normalise_isovalue(each.isovalue), each)
    return tuple(found.values())


def solid_keys(scene: Scene, side: Side) -> dict[str, Any]:
    """Return the keys that say which side of the isovalue is solid in the scene of a ``side``,
    so that another process that opens it gets the same scene.
    """
    document = scene.source.document
    turned = document.get("inside_out", False)
    if str(document.get("volume", DEFAULT_DEMO)).startswith("demo:"):
        return {"inside_out": turned != side.inner}
    # The volume is turned already: name the solid side that its file has.
    if turned:
        solid = {"above": "below", "below": "above"}[scene.solid]
    else:
        solid = scene.solid
    return {"inside_out": turned != side.inner, "solid": solid}


SIDE_SETTINGS = ("isovalue", "isovalues", "presets", "albedo", "transmission", "clear", "surfaces")
"""Keys of a scene that the scene of each side has for itself."""
