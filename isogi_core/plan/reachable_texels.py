"""The texels that views can ever show, counted before anything is baked, and the texels of
whole isosurfaces.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial, reduce

import numpy as np

from isogi_core.kernels.tracing.field import Field
from isogi_core.kernels.tracing.macrocells import mark_cells
from isogi_core.kernels.transport.transfer import locate_texels
from isogi_core.model.volume import Isovalue

Shape = tuple[int, int, int]

Cells = Callable[[int, int], np.ndarray]
"""Function that marks a range of layers of cells, from the first to before the last."""

SAMPLED_TEXELS = 1 << 15
"""Number of shown texels, evenly sampled, among which void ones are counted."""


@dataclass(frozen=True)
class TexelCount:
    """Counts of the texels of a lattice.

    - ``total``: all; ``shown``: texels that some view can read; ``void``: shown texels that cannot
      be lit, estimated from at most SAMPLED_TEXELS of them.
    - ``chunks``, ``shown_chunks``: the same in chunks of ``chunk`` texels along each side.
    """

    total: int
    shown: int
    void: int
    chunks: int
    shown_chunks: int
    chunk: int


def count_texels(
    field: Field, shape: Shape, lowest: Isovalue, highest: Isovalue, chunk: int
) -> TexelCount:
    """Count the texels of a lattice of ``shape`` (z, y, x) over a ``field`` that views of isovalues
    from ``lowest`` to ``highest`` can read.

    The outermost texels lie on the outermost voxels; ``chunk`` is the side of a chunk in texels.
    The field needs no macrocells.
    """
    nz, ny, nx = (n - 1 for n in field.voxels.shape)

    def cells(first: int, last: int) -> np.ndarray:
        """Mark the cells of some layers that may show a surface of any isovalue of the range."""
        return surface_cells(field.voxels[first : last + 1], lowest, highest)

    # Count shown texels one layer of chunks at a time, and sample their places.
    sample = Sample(SAMPLED_TEXELS)
    touched = 0
    for n, block in enumerate(shown_blocks(cells, (nz, ny, nx), shape, chunk)):
        for z, layer in enumerate(block):
            sample.add(np.flatnonzero(layer) + (n * chunk + z) * layer.size)
        touched += touched_chunks(block, chunk)
    # Estimate the void ones from the sample, as locating each texel takes longer than counting.
    few = sample.places
    count = sample.passed
    if len(few):
        share = float(void_texels(field, shape, few).mean())
    else:
        share = 0.0
    chunks = math.prod(-(-n // chunk) for n in shape)
    return TexelCount(math.prod(shape), count, round(share * count), chunks, touched, chunk)


def touched_chunks(block: np.ndarray, chunk: int) -> int:
    """Count the chunks of one layer of chunks in which any texel of the ``block`` (layers, y,
    x) is marked.
    """
    columns = np.asarray(block.any(axis=0))
    firsts = [np.arange(0, n, chunk) for n in columns.shape]
    return int(
        np.count_nonzero(
            any_within(columns, firsts, [np.full(len(each), chunk) for each in firsts])
        )
    )


class Sample:
    """An even sample of at most ``most`` places out of a stream; ``passed`` is the length of
    the stream so far.
    """

    def __init__(self, most: int) -> None:
        """Begin by taking every place; later every second, fourth and so on is taken."""
        self._most = most
        self._step = 1
        self._taken = [np.zeros(0, np.int64)]
        self.passed = 0

    def add(self, places: np.ndarray) -> None:
        """Add the next ``places`` (m,) of the stream."""
        # Take those whose number in the stream is a multiple of the step; the first of them is
        # -passed modulo step places ahead.
        self._taken.append(places[-self.passed % self._step :: self._step].copy())
        self.passed += len(places)
        # Too many: keep every second, and take half as many from now on.
        while sum(map(len, self._taken)) > self._most:
            self._taken = [self.places[::2]]
            self._step = 2 * self._step

    @property
    def places(self) -> np.ndarray:
        """The sampled places; (m,) int64."""
        return np.concatenate(self._taken)


def surface_cells(voxels: np.ndarray, lowest: Isovalue, highest: Isovalue) -> np.ndarray:
    """Return which cells of ``voxels`` may show a surface of some isovalue from ``lowest`` to
    ``highest``; bool.

    Such an isovalue lies between the least and greatest corner of the cell, both included, as a hit
    on a face may be rounded into the next cell. A cell with a NaN shows none.
    """
    cells = np.empty(tuple(n - 1 for n in voxels.shape), np.bool_)
    mark_cells(voxels, lowest, highest, cells)
    return cells


def shown_blocks(cells: Cells, extent: Shape, shape: Shape, size: int) -> Iterator[np.ndarray]:
    """Yield which texels are corners of a lattice cell that overlaps a marked one of the ``cells``;
    (layers, y, x) bool.

    There are ``extent`` cells (z, y, x), of which ``cells(first, last)`` marks some layers, and
    ``shape`` texels. These come ``size`` layers at a time, so that no more need to be in memory.
    """
    spans = [lattice_spans(n, t) for n, t in zip(extent, shape, strict=True)]
    (first, count) = spans[0]
    top = shape[0] - 1
    for a in range(0, shape[0], size):
        # Read the lattice cells on both sides of these layers of texels.
        low = max(a - 1, 0)
        high = min(a + size, top)
        begin = first[low]
        marks = cells(begin, first[high - 1] + count[high - 1])
        part = [(first[low:high] - begin, count[low:high]), *spans[1:]]
        # Mark the lattice cells that overlap a marked cell, then all of their corners.
        held = any_within(marks, [each for each, _ in part], [each for _, each in part])
        yield widened(widened(widened(held, 2), 1), 0, before=a == 0, after=a + size > top)


def widened(held: np.ndarray, axis: int, before: bool = True, after: bool = True) -> np.ndarray:
    """Return which corners along an ``axis`` belong to a marked cell. The cells ``before`` and
    ``after`` the first and last count as unmarked; without one of them, the corners at that end
    are left out.
    """
    wide = [(0, 0)] * 3
    wide[axis] = (int(before), int(after))
    layers = np.moveaxis(np.pad(held, wide), axis, 0)
    return np.moveaxis(layers[1:] | layers[:-1], 0, axis)


def lattice_spans(cells: int, texels: int) -> tuple[np.ndarray, np.ndarray]:
    """Return, for each lattice cell along an axis, the first voxel cell that it overlaps, and
    the number of these.
    """
    edges = np.arange(texels) * (cells / (texels - 1))
    first = np.floor(edges[:-1]).astype(int)
    last = np.ceil(edges[1:]).astype(int)
    return first, np.minimum(last, cells) - first


def any_within(marks: np.ndarray, firsts: list[np.ndarray], counts: list[np.ndarray]) -> np.ndarray:
    """Return True for each box in which one of the ``marks``, bool, is set; bool, with as
    many entries along each axis as there are intervals along it.

    A box is the product of one interval of each axis. Interval i of an axis has ``counts[axis][i]``
    marks, 1 or more, from ``firsts[axis][i]`` on. It must begin within the array, and its part
    beyond the end of the array counts as not set.
    """
    for axis, (first, count) in enumerate(zip(firsts, counts, strict=True)):
        most = marks.shape[axis] - 1
        # Each interval is one mark, in order: there is nothing to combine along this axis.
        if np.array_equal(first, np.arange(most + 1)) and (count == 1).all():
            continue
        # Combine the k-th mark of each interval, for each k. An interval that has fewer marks, or
        # is cut off by the end of the array, repeats its last one.
        steps = (np.minimum(first + np.minimum(k, count - 1), most) for k in range(count.max()))
        marks = reduce(np.logical_or, map(partial(marks.take, axis=axis), steps))
    return marks


def void_texels(field: Field, shape: Shape, places: np.ndarray) -> np.ndarray:
    """Return which texels at flat ``places`` of the lattice can hold no light, see
    ``locate_texels``; bool.
    """
    # Voxels per texel along x, y, z.
    step = np.array(
        [(n - 1) / (m - 1) for n, m in zip(field.voxels.shape[::-1], shape[::-1], strict=True)]
    )
    texels = np.stack(np.unravel_index(places, shape), axis=-1).astype(np.int32)
    points = np.empty((3, len(texels)))
    normals = np.empty((3, len(texels)))
    isovalues = np.empty(len(texels))
    void = np.empty(len(texels), np.bool_)
    locate_texels(field, step, texels, points, normals, isovalues, void)
    return void


Range = tuple[Isovalue, Isovalue]
"""Isovalues from one to another, both included."""


def surface_texels(
    voxels: np.ndarray, shape: Shape, chunk: int, ranges: Sequence[Range]
) -> Iterator[tuple[Shape, np.ndarray]]:
    """Yield the chunks (z, y, x) that hold texels of isosurfaces in the ``ranges``, with the
    ascending offsets of these texels in their chunk.

    The lattice of ``shape`` (z, y, x) has ``chunk`` texels along each side of a chunk; offsets are
    int32. One layer of chunks is in memory at a time.
    """
    nz, ny, nx = (n - 1 for n in voxels.shape)

    def cells(first: int, last: int) -> np.ndarray:
        """Mark the cells of some layers that may show a surface of any of the ranges."""
        slab = voxels[first : last + 1]
        return reduce(np.logical_or, [surface_cells(slab, low, high) for low, high in ranges])

    # Divide each layer of chunks into its chunks, and list the marked texels of each.
    for layer, shown in enumerate(shown_blocks(cells, (nz, ny, nx), shape, chunk)):
        for y in range(0, shape[1], chunk):
            for x in range(0, shape[2], chunk):
                z, j, i = np.nonzero(shown[:, y : y + chunk, x : x + chunk])
                if len(z):
                    yield (
                        (layer, y // chunk, x // chunk),
                        ((z * chunk + j) * chunk + i).astype(np.int32),
                    )
