"""A set of pictures of one isosurface: cameras around and above it, each under a light that is turned step by step."""

import math
from dataclasses import dataclass

from isogi_core.model.scene import Scene
from isogi_core.model.view import View, quaternion_from_angles

Pick = tuple[int, int]
"""A camera and a turn of the light, by their numbers."""

GOLDEN = math.pi * (3.0 - math.sqrt(5.0))
"""The golden angle."""

STEPS = (5, 3, 2, 1)
"""Turns of the light between one picked picture and the next: the first that goes through all of them."""


@dataclass(frozen=True, eq=False)
class PictureSet:
    """``views`` cameras spread evenly above the horizon, three radii away, 30 degrees wide, by ``turns`` of light."""

    scene: Scene
    size: int
    views: int
    turns: int

    def __len__(self) -> int:
        return self.views * self.turns

    def view(self, camera: int, turn: int = 0) -> View:
        """The picture of one of the cameras under one of the lights, turned about z by equal steps.

        Directions are those of a Fibonacci lattice on the upper half of the sphere.
        """
        elevation = math.degrees(math.asin(1.0 - (camera + 0.5) / self.views))
        azimuth = math.degrees(camera * GOLDEN) % 360.0
        light = quaternion_from_angles(360.0 * turn / self.turns, 0.0, 0.0)
        towards = self.scene.camera(azimuth, elevation, 3.0, 30.0)
        return View(self.scene.isovalue, towards, light, self.size, self.size)

    def picks(self, count: int) -> list[Pick]:
        """Cameras and turns of ``count`` pictures from all over the set, different in both as far as there are."""
        count = min(count, len(self))
        step = next(step for step in STEPS if math.gcd(step, self.turns) == 1)
        return [((2 * i + 1) * self.views // (2 * count), step * i % self.turns) for i in range(count)]
