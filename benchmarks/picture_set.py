"""A set of pictures of one isosurface: cameras all around it, each under a light that is turned step by step."""

import math
from dataclasses import dataclass

from isogi_core.model.scene import Scene
from isogi_core.model.view import View, quaternion_from_angles

Pick = tuple[int, int]
"""A camera and a turn of the light, by their numbers."""

GOLDEN = math.pi * (3.0 - math.sqrt(5.0))
"""The golden angle."""


@dataclass(frozen=True, eq=False)
class PictureSet:
    """``views`` cameras in evenly spread directions, three radii away, 30 degrees wide, by ``turns`` of the light."""

    scene: Scene
    size: int
    views: int
    turns: int

    def __len__(self) -> int:
        return self.views * self.turns

    def view(self, camera: int, turn: int = 0) -> View:
        """The picture of one of the cameras under one of the lights, turned about z by equal steps.

        Directions are those of a Fibonacci lattice on the sphere.
        """
        elevation = math.degrees(math.asin(1.0 - (2.0 * camera + 1.0) / self.views))
        azimuth = math.degrees(camera * GOLDEN) % 360.0
        light = quaternion_from_angles(360.0 * turn / self.turns, 0.0, 0.0)
        towards = self.scene.camera(azimuth, elevation, 3.0, 30.0)
        return View(self.scene.isovalue, towards, light, self.size, self.size)

    def picks(self, count: int) -> list[Pick]:
        """Cameras and turns of ``count`` pictures from all over the set, different in both as far as there are."""
        count = min(count, len(self))
        return [((2 * i + 1) * self.views // (2 * count), 5 * i % self.turns) for i in range(count)]
