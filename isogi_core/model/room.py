"""Walls: flat rectangles near the isosurface, read from ``[[walls]]`` tables, or a whole room
around the volume.
"""

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from isogi_core.errors import SceneError, ViewError
from isogi_core.files.scene_file import TableReaders, read_colour, read_table, read_vector
from isogi_core.files.vector import Vector, triple
from isogi_core.model.lights import LARGEST_LIGHT, AreaLight, Colour
from isogi_core.model.view import Camera
from isogi_core.model.volume import Volume

MOST_WALLS = 64
"""Most walls of a scene: every ray tests each of them."""

MAX_SKEW = 1e-6
"""Cosine up to which two edges count as being at a right angle."""


IN_WALL = 1e-6
"""Least distance of the camera from a wall, in radii of the volume."""


@dataclass(frozen=True)
class Wall:
    """A rectangle in the world with a ``corner`` and two ``edges``, which reflects ``albedo`` and
    gives off ``radiance``, both linear RGB.

    If ``sides`` is 1, only the side that the cross product of the edges points to is lit; the other
    is black, and eye rays pass through it. Raises SceneError if a value has no meaning.
    """

    corner: Vector
    edges: tuple[Vector, Vector]
    albedo: Colour = (0.7, 0.7, 0.7)
    radiance: Colour = (0.0, 0.0, 0.0)
    sides: int = 2

    def __post_init__(self) -> None:
        _check_edges(*map(np.array, self.edges))
        if not all(0.0 <= share <= 1.0 for share in self.albedo):
            raise SceneError(f"A wall's albedo is {_listed(self.albedo)}: it must be from 0 to 1.")
        if not all(0.0 <= light <= LARGEST_LIGHT for light in self.radiance):
            raise SceneError(
                f"A wall's radiance is {_listed(self.radiance)}: it must be from 0 to "
                f"{LARGEST_LIGHT:g}."
            )

    @property
    def lamps(self) -> tuple[AreaLight, ...]:
        """Light of the wall as area lights, one for each lit side; empty if it gives off none."""
        # Edges in turn span the front of the wall; swapped, they span its back.
        u, v = self.edges
        both = (
            AreaLight(self.corner, u, v, self.radiance),
            AreaLight(self.corner, v, u, self.radiance),
        )
        if any(self.radiance):
            return both[: self.sides]
        return ()


def _check_edges(u: np.ndarray, v: np.ndarray) -> None:
    """Raise SceneError if two edges do not span a rectangle."""
    longest = max(float(np.linalg.norm(u)), float(np.linalg.norm(v)))
    if not 0.0 < np.linalg.norm(np.cross(u, v)) <= LARGEST_LIGHT or longest > LARGEST_LIGHT:
        raise SceneError("A wall's edges span no area: give two edges that are not parallel.")
    if abs(u @ v) > MAX_SKEW * np.linalg.norm(u) * np.linalg.norm(v):
        raise SceneError("A wall's edges are not at a right angle: walls are rectangles.")


def _listed(values: Sequence[float]) -> str:
    """Join numbers with commas, for messages."""
    return ", ".join(f"{value:g}" for value in values)


@dataclass(frozen=True, eq=False)
class Room:
    """The ``walls`` of a scene; ``corners`` (k, 3) and ``edges`` (k, 2, 3) are in the volume's
    box.
    """

    walls: tuple[Wall, ...]
    corners: np.ndarray
    edges: np.ndarray

    @property
    def any(self) -> bool:
        """True if there is any wall."""
        return bool(self.walls)

    @property
    def lamps(self) -> tuple[AreaLight, ...]:
        """The light of all walls as area lights."""
        return tuple(lamp for wall in self.walls for lamp in wall.lamps)

    @property
    def albedos(self) -> tuple[Colour, ...]:
        """The albedo of each wall."""
        return tuple(wall.albedo for wall in self.walls)

    @cached_property
    def digest(self) -> str:
        """Hex digest of everything that light depends on."""
        rest = [[wall.albedo, wall.radiance, wall.sides] for wall in self.walls]
        text = repr([self.corners.tolist(), self.edges.tolist(), rest])
        return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()

    @property
    def dark_digest(self) -> str:
        """Hex digest of everything that reflects light, without the light that walls give off."""
        dark = tuple(replace(wall, radiance=(0.0, 0.0, 0.0)) for wall in self.walls)
        return Room(dark, self.corners, self.edges).digest

    def wall_at(self, point: Vector, near: float) -> int | None:
        """Return the number, from 0, of the first wall in which a ``point`` of the box lies: at
        most ``near`` away from its plane, and not beyond its rim. None if there is none.
        """
        for k, (corner, (u, v)) in enumerate(zip(self.corners, self.edges, strict=True)):
            # Edges are at a right angle: coordinates along them are from 0 to 1 within the rim.
            away = np.subtract(point, corner)
            normal = np.cross(u, v)
            shares = away @ u / (u @ u), away @ v / (v @ v)
            if abs(away @ normal) <= near * np.linalg.norm(normal) and all(
                0.0 <= share <= 1.0 for share in shares
            ):
                return k
        return None

    def refuse_camera(self, camera: Camera, radius: float) -> None:
        """Raise ViewError if a ``camera`` in the volume's box stands in a wall, closer than
        IN_WALL of the volume's ``radius``.
        """
        wall = self.wall_at(camera.eye, IN_WALL * radius)
        if wall is not None:
            raise ViewError(f"The camera stands in wall {wall + 1}: move it to either side.")


