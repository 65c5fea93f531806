"""Carry light that was traced for the points of earlier views to another view of the same surface.

The surface reflects evenly to all sides, so the light of a point does not depend on the camera. A
pixel of another view takes over the paths of the nearest point that an earlier view has traced, if
both lie on one patch of the surface. On the way from one point to the other light is taken to
change evenly, by its slope in the picture of the earlier view; where the slope itself changes, as
at edges of shadows, no light is taken over. Control pixels measure the picture afterwards, so that
light which was carried too far shows as error.
"""

from dataclasses import dataclass
from itertools import accumulate
from typing import Any, Self

import numpy as np

from isogi_core.frame.gbuffer import numbered
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

FARTHEST = 2.0
FARTHEST_ASIDE = 0.5
"""Distance of two points, in pixels of the finer view, up to which one takes the other's light, and
the part of it along the normal. Points in one pixel are further apart than its side where the
surface is seen at a grazing angle.
"""

LEAST_COSINE = 0.95
"""Least cosine of the angle between the normals of two such points: 18 degrees."""

MOST_BENT = 1.0
"""Largest half of a bend, times the distance in pixels, over which light is carried, in target
errors: the error if the slope of light changes at the point; most errors are far smaller. With this
bound carried light of the engine, CT head, carp and bonsai has the error of light that was traced
for the same points.
"""

DIRECTIONS = ((0, 1), (1, 0), (1, 1), (1, -1))
"""Lines and columns from a pixel to four of the eight around it; the others lie opposite these."""


