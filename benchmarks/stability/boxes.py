"""Cases of extreme boxes: stretched, minute, immense, and such as cut the surface."""

import math
from dataclasses import replace
from itertools import product

import numpy as np

from benchmarks.stability.box_volumes import GROUP
from benchmarks.stability.case import Outcome, Size, case
from benchmarks.stability.pictures import faults, grey_levels, hits_of, picture_of
from benchmarks.stability.range_volumes import soft
from benchmarks.stability.shapes import grid
from benchmarks.stability.specimen import Spacing, volumes
from benchmarks.stability.stage import renderer_of, scene_of, scenes_of, view_of
from isogi_core.model.scene import Scene
from isogi_core.model.view import SHADINGS, Camera, View
from isogi_core.model.volume import make_volume

RADIUS = 8.0
"""Of spheres, in voxels of the coarse axes."""

CHORDS = RADIUS - math.sqrt(RADIUS**2 - 0.75)
"""How far a cube's trilinear field may lie within the sphere: of r² it lacks 1/4 for each axis at most."""

Figures = tuple[float, float]


def sphere(ratio: int) -> Scene:
    """A sphere in voxels that are so many times thinner along x than along y and z."""
    side = round(2 * RADIUS) + 6
    x, y, z = grid((side - 1) * ratio + 1, side, side)
    field = RADIUS**2 - (x / ratio) ** 2 - y**2 - z**2
    return scene_of(make_volume(field.astype(np.float32), (1.0 / ratio, 1.0, 1.0)), 0.0)


def off_sphere(scene: Scene, view: View) -> Figures:
    """How far pixels' points are from the sphere, in coarse voxels, and their normals from its own, in radians."""
    with renderer_of(scene) as renderer:
        gbuffer = renderer.gbuffer(view)
        points, normals = gbuffer.points, gbuffer.normals(renderer.recipe, renderer.tiles, None)
    out = points.astype(np.float64) * scene.volume.spacing - scene.volume.centre
    radii = np.linalg.norm(out, axis=1)
    angles = np.arccos(np.clip((out * normals).sum(axis=1) / radii, -1.0, 1.0))
    return float(np.abs(radii - RADIUS).max()), float(angles.max())


@case(
    GROUP,
    "spheres of thin voxels",
    "a sphere in voxels 1000 times thinner one way is as round as in cubes",
    CHORDS,
    "voxels",
)
def thin_voxels(size: Size) -> Outcome:
    """Compare points and normals of a sphere with its closed form, for ratios of spacing up to 1 : 1000."""
    figures: list[Figures] = []
    for ratio in (1, 10, 100, 1000)[: size.pick(3, 4)]:
        scene = sphere(ratio)
        figures.append(off_sphere(scene, view_of(scene, size.pick(64, 256), shading="lambert")))
    far, turned = np.max(figures, axis=0)
    return Outcome(far, f"normals within {math.degrees(turned):.2g}°, in cubes {math.degrees(figures[0][1]):.2g}°")


@case(GROUP, "minute and immense", "the picture does not depend on the unit of length", 1, "grey levels")
def units(size: Size) -> Outcome:
    """Compare the pictures of one field in spacings of 1e-30, 1 and 1e30."""
    worst = 0
    for shading in ("lambert", "phong_shadow", "lambert_fog", "gi"):
        one, *others = (spaced(step, shading, size.pick(14, 96)) for step in (1.0, 1e-30, 1e-3, 1e30))
        worst = max(worst, *(grey_levels(one, other) for other in others))
    return Outcome(worst, "from 1e-30 to 1e30 a voxel")


def spaced(step: float, shading: str, pixels: int) -> np.ndarray:
    """The picture of the body with cubes of ``step`` for voxels."""
    spacing: Spacing = (step, step, step)
    scene = scene_of(make_volume(soft(), spacing), 0.5)
    return picture_of(scene, view_of(scene, pixels, shading=shading), 256)


@case(GROUP, "cut by the box", "where the box ends, the surface ends, and nothing else changes", 1e-4, "voxels")
def cut(size: Size) -> Outcome:
    """Hits of the upper half of the body, and those of the whole body that lie there, by the same rays."""
    whole = scene_of(make_volume(soft()), 0.5)
    half = scene_of(make_volume(soft()[16:]), 0.5)
    view = view_of(whole, size.pick(96, 384), elevation=50.0)
    (x, y, z), (u, v, w) = view.camera.eye, view.camera.target
    camera = Camera((x, y, z - 16.0), (u, v, w - 16.0), view.camera.up, view.camera.fov)
    found, expected = hits_of(half, replace(view, camera=camera)), hits_of(whole, view)
    kept = expected[..., 2] >= 16.0
    far = np.abs(found[kept] - (expected[kept] - np.array([0, 0, 16], np.float32)))
    return Outcome(float(far.max()), f"of {kept.sum()} pixels")


@case(GROUP, "every shading", "every specimen has finite pixels in every shading, seen from within too", 0, "numbers")
def every_shading(size: Size) -> Outcome:
    """Render all specimens in all shadings, and count numbers that are none; light is not baked for it."""
    wrong, frames = 0, 0
    for each in volumes("" if size else GROUP):
        for scene in scenes_of(each):
            with renderer_of(scene) as renderer:
                for shading, distance in product(SHADINGS, (2.4, 0.1)):
                    view = view_of(scene, size.pick(8, 64), shading=shading, distance=distance)
                    wrong, frames = wrong + faults(renderer.render(view)), frames + 1
    return Outcome(wrong, f"of {frames} frames")
