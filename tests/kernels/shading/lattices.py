"""A lattice for the tests of its kernels: points in it, the texels around them, and a view's tables
by the kernels.
"""

import numpy as np

from isogi_core.kernels.shading.chunks import (
    find_coarse_corners,
    find_corners,
    find_places,
    mark_texels,
)
from isogi_core.kernels.shading.lattice import DEFAULT_CHUNK_SIDE, Lattice

SHAPE = (40, 37, 34)
"""Texels along z, y, x: chunks of any size have neighbours along each axis."""

STEP = np.array([1.5, 0.5, 1.0])
RNG = np.random.default_rng(21)


def lattice(chunk=DEFAULT_CHUNK_SIDE):
    """SHAPE texels, one every STEP voxels (x, y, z)."""
    return Lattice.of(SHAPE, tuple((1.0 / STEP).tolist()), chunk)


def some_points(count=300):
    """Points (n, 3) float32 in voxels: anywhere, on texels, and on the last faces."""
    last = (np.array(SHAPE[::-1]) - 1) * STEP
    points = RNG.random((count, 3)) * last
    points[::3] = np.rint(points[::3] / STEP) * STEP
    points[::10] = last
    return points.astype(np.float32)


def border_points():
    """Points whose lattice cells lie on borders, edges and corners of chunks of any size, and some
    anywhere.
    """
    sides = [[0.3, 7.5, 15.5, 31.5, n - 1.2] for n in SHAPE[::-1]]
    grid = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 3) * STEP
    return np.concatenate([grid.astype(np.float32), some_points()])


def lower_texels(points):
    """Lower texel (n, 3; z, y, x) of each point's lattice cell, and the fractions in it, by
    NumPy.
    """
    place = (points.astype(float) / STEP)[:, ::-1]
    low = np.clip(np.floor(place).astype(int), 0, np.array(SHAPE) - 2)
    return low, np.clip(place - low, 0.0, 1.0)


def corner_texels(points):
    """The eight texels (n, 8, 3; z, y, x) around each point, x fastest."""
    return lower_texels(points)[0][:, None] + np.array(list(np.ndindex(2, 2, 2)))


def view_of(points, pieces=1, chunk=DEFAULT_CHUNK_SIDE, coarse=False):
    """A view's tables as `frame.view_texels` makes them: read (slots · rows,), places of texels,
    corners (n, 8).
    """
    whole = lattice(chunk)
    slots = np.arange(np.prod(whole.chunks), dtype=np.int32).reshape(whole.chunks)
    read = np.zeros(slots.size * whole.rows, np.uint32)
    for piece in np.array_split(points, pieces):
        mark_texels(whole, piece, coarse, slots, read)
    first = np.concatenate([[0], np.cumsum(np.bitwise_count(read), dtype=np.uint32)]).astype(
        np.uint32
    )
    places = np.full(first[-1], 2**32 - 1, np.uint32)
    corners = np.empty((len(points), 8), np.uint32)
    for begin in range(0, read.size, 1000):
        find_places(whole, begin, min(begin + 1000, read.size), read, first, places)
    (find_coarse_corners if coarse else find_corners)(whole, points, slots, read, first, corners)
    return read, places.astype(int), corners
