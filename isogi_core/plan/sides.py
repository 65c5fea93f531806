"""The sides of several surfaces, and the scene in which each of them is lit.

The light on either side of each surface is that of a scene of its own: there this surface is the one that slides, and
the others are pinned beside it, the one that slides at the isovalue which is shown. Of inner sides the volume is turned
inside out, so that they are outer ones.
"""

from dataclasses import dataclass
from typing import Any

from isogi_core.files.scene_file import DEFAULT_DEMO
from isogi_core.kernels.tracing.peels import MAX_SURFACES
from isogi_core.model.surfaces import PinnedSurface
from isogi_core.model.volume import Isovalue
from isogi_core.plan.scene import Scene
from isogi_core.plan.variants import remade


@dataclass(frozen=True)
class Side:
    """One side of a surface of a scene: its ``number``, 0 of the one that slides and k of the pinned one k - 1, and
    whether it is the ``inner`` one, which faces what is solid.
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
        PinnedSurface(shown, scene.surfaces.albedo, scene.surfaces.clear, transmission=scene.surfaces.transmission),
        *scene.surfaces.pinned,
    )


def sides_of(scene: Scene) -> tuple[Side, ...]:
    """Both sides of all surfaces of a ``scene``."""
    return tuple(Side(number, inner) for number in range(1 + len(scene.surfaces.pinned)) for inner in (False, True))


def scene_of_side(scene: Scene, side: Side, shown: float) -> Scene:
    """The scene whose light is that on a ``side``, where the one that slides shows the isovalue ``shown``.

    Raises as ``build_scene`` does.
    """
    if side == OUTER:
        return scene
    every = surfaces_of(scene, shown)
    own, others = every[side.number], every if side.number else scene.surfaces.pinned
    others = distinct_surfaces((own, *others), scene)[1:]
    document: dict[str, Any] = {key: value for key, value in scene.source.document.items() if key not in SIDE_SETTINGS}
    document |= {key: value for key, value in own.table.items() if key != "name"} | lying(scene, side)
    document |= {"isovalues": [own.isovalue] * 2 if side.number else list(scene.isovalues)}
    document |= {"surfaces": [each.table for each in others]} if others else {}
    return remade(scene, document, scene.volume.inside_out if side.inner else scene.volume)


def distinct_surfaces(surfaces: tuple[PinnedSurface, ...], scene: Scene) -> tuple[PinnedSurface, ...]:
    """The ``surfaces`` without any that lies at the isovalue of one before it."""
    found: dict[Isovalue, PinnedSurface] = {}
    for each in surfaces:
        found.setdefault(scene.volume.normalise_isovalue(each.isovalue), each)
    return tuple(found.values())


def lying(scene: Scene, side: Side) -> dict[str, Any]:
    """Which side of its isosurfaces is solid in the scene of a ``side``: what a process that opens it is to know."""
    document = scene.source.document
    turned = document.get("inside_out", False)
    if str(document.get("volume", DEFAULT_DEMO)).startswith("demo:"):
        return {"inside_out": turned != side.inner}
    solid = {"above": "below", "below": "above"}[scene.solid] if turned else scene.solid
    return {"inside_out": turned != side.inner, "solid": solid}


SIDE_SETTINGS = ("isovalue", "isovalues", "presets", "albedo", "transmission", "clear", "surfaces")
"""What each side's scene has for itself."""
