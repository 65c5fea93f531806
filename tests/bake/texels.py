"""Texels of the orbital and their light, baked in this process; bake specs of plans of a test's
own.
"""

import math
from functools import cache
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from isogi_core.bake.bake_spec import BakeSpec, spec_for
from isogi_core.bake.noise import Goal
from isogi_core.bake.refine import climb, locate, refine
from isogi_core.bake.texel_light import Light
from isogi_core.kernels.transport.harmonics import rotate
from isogi_core.model.scene_plan import Layer, ScenePlan
from isogi_core.prepared.prepared_scene import PreparedScene
from tests.loaded import load_scene

NEVER = -1.0
"""A target that no texel reaches."""

SKY = {"type": "sky", "sun_azimuth": 20.0, "sun_elevation": 35.0}
CONSTANT = {"type": "constant", "radiance": 1.0}
COLUMNS = ("samples", "noise", "coefficients")


ALBEDO = (0.3, 0.6, 0.9)


def rotations_of(light: np.ndarray, count: int, seed: int = 1) -> np.ndarray:
    """The light (channels, n²) under so many random rotations, (count, channels, n²)."""
    order = math.isqrt(light.shape[1])
    out = np.empty((count, *light.shape))
    for matrix, place in zip(Rotation.random(count, rng=seed).as_matrix(), out, strict=True):
        rotate(order, np.ascontiguousarray(matrix), light, place)
    return out


def spec_of(plan: ScenePlan, **settings: Any) -> BakeSpec:
    """The orbital under a sky, lit by a plan of the test's own."""
    return BakeSpec(
        PreparedScene(
            load_scene("demo:orbital", **{"lights": [SKY], "albedo": list(ALBEDO), **settings})
        ),
        plan,
    )


def plan_of(*layers: Layer, representation: str = "transfer", bounces: int = 3) -> ScenePlan:
    """The plan of some layers."""
    order = max(layer.order for layer in layers)
    return ScenePlan(representation, layers, order, bounces, 1.0, 4096)


@cache
def orbital(
    albedo: float | tuple[float, ...] = 0.7, shading: str = "gi", sky: bool = True, **settings: Any
) -> BakeSpec:
    """A bake spec of the orbital with 3 bounces, under a sky (no lobes) or constant light; three
    albedos: coloured.
    """
    if isinstance(albedo, tuple):
        given = list(albedo)
    else:
        given = albedo
    lights = [SKY if sky else CONSTANT]
    settled = {"lights": lights, "albedo": given, "bounces": 3, "lobes": 0, **settings}
    scene = load_scene("demo:orbital", **settled)
    return spec_for(PreparedScene(scene), shading)


def surface_texels(spec: BakeSpec, count: int, seed: int = 1) -> np.ndarray:
    """Random texels (count, 3; z, y, x) within a voxel or so of the scene's own isosurface; lattice
    1.
    """
    volume = spec.prepared.scene.volume
    iso = volume.normalise_isovalue(spec.prepared.scene.isovalue)
    steep = np.sqrt(sum(g * g for g in np.gradient(volume.voxels)))
    near = np.argwhere(np.abs(volume.voxels - iso) < steep)
    return np.random.default_rng(seed).permutation(near)[:count].astype(np.int32)


def baked(spec: BakeSpec, texels: np.ndarray, *levels: int, target: float = NEVER) -> Light:
    """Light of the texels after one call of `refine` for each of the `levels`."""
    light = Light.dark(spec.plan, len(texels))
    for until in levels:
        refine(light, texels, spec, until, Goal(target))
    return light


def climbed(spec: BakeSpec, texels: np.ndarray, samples: int) -> Light:
    """Light of the texels with so many samples in every part."""
    light = Light.dark(spec.plan, len(texels))
    for part in light.parts:
        while part.samples.max() < samples:
            climb([part], np.arange(len(texels)), locate(texels, spec.prepared, spec.shown), spec)
    return light


def same(one: Light, other: Light) -> bool:
    """Whether two lights have the same bits."""
    return all(
        np.array_equal(getattr(a, name), getattr(b, name))
        for a, b in zip(one.parts, other.parts, strict=True)
        for name in COLUMNS
    )
