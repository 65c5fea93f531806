"""The core of a volume's values: what they are without outliers and marks of missing data.

One voxel of 1e30, or the -9999 of cells that a simulation did not reach, says nothing of the field, and yet a range
that holds it leaves no digits to all other values.
"""

import math

import numpy as np

MOST = 1 << 20
"""Voxels that are looked at."""

SLAB = 1 << 26
"""Bytes that are looked at together."""

FAR = 1024.0
"""Values are outliers that lie farther off than so many times the span of the others."""


def sample_step(shape: tuple[int, ...]) -> int:
    """How many voxels on the next one is looked at, so that at most MOST are, of a volume of ``shape`` (z, y, x).

    The step shares no divisor with the length of a row, so that every column has its turn.
    """
    step = max(-(-math.prod(shape) // MOST), 1)
    while math.gcd(step, shape[2]) > 1:
        step += 1
    return step


def sample_values(array: np.ndarray) -> np.ndarray:
    """The distinct finite values of at most MOST voxels, evenly taken from ``array`` (z, y, x), ascending.

    It is looked at a few layers at a time: one that is a file need not be in memory as a whole.
    """
    step, layers = sample_step(array.shape), max(SLAB // max(array[0].nbytes, 1), 1)
    parts = [sample_layers(array[z : z + layers], step, z) for z in range(0, len(array), layers)]
    return np.unique(np.concatenate(parts))


def sample_layers(layers: np.ndarray, step: int, first: int) -> np.ndarray:
    """What ``sample_values`` takes, with a ``step``, of some layers of a volume, from the layer ``first`` on."""
    values = np.unique(layers.flat[-first * layers[0].size % step :: step])
    return values[np.isfinite(values)]


def find_core(values: np.ndarray) -> tuple[float, float]:
    """The ends of the core of distinct ascending ``values``, exact Python numbers; all of them where none is far off.

    Two thirds of the values that lie closest together are a core, and it grows over gaps of up to FAR times its span.
    A core that has a core of its own is none: of values that fall by powers of ten none is an outlier.
    """
    first, last = grow(values)
    if grow(values[first : last + 1]) != (0, last - first):
        first, last = 0, len(values) - 1
    return values[first].item(), values[last].item()


def grow(values: np.ndarray) -> tuple[int, int]:
    """First and last place of the closest two thirds of the ``values``, grown over what is not far off."""
    places, count = positions(values), len(values)
    gaps, most = np.diff(places), count - count // 3
    first = int(np.argmin(places[most - 1 :] - places[: count - most + 1]))
    last = first + most - 1
    while True:
        far = np.flatnonzero(gaps / FAR > places[last] - places[first])
        ends = int(far[far < first].max(initial=-1)) + 1, int(far[far >= last].min(initial=count - 1))
        if ends == (first, last):
            return ends
        first, last = ends


def positions(values: np.ndarray) -> np.ndarray:
    """Numbers whose differences are those of ascending ``values``, or a quarter of them; none of these overflows."""
    if values.dtype.kind in "iu":
        whole = values.astype(values.dtype.newbyteorder("=")).view(f"u{values.itemsize}")
        return whole - whole[0]
    reals = values.astype(np.float64)
    return reals * 0.25 if np.abs(reals).max() > 2.0**1000 else reals
