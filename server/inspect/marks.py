"""Marks of nothing: a value, such as -9999, that stands in voxels where nothing was measured."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from isogi_core.model.volume import Volume

MANY = 0.001
"""Share of the voxels that have the value, at least: a single voxel is an outlier and not a mark."""


def mark_of_nothing(volume: Volume) -> float | None:
    """The end of the value range that looks like a mark of missing data, in the volume's own units; None where none.

    Many voxels have it, and it lies farther from all other values than these lie apart. Two values make a mask.
    """
    ends = [(np.nanmin(slab), np.nanmax(slab)) for slab in numbers(volume)]
    least, most = min(low for low, _ in ends), max(high for _, high in ends)
    told = volume.value_range[:: 1 if volume.scale > 0 else -1]
    for value, end, other in zip(told, (least, most), (most, least), strict=True):
        if is_far(volume, end, other):
            return value
    return None


def numbers(volume: Volume) -> Iterator[np.ndarray]:
    """The volume's slabs that hold any number."""
    return (slab for slab in volume.slabs() if not np.isnan(slab).all())


def is_far(volume: Volume, end: Any, other: Any) -> bool:
    """Whether one ``end`` of the range of a volume's voxels is that of many, and far from all others."""
    if sum(np.count_nonzero(slab == end) for slab in volume.slabs()) < MANY * volume.voxels.size:
        return False
    if end < other:
        beside = min(np.min(slab, where=slab > end, initial=other) for slab in volume.slabs())
    else:
        beside = max(np.max(slab, where=slab < end, initial=other) for slab in volume.slabs())
    return bool(beside != other and abs(float(beside) - float(end)) > abs(float(other) - float(beside)))
