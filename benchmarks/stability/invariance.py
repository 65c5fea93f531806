"""Cases of invariance: other units, other axes, the same picture."""

import math
from collections.abc import Sequence
from itertools import permutations, product

import numpy as np

from benchmarks.stability.case import Outcome, Size, case
from benchmarks.stability.pictures import grey_levels, picture_of
from benchmarks.stability.range_volumes import soft
from benchmarks.stability.stage import scene_of, view_of
from isogi_core.model.view import Camera, View
from isogi_core.model.volume import make_volume

GROUP = "invariance"
SHADED = ("lambert", "phong_shadow", "gi")
OFFSETS_AND_FACTORS = ((1e9, 1.0), (-1e9, 1.0), (0.0, 1e-300), (0.0, 1e300), (0.0, 3.7))
STAND = np.array([50.0, 33.0, 21.0])
"""The eye, from the volume's middle, in voxels; that of the mirrored and permuted field is mirrored and permuted."""

SUN = np.array([0.5, 0.7, 0.6])
"""Towards the lamp of all shadings but global illumination, which has the same light from everywhere."""

Axes = tuple[Sequence[int], Sequence[int]]


@case(GROUP, "units of value", "v, 1e9 + v, 1e-300 v and 1e300 v have one picture", 1, "grey levels")
def units(size: Size) -> Outcome:
    """Compare the pictures of fields that differ in offset and factor, in each shading."""
    field, worst, samples = soft(), 0, size.pick(256, 1024)
    for shading in SHADED:
        plain = scene_of(make_volume(field), 0.5)
        view = view_of(plain, size.pick(20, 64), shading=shading)
        one = picture_of(plain, view, samples)
        for offset, factor in OFFSETS_AND_FACTORS:
            scene = scene_of(make_volume(offset + factor * field), offset + factor * 0.5)
            other = picture_of(scene, view_of(scene, view.width, shading=shading), samples)
            worst = max(worst, grey_levels(one, other))
    return Outcome(worst, f"in {', '.join(SHADED)}")


def turned(axes: Axes, shading: str, pixels: int, samples: int) -> np.ndarray:
    """The picture of the field with its axes (x, y, z) permuted and then mirrored, from an eye that went along.

    The lamp went along too. The picture is itself mirrored back where the axes changed their hand.
    """
    order, signs = axes
    field = soft(24).transpose([2 - order[2 - axis] for axis in range(3)])
    field = field[tuple(slice(None, None, signs[2 - axis]) for axis in range(3))]
    move = np.eye(3)[list(order)] * np.array(signs)[:, None]
    x, y, z = move @ SUN
    angles = {"azimuth": math.degrees(math.atan2(y, x)), "elevation": math.degrees(math.atan2(z, math.hypot(x, y)))}
    lamp = {"type": "directional", **angles}
    scene = scene_of(make_volume(field), 0.5, **({} if shading == "gi" else {"lights": [lamp]}))
    eye = np.array(scene.volume.centre) + move @ STAND
    camera = Camera(tuple(eye), scene.volume.centre, tuple(move @ (0.1, 0.2, 1.0)), 26.0)
    picture = picture_of(scene, View(0.5, camera, width=pixels, height=pixels, shading=shading), samples)
    return picture if np.linalg.det(move) > 0.0 else picture[:, ::-1]


def worst_of(changed: Sequence[Axes], size: Size) -> Outcome:
    """The largest difference of pictures with changed axes from the one with none, in each shading."""
    worst = {}
    for shading in SHADED:
        shown = shading, size.pick(10, 20), size.pick(2048, 4096)
        one = turned(((0, 1, 2), (1, 1, 1)), *shown)
        worst[shading] = max(grey_levels(one, turned(axes, *shown)) for axes in changed)
    return Outcome(max(worst.values()), ", ".join(f"{shading} {levels}" for shading, levels in worst.items()))


@case(GROUP, "mirrored", "a mirrored volume has the mirrored picture", 1, "grey levels")
def mirrored(size: Size) -> Outcome:
    """Mirror one axis, two, and all."""
    signs = [each for each in product((1, -1), repeat=3) if each != (1, 1, 1)]
    return worst_of([((0, 1, 2), each) for each in signs[: size.pick(1, 7)]], size)


@case(GROUP, "permuted axes", "a volume with permuted axes has the permuted picture", 1, "grey levels")
def permuted(size: Size) -> Outcome:
    """Permute the axes in all five ways."""
    orders = list(permutations(range(3)))[1:]
    return worst_of([(each, (1, 1, 1)) for each in orders[: size.pick(1, 5)]], size)
