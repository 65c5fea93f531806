"""Cameras that are hard: within the solid, on its surface, far away, with the narrowest and the widest fields."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from benchmarks.stability.stage import STAND
from isogi_core.frame.renderer import Renderer
from isogi_core.model.scene import Scene
from isogi_core.model.view import Camera, View

NARROWEST, WIDEST, FURTHEST = 0.01, 179.0, 1e7
"""Degrees of the field of view, and bounding radii, that a view may ask for at most."""

TURNS = [(a, e) for a in (-360.0, -90.0, 90.0, 360.0) for e in (-90.0, 0.0, 90.0)]

KNOBS: Mapping[str, Mapping[str, float]] = {
    **{f"azimuth {a:g}, elevation {e:g}": {"azimuth": a, "elevation": e} for a, e in TURNS},
    "narrowest": {"fov": NARROWEST},
    "widest": {"fov": WIDEST},
    "from the middle, widest": {"distance": 0.01, "fov": WIDEST},
    "from the middle, narrowest": {"distance": 0.01, "fov": NARROWEST},
    "a thousand radii away": {"distance": 1e3, "fov": 0.1},
    "ten thousand radii away": {"distance": 1e4, "fov": NARROWEST},
}
"""Views from an orbit, by their knobs."""

SIZES: Mapping[str, tuple[int, int]] = {"one pixel": (1, 1), "a row": (97, 1), "a column": (1, 97)}
"""Pictures, by width and height."""


def hard_views(renderer: Renderer, size: int) -> dict[str, View]:
    """Thirty views of a scene, ``size`` pixels a side but where that is what is hard."""
    scene = renderer.recipe.scene
    usual = square(scene, scene.camera(**STAND), size)
    found = {name: square(scene, scene.camera(**{**STAND, **knobs}), size) for name, knobs in KNOBS.items()}
    for name, (width, height) in SIZES.items():
        found[name] = View(scene.isovalue, scene.camera(**STAND), width=width, height=height)
    points = renderer.gbuffer(usual).points
    on = points[len(points) // 2] * np.array(scene.volume.spacing)
    return found | {name: square(scene, camera, size) for name, camera in eyes(scene, on).items()}


def square(scene: Scene, camera: Camera, size: int) -> View:
    """A square picture of the scene."""
    return View(scene.isovalue, camera, width=size, height=size)


def eyes(scene: Scene, on: np.ndarray) -> dict[str, Camera]:
    """Cameras within the solid, at the point ``on`` of its surface, and on the box; world."""
    volume = scene.volume
    middle, far_corner = np.array(volume.centre), np.array(volume.extent)
    within = np.argwhere(volume.voxels == volume.voxels.max())[0][::-1] * np.array(volume.spacing)
    face = middle * (0, 1, 1)
    return {
        "within the solid": looking(within, middle),
        "on the surface, outwards": looking(on, 2.0 * on - middle, 120.0),
        "on the surface, inwards": looking(on, middle, 120.0),
        "on a voxel": looking(np.rint(on / volume.spacing) * volume.spacing, middle, 90.0),
        "on a corner of the box": looking(far_corner, middle, 90.0),
        "on a face of the box, along it": looking(face, face + np.array((0, 1, 0)), 90.0),
        "on a face of the box, inwards": looking(face, middle, 120.0),
        "a million boxes away": far_eye(scene, 1e6 * max(volume.extent)),
        "looking away": looking(3.0 * far_corner, 4.0 * far_corner),
    }


def looking(eye: Any, target: Any, fov: float = 40.0) -> Camera:
    """A camera at one point that looks at another, its up at no special angle."""
    (x, y, z), (u, v, w) = (np.asarray(point, np.float64).tolist() for point in (eye, target))
    return Camera((x, y, z), (u, v, w), (0.1, 0.2, 1.0), fov)


def far_eye(scene: Scene, distance: float) -> Camera:
    """A camera so far from the middle of the box, whose field just holds the box."""
    out = np.array((0.36, 0.48, 0.8))
    fov = 2.0 * math.degrees(math.atan(scene.volume.radius / distance))
    return looking(np.array(scene.volume.centre) + distance * out, scene.volume.centre, fov)
