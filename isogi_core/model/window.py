"""Windows: planes that take away, for the eye alone, what lies before them. The scene stays whole, and so its light."""

import math
import re
from dataclasses import dataclass

import numpy as np

from isogi_core.errors import ViewError
from isogi_core.files.grid import Vector
from isogi_core.model.orientation import Orientation, triple

MAX_WINDOW_PLANES = 12
"""Most planes of a window: six at any angle, and the six of a box."""

MIN_NORMAL_LENGTH, MAX_PLANE_NUMBER = 1e-12, 1e12
"""The least and the greatest length of a plane's normal, and the greatest distance of a plane from the origin."""

AXIS_NORMALS = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}

NUMBER_PATTERN = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
TERM_PATTERN = re.compile(
    rf"([xyz]|{NUMBER_PATTERN},{NUMBER_PATTERN},{NUMBER_PATTERN})([<>])({NUMBER_PATTERN})", re.ASCII
)

Plane = tuple[float, float, float, float]


@dataclass(frozen=True)
class Window:
    """What is left to see: points p with n · p + w ≥ 0 for each of the ``planes`` (n, w), whose normals are units.

    What is left is convex, so that a ray sees one part of it. Planes are in the volume's box, or in the world.
    """

    planes: tuple[Plane, ...]

    def in_box(self, orientation: Orientation) -> "Window":
        """This window of the world in the box of a volume with an ``orientation``."""
        return Window(tuple(_plane_in_box(plane, orientation) for plane in self.planes))

    def in_index(self, spacing: Vector) -> np.ndarray:
        """The planes of the box in index space, as kernels take them; (k, 4) float64."""
        return np.array(self.planes, np.float64).reshape(-1, 4) * (*spacing, 1.0)


def _plane_in_box(plane: Plane, orientation: Orientation) -> Plane:
    normal, offset = plane[:3], plane[3]
    moved = offset + float(np.dot(normal, orientation.origin)) if orientation.placed else offset
    return (*orientation.direction_to_box(normal), moved)


def read_window(text: str) -> Window:
    """The window that a ``text`` such as ``x>40;0,1,-1<12.5`` spells: each term takes away what it is true of.

    An axis stands for its unit normal; other normals, of any length, are three numbers. Raises ViewError.
    """
    terms = [part.replace(" ", "") for part in text.split(";")]
    if len(terms) > MAX_WINDOW_PLANES:
        raise ViewError(f"A window has at most {MAX_WINDOW_PLANES} planes, not {len(terms)}.")
    return Window(tuple(map(_read_term, terms)))


def _read_term(term: str) -> Plane:
    match = TERM_PATTERN.fullmatch(term) if len(term) <= 200 else None
    if match is None:
        shown = term if len(term) <= 40 else f"{term[:39]}…"
        raise ViewError(f"A plane takes away, such as x>40 or 0,1,-1<12.5, with ; between planes; '{shown}' is none.")
    named, sign, limit = match[1], -1.0 if match[2] == ">" else 1.0, float(match[3])
    normal = AXIS_NORMALS.get(named) or triple([float(each) for each in named.split(",")])
    length = math.hypot(*normal)
    if not MIN_NORMAL_LENGTH <= length <= MAX_PLANE_NUMBER or not abs(limit) <= MAX_PLANE_NUMBER * length:
        raise ViewError(
            f"The plane '{term}' has no direction, or is too far away: give a longer normal or a less limit."
        )
    x, y, z = (sign * each / length + 0.0 for each in normal)  # no -0
    return x, y, z, -sign * limit / length + 0.0
