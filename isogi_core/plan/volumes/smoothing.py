"""Smooth a volume by a Gaussian, slab by slab, before anything is made of it.

MRI and other noisy volumes have dimples at the pitch of their voxels, which light shows; a Gaussian
of about a voxel removes these. Voxels of whole numbers become floats and are not rounded again, so
that a volume of 8 bits has no steps.
"""

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from isogi_core.files.grid import Grid
from isogi_core.model.value_survey import are_measured, find_marks, usable, usable_type

GAUSSIAN_REACH = 4.0
"""Standard deviations to which the Gaussian is summed: a share of 6·10⁻⁵ of it lies beyond."""

SMOOTH_NOTE = "Smoothed by a Gaussian of {sigma:g} voxels along each axis."


def smoothed(grid: Grid, sigma: float, missing: Sequence[float] = ()) -> Grid:
    """Return a ``grid`` of floats, smoothed by a Gaussian of standard deviation ``sigma`` voxels
    along each axis.

    Values equal to one of ``missing``, and values that are not finite, are holes: they stay holes,
    and the mean around them is of the other values alone. Beyond the sides of the grid its
    outermost values are repeated. A few layers are in memory at a time.
    """
    # Single floats hold integers of 16 bits and half floats exactly; wider values need doubles.
    kind = usable_type(grid.dtype)
    dtype = np.dtype(np.float64 if kind.itemsize > 2 and kind != np.float32 else np.float32)
    marks = find_marks(missing, kind)
    given = grid.stamp
    return replace(
        grid,
        dtype=dtype,
        slabs=partial(_smoothed_layers, grid, sigma, marks, dtype),
        stamp=lambda: f"{given()} smoothed {sigma!r} {marks.tolist()}",
        notes=(*grid.notes, SMOOTH_NOTE.format(sigma=sigma)),
    )


def gaussian_reach(sigma: float) -> int:
    """Voxels to which a Gaussian of standard deviation ``sigma`` reaches."""
    return int(np.ceil(GAUSSIAN_REACH * sigma))


def gaussian_weights(sigma: float, dtype: np.dtype[Any]) -> np.ndarray:
    """Return the weights (2 r + 1,) of a Gaussian at whole voxels up to r, GAUSSIAN_REACH
    deviations; their sum is 1.
    """
    reach = gaussian_reach(sigma)
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    return np.asarray(weights / weights.sum(), dtype)


class Flattened(NamedTuple):
    """A layer smoothed along x and y.

    ``values`` are weighted sums, with 0 in holes; ``there`` are the sums of the weights of values
    that are no hole; ``holes`` marks these. Both are None if there are no holes.
    """

    values: np.ndarray
    there: np.ndarray | None
    holes: np.ndarray | None


def _smoothed_layers(
    grid: Grid, sigma: float, marks: np.ndarray, dtype: np.dtype[Any]
) -> Iterator[np.ndarray]:
    """Yield the smoothed layers of a grid, (1, ny, nx) each.

    A Gaussian is separable: each layer is smoothed along x and y as it comes, and those within
    reach are kept and summed along z. With holes the sums are divided by those of the weights.
    """
    weights = gaussian_weights(sigma, dtype)
    reach = len(weights) // 2
    layers = (_flattened(layer, weights, marks) for slab in grid.slabs() for layer in usable(slab))
    window: deque[Flattened] = deque(maxlen=len(weights))
    # Slide a window of layers along z; its middle is complete once the window is full.
    for layer in _with_repeated_ends(layers, reach):
        window.append(layer)
        if len(window) == len(weights):
            yield _summed(window, weights, reach)[None]


def _flattened(layer: np.ndarray, weights: np.ndarray, marks: np.ndarray) -> Flattened:
    """Smooth a ``layer`` (ny, nx) along x and y; ``marks`` are the missing values."""
    there = are_measured(layer, marks)
    if there.all():
        return Flattened(
            _along(_along(layer.astype(weights.dtype), weights, 1), weights, 0), None, None
        )
    # Smooth the values with 0 in holes, and the marks of the others likewise: their quotient is the
    # mean of values alone.
    known = np.where(there, layer, 0).astype(weights.dtype)
    both = [
        _along(_along(each, weights, 1), weights, 0)
        for each in (known, there.astype(weights.dtype))
    ]
    return Flattened(both[0], both[1], ~there)


def _along(layer: np.ndarray, weights: np.ndarray, axis: int) -> np.ndarray:
    """Smooth a ``layer`` along an ``axis``; beyond its ends its outermost values are repeated."""
    reach = len(weights) // 2
    wide = np.pad(layer, [(reach, reach) if each == axis else (0, 0) for each in range(2)], "edge")
    count = layer.shape[axis]
    smooth = np.zeros_like(layer)
    for n, weight in enumerate(weights):
        smooth += weight * (wide[n : n + count] if axis == 0 else wide[:, n : n + count])
    return smooth


def _with_repeated_ends(layers: Iterator[Flattened], reach: int) -> Iterator[Flattened]:
    """Yield the ``layers`` with the first and the last repeated ``reach`` times."""
    last = next(layers)
    yield from [last] * reach
    yield last
    for last in layers:
        yield last
    yield from [last] * reach


def _summed(window: Sequence[Flattened], weights: np.ndarray, middle: int) -> np.ndarray:
    """Return the layer in the ``middle`` of a ``window``, smoothed along z; NaN in its holes."""
    values = np.zeros_like(window[middle].values)
    for weight, layer in zip(weights, window, strict=True):
        values += weight * layer.values
    if all(layer.there is None for layer in window):
        return values
    # Divide by the weights of the values that are no hole.
    there = np.zeros_like(values)
    for weight, layer in zip(weights, window, strict=True):
        there += weight if layer.there is None else weight * layer.there
    with np.errstate(divide="ignore", invalid="ignore"):
        values /= there
    if window[middle].holes is not None:
        values[window[middle].holes] = np.nan
    return values
