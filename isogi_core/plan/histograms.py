"""The histogram by which people choose isovalues. Its bins are even, or of even ratios if
values span decades.
"""

import math
from typing import NamedTuple

import numpy as np

from isogi_core.model.volume import HISTOGRAM_BINS, Volume
from isogi_core.plan.inputs import find_once

MAX_SAMPLED = 1 << 18
"""Number of voxels, about, that are read to find out if values span decades."""

MIN_DECADES = 2.0
"""Powers of ten that the positive values on a logarithmic axis span at least, without a tenth
of them at either end.
"""

CROWDED_END = 0.5
"""Share of an even axis, at its low end, in which nine tenths of the positive values must lie
for a logarithmic axis.
"""

MOST_DECADES = 6.0
"""Powers of ten below the greatest value that a logarithmic axis shows."""


class ShownHistogram(NamedTuple):
    """Counts (bins,) int64 of the voxels in the core, and the ``edges`` (bins + 1,) of bins in the
    units of the volume's file.

    If it is ``logarithmic``, all edges but the least are at even ratios.
    """

    counts: np.ndarray
    edges: np.ndarray
    logarithmic: bool


def shown_histogram(volume: Volume) -> ShownHistogram:
    """Return the histogram of a ``volume``, computed once and kept."""
    return find_once(volume, "histogram", lambda: _shown_histogram(volume))


def _shown_histogram(volume: Volume) -> ShownHistogram:
    """Compute the histogram of a ``volume``."""
    low = least_shown(volume)
    if low is None:
        return ShownHistogram(*volume.histogram(), False)
    # The first bin holds all values below the logarithmic part.
    inner = np.geomspace(low, volume.core[1], HISTOGRAM_BINS)
    edges = np.concatenate([[min(volume.core[0], low)], inner])
    edges[-1] = volume.core[1]
    counts = np.zeros(HISTOGRAM_BINS, np.int64)
    for voxels in volume.core_voxels():
        values = volume.offset + volume.scale * voxels.ravel().astype(np.float64)
        counts += np.histogram(np.clip(values, edges[0], edges[-1]), edges)[0]
    return ShownHistogram(counts, edges, True)


def least_shown(volume: Volume) -> float | None:
    """Return the least value of a logarithmic axis; None if values are whole numbers or
    negative, do not span MIN_DECADES, or are not crowded at the low end of an even axis.
    """
    low, high = volume.core
    if low < 0.0 or not 0.0 < high < math.inf or np.dtype(volume.dtype).kind != "f":
        return None
    # Judge by the positive values among evenly sampled voxels.
    flat = volume.voxels.reshape(-1)
    some = flat[:: max(flat.size // MAX_SAMPLED, 1)].astype(np.float64)
    values = volume.offset + volume.scale * some
    positive = values[(values > 0.0) & (values <= high)]
    if not len(positive):
        return None
    # Keep an even axis if values do not span decades without the tenth of them at either end, or
    # if they fill it well.
    few, many = np.quantile(positive, (0.1, 0.9))
    if many < few * 10.0**MIN_DECADES or many > CROWDED_END * high:
        return None
    return float(max(few, high * 10.0**-MOST_DECADES, low))
