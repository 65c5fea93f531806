"""Carry light that was traced for the points of earlier views to another view of the same surface.

The surface reflects evenly to all sides, so the light of a point does not depend on the camera. A
pixel of another view takes over the paths of the nearest point that an earlier view has traced, if
that point is less than about a pixel away, and light changes little on the way. Control pixels
measure the picture afterwards, so that light which was carried too far shows as error.
"""

from dataclasses import dataclass
from itertools import accumulate, product
from typing import Any, Self

import numpy as np

from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.rays.control_pixels import paths_of_truth
from isogi_core.frame.rays.own_light import REPLICAS, PixelLight
from isogi_core.frame.rays.point_paths import Estimate
from isogi_core.frame.shot import Shot
from isogi_core.model.environment import LUMINANCE_WEIGHTS
from isogi_core.model.view import View

MOST_VIEWS = 8
MOST_BYTES = 64 << 20
"""Number of earlier views whose points are kept, and the bytes that they may take."""

FARTHEST = 1.0
"""Distance of two points, in pixels of the finer view, up to which one takes the other's light."""

LEAST_COSINE = 0.95
"""Least cosine of the angle between the normals of two such points: 18 degrees."""

LEAST_NEIGHBOURS = 6
"""Number of a pixel's eight neighbours whose light must be known to tell how light changes."""

MOST_CHANGE = 2.5
"""Largest relative change of light from one point to the other, in target errors: most changes are
far smaller, and only a part of the pixels takes light over.
"""


