"""Colours of labels: codes that are never mixed. Between labels that touch, the colour goes over their mean.

Frames and paths interpolate codes between the corners of a cell, leaving out corners without a label, whose share of
the albedo is the one outside. So codes lie half a voxel apart: a place at a voxel's centre has its label, one between
voxels has the label that all voxels around it share, else none. A cell then has one label at most.
"""

import math

import numpy as np

from isogi_core.errors import VolumeError
from isogi_core.files.scene_file import Settings
from isogi_core.model.colours import VALUES, Colour, Scale, SurfaceColours
from isogi_core.model.volume import Volume
from isogi_core.plan.volumes.colours import capped, volume_grids
from isogi_core.plan.volumes.labels import REACH, LabelTable, Segmentation
from isogi_core.plan.volumes.masks import matrix_into, nearest_layer

PLACES = 513**3
"""Places of a grid of codes, at most: volumes of more than 257³ voxels have labels at every second one, or fewer."""

SPREAD = REACH + 1
"""Voxels by which labels are spread: beyond them the field is zero."""


def colours_of_labels(listed: tuple[LabelTable, ...], settings: Settings, volume: Volume) -> SurfaceColours:
    """The colours of a scene's ``volume``, a segmentation. Raises SceneError and VolumeError."""
    raw = settings.text("axes", "") == "raw"
    grid, straight = volume_grids(settings, settings.source.base, volume, raw)
    if straight.shape != volume.shape:
        raise VolumeError(f"The volume '{volume.name}' changed while it was read: try again once it is written.")
    found = Segmentation(grid, listed)
    matrix = matrix_into("segmentation", grid, grid, straight)
    stride = stride_of(volume.shape)
    codes = between(sampled(spread(found.codes), matrix, volume.shape, stride))
    step = 0.5 * stride
    return SurfaceColours(codes, (step, step, step), scale_of(found, volume.name))


def stride_of(shape: tuple[int, ...]) -> int:
    """How many voxels apart places with a label of their own lie."""
    stride = 1
    while math.prod(2 * places(n, stride) - 1 for n in shape) > PLACES:
        stride += 1
    return stride


def places(n: int, stride: int) -> int:
    """How many places a side of ``n`` voxels has."""
    return max(math.ceil((n - 1) / stride) + 1, 2)


def sampled(codes: np.ndarray, matrix: np.ndarray, shape: tuple[int, ...], stride: int) -> np.ndarray:
    """The nearest of ``codes`` at every ``stride``-th voxel of a volume of a ``shape``, its last ones at its end."""
    z, y, x = (np.minimum(np.arange(places(n, stride)) * stride, n - 1) for n in shape)
    return np.stack([nearest_layer(codes, matrix, (x, y[:, None]), int(layer)) for layer in z])


def spread(codes: np.ndarray) -> np.ndarray:
    """The codes, and in voxels without one that of a voxel near by, SPREAD voxels along each axis at most."""
    grown = codes.copy()
    for _ in range(SPREAD):
        for axis in range(3):
            before = np.moveaxis(grown.copy(), axis, 0)
            after = np.moveaxis(grown, axis, 0)
            for into, come in ((after[1:], before[:-1]), (after[:-1], before[1:])):
                np.copyto(into, come, where=into == 0)
    return grown


def between(codes: np.ndarray) -> np.ndarray:
    """The codes with places half-way between: there the code that all places beside it share, else none."""
    for axis in range(3):
        old = np.moveaxis(codes, axis, 0)
        wide = np.empty((2 * len(old) - 1, *old.shape[1:]), np.uint8)
        wide[::2], wide[1::2] = old, np.where(old[1:] == old[:-1], old[1:], 0)
        codes = np.moveaxis(wide, 0, axis)
    return np.ascontiguousarray(codes)


def scale_of(found: Segmentation, name: str) -> Scale:
    """The labels as a table of albedos; places between two of them have the mean of those that are shown."""
    shown = [capped(label.colour) for label in found.labels if label.shown]
    outside: Colour = capped(np.mean(shown, axis=0).tolist())
    table = np.tile(outside, (VALUES, 1))
    table[: len(shown)] = shown
    values = [label.value for label in found.labels if label.shown]
    return Scale(name, (float(values[0]), float(values[-1])), "labels", table, outside, found.labels)