NO_ROOM = Room((), np.empty((0, 3)), np.empty((0, 2, 3)))


def place_walls(walls: Sequence[Wall], volume: Volume) -> Room:
    """Place ``walls`` of the world around a ``volume``. Raises SceneError if there are too many."""
    if len(walls) > MOST_WALLS:
        raise SceneError(f"The scene has {len(walls)} walls: give it at most {MOST_WALLS}.")
    if not walls:
        return NO_ROOM
    matrix = volume.orientation.matrix
    origin = np.array(volume.orientation.origin)
    corners = np.array([wall.corner for wall in walls])
    edges = np.array([wall.edges for wall in walls])
    return Room(tuple(walls), (corners - origin) @ matrix, edges @ matrix)


def wall_from_mapping(table: Mapping[str, Any]) -> Wall:
    """Read the wall of one ``[[walls]]`` table. Raises SceneError if a key is unknown or
    missing, or a value has no meaning.
    """
    return Wall(**read_table(table, "A wall", WALL_READERS, ("corner", "edges")))


def _edges(name: str, value: Any) -> tuple[Vector, Vector]:
    """Read two vectors."""
    if not isinstance(value, list) or len(value) != 2:
        raise SceneError(f"{name} are {value!r}: give two, [[x, y, z], [x, y, z]].")
    return read_vector("A wall's edge", value[0]), read_vector("A wall's edge", value[1])


def _sides(name: str, value: Any) -> int:
    """Read 1 or 2."""
    if value not in (1, 2) or isinstance(value, bool):
        raise SceneError(f"{name} are {value!r}: give 1 or 2, as many as are lit.")
    return int(value)


WALL_READERS: TableReaders = {
    "corner": read_vector,
    "edges": _edges,
    "albedo": read_colour,
    "radiance": read_colour,
    "sides": _sides,
}
"""Readers of the keys of a ``[[walls]]`` table."""

ROOMS = ("cornell",)
"""Names of whole rooms."""

WHITE_ALBEDO = (0.73, 0.73, 0.73)
RED_ALBEDO = (0.63, 0.065, 0.05)
GREEN_ALBEDO = (0.14, 0.45, 0.09)
"""Albedos of a Cornell room's walls."""

ROOM_WIDTH = 1.5
FLOOR_GAP = 0.05
"""Side of the room, and distance of its floor below the volume's box, over the box's longest
side.
"""

LAMP_SIDE = 1.0 / 3.0
LAMP_GAP = 0.005
"""Side of its luminaire, and distance of that below the ceiling, over the side of the room."""

LAMP_RADIANCE = 0.25 * math.pi / LAMP_SIDE**2
"""Radiance of the luminaire, with which a white surface in the middle of the room that faces it
has about radiance 1.
"""


def cornell_room(volume: Volume) -> tuple[Wall, ...]:
    """Return a cube around the box of a ``volume``, open towards +y, with a luminaire at its
    ceiling.

    All walls are lit on their inner sides. Seen from +y, red is on the left and green on the right.
    """
    # Place a cube around the box, with its floor a little below.
    low, high = np.array(volume.world_bounds, np.float64)
    longest = float((high - low).max())
    side = ROOM_WIDTH * longest
    x, y = ((low + high) / 2.0 - side / 2.0)[:2]
    z = low[2] - FLOOR_GAP * longest
    along = np.eye(3) * side

    def wall(
        corner: Sequence[float], u: np.ndarray, v: np.ndarray, albedo: Colour, radiance: float = 0.0
    ) -> Wall:
        """Make a wall that is lit on the side that u × v points to."""
        return Wall(triple(corner), (triple(u), triple(v)), albedo, (radiance,) * 3, sides=1)

    # Floor, ceiling, back, left and right wall; then the luminaire, which looks down.
    rim = 0.5 * (1.0 - LAMP_SIDE) * side
    hung = z + (1.0 - LAMP_GAP) * side
    return (
        wall((x, y, z), along[0], along[1], WHITE_ALBEDO),
        wall((x, y, z + side), along[1], along[0], WHITE_ALBEDO),
        wall((x, y, z), along[2], along[0], WHITE_ALBEDO),
        wall((x + side, y, z), along[2], along[1], RED_ALBEDO),
        wall((x, y, z), along[1], along[2], GREEN_ALBEDO),
        wall(
            (x + rim, y + rim, hung),
            LAMP_SIDE * along[1],
            LAMP_SIDE * along[0],
            (0.0, 0.0, 0.0),
            LAMP_RADIANCE,
        ),
    )
