"""Colours of labels: at each place the two that weigh most around it, so that seams between them are smooth.

Labels are weighed by the Gaussian that smooths their field, whose surface is theirs. Frames and paths interpolate the
shares of both labels and take the greatest one's colour (``label_albedo``): where two touch it changes on a surface as
smooth as the one that is seen, and no third label comes up between them.
"""

import math

import numpy as np

from isogi_core.errors import VolumeError
from isogi_core.files.scene_file import Settings
from isogi_core.kernels.transport.colours import weigh_labels
from isogi_core.model.colours import VALUES, Colour, Scale, SurfaceColours
from isogi_core.model.volume import Volume
from isogi_core.plan.volumes.colours import capped, volume_grids
from isogi_core.plan.volumes.labels import SIGMA, SMOOTHING_REACH, LabelTable, Segmentation
from isogi_core.plan.volumes.masks import matrix_into, nearest_layer

MAX_LABELLED_PLACES = 355**3
"""Places with labels, at most, of three bytes each: larger volumes have labels at every second voxel, or fewer."""

MIDDLE_WEIGHT = 1024
"""What the middle of the Gaussian weighs: weights are whole numbers, so that their sums are exact."""


def colours_of_labels(listed: tuple[LabelTable, ...], settings: Settings, volume: Volume) -> SurfaceColours:
    """The colours of a scene's ``volume``, a segmentation. Raises SceneError and VolumeError."""
    raw = settings.text("axes", "") == "raw"
    grid, straight = volume_grids(settings, settings.source.base, volume, raw)
    if straight.shape != volume.shape:
        raise VolumeError(f"The volume '{volume.name}' changed while it was read: try again once it is written.")
    found = Segmentation(grid, listed)
    matrix = matrix_into("segmentation", grid, grid, straight)
    stride = stride_of(volume.shape)
    labels = weighed(sampled(found.codes, matrix, volume.shape, stride))
    return SurfaceColours(labels, (float(stride),) * 3, scale_of(found, volume.name))


def stride_of(shape: tuple[int, ...]) -> int:
    """How many voxels apart places with a label of their own lie."""
    stride = 1
    while math.prod(places(n, stride) for n in shape) > MAX_LABELLED_PLACES:
        stride += 1
    return stride


def places(n: int, stride: int) -> int:
    """How many places a side of ``n`` voxels has."""
    return max(math.ceil((n - 1) / stride) + 1, 2)


def sampled(codes: np.ndarray, matrix: np.ndarray, shape: tuple[int, ...], stride: int) -> np.ndarray:
    """The nearest of ``codes`` at every ``stride``-th voxel of a volume of a ``shape``, its last ones at its end."""
    z, y, x = (np.minimum(np.arange(places(n, stride)) * stride, n - 1) for n in shape)
    return np.stack([nearest_layer(codes, matrix, (x, y[:, None]), int(layer)) for layer in z])


def weighed(codes: np.ndarray) -> np.ndarray:
    """The labels of places with ``codes`` (nz, ny, nx), as ``Colours`` has them, (nz, ny, nx, 3) uint8.

    A place without one has that of its neighbours as far as the Gaussian is summed: beyond, the field is zero.
    """
    highest = _extreme(codes, np.maximum)
    lowest = _extreme(codes - np.uint8(1), np.minimum) + np.uint8(1)
    labels = np.zeros((*codes.shape, 3), np.uint8)
    labels[..., 0] = highest
    bell = np.rint(
        MIDDLE_WEIGHT * np.exp(-0.5 * (np.arange(-SMOOTHING_REACH, SMOOTHING_REACH + 1) / SIGMA) ** 2)
    ).astype(np.int64)
    weigh_labels(codes, np.ascontiguousarray(lowest < highest), bell, labels)
    return labels


def _extreme(codes: np.ndarray, extreme: np.ufunc) -> np.ndarray:
    """The extreme of the codes around each place, SMOOTHING_REACH along each axis."""
    for axis in range(3):
        before = np.moveaxis(codes, axis, 0)
        after = before.copy()
        for step in range(1, min(SMOOTHING_REACH, len(before) - 1) + 1):
            extreme(after[step:], before[:-step], out=after[step:])
            extreme(after[:-step], before[step:], out=after[:-step])
        codes = np.moveaxis(after, 0, axis)
    return codes


def scale_of(found: Segmentation, name: str) -> Scale:
    """The labels as a table of albedos; places far from all of them have the mean of those that are shown."""
    shown = [capped(label.colour) for label in found.labels if label.shown]
    outside: Colour = capped(np.mean(shown, axis=0).tolist())
    table = np.tile(outside, (VALUES, 1))
    table[: len(shown)] = shown
    values = [label.value for label in found.labels if label.shown]
    return Scale(name, (float(values[0]), float(values[-1])), "labels", table, outside, found.labels)
