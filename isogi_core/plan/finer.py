"""Finer light: the same scene with more texels and more bands, for views whose control pixels ask for it."""

from dataclasses import replace

from isogi_core.kernels.transport.harmonics import MAX_ORDER
from isogi_core.model.scene_plan import GLOW, Layer, ScenePlan
from isogi_core.plan.planner import complete
from isogi_core.plan.scene import Scene

FINEST = 4.0
"""Texels per voxel along each axis, at most."""

DENSER = 2.0
"""How many times as many texels finer light has along each axis."""

FURTHER = 2
"""Bands of harmonics that finer light has besides, of light that turns."""


def has_finer(scene: Scene) -> bool:
    """Whether there is finer light of a ``scene``: not beyond FINEST, and not among walls, which have light of their
    own, nor of several surfaces.
    """
    return DENSER * scene.settings.lattice <= FINEST and not scene.lighting.room.any and not scene.surfaces.several


def finer(scene: Scene) -> Scene:
    """The ``scene`` with finer light."""
    lattice = DENSER * scene.settings.lattice
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
    if layer.kind == GLOW:
        return layer
    return replace(layer, order=min(layer.order + FURTHER, MAX_ORDER))
