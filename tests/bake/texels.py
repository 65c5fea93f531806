"""Texels of the orbital and their light, baked in this process."""

from functools import cache
from typing import Any

import numpy as np

from isogi_core.bake.light import Light
from isogi_core.bake.look import Look, look_for
from isogi_core.bake.recipe import Recipe
from isogi_core.bake.refine import climb, refine
from isogi_core.model.scene import load_scene

NEVER = -1.0
"""A target that no texel reaches."""

SKY = {"type": "sky", "sun_azimuth": 20.0, "sun_elevation": 35.0}
CONSTANT = {"type": "constant", "radiance": 1.0}
COLUMNS = ("samples", "noise", "coefficients")


@cache
def orbital(albedo: float | tuple[float, ...] = 0.7, shading: str = "gi", sky: bool = True, **settings: Any) -> Look:
    """A look at the orbital with 3 bounces, under a sky (no lobes) or constant light; three albedos: coloured."""
    given = list(albedo) if isinstance(albedo, tuple) else albedo
    lights = [SKY if sky else CONSTANT]
    told = {"lights": lights, "albedo": given, "bounces": 3, "lobes": 0, **settings}
    scene = load_scene("demo:orbital", **told)
    return look_for(Recipe(scene), shading)


def surface_texels(look: Look, count: int, seed: int = 1) -> np.ndarray:
    """Random texels (count, 3; z, y, x) within a voxel or so of the scene's own isosurface; lattice 1."""
    volume = look.recipe.scene.volume
    iso = volume.normalise_isovalue(look.recipe.scene.isovalue)
    steep = np.sqrt(sum(g * g for g in np.gradient(volume.voxels)))
    near = np.argwhere(np.abs(volume.voxels - iso) < steep)
    return np.random.default_rng(seed).permutation(near)[:count].astype(np.int32)


def baked(look: Look, texels: np.ndarray, *rungs: int, target: float = NEVER) -> Light:
    """Light of the texels after one call of `refine` for each of the `rungs`."""
    light = Light.dark(look.plan, len(texels))
    for until in rungs:
        refine(light, texels, look, until, target)
    return light


def climbed(look: Look, texels: np.ndarray, samples: int) -> Light:
    """Light of the texels with so many samples in every part."""
    light = Light.dark(look.plan, len(texels))
    for part in light.parts:
        while part.samples.max() < samples:
            climb([part], np.arange(len(texels)), texels, look)
    return light


def same(one: Light, other: Light) -> bool:
    """Whether two lights have the same bits."""
    return all(
        np.array_equal(getattr(a, name), getattr(b, name))
        for a, b in zip(one.parts, other.parts, strict=True)
        for name in COLUMNS
    )
