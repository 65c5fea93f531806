"""Which texels of a lattice the isovalues that views may ask for can ever show, counted before anything is baked."""

from dataclasses import dataclass
from functools import reduce

import numpy as np

Shape = tuple[int, int, int]

SLAB = 4
"""Layers of cells that are looked at together, so that they stay in the cache."""

SAMPLE = 1 << 15
"""Shown texels, evenly taken, of which those without a gradient are counted."""


@dataclass(frozen=True)
class TexelCount:
    """Texels of a lattice: ``total``; ``shown``, which some view can read; ``void``, shown ones without a gradient.

    ``chunks`` and ``shown_chunks`` are the same of chunks. ``void`` is told from at most SAMPLE of the shown ones.
    """

    total: int
    shown: int
    void: int
    chunks: int
    shown_chunks: int


def count_texels(voxels: np.ndarray, shape: Shape, lowest: float, highest: float, chunk: int) -> TexelCount:
    """Count the texels of a lattice of ``shape`` over ``voxels`` (both z, y, x) for a range of isovalues.

    ``lowest`` and ``highest`` are normalised, as the voxels are. The outermost texels lie on the outermost
    voxels; ``chunk`` is the side of a chunk in texels.
    """
    shown = shown_texels(surface_cells(voxels, lowest, highest), shape)
    chunks = tuple(-(-n // chunk) for n in shape)
    touched = any_within(shown, [np.arange(n) * chunk for n in chunks], [np.full(n, chunk) for n in chunks])
    count = int(np.count_nonzero(shown))
    few = every(max(-(-count // SAMPLE), 1), shown)
    share = float(void_texels(voxels, shape, few).mean()) if len(few) else 0.0
    return TexelCount(shown.size, count, round(share * count), touched.size, int(touched.sum()))


def every(step: int, marks: np.ndarray) -> np.ndarray:
    """Flat places of every ``step``-th set mark, from the first on, found layer by layer to save memory; int64."""
    taken, passed = [], 0
    for z, layer in enumerate(marks):
        places = np.flatnonzero(layer)
        taken.append(places[-passed % step :: step] + z * layer.size)
        passed += len(places)
    return np.concatenate(taken)


def surface_cells(voxels: np.ndarray, lowest: float, highest: float) -> np.ndarray:
    """Whether each cell of ``voxels`` may show a surface of some isovalue from ``lowest`` to ``highest``; bool.

    It does where the isovalue lies between its least and greatest corner, both included: a hit on a face may be
    rounded into the cell beyond. A cell with a NaN shows none.
    """
    cells = np.empty(tuple(n - 1 for n in voxels.shape), np.bool_)
    for first in range(0, len(cells), SLAB):
        slab = voxels[first : first + SLAB + 1]
        low, high = corners(slab, np.minimum), corners(slab, np.maximum)
        cells[first : first + SLAB] = (low <= highest) & (high >= lowest) & (low < high)
    return cells


def corners(slab: np.ndarray, least: np.ufunc) -> np.ndarray:
    """The least, or greatest, of the eight corners of each cell."""
    rows = least(slab[:, :, 1:], slab[:, :, :-1])
    planes = least(rows[:, 1:], rows[:, :-1])
    return np.asarray(least(planes[1:], planes[:-1]))


def shown_texels(cells: np.ndarray, shape: Shape) -> np.ndarray:
    """Whether each texel is a corner of a lattice cell that shares some room with one of the ``cells``; bool."""
    spans = [lattice_spans(n, t) for n, t in zip(cells.shape, shape, strict=True)]
    held = any_within(cells, [first for first, _ in spans], [count for _, count in spans])
    for axis in range(3):
        wide = [(0, 0)] * 3
        wide[axis] = (1, 1)
        padded = np.pad(held, wide)
        held = padded.take(range(1, padded.shape[axis]), axis) | padded.take(range(padded.shape[axis] - 1), axis)
    return held


def lattice_spans(cells: int, texels: int) -> tuple[np.ndarray, np.ndarray]:
    """For each of the lattice's cells along an axis: the first voxel cell that it reaches into, and how many."""
    edges = np.arange(texels) * (cells / (texels - 1))
    first = np.floor(edges[:-1]).astype(int)
    last = np.ceil(edges[1:]).astype(int)
    return first, np.minimum(last, cells) - first


def any_within(marks: np.ndarray, firsts: list[np.ndarray], counts: list[np.ndarray]) -> np.ndarray:
    """Whether any mark is set in each box of ``counts`` marks from ``firsts`` on, both by axis; none is set outside."""
    for axis, (first, count) in enumerate(zip(firsts, counts, strict=True)):
        most = marks.shape[axis] - 1
        steps = [marks.take(np.minimum(first + np.minimum(k, count - 1), most), axis) for k in range(count.max())]
        marks = reduce(np.logical_or, steps)
    return marks


def void_texels(voxels: np.ndarray, shape: Shape, places: np.ndarray) -> np.ndarray:
    """Whether the texels at flat ``places`` of the lattice have no gradient, smoothed or of their own cell; bool.

    The twin of ``kernels.field.normal`` in NumPy, with the tricubic B-spline over 4×4×4 voxels.
    """
    where = np.unravel_index(places, shape)
    points = [t * ((n - 1) / (m - 1)) for t, n, m in zip(where, voxels.shape, shape, strict=True)]
    cells = [np.minimum(p.astype(int), n - 2) for p, n in zip(points, voxels.shape, strict=True)]
    parts = [p - cell for p, cell in zip(points, cells, strict=True)]
    smooth = gradient(voxels, cells, [bspline(f) for f in parts], -1)
    own = gradient(voxels, cells, [(np.stack([1.0 - f, f]), np.stack([f * 0 - 1, f * 0 + 1])) for f in parts], 0)
    return ~(np.nan_to_num(smooth).any(axis=0) | np.nan_to_num(own).any(axis=0))


def gradient(
    voxels: np.ndarray, cells: list[np.ndarray], filters: list[tuple[np.ndarray, np.ndarray]], start: int
) -> np.ndarray:
    """Σ over voxels from ``start`` on about ``cells``, with the slopes of one axis and the weights of the others.

    ``filters`` hold weights and slopes (taps, m) of each axis; (3, m) float64. Voxels beyond the border repeat
    the border's. Values are taken from that of the cell's own voxel, so that a plateau has no gradient at all.
    """
    level = voxels[tuple(cells)].astype(np.float64)
    total = np.zeros((3, len(cells[0])))
    for taps in np.ndindex(*(len(weights) for weights, _ in filters)):
        at = tuple(
            np.clip(cell + start + tap, 0, n - 1) for cell, tap, n in zip(cells, taps, voxels.shape, strict=True)
        )
        value = voxels[at] - level
        for axis in range(3):
            factors = [own[axis == a][tap] for a, (own, tap) in enumerate(zip(filters, taps, strict=True))]
            total[axis] += factors[0] * factors[1] * factors[2] * value
    return total


def bspline(f: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weights and slopes (4, m) of the cubic B-spline at fractions ``f``, for voxels -1, 0, 1, 2."""
    g = 1.0 - f
    weights = [g**3, 4.0 + f * f * (3.0 * f - 6.0), 4.0 + g * g * (3.0 * g - 6.0), f**3]
    slopes = [-0.5 * g * g, f * (1.5 * f - 2.0), -g * (1.5 * g - 2.0), 0.5 * f * f]
    return np.stack(weights) / 6.0, np.stack(slopes)