@dataclass(frozen=True, eq=False)
class TracedPoints:
    """Points of a ``view`` whose light was traced.

    - ``rows`` (height, width) int32: number of the point that a pixel shows, -1 if it has none.
    - ``points``, ``normals`` (k, 3) float32: their positions in the volume's box, and outward
      normals.
    - ``estimate``: sums of their paths; ``expected`` (k,): expected errors of the texels there.
    - ``shares`` (k,): shares of their light that were shown: below 1 in the rim of the chosen
      points, in which traced light fades out.
    - ``slopes`` (k, 2, 3): change of their light from a column and from a line to the next one.
    - ``bends`` (k,): largest relative change of slopes: see ``Neighbours.bends``.
    """

    view: View
    rows: np.ndarray
    points: np.ndarray
    normals: np.ndarray
    estimate: Estimate
    expected: np.ndarray
    shares: np.ndarray
    slopes: np.ndarray
    bends: np.ndarray

    @classmethod
    def of(cls, shot: Shot, own: PixelLight, carried: np.ndarray) -> Self:
        """Return the points of a ``shot`` whose ``own`` light was traced for themselves: all but
        the ``carried`` ones (rows of the G-buffer). Raises Cancelled.
        """
        gbuffer = shot.gbuffer
        traced = ~np.isin(own.places, carried, assume_unique=True)
        # See how light changes in the picture: carried light counts here, too.
        pixels = gbuffer.pixels[own.places]
        around = Neighbours(numbered(pixels, gbuffer.shape), own.light, pixels[traced])
        places = own.places[traced]
        return cls(
            shot.view,
            numbered(pixels[traced], gbuffer.shape),
            gbuffer.points[places] * np.array(gbuffer.spacing, np.float32),
            gbuffer.normals(shot.tiles)[places],
            own.estimate.part(traced),
            own.expected[places],
            np.broadcast_to(own.shares, own.places.shape)[traced],
            around.slopes.astype(np.float32),
            around.bends.astype(np.float32),
        )

    @property
    def nbytes(self) -> int:
        """The size of its arrays in bytes."""
        geometry = (self.rows, self.points, self.normals)
        light = (self.expected, self.shares, self.slopes, self.bends)
        return self.estimate.nbytes + sum(each.nbytes for each in (*geometry, *light))

    def pairs(self, shot: Shot, points: np.ndarray, pixel_sides: np.ndarray) -> "Pairs":
        """Match points of another ``shot`` with those that were traced for the pixels of this view
        in which they lie; return those whose light they may take over. Raises Cancelled.

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
        # The point traced there may lie far before or behind: take its light only if both lie on
        # one patch of the surface, and face the same way.
        finer = np.minimum(depths * self.view.camera.pixel_size(height), pixel_sides)[places]
        ways = points[places] - self.points[numbers]
        away = np.linalg.norm(ways, axis=1) / finer
        aside = np.abs((ways * self.normals[numbers]).sum(axis=1)) / finer
        normals = shot.gbuffer.normals(shot.tiles)
        cosines = (normals[places] * self.normals[numbers]).sum(axis=1)
        near = (away <= FARTHEST) & (aside <= FARTHEST_ASIDE) & (cosines >= LEAST_COSINE)
        # Carry light along its slope, from the middle of the pixel. On either side the slope may
        # differ from it by half the bend. Leave out points at edges of shadows, where bends are
        # large, and at the rim of the known pixels, where they are infinite, at any distance.
        offsets = np.column_stack([columns, lines])[places] % 1.0 - 0.5
        distances = np.maximum(np.linalg.norm(offsets, axis=1), np.finfo(np.float64).tiny)
        near &= self.bends[numbers] / 2.0 * distances <= MOST_BENT * shot.goal.error
        numbers = numbers[near]
        changes = np.einsum("kd,kdc->kc", offsets[near], self.slopes[numbers])
        return Pairs(places[near], numbers, away[near], changes)


@dataclass(frozen=True, eq=False)
class Pairs:
    """Points of a shot, and those of an earlier view whose light they may take over.

    - ``places`` (j,): rows of the shot's points, ascending; ``numbers`` (j,): of the earlier ones.
    - ``away`` (j,): their distances in pixels of the finer view.
    - ``changes`` (j, 3): expected change of light on the way, linear RGB.
    """

    places: np.ndarray
    numbers: np.ndarray
    away: np.ndarray
    changes: np.ndarray


@dataclass(frozen=True, eq=False)
class TracedLight:
    """The points of earlier ``views`` of a surface under one light, the newest first."""

    views: tuple[TracedPoints, ...]

    @property
    def nbytes(self) -> int:
        """The size of its arrays in bytes."""
        return sum(each.nbytes for each in self.views)

    def joined(self, newest: TracedPoints) -> "TracedLight":
        """Return this light with the points of the ``newest`` view first. If there are points of
        the same view, as at another target, the larger set of both is kept. At most MOST_VIEWS
        views and MOST_BYTES are kept, the first view in any case.
        """
        others = []
        for each in self.views:
            if each.view != newest.view:
                others.append(each)
            elif len(each.points) > len(newest.points):
                newest = each
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
        # Go through the views, and take for each point the paths of the nearest point, and the
        # change of light from there.
        for each in self.views:
            pairs = each.pairs(shot, points, pixel_sides)
            nearer = pairs.away < nearest[pairs.places]
            places = pairs.places[nearer]
            numbers = pairs.numbers[nearer]
            nearest[places] = pairs.away[nearer]
            counts[places] = each.estimate.counts[numbers]
            changes = counts[places, None] * pairs.changes[nearer]
            sums[places] = each.estimate.sums[numbers] + changes[:, None]
            expected[places] = each.expected[numbers]
            shares[places] = each.shares[numbers]
        found = np.flatnonzero(nearest < np.inf)
        if not len(found):
            return PixelLight.none()
        # Filter the light as if its paths had been traced for these points.
        paths = paths_of_truth(shot.light, gbuffer, found, shot.tiles)
        estimate = Estimate(sums, counts).part(found)
        return PixelLight.of(found, estimate, paths, expected, shares[found])


class Neighbours:
    """The light of the eight pixels around each of some ``pixels`` (j,), numbered along the lines.

    ``numbers`` (height, width) has the row of each pixel in ``light`` (k, 3), -1 if it has none.
    """

    def __init__(self, numbers: np.ndarray, light: np.ndarray, pixels: np.ndarray) -> None:
        self._numbers = np.pad(numbers, 1, constant_values=-1)
        # The last row, number -1, stands for pixels without light.
        self._light = np.vstack([light, np.full((1, 3), np.nan)])
        self._lines, self._columns = np.divmod(pixels.astype(np.int64), numbers.shape[1])

    def at(self, dy: int, dx: int) -> np.ndarray:
        """Return the light of the pixels so many lines and columns away, at most one; (j, 3), NaN
        if there is none.
        """
        rows = self._numbers[self._lines + 1 + dy, self._columns + 1 + dx]
        return np.asarray(self._light[rows])

    @property
    def slopes(self) -> np.ndarray:
        """Half the difference of light from the left to the right neighbour of each pixel, and from
        the upper to the lower one; (j, 2, 3), NaN if one has no light.
        """
        across = self.at(0, 1) - self.at(0, -1)
        down = self.at(1, 0) - self.at(-1, 0)
        return np.asarray(np.stack([across, down], axis=1) / 2.0)

    @property
    def bends(self) -> np.ndarray:
        """The largest second difference of light in the four directions through each pixel, in any
        colour, relative to the luminance of the pixel; (j,).

        It is for steps as long as the side of a pixel: those along diagonals count half, as where
        light curves smoothly, so that a sharp change of slope across a diagonal is taken for 1/√2
        of what it is. It is infinite if one of the eight neighbours has no light.
        """
        here = self.at(0, 0)
        worst = np.zeros(len(here))
        for dy, dx in DIRECTIONS:
            bent = self.at(dy, dx) + self.at(-dy, -dx) - 2.0 * here
            worst = np.maximum(worst, np.abs(bent).max(axis=1) / (dy**2 + dx**2))
        worst /= np.maximum(here @ LUMINANCE_WEIGHTS, np.finfo(np.float64).tiny)
        return np.nan_to_num(worst, nan=np.inf, posinf=np.inf)


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
