"""Orientation: where a volume's box lies in the world, and what the world's cameras, lights and points are in the box.

Voxels are never turned: cameras and lights are, once, where a view is made.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from isogi_core.files.grid import Grid, Vector, triple

Rows = tuple[Vector, Vector, Vector]
STRAIGHT: Rows = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))

OPPOSITE = dict(zip("RASLPI", "LPIRAS", strict=True))
"""The letter on a patient's other side."""


@dataclass(frozen=True)
class Orientation:
    """``world = rotation · box + origin``; a point of the box is voxel indices times spacing, x first.

    ``rotation`` is the rows of a rotation. ``unit`` is that of the world's lengths, empty where unknown. ``letters``
    say where the world's axes point in a patient, "RAS", else empty. ``notes`` tell what was done to the file's field,
    and ``read_as`` in a line what the file was taken for.
    """

    rotation: Rows = STRAIGHT
    origin: Vector = (0.0, 0.0, 0.0)
    unit: str = ""
    letters: str = ""
    notes: tuple[str, ...] = ()
    read_as: str = field(default="", compare=False)

    @classmethod
    def of(cls, grid: Grid) -> "Orientation":
        """The orientation of a ``grid`` on right angles."""
        if grid.affine is None:
            return cls(unit=grid.unit, notes=grid.notes, read_as=grid.read_as)
        directions = np.array(grid.affine.matrix) / np.array(grid.spacing)
        a, b, c = (triple(row) for row in np.where(np.abs(directions) < 1e-12, 0.0, directions))
        return cls((a, b, c), grid.affine.origin, grid.unit, grid.affine.letters, grid.notes, grid.read_as)

    @property
    def turned(self) -> bool:
        """Whether the box's axes are not the world's."""
        return self.rotation != STRAIGHT

    @property
    def straight(self) -> bool:
        """Whether the box's axes lie along the world's, in whatever order and direction."""
        parts = np.abs(self.matrix)
        return bool(np.isclose(parts, np.round(parts), atol=1e-6).all())

    @property
    def matrix(self) -> np.ndarray:
        """The rotation from the box to the world, (3, 3) float64."""
        return np.array(self.rotation)

    def affine(self, spacing: Vector) -> np.ndarray:
        """From voxel indices of a volume with this ``spacing`` to the world: a matrix, and the origin; (3, 4)."""
        return np.column_stack([self.matrix * np.array(spacing), self.origin])

    def to_world(self, points: Any) -> np.ndarray:
        """Points (..., 3) of the box, in the world."""
        return np.asarray(points) @ self.matrix.T + np.array(self.origin) if self.placed else np.asarray(points)

    def point_to_box(self, point: Vector) -> Vector:
        """A point of the world, in the box."""
        return self.direction_to_box(triple(np.subtract(point, self.origin))) if self.placed else point

    def direction_to_box(self, direction: Vector) -> Vector:
        """A direction of the world, in the box."""
        return triple(self.matrix.T @ np.array(direction)) if self.turned else direction

    def letter(self, direction: Vector) -> str:
        """The letter of the patient's side that a world ``direction`` points to most; empty without letters."""
        if not self.letters:
            return ""
        axis = int(np.argmax(np.abs(direction)))
        letter = self.letters[axis]
        return letter if direction[axis] > 0.0 else OPPOSITE[letter]

    def sides(self, point: Vector) -> str:
        """The sides of the patient that a world ``point`` lies on, seen from the world's origin, such as "LAS"."""
        pairs = zip(self.letters, point, strict=False)
        return "".join(letter if coordinate >= 0.0 else OPPOSITE[letter] for letter, coordinate in pairs)

    @property
    def axes(self) -> str:
        """Where voxel axes x, y, z point in a patient, as three letters; empty without letters."""
        return "".join(self.letter(triple(column)) for column in self.matrix.T)

    @property
    def placed(self) -> bool:
        """Whether a point of the box has other coordinates in the world."""
        return self.turned or self.origin != (0.0, 0.0, 0.0)


PLAIN_ORIENTATION = Orientation()
"""The orientation of a volume whose world is its voxels' indices times spacing."""
