"""A view: camera, isovalue, light rotation, picture size, shading and window of one frame."""

import math
import re
from dataclasses import dataclass, field, replace

import numpy as np

from isogi_core.errors import ViewError
from isogi_core.files.vector import Vector, triple
from isogi_core.model.choices import VIEW_SHADINGS
from isogi_core.model.material import Shine
from isogi_core.model.volume import PLAIN_ORIENTATION, Orientation

MAX_WINDOW_PLANES = 12
"""Most planes of a window: six at any angle, and the six of a box."""

MIN_NORMAL_LENGTH = 1e-12
MAX_PLANE_NUMBER = 1e12
"""Least and greatest length of a plane's normal, and greatest distance of a plane from the
origin.
"""

AXIS_NORMALS = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}

NUMBER_PATTERN = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
TERM_PATTERN = re.compile(
    rf"([xyz]|{NUMBER_PATTERN},{NUMBER_PATTERN},{NUMBER_PATTERN})([<>])({NUMBER_PATTERN})", re.ASCII
)

Plane = tuple[float, float, float, float]


@dataclass(frozen=True)
class Window:
    """The part of space that the eye sees: points p with n · p + w ≥ 0 for each of the ``planes``
    (n, w), whose normals are unit vectors.

    That part is convex, so that a ray sees one interval of it. Planes are in the volume's box, or
    in the world.
    """

    planes: tuple[Plane, ...]

    def in_box(self, orientation: Orientation) -> "Window":
        """Return this window of the world in the box of a volume with an ``orientation``."""
        return Window(tuple(_plane_in_box(plane, orientation) for plane in self.planes))

    def in_index(self, spacing: Vector) -> np.ndarray:
        """Return the planes of the box in index space, as kernels take them; (k, 4) float64."""
        return np.array(self.planes, np.float64).reshape(-1, 4) * (*spacing, 1.0)


def _plane_in_box(plane: Plane, orientation: Orientation) -> Plane:
    """Return a plane of the world in the box of a volume with an ``orientation``."""
    normal = plane[:3]
    offset = plane[3]
    if orientation.placed:
        moved = offset + float(np.dot(normal, orientation.origin))
    else:
        moved = offset
    return (*orientation.direction_to_box(normal), moved)


def read_window(text: str) -> Window:
    """Read a window from a ``text`` such as ``x>40;0,1,-1<12.5``. Each term removes the points for
    which it is true.

    An axis stands for its unit normal; other normals, of any length, are three numbers. Raises
    ViewError.
    """
    terms = [part.replace(" ", "") for part in text.split(";")]
    if len(terms) > MAX_WINDOW_PLANES:
        raise ViewError(f"A window has at most {MAX_WINDOW_PLANES} planes, not {len(terms)}.")
    return Window(tuple(map(_read_term, terms)))


def _read_term(term: str) -> Plane:
    """Read one term of a window as a plane (nx, ny, nz, w) with a unit normal, in the coordinates
    of the term: it removes the points p for which the term is true, and keeps n · p + w ≥ 0.

    Raises ViewError if it is no term, or the plane has no direction or is too far away.
    """
    # The pattern is tried on terms of a sensible length alone.
    match = TERM_PATTERN.fullmatch(term) if len(term) <= 200 else None
    if match is None:
        shown = term if len(term) <= 40 else f"{term[:39]}…"
        raise ViewError(
            f"A plane is written as x>40 or 0,1,-1<12.5, with ; between planes; '{shown}' is none."
        )
    named = match[1]
    sign = -1.0 if match[2] == ">" else 1.0
    limit = float(match[3])
    normal = AXIS_NORMALS.get(named) or triple([float(each) for each in named.split(",")])
    length = math.hypot(*normal)
    if (
        not MIN_NORMAL_LENGTH <= length <= MAX_PLANE_NUMBER
        or not abs(limit) <= MAX_PLANE_NUMBER * length
    ):
        raise ViewError(
            f"The plane '{term}' has no direction, or is too far away: give a normal about 1 long, "
            "or a smaller limit."
        )
    # Divide by the length for a unit normal, and turn it to the side that is kept; adding 0 turns
    # -0 into 0.
    x, y, z = (sign * each / length + 0.0 for each in normal)
    return x, y, z, -sign * limit / length + 0.0


