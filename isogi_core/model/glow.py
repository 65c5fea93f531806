"""Glow: parts of the volume that give off light and block none, read from ``[[glow]]`` tables."""

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from isogi_core.errors import SceneError
from isogi_core.files.scene_file import (
    TableReaders,
    are_numbers,
    is_number,
    read_colour,
    read_name,
    read_table,
)
from isogi_core.files.spelling import shortest
from isogi_core.files.vector import Vector, triple
from isogi_core.model.lights import LARGEST_LIGHT, Colour
from isogi_core.model.volume import Volume

MOST_GLOWS = 8
"""Most tables of a scene: every ray tests each of them."""

ALL_VALUES = (-math.inf, math.inf)
"""The range of all values."""

NO_BITS = np.zeros((0, 0, 0), np.uint8)
"""The mask bits of a scene in which no glow has a mask."""

REGION_ROUNDING = 1e-9
"""Share of the volume's radius by which a region may reach out of its box, for rounding."""


@dataclass(frozen=True)
class Glow:
    """A part of the volume that gives off ``radiance``, linear RGB: that of a ray which passes it
    over its mean chord.

    - ``box``: two opposite corners in the world; the edges lie along the volume's axes. ``sphere``:
      world x, y, z and radius. Without either the region is the volume's box.
    - ``values``: range of the file's values that glow within the region.
    - ``mask``: file of a volume outside of which nothing glows; ``labels``: the values in it that
      are inside, by default all but 0.

    Raises SceneError if these do not go together.
    """

    radiance: Colour = (1.0, 1.0, 1.0)
    box: tuple[Vector, Vector] | None = None
    sphere: tuple[float, float, float, float] | None = None
    values: tuple[float, float] = ALL_VALUES
    mask: str = ""
    labels: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if self.box is not None and self.sphere is not None:
            raise SceneError("A glow has a box and a sphere: give one of them.")
        if self.box is None and self.sphere is None and self.values == ALL_VALUES and not self.mask:
            raise SceneError(
                "A glow has no place: give it a box, a sphere, a range of values or a mask."
            )
        if self.labels and not self.mask:
            raise SceneError(
                "A glow has labels and no mask: add mask, the file that they are in, or leave "
                "them out."
            )
        if not all(0.0 <= light <= LARGEST_LIGHT for light in self.radiance):
            given = ", ".join(f"{light:g}" for light in self.radiance)
            raise SceneError(
                f"A glow's radiance is {given}: it must be from 0 to {LARGEST_LIGHT:g}."
            )
        if self.sphere is not None and not self.sphere[3] > 0.0:
            raise SceneError(
                f"A glow's sphere has the radius {self.sphere[3]:g}: give it one above 0."
            )
        if self.box is not None and any(a == b for a, b in zip(*self.box, strict=True)):
            raise SceneError(
                "A glow's box has no volume: give two opposite corners that differ in x, y and z."
            )

    def place(
        self, volume: Volume, within: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the middle and half edges of the glow in the box of a ``volume``, (3,) each.

        Without a box and a sphere the region lies between the opposite corners ``within`` (2, 3),
        in voxels; by default it is the volume's box. Raises SceneError if the region reaches out of
        it.
        """
        orientation = volume.orientation
        extent = np.array(volume.extent)
        # Spheres and boxes are given in the world; the region of a mask in voxels.
        if self.sphere is not None:
            middle = np.array(orientation.point_to_box(triple(self.sphere[:3])))
            half = np.full(3, self.sphere[3])
        elif self.box is not None:
            corners = np.array([orientation.point_to_box(corner) for corner in self.box])
            middle = corners.mean(axis=0)
            half = np.abs(corners[1] - corners[0]) / 2.0
        elif within is not None:
            low, high = within * volume.spacing
            middle = (low + high) / 2.0
            half = (high - low) / 2.0
        else:
            middle = extent / 2.0
            half = extent / 2.0
        # Rays gather glow only within the volume's box, so a region must not reach out of it.
        if (
            np.abs(middle - extent / 2.0) + half > extent / 2.0 + REGION_ROUNDING * volume.radius
        ).any():
            low, high = (
                "[" + ", ".join(f"{x:g}" for x in corner) + "]" for corner in volume.world_bounds
            )
            raise SceneError(
                f"A glow reaches out of the volume's box, {low} to {high}: move it, or make it "
                "smaller."
            )
        return middle, half


@dataclass(frozen=True, eq=False)
class Glowing:
    """The ``glows`` of a scene in the box of its volume.

    - ``middles`` (k, 3); ``halves`` (k, 3): half edges, or radii of balls.
    - ``ranges`` (k, 2): values of the voxels that glow; -inf to inf for all.
    - ``bits``: uint8 of the volume's shape. Bit k of a voxel is set if it is in the mask of glow k.
      Empty if no glow has a mask.
    """

    glows: tuple[Glow, ...]
    middles: np.ndarray
    halves: np.ndarray
    ranges: np.ndarray
    bits: np.ndarray = field(default_factory=lambda: NO_BITS)

    @property
    def any(self) -> bool:
        """True if anything glows."""
        return bool(self.glows)

    @property
    def round(self) -> np.ndarray:
        """True for each glow that is a ball, (k,) bool."""
        return np.array([glow.sphere is not None for glow in self.glows], bool)

    @property
    def masked(self) -> np.ndarray:
        """True for each glow that has a mask, (k,) bool."""
        return np.array([bool(glow.mask) for glow in self.glows], bool)

    @property
    def radiances(self) -> np.ndarray:
        """Radiance of each glow, linear RGB, (k, 3)."""
        return np.array([glow.radiance for glow in self.glows], np.float64).reshape(-1, 3)

    @property
    def chords(self) -> np.ndarray:
        """Mean chord of each glow: 4 V / S of a convex body (Cauchy 1841), 4 r / 3 of a ball;
        (k,) world units.
        """
        x, y, z = self.halves.T
        return np.where(
            self.round, 4.0 / 3.0 * x, 4.0 * x * y * z / np.maximum(x * y + y * z + z * x, 1e-300)
        )

    @property
    def radii(self) -> np.ndarray:
        """Radii of the balls around the glows, (k,)."""
        return np.where(self.round, self.halves[:, 0], np.linalg.norm(self.halves, axis=1))

    def seen_from(self, distance: float) -> np.ndarray:
        """Return E/π of all glows together on a surface that faces them at a ``distance``,
        linear RGB, (3,): L S / (4 π d²).
        """
        x, y, z = self.halves.T
        areas = np.where(self.round, 4.0 * math.pi * x**2, 8.0 * (x * y + y * z + z * x))
        return np.asarray((areas / (4.0 * math.pi * distance**2)) @ self.radiances)

    @cached_property
    def digest(self) -> str:
        """Hex digest of the places of glows, without their colours and strengths."""
        places = [
            self.middles.tolist(),
            self.halves.tolist(),
            self.round.tolist(),
            self.ranges.tolist(),
        ]
        # Parts that a scene does not have are left out, so that digests of other scenes stay as
        # they are.
        if self.masked.any():
            places += [self.masked.tolist()]
        # Within a range of values, glow changes evenly between the steps along a ray.
        if np.isfinite(self.ranges).any():
            places += ["even"]
        found = hashlib.blake2b(repr(places).encode(), digest_size=16)
        found.update(np.ascontiguousarray(self.bits).data)
        return found.hexdigest()


NO_GLOW = Glowing((), np.empty((0, 3)), np.empty((0, 3)), np.empty((0, 2)))


def place_glows(glows: Sequence[Glow], volume: Volume, bits: np.ndarray = NO_BITS) -> Glowing:
    """Place ``glows`` of the world in a ``volume``; ``bits`` are those of ``Glowing`` for their
    masks.

    Raises SceneError if there are too many, one reaches out of the volume, or nothing is in its
    mask.
    """
    if len(glows) > MOST_GLOWS:
        raise SceneError(f"The scene has {len(glows)} glows: give it at most {MOST_GLOWS}.")
    if not glows:
        return NO_GLOW
    # The region of a mask is the box around it, so that rays skip the rest.
    boxes = [_box_of(glow.mask, bits, k) if glow.mask else None for k, glow in enumerate(glows)]
    places = [glow.place(volume, box) for glow, box in zip(glows, boxes, strict=True)]
    middles, halves = (np.array(each) for each in zip(*places, strict=True))
    return Glowing(
        tuple(glows),
        middles,
        halves,
        np.array([_range_of_voxels(glow.values, volume) for glow in glows]),
        bits,
    )


def _box_of(mask: str, bits: np.ndarray, number: int) -> np.ndarray:
    """Return opposite corners (2, 3), x, y, z in voxels, of the box around the voxels in the mask
    of glow ``number``.

    A voxel reaches half a voxel to each side, but not out of the volume. Raises SceneError if the
    mask is empty.
    """
    # Project the mask onto the three axes, and take the first and last voxel along each.
    there = [(layer >> number) & 1 == 1 for layer in bits]
    planes = np.logical_or.reduce(there)
    sides = planes.any(axis=0), planes.any(axis=1), np.array([layer.any() for layer in there])
    if not sides[2].any():
        raise SceneError(
            f"No voxel of the volume is in the glow's mask '{mask}': check its labels, and "
            "where it lies."
        )
    spans = [np.flatnonzero(side)[[0, -1]] + [-0.5, 0.5] for side in sides]
    return np.array(
        [np.clip(span, 0.0, len(side) - 1.0) for span, side in zip(spans, sides, strict=True)]
    ).T


def _range_of_voxels(values: tuple[float, float], volume: Volume) -> tuple[float, float]:
    """Convert a range of the file's values to the units of a volume's voxels, the least first.

    Ends may lie outside the volume's values. Raises SceneError if the range lies wholly below or
    above these.
    """
    # An infinite range stays so: kernels take it as no range.
    if values == ALL_VALUES:
        return ALL_VALUES
    low, high = volume.value_range
    if values[0] > high or values[1] < low:
        raise SceneError(
            f"A glow's values are {shortest(values[0])} to {shortest(values[1])}, and the volume's "
            f"{shortest(low)} to {shortest(high)}: no voxel glows."
        )
    least, greatest = volume.normalise_span(*values)
    return float(least), float(greatest)


def glow_from_mapping(table: Mapping[str, Any]) -> Glow:
    """Read the glow of one ``[[glow]]`` table. Raises SceneError if a key is unknown or a value
    has no meaning.
    """
    return Glow(**read_table(table, "A glow", GLOW_READERS))


def _box(name: str, value: Any) -> tuple[Vector, Vector]:
    """Read two corners."""
    if (
        not isinstance(value, list)
        or len(value) != 2
        or not all(are_numbers(corner, 3) for corner in value)
    ):
        raise SceneError(f"{name} is {value!r}: give two opposite corners, [[x, y, z], [x, y, z]].")
    return triple(value[0]), triple(value[1])


def _sphere(name: str, value: Any) -> tuple[float, float, float, float]:
    """Read a middle and a radius."""
    if not are_numbers(value, 4):
        raise SceneError(f"{name} is {value!r}: give its middle and radius, [x, y, z, radius].")
    x, y, z, radius = (float(number) for number in value)
    return x, y, z, radius


def _values(name: str, value: Any) -> tuple[float, float]:
    """Read two ascending values."""
    if not are_numbers(value, 2) or value[0] > value[1]:
        raise SceneError(f"{name} are {value!r}: give the least and the greatest, [low, high].")
    return float(value[0]), float(value[1])


def _labels(name: str, value: Any) -> tuple[float, ...]:
    """Read a list of values in a mask."""
    if not isinstance(value, list) or not value or not all(map(is_number, value)):
        raise SceneError(f"{name} are {value!r}: give a list of the mask's values.")
    return tuple(float(label) for label in value)


GLOW_READERS: TableReaders = {
    **{"box": _box, "sphere": _sphere, "values": _values, "mask": read_name, "labels": _labels},
    "radiance": read_colour,
}
"""Readers of the keys of a ``[[glow]]`` table."""
