"""Texels of a view: the chunks that its surface touches, and the texels that its pixels read."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from isogi_core.bake.bake_spec import spec_name
from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.shading.chunks import (
    add_footprints,
    find_coarse_corners,
    find_corners,
    find_places,
    mark_texels,
    touch_chunks,
    weigh_chunks,
)
from isogi_core.kernels.shading.filtering import Numbering
from isogi_core.kernels.shading.framebuffer import Framebuffer
from isogi_core.kernels.shading.lattice import Lattice
from isogi_core.model.view import View
from isogi_core.plan.scene import Scene
from isogi_core.prepared.prepared_scene import Index, PreparedScene

LEAST_SEEN = 1 / 16
"""Least footprint of a texel, as a share of the mean."""


READ = 3.0
"""Number of texels that a view reads for each square of the lattice on a surface."""


EACH = 16
"""Step, in surface points, between the pairs of points by which the area of a pixel is
estimated.
"""


PAIRED = 17.0 / 8.0
"""Factor on the variance of a texel in the pixels of a ``coarse`` view, in the mean.

There, two texels stand for the eight corners of a cell, and add up their trilinear weights: over a
cell the squares of these sums are 17/27 in the mean, those of the weights themselves (2/3)³.
"""


@dataclass(frozen=True, eq=False)
class ViewTexels:
    """The texels of a ``lattice`` that the points of a G-buffer read, numbered 0 … m - 1, chunk by
    chunk.

    - ``chunks``: indices of the chunks that are touched.
    - ``places`` (m,) uint32: texel t is at i · texels of a chunk + offset, if it lies in chunk i.
    - ``bounds`` (chunks + 1,): texels of chunk i are ``bounds[i]`` … ``bounds[i + 1]``.
    - ``corners`` (points, 8) uint32: numbers of the texels around each point.
    - ``numbering``: tables that find the number of a texel by its place.
    - ``coarse``: True if only ``first_texels`` are read, which stand for their neighbours.
    """

    gbuffer: GBuffer
    lattice: Lattice
    chunks: tuple[Index, ...]
    places: np.ndarray
    bounds: np.ndarray
    corners: np.ndarray
    numbering: Numbering
    coarse: bool = False

    @property
    def nbytes(self) -> int:
        """The size of its arrays in bytes, without the G-buffer; arrays that are found later
        are counted before.
        """
        numbering = sum(each.nbytes for each in self.numbering)
        return 6 * self.places.nbytes + self.bounds.nbytes + self.corners.nbytes + numbering

    def numbers(self, places: np.ndarray) -> np.ndarray:
        """Return the numbers in the whole lattice of texels at some ``places`` (k,); (k,)
        uint64.
        """
        bits = 3 * self.lattice.bits
        chunks = np.array(self.chunks, np.int64).reshape(-1, 3)
        first = np.asarray(np.ravel_multi_index(tuple(chunks.T), self.lattice.chunks)) << bits
        return (first[places >> bits] + places % self.lattice.texels).astype(np.uint64)

    @cached_property
    def positions(self) -> np.ndarray:
        """Lattice indices of the texels, (m, 3; z, y, x) int32."""
        return self.positions_of(self.places)

    def positions_of(self, places: np.ndarray) -> np.ndarray:
        """Return the lattice indices of texels at some ``places`` (k,), (k, 3; z, y, x) int32."""
        chunks = np.array(self.chunks, np.int32).reshape(-1, 3) * self.lattice.chunk
        bits = self.lattice.bits
        side = self.lattice.chunk - 1
        inside = np.stack([places >> bits * axis & side for axis in (2, 1, 0)], axis=-1).astype(
            np.int32
        )
        return chunks[places >> 3 * bits] + inside

    @cached_property
    def offsets(self) -> tuple[np.ndarray, ...]:
        """The offset of each texel in its chunk, int32: an array for each chunk, of its texels."""
        offsets = (self.places % self.lattice.texels).astype(np.int32)
        return tuple(offsets[a:b] for a, b in pairwise(self.bounds.tolist()))

    @cached_property
    def footprints(self) -> tuple[np.ndarray, ...]:
        """The weight of each texel's variance in the sum of the variances of all pixels, float32:
        an array for each chunk, of its texels.

        It is the sum of the squares of the texel's weights in them, see ``add_footprints``, and at
        least LEAST_SEEN of the mean: texels that are hardly seen are to become final, too.
        """
        seen = np.zeros(len(self.places))
        add_footprints(self.lattice, self.gbuffer.points, self.corners, seen)
        seen = np.maximum(seen, LEAST_SEEN * seen.mean()).astype(np.float32)
        return tuple(seen[a:b] for a, b in pairwise(self.bounds.tolist()))

    def weights(self, framebuffer: Framebuffer) -> np.ndarray:
        """Return the squared visible error that the pixels of a picture have left in each
        chunk, see ``weigh_chunks``; (chunks,).
        """
        weight = np.zeros(len(self.chunks))
        height, width = self.gbuffer.shape
        weigh_chunks(
            self.lattice,
            self.corners,
            self.places,
            self.gbuffer.pixels,
            width,
            height,
            framebuffer,
            weight,
        )
        return weight


def reads_coarsely(view: View, gbuffer: GBuffer, lattice: Lattice) -> bool:
    """Return True if a ``view`` is to read coarse texels alone: it moves, and would read more
    texels than it has surface points.
    """
    if not view.moving:
        return False
    # Take the squared distance between points in horizontally neighbouring pixels for the area of a
    # pixel on the surface, in squares of the lattice. The median leaves out the steps across
    # outlines. Each square has READ texels about it.
    are_neighbours = gbuffer.pixels[1::EACH] - gbuffer.pixels[:-1:EACH] == 1
    steps = gbuffer.points[1::EACH] - gbuffer.points[:-1:EACH]
    areas = ((steps * np.array(lattice.density, np.float32)) ** 2).sum(axis=1)[are_neighbours]
    return len(areas) > 0 and READ * float(np.median(areas)) > 1.0


def find_texels(
    gbuffer: GBuffer, prepared: PreparedScene, tiles: Tiles, coarse: bool = False
) -> ViewTexels:
    """Find the texels around every surface point of ``gbuffer``, or ``coarse`` ones alone, and
    number them. Raises Cancelled.
    """
    points = gbuffer.points
    lattice = prepared.lattice
    piece = tiles.even(len(points))
    share = tiles.even(len(points), 1)

    def _over_points(
        kernel: Callable[..., None], size: int, each: Callable[[int, int], tuple[Any, ...]]
    ) -> None:
        tiles.run(lambda a, b: kernel(lattice, points[a:b], *each(a, b)), len(points), size)

    # Mark the chunks that points touch, and give each a slot.
    touched = np.zeros(prepared.chunks, np.bool_)
    _over_points(touch_chunks, piece, lambda a, b: (coarse, touched))
    indices = np.argwhere(touched)
    slots = np.full(prepared.chunks, -1, np.int32)
    slots[touched] = np.arange(len(indices))
    # Mark the texels of these chunks that points read, one bit each. Threads mark rows of their
    # own, which are joined then: two of them never write to one word.
    marks = np.zeros((-(-len(points) // share), len(indices) * lattice.rows), np.uint32)
    _over_points(mark_texels, share, lambda a, b: (coarse, slots, marks[a // share]))
    read = np.bitwise_or.reduce(marks, axis=0)
    # Number the texels: a running sum of the bits that are set in the words before.
    first = np.zeros(len(read) + 1, np.uint32)
    np.cumsum(np.bitwise_count(read), out=first[1:])
    # List the place of each texel, and the numbers of the eight around each point.
    places = np.empty(first[-1], np.uint32)
    tiles.run(
        lambda a, b: find_places(lattice, a, b, read, first, places),
        len(read),
        tiles.even(len(read)),
    )
    corners = np.empty((len(points), 8), np.uint32)
    if coarse:
        find = find_coarse_corners
    else:
        find = find_corners
    _over_points(find, piece, lambda a, b: (slots, read, first, corners[a:b]))
    chunks = tuple((z, y, x) for z, y, x in indices.tolist())
    numbering = Numbering(slots, read, first)
    return ViewTexels(
        gbuffer, lattice, chunks, places, first[:: lattice.rows].copy(), corners, numbering, coarse
    )


def carries_irradiance_ratios(scene: Scene, shading: str, projects: bool) -> bool:
    """Return True if pictures of a ``shading`` interpolate ratios to unshadowed irradiance, and not
    light itself.

    Under constant light, and in vicinity shading, ratios equal the light. Weights by normals, which
    come with them, then help only a view that ``projects`` its texels. Light that leaves a surface
    from inside does not follow its normals, and has no ratios.
    """
    sided = scene.plan.representation in ("transfer", "irradiance") and not scene.inputs.constant
    return (
        spec_name(shading) == "gi" and (sided or projects) and not scene.surfaces.material.scatters
    )