@dataclass(frozen=True, eq=False)
class TracedPoints:
    """Points of a ``view`` whose light was traced.

    - ``rows`` (height, width) int32: number of the point that a pixel shows, -1 if it has none.
    - ``points``, ``normals`` (k, 3) float32: their positions in the volume's box, and outward
      normals.
    - ``estimate``: sums of their paths; ``expected`` (k,): expected errors of the texels there.
    - ``shares`` (k,): shares of their light that were shown: below 1 in the rim of the chosen
      points, in which traced light fades out.
    - ``changes`` (k,): largest relative change of light to a neighbouring pixel.
    """

    view: View
    rows: np.ndarray
    points: np.ndarray
    normals: np.ndarray
    estimate: Estimate
    expected: np.ndarray
    shares: np.ndarray
    changes: np.ndarray

    @classmethod
    def of(cls, shot: Shot, own: PixelLight, carried: np.ndarray) -> Self:
        """Return the points of a ``shot`` whose ``own`` light was traced for themselves: all but
        the ``carried`` ones (rows of the G-buffer). Raises Cancelled.
        """
        gbuffer = shot.gbuffer
        traced = ~np.isin(own.places, carried, assume_unique=True)
        places = own.places[traced]
        rows = np.full(gbuffer.shape, -1, np.int32)
        rows.reshape(-1)[gbuffer.pixels[places]] = np.arange(len(places), dtype=np.int32)
        return cls(
            shot.view,
            rows,
            gbuffer.points[places] * np.array(gbuffer.spacing, np.float32),
            gbuffer.normals(shot.tiles)[places],
            own.estimate.part(traced),
            own.expected[places],
            np.broadcast_to(own.shares, own.places.shape)[traced],
            changes_by_pixel(rows, own.light[traced] @ LUMINANCE_WEIGHTS),
        )

    @property
    def nbytes(self) -> int:
        """The size of its arrays in bytes."""
        arrays = (self.rows, self.points, self.normals, self.expected, self.shares, self.changes)
        return self.estimate.nbytes + sum(each.nbytes for each in arrays)

    def pairs(
        self, shot: Shot, points: np.ndarray, pixel_sides: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Match points of another ``shot`` with those that were traced for the pixels of this view
        in which they lie. Return the rows of those that may take over light, ascending, the numbers
        of the points whose light they take, and their distances in pixels of the finer view; (j,)
        each. Raises Cancelled.

        ``points`` (m, 3) are the positions of the shot's points in the volume's box, and
        ``pixel_sides`` (m,) the lengths of the sides of its pixels there.
        """
        # Find the pixel of this view in which each point lies, and the point that was traced there.
        columns, lines, depths = project(self.view, points)
        height, width = self.rows.shape
        seen = (columns >= 0) & (columns < width) & (lines >= 0) & (lines < height) & (depths > 0)
        places = np.flatnonzero(seen)
        numbers = self.rows[lines[places].astype(np.int64), columns[places].astype(np.int64)]
        places = places[numbers >= 0]
        numbers = numbers[numbers >= 0]
        # The point traced there may lie far before or behind: take its light only if both are about
        # a pixel apart, and face the same way.
        finer = np.minimum(depths * self.view.camera.pixel_size(height), pixel_sides)
        away = np.linalg.norm(points[places] - self.points[numbers], axis=1) / finer[places]
        normals = shot.gbuffer.normals(shot.tiles)
        cosines = (normals[places] * self.normals[numbers]).sum(axis=1)
        near = (away <= FARTHEST) & (cosines >= LEAST_COSINE)
        # Leave out points at edges of shadows, where light changes within a part of a pixel, and
        # those at the rim of the traced pixels, whose changes are unknown and thus infinite, at any
        # distance.
        least = np.finfo(np.float64).tiny
        near &= self.changes[numbers] * np.maximum(away, least) <= MOST_CHANGE * shot.goal.error
        return places[near], numbers[near], away[near]


@dataclass(frozen=True, eq=False)
class TracedLight:
    """The points of earlier ``views`` of a surface under one light, the newest first."""

    views: tuple[TracedPoints, ...]

    @property
    def nbytes(self) -> int:
        """The size of its arrays in bytes."""
        return sum(each.nbytes for each in self.views)

    def joined(self, newest: TracedPoints) -> "TracedLight":
        """Return this light with the points of the ``newest`` view, which replace older ones of the
        same view. At most MOST_VIEWS views and MOST_BYTES are kept, and the newest in any case.
        """
        others = [each for each in self.views if each.view != newest.view]
        # Keep the newest views whose sizes together are within the limit.
        sizes = accumulate((each.nbytes for each in others), initial=newest.nbytes)
        next(sizes)
        kept = [each for each, size in zip(others, sizes, strict=True) if size <= MOST_BYTES]
        return TracedLight((newest, *kept[: MOST_VIEWS - 1]))

    def carried_to(self, shot: Shot, uncertainty: np.ndarray) -> PixelLight:
        """Return the light that points of a ``shot`` take over, each from the nearest point of all
        views; light of no points if none is near. Raises Cancelled.

        ``uncertainty`` (m,) of the texels' luminance at the shot's points stands for the expected
        error of those that take over none.
        """
        gbuffer = shot.gbuffer
        view = shot.view
        points = gbuffer.points * np.array(gbuffer.spacing)
        pixel_sides = project(view, points)[2] * view.camera.pixel_size(view.height)
        m = len(points)
        nearest = np.full(m, np.inf)
        sums = np.zeros((m, REPLICAS, 3))
        counts = np.zeros(m, np.int64)
        expected = np.array(uncertainty, np.float64)
        shares = np.ones(m)
        # Go through the views, and take for each point the paths of the nearest point.
        for each in self.views:
            places, numbers, away = each.pairs(shot, points, pixel_sides)
            nearer = away < nearest[places]
            places = places[nearer]
            numbers = numbers[nearer]
            nearest[places] = away[nearer]
            sums[places] = each.estimate.sums[numbers]
            counts[places] = each.estimate.counts[numbers]
            expected[places] = each.expected[numbers]
            shares[places] = each.shares[numbers]
        found = np.flatnonzero(nearest < np.inf)
        if not len(found):
            return PixelLight.none()
        # Filter the light as if its paths had been traced for these points.
        paths = paths_of_truth(shot.light, gbuffer, found, shot.tiles)
        estimate = Estimate(sums, counts).part(found)
        return PixelLight.of(found, estimate, paths, expected, shares[found])


def changes_by_pixel(rows: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the largest difference of each of the ``values`` (k,) from those of the eight pixels
    around it, relative to the value; (k,).

    It is infinite if fewer than LEAST_NEIGHBOURS of these have a value, as at the rim of the pixels
    that were traced. ``rows`` (height, width) has the number of each pixel's value, -1 if it has
    none.
    """
    worst = np.zeros(len(values))
    neighbours = np.zeros(len(values), np.int64)
    padded = np.pad(rows, 1, constant_values=-1)
    height, width = rows.shape
    for dy, dx in product((-1, 0, 1), repeat=2):
        other = padded[1 + dy : 1 + dy + height, 1 + dx : 1 + dx + width]
        both = (rows >= 0) & (other >= 0)
        here = rows[both]
        worst[here] = np.maximum(worst[here], np.abs(values[here] - values[other[both]]))
        neighbours[here] += 1
    # A pixel was counted as a neighbour of itself.
    worst[neighbours <= LEAST_NEIGHBOURS] = np.inf
    return worst / np.maximum(values, np.finfo(np.float64).tiny)


def project(view: View, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the columns and lines at which a ``view`` shows ``points`` (m, 3) of the volume's box,
    in pixels from the upper left corner, and their depths; (m,) each.

    A depth is the component of the way from the eye to the point along the viewing direction, in
    lengths of the box; it is not positive for points behind the eye, whose columns and lines mean
    nothing.
    """
    right, up, forward = view.camera.basis()
    offsets = points - np.array(view.camera.eye)
    depths = offsets @ forward
    scale = 1.0 / (np.where(depths > 0.0, depths, np.inf) * view.camera.pixel_size(view.height))
    columns = view.width / 2.0 + offsets @ right * scale
    lines = view.height / 2.0 - offsets @ up * scale
    return columns, lines, depths


def carried_key(light: RotatedLight) -> tuple[Any, ...] | None:
    """Return the cache key of the light of a surface's points: all that it depends on. None if the
    picture is a part of a larger one, or if light depends on the direction to the eye.
    """
    view = light.view
    if view.strip is not None or view.columns is not None or light.shine is not None:
        return None
    return "TracedLight", view.isovalue, view.window, view.light, view.albedo, view.glow
