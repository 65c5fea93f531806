"""Cuts: parts of a volume that are taken away, so that light comes in. What is left is a volume like any other.

Voxels that are taken away hold CUT_AWAY_VALUE, outside of every isosurface. Between them and what is left the field
falls so steeply that each isosurface has its face at the last voxels left: flat, at the same place for all isovalues.
"""

import hashlib
import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from isogi_core.errors import SceneError, ViewError
from isogi_core.files.mappings import UNMAPPED_SHARE, budget
from isogi_core.files.volume_copies import get_copy
from isogi_core.files.voxel_file import Draft
from isogi_core.model.volume import UNMEASURED_FIELDS, Volume
from isogi_core.model.window import Plane, read_window

CUT_AWAY_VALUE = -8.0
"""What voxels that are taken away hold, in units of voxels: those that are left are from 0 to 1, but for outliers.

A face of the isovalue c lies (f - c) / (f - CUT_AWAY_VALUE) of a voxel before the last voxels left, f. Were it farther,
faces would be flatter, and edges beside them rounder: normals are smoothed over four voxels.
"""

AXIS_TOLERANCE = 1e-6
"""How much a plane's normal may be off an axis of the voxels."""

PLANE_TOLERANCE = 1e-6
"""Voxels by which a plane may miss those that it leaves, and leave them still."""

NORMAL_REACH = 2.5
"""Voxels from a face within which a texel is lit about another normal than in the whole volume: four are smoothed."""

Ranges = tuple[range, range, range]
"""The voxels that are left, along x, y, z."""


def cut_away(volume: Volume, text: str) -> Volume:
    """What planes leave of a ``volume``; ``text`` is as ``read_window`` has it, in the world.

    Planes lie along the axes of the voxels; voxels on a plane are left. Raises SceneError where they cannot be read,
    lie otherwise or leave nothing, and VolumeError where the copy of a large volume cannot be kept.
    """
    left, digest = voxels_left(volume, text), cut_digest(volume, text)
    if digest == volume.digest:
        return volume
    known = replace(volume.counted(), digest=digest)
    if volume.voxels.nbytes <= UNMAPPED_SHARE * budget():
        return replace(known, voxels=np.concatenate(list(slabs_left(volume, left))))

    def write(draft: Draft) -> dict[str, Any]:
        for plane in (plane for slab in slabs_left(volume, left) for plane in slab):
            draft.write(plane)
        facts = {name: value for name, value in vars(known).items() if name not in UNMEASURED_FIELDS}
        draft.seal(volume.shape, facts)
        return facts

    return replace(known, voxels=get_copy(digest, volume.voxels.nbytes, write)[0])


def cut_digest(volume: Volume, text: str) -> str:
    """The digest of a ``volume`` that is cut: plane by plane, so that one cut after another is both at once."""
    digest, whole = volume.digest, tuple(map(range, volume.size))
    for left in (voxels_left(volume, term) for term in text.split(";")):
        if left != whole:
            digest = hashlib.blake2b(f"{digest} {left} {CUT_AWAY_VALUE}".encode(), digest_size=16).hexdigest()
    return digest


def voxels_left(volume: Volume, text: str) -> Ranges:
    """The voxels of a ``volume`` that planes leave. Raises SceneError, see ``cut_away``."""
    try:
        planes = read_window(text).in_box(volume.orientation).planes
    except ViewError as error:
        raise SceneError(f"cut = '{text}' cannot be read. {error}") from None
    left = [range(n) for n in volume.size]
    for plane in planes:
        axis = _axis_of(plane, text)
        place = -plane[3] / plane[axis] / volume.spacing[axis]
        first, last = left[axis].start, left[axis].stop
        if plane[axis] > 0.0:
            first = max(first, math.ceil(min(place - PLANE_TOLERANCE, last)))
        else:
            last = min(last, math.floor(max(place + PLANE_TOLERANCE, -1.0)) + 1)
        left[axis] = range(first, max(last, first))
    if not all(left):
        raise SceneError(f"cut = '{text}' leaves nothing of the volume '{volume.name}': take less away.")
    x, y, z = left
    return x, y, z


def _axis_of(plane: Plane, text: str) -> int:
    """The axis that a plane's normal is along."""
    axis = int(np.argmax(np.abs(plane[:3])))
    if 1.0 - abs(plane[axis]) > AXIS_TOLERANCE:
        raise SceneError(f"cut = '{text}' lies across the voxels: cut along their axes, or look through a window=.")
    return axis


def box_left(left: Ranges, size: tuple[int, int, int]) -> np.ndarray:
    """The box in which surfaces are what they are in the whole volume, of this ``size``: NORMAL_REACH from all faces.

    (2, 3) float64, its least and its greatest corner in index space; infinite where nothing is taken away.
    """
    low = [each.start + NORMAL_REACH if each.start else -np.inf for each in left]
    high = [each.stop - 1 - NORMAL_REACH if each.stop < n else np.inf for each, n in zip(left, size, strict=True)]
    return np.array([low, high])


def values_beyond(volume: Volume, box: np.ndarray) -> tuple[float, float]:
    """The least and the greatest voxel of a ``volume`` at cells that are not wholly within a ``box``: see ``box_left``.

    Isosurfaces below and above these do not leave the box; (inf, -inf) where it holds all.
    """
    size = np.array(volume.size)
    first, end = np.clip(np.ceil(box[0]) + 1, 0, size).astype(int), np.clip(np.floor(box[1]), 0, size).astype(int)
    low, high, z = np.inf, -np.inf, 0
    for slab in volume.slabs():
        a, b = (int(np.clip(each[2] - z, 0, len(slab))) for each in (first, end))
        across, rows = slab[a:b], slab[a:b, first[1] : end[1]]
        parts = slab[:a], slab[max(a, b) :], across[:, : first[1]], across[:, end[1] :]
        for part in (*parts, rows[:, :, : first[0]], rows[:, :, end[0] :]):
            low = float(np.fmin.reduce(part, axis=None, initial=low))
            high = float(np.fmax.reduce(part, axis=None, initial=high))
        z += len(slab)
    return low, high


def is_within(points: np.ndarray, box: np.ndarray) -> np.ndarray:
    """Which ``points`` (m, 3) lie in a ``box`` (2, 3), as of ``box_left``; (m,) bool."""
    return np.asarray(((points >= box[0]) & (points <= box[1])).all(axis=1))


def slabs_left(volume: Volume, left: Ranges) -> Iterator[np.ndarray]:
    """The slabs of a ``volume``, with CUT_AWAY_VALUE in place of the voxels that are not ``left``."""
    z, inside = 0, tuple(slice(each.start, each.stop) for each in (left[1], left[0]))
    for slab in volume.slabs():
        cut = np.full_like(slab, CUT_AWAY_VALUE)
        first, last = (min(max(end - z, 0), len(slab)) for end in (left[2].start, left[2].stop))
        cut[(slice(first, last), *inside)] = slab[(slice(first, last), *inside)]
        z += len(slab)
        yield cut