Quaternion = tuple[float, float, float, float]

ORTHOGRAPHIC_RADII = 1e7
"""Distance in radii of the volume from which an orthographic camera looks. Its rays meet the
volume in a ten-millionth of their length, which float32 coordinates of the hit points just
resolve.
"""

IDENTITY: Quaternion = (1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Camera:
    """A pinhole camera, in the world (z up) or in a volume's box (voxel index × spacing).

    ``fov`` is the vertical field of view in degrees. Raises ViewError if the frame of reference
    degenerates: the eye is at the target, ``up`` is along the view, or fov is outside of (0, 180).
    """

    eye: Vector
    target: Vector
    up: Vector = (0.0, 0.0, 1.0)
    fov: float = 30.0

    def __post_init__(self) -> None:
        if not np.isfinite([*self.eye, *self.target, *self.up, self.fov]).all():
            raise ViewError(
                "The camera has a number that is not finite: give finite eye, target, up and fov."
            )
        if not 0.0 < self.fov < 180.0:
            raise ViewError(f"fov {self.fov:g} is not between 0 and 180 degrees.")
        forward = np.subtract(self.target, self.eye)
        length = float(np.linalg.norm(forward))
        if length == 0.0:
            raise ViewError("The camera's eye and target are the same point: move one of them.")
        lift = float(np.linalg.norm(self.up))
        if (
            lift == 0.0
            or np.linalg.norm(np.cross(forward / length, np.divide(self.up, lift))) < 1e-9
        ):
            raise ViewError("The camera's up is zero or along the view direction: give another up.")

    def basis(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return unit vectors (right, up, forward) at right angles, each of shape (3,), float64.

        They are left-handed: right × up points backward.
        """
        forward = np.subtract(self.target, self.eye)
        forward = forward / np.linalg.norm(forward)
        # Scale ``up`` to a length of about 1, so that no product of its parts underflows.
        up = np.ldexp(self.up, -int(np.frexp(max(map(abs, self.up)))[1]))
        right = np.cross(forward, up)
        right = right / np.linalg.norm(right)
        return right, np.cross(right, forward), forward

    def pixel_size(self, rows: int) -> float:
        """Return the side of a pixel of a picture of so many ``rows``, on a plane at distance 1
        along the view. Pixels are square: the vertical field of view sets their size.
        """
        return 2.0 * math.tan(math.radians(self.fov) / 2.0) / rows

    def in_box(self, orientation: Orientation) -> "Camera":
        """Return this camera of the world in the box of a volume with an ``orientation``."""
        if not orientation.placed:
            return self
        eye = orientation.point_to_box(self.eye)
        target = orientation.point_to_box(self.target)
        return replace(self, eye=eye, target=target, up=orientation.direction_to_box(self.up))

    def in_world(self, orientation: Orientation) -> "Camera":
        """Return this camera of the box of a volume with an ``orientation`` in the world."""
        eye, target = (triple(orientation.to_world(point)) for point in (self.eye, self.target))
        return replace(self, eye=eye, target=target, up=triple(orientation.matrix @ self.up))


def orbit(
    centre: Vector, radius: float, azimuth: float, elevation: float, distance: float, fov: float
) -> Camera:
    """Return a camera on a sphere around ``centre``. Angles are in degrees, ``distance`` in units
    of ``radius``.

    Azimuth 0 looks from +x, 90 from +y; elevation 90 looks straight down (up then points away from
    the side of the azimuth).
    """
    a, e = math.radians(azimuth), math.radians(elevation)
    out = (math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e))
    up = (-math.sin(e) * math.cos(a), -math.sin(e) * math.sin(a), math.cos(e))
    x, y, z = (c + distance * radius * o for c, o in zip(centre, out, strict=True))
    return Camera((x, y, z), centre, up, fov)


def orthographic(camera: Camera, radius: float) -> Camera:
    """Return an orthographic camera that shows things at the target of ``camera`` in the same size;
    ``radius`` is that of the volume.

    It is the same camera ORTHOGRAPHIC_RADII radii away, whose rays are parallel to rounding, with
    the field of view that keeps the height of the picture at the target. It sees everything along
    its rays, also behind the eye of the perspective camera.
    """
    away = math.dist(camera.eye, camera.target)
    # Move the eye back along the view, and narrow the field of view in proportion.
    afar = ORTHOGRAPHIC_RADII * radius
    _, _, (x, y, z) = camera.basis()
    fov = 2.0 * math.degrees(math.atan(math.tan(math.radians(camera.fov) / 2.0) * away / afar))
    eye = (camera.target[0] - afar * x, camera.target[1] - afar * y, camera.target[2] - afar * z)
    return replace(camera, eye=eye, fov=fov)


def quaternion_from_angles(yaw: float, pitch: float, roll: float) -> Quaternion:
    """Return the unit quaternion (w, x, y, z) of intrinsic yaw about z, then pitch about y,
    then roll about x, degrees.
    """
    cy, sy = math.cos(math.radians(yaw) / 2), math.sin(math.radians(yaw) / 2)
    cp, sp = math.cos(math.radians(pitch) / 2), math.sin(math.radians(pitch) / 2)
    cr, sr = math.cos(math.radians(roll) / 2), math.sin(math.radians(roll) / 2)
    return (
        cy * cp * cr + sy * sp * sr,
        cy * cp * sr - sy * sp * cr,
        cy * sp * cr + sy * cp * sr,
        sy * cp * cr - cy * sp * sr,
    )


def unit_quaternion(values: Quaternion) -> Quaternion:
    """Scale a quaternion to unit length. Raises ViewError if its length is not within [1e-3,
    1e3].
    """
    norm = math.sqrt(sum(v * v for v in values))
    if not 1e-3 <= norm <= 1e3:
        raise ViewError("The light's quaternion w,x,y,z must have a length between 0.001 and 1000.")
    w, x, y, z = (v / norm for v in values)
    return (w, x, y, z)


def rotation_matrix(q: Quaternion) -> np.ndarray:
    """Return the 3×3 float64 matrix that rotates a vector by the unit quaternion ``q`` = (w, x,
    y, z).
    """
    w, x, y, z = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ],
        dtype=np.float64,
    )


def quaternion_of(matrix: np.ndarray) -> Quaternion:
    """Return the unit quaternion (w, x, y, z), w not negative, of a rotation ``matrix`` (3, 3).

    It is the eigenvector of the greatest eigenvalue of Bar-Itzhack's symmetric matrix, exact to
    rounding everywhere. Source: Bar-Itzhack, "New method for extracting the quaternion from a
    rotation matrix", 2000.
    """
    # The symmetric matrix has the trace at its corner, the skew part next to it, and the symmetric
    # part below.
    m = np.asarray(matrix, np.float64)
    skew = np.array([m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]])
    symmetric = np.block(
        [
            [np.array([[np.trace(m)]]), skew[None]],
            [skew[:, None], m + m.T - np.trace(m) * np.eye(3)],
        ]
    )
    w, x, y, z = (float(value) for value in np.linalg.eigh(symmetric)[1][:, -1])
    if w >= 0.0:
        return (w, x, y, z)
    return (-w, -x, -y, -z)


TURN_STEP = 5.0
"""Degrees to which yaw, pitch and roll are rounded if light is baked for each turn.

A step moves the edge of a shadow by a twelfth of the distance that it is cast over. Each turn takes
a bake, so a drag by a quarter of a circle takes 18.
"""

Turn = tuple[float, float, float]
"""Yaw, pitch and roll of the light, degrees."""

NO_TURN: Turn = (0.0, 0.0, 0.0)


def angles_of(q: Quaternion) -> Turn:
    """Return yaw, pitch and roll of a unit quaternion, degrees, pitch within ±90 and the others
    within ±180: the inverse of ``quaternion_from_angles``.

    At pitch ±90 only the sum or the difference of yaw and roll is determined: roll is then 0.
    """
    w, x, y, z = q
    sine = min(1.0, max(-1.0, 2.0 * (w * y - x * z)))
    if abs(sine) > 1.0 - 1e-9:
        yaw = math.atan2(2.0 * (w * z - x * y), 1.0 - 2.0 * (x * x + z * z))
        return (math.degrees(yaw), math.copysign(90.0, sine), 0.0)
    yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    return (math.degrees(yaw), math.degrees(math.asin(sine)), math.degrees(roll))


def nearest_turn(q: Quaternion) -> Turn:
    """Return yaw, pitch and roll, in degrees, of a unit quaternion, a turn in the world; each is
    rounded by itself to a multiple of TURN_STEP.

    Angles that mean the same rotation become equal: at pitch ±90 roll is 0, and half a turn is 180.
    Of the turns by such angles, the result is not always the one nearest to the given turn.
    """
    yaw, pitch, roll = (TURN_STEP * round(angle / TURN_STEP) for angle in angles_of(q))
    # Rounding may reach the pole: only yaw - roll counts at pitch 90, and yaw + roll at -90.
    if abs(pitch) == 90.0:
        yaw -= roll * pitch / 90.0
        roll = 0.0
    # Bring angles into (-180, 180]; adding 0 turns -0 into 0.
    yaw, roll = (180.0 - (180.0 - angle) % 360.0 for angle in (yaw, roll))
    return (yaw + 0.0, pitch + 0.0, roll + 0.0)


def light_in_box(light: Quaternion, orientation: Orientation) -> Quaternion:
    """Convert a rotation of light in the world to the box: it is followed by the inverse of the
    box's rotation.
    """
    if orientation.turned:
        return quaternion_of(orientation.matrix.T @ rotation_matrix(light))
    return light


@dataclass(frozen=True)
class View:
    """The parameters of one frame.

    - ``isovalue``: in the units of the volume's file.
    - ``camera``, ``light``: in the volume's box; ``light`` rotates the environment.
      ``orientation``: place of the box in the world.
    - ``width``, ``height``: pixels.
    - ``shading``: one of VIEW_SHADINGS; ``samples``: least paths per pixel, of ``path_traced``
      alone.
    - ``albedo`` (linear RGB), ``shine``: of the surface; None for the scene's, see
      ``SceneSurfaces``.
    - ``glow``: brightness of glows over the scene's.
    - ``moving``: the picture is to come quickly, so that texels are not projected. ``smooth``:
      else, pixels at edges get more samples.
    - ``strip``: the picture is rows of a larger one: the first row there, and the number of rows of
      that picture. ``columns``: the same for columns.
    - ``window``: planes in the box that hide matter from the eye; None for none.
    """

    isovalue: float
    camera: Camera
    light: Quaternion = IDENTITY
    width: int = 512
    height: int = 512
    shading: str = "gi"
    samples: int = field(default=16)
    albedo: Vector | None = None
    moving: bool = field(default=False, repr=False)
    smooth: bool = False
    strip: tuple[int, int] | None = None
    columns: tuple[int, int] | None = None
    shine: Shine | None = field(default=None, repr=False)
    glow: float = field(default=1.0, repr=False)
    orientation: Orientation = field(default=PLAIN_ORIENTATION, repr=False)
    window: Window | None = field(default=None, repr=False)

    @property
    def whole(self) -> tuple[int, int]:
        """First row of this picture in the picture that its camera sees, and the number of rows
        of that picture.
        """
        return self.strip or (0, self.height)

    def pixel(self, column: int, row: int) -> "View":
        """Return the view of a single pixel of this picture, by the same ray."""
        first, rows = self.whole
        before, columns = self.columns or (0, self.width)
        strip = (first + row, rows)
        return replace(self, width=1, height=1, strip=strip, columns=(before + column, columns))

    def __post_init__(self) -> None:
        if not math.isfinite(self.isovalue):
            raise ViewError("The isovalue is not a finite number.")
        if self.width < 1 or self.height < 1:
            raise ViewError(
                f"A picture of {self.width} × {self.height} pixels is empty: ask for at "
                "least 1 × 1."
            )
        if self.shading not in VIEW_SHADINGS:
            raise ViewError(
                f"There is no shading '{self.shading}': choose one of {', '.join(VIEW_SHADINGS)}."
            )
        if self.samples < 1:
            raise ViewError("At least one sample per pixel is needed.")
