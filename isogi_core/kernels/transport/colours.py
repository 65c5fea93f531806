"""Albedos of an isosurface from a grid of data values or labels and a colour table."""

from typing import Any, NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel, record
from isogi_core.kernels.tracing.field import VOXEL_ARRAY, clamp_cell, smooth_gradient, value
from isogi_core.kernels.tracing.vec import length

NO_VALUE = 0
"""Code of a place without a value."""

LAST_CODE = 255
"""Code of the highest value; the lowest has code 1."""

LABEL_SHARE = 1.0 / 510.0
"""Unit of the byte that holds the share of the second label; the share is 0.5 at most."""

SLACK = 1e-6
"""Distance in voxels outside of a volume at which a place still counts as on its border."""


class Colours(NamedTuple):
    """A grid of ``codes`` uint8 (nz, ny, nx) of values, or of ``labels`` uint8 (nz, ny, nx, 3); the
    other is empty.

    Places lie ``step`` (3,) voxels apart along x, y, z. A place has two labels, and the share of
    the second in units of LABEL_SHARE. ``table`` (256, 3) float64 holds the linear RGB albedo of
    each code; its first row belongs to NO_VALUE.
    """

    codes: Any
    labels: Any
    step: Any
    table: Any


NO_CODES = np.zeros((0, 0, 0), np.uint8)
NO_LABELS = np.zeros((0, 0, 0, 3), np.uint8)
NO_COLOURS = Colours(NO_CODES, NO_LABELS, np.ones(3), np.zeros((0, 3)))
COLOURS_RECORD = record(
    Colours,
    types.uint8[:, :, ::1],
    types.uint8[:, :, :, ::1],
    types.float64[::1],
    types.float64[:, ::1],
)


def colours_of(places: np.ndarray, step: tuple[float, float, float], table: np.ndarray) -> Colours:
    """Make Colours of ``places``: codes (nz, ny, nx), or labels (nz, ny, nx, 3)."""
    if places.ndim == 3:
        codes = places
        labels = NO_LABELS
    else:
        codes = NO_CODES
        labels = places
    return Colours(codes, labels, np.array(step), table)


@kernel()
def known_code(codes, p):
    """Interpolate the codes at ``p``, in steps of the grid, over corners that have a value;
    return (code, weight of these corners).
    """
    nz, ny, nx = codes.shape
    i, j, k = clamp_cell(p[0], nx), clamp_cell(p[1], ny), clamp_cell(p[2], nz)
    x = min(max(p[0] - i, 0.0), 1.0)
    y = min(max(p[1] - j, 0.0), 1.0)
    z = min(max(p[2] - k, 0.0), 1.0)
    known = 0.0
    total = 0.0
    for c in range(2):
        for b in range(2):
            for a in range(2):
                # Leave out corners without a value.
                code = codes[k + c, j + b, i + a]
                weight = (x if a else 1.0 - x) * (y if b else 1.0 - y) * (z if c else 1.0 - z)
                if code != NO_VALUE:
                    known = known + weight
                    total = total + weight * code
    return (total / known if known > 0.0 else 1.0), known


@kernel()
def next_label(labels, p, after):
    """Return the least label above ``after`` at the corners of the cell at ``p``, and its trilinear
    weight.

    ``p`` is in steps of the grid. The label is LAST_CODE + 1 if there is none.
    """
    nz, ny, nx = labels.shape[:3]
    i, j, k = clamp_cell(p[0], nx), clamp_cell(p[1], ny), clamp_cell(p[2], nz)
    x = min(max(p[0] - i, 0.0), 1.0)
    y = min(max(p[1] - j, 0.0), 1.0)
    z = min(max(p[2] - k, 0.0), 1.0)
    least = LAST_CODE + 1
    total = 0.0
    for corner in range(8):
        a = corner & 1
        b = corner >> 1 & 1
        c = corner >> 2
        weight = (x if a else 1.0 - x) * (y if b else 1.0 - y) * (z if c else 1.0 - z)
        # Each corner has two labels, with the shares 1 - second and second.
        second = LABEL_SHARE * labels[k + c, j + b, i + a, 2]
        for which in range(2):
            label = np.int64(labels[k + c, j + b, i + a, which])
            # Start the sum again if a lower label is found, else add to it.
            if after < label <= least:
                total = (total if label == least else 0.0) + weight * (
                    second if which else 1.0 - second
                )
                least = label
    return least, total


@kernel()
def label_albedo(colours, p):
    """Blend the albedos of labels at ``p``, in steps of the grid: W Σ w⁸ c / Σ w⁸ + (1 - W) c₀ over
    their trilinear weights w.

    W = Σ w is the share of labelled places at the corners around, and c₀ the colour of NO_VALUE.
    The power makes one colour change to the next within a quarter of a step, along a smooth seam of
    equal weights.
    """
    known = 0.0
    total = 0.0
    r = 0.0
    g = 0.0
    b = 0.0
    label, share = next_label(colours.labels, p, NO_VALUE)
    # Go through the labels of the cell in ascending order.
    while label <= LAST_CODE:
        weight = share**8
        colour = colours.table[label]
        r, g, b = r + weight * colour[0], g + weight * colour[1], b + weight * colour[2]
        known = known + share
        total = total + weight
        label, share = next_label(colours.labels, p, label)
    if total > 0.0:
        part = known / total
    else:
        known = 0.0
        part = 0.0
    # ``part`` scales Σ w⁸ c to the share of labelled places; the rest has the colour of NO_VALUE.
    rest = 1.0 - known
    outside = colours.table[NO_VALUE]
    return part * r + rest * outside[0], part * g + rest * outside[1], part * b + rest * outside[2]


@kernel()
def albedo_at(colours, p):
    """Return the linear RGB albedo of the surface at ``p`` in index space,
    from the table by code or labels.
    """
    table = colours.table
    step = colours.step
    place = (p[0] / step[0], p[1] / step[1], p[2] / step[2])
    if colours.labels.shape[0] > 0:
        return label_albedo(colours, place)
    code, known = known_code(colours.codes, place)
    # Interpolate the table between two codes; code 0 stands for the rest of the weights.
    low = min(max(int(code), 1), LAST_CODE - 1)
    share = code - low
    r = (
        known * (table[low, 0] + share * (table[low + 1, 0] - table[low, 0]))
        + (1.0 - known) * table[0, 0]
    )
    g = (
        known * (table[low, 1] + share * (table[low + 1, 1] - table[low, 1]))
        + (1.0 - known) * table[0, 1]
    )
    b = (
        known * (table[low, 2] + share * (table[low + 1, 2] - table[low, 2]))
        + (1.0 - known) * table[0, 2]
    )
    return r, g, b


@kernel(types.void(COLOURS_RECORD, types.float32[:, ::1], types.float32[:, ::1]))
def fill_albedos(colours, points, albedos):
    """Fill ``albedos`` (m, 3), linear RGB, of surface ``points`` (m, 3) in index space."""
    for m in range(points.shape[0]):
        p = (np.float64(points[m, 0]), np.float64(points[m, 1]), np.float64(points[m, 2]))
        albedos[m, 0], albedos[m, 1], albedos[m, 2] = albedo_at(colours, p)


@kernel(
    types.void(
        VOXEL_ARRAY, types.float64[:, ::1], types.float64, types.float64[::1], types.float32[:, ::1]
    )
)
def sample_layer(voxels, matrix, z, step, values):
    """Resample ``voxels`` at layer ``z`` of another grid into ``values`` (ny, nx); NaN outside.

    Places are ``step`` (3,) voxels of the other volume apart. ``matrix`` (3, 4) maps voxel indices
    x, y, z of that volume to those of ``voxels``. Interpolation is trilinear.
    """
    nz, ny, nx = voxels.shape
    for row in range(values.shape[0]):
        for column in range(values.shape[1]):
            x, y = column * step[0], row * step[1]
            # Map the place to the other volume.
            a = matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2] * z + matrix[0, 3]
            b = matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2] * z + matrix[1, 3]
            c = matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2] * z + matrix[2, 3]
            inside = a >= -SLACK and b >= -SLACK and c >= -SLACK
            inside = inside and a <= nx - 1 + SLACK and b <= ny - 1 + SLACK and c <= nz - 1 + SLACK
            if inside:
                values[row, column] = value(voxels, (a, b, c))
            else:
                values[row, column] = np.nan


@kernel(
    types.void(
        VOXEL_ARRAY, types.float64[::1], types.float64, types.float64[::1], types.float32[:, ::1]
    )
)
def slope_layer(voxels, spacing, z, step, values):
    """Fill ``values`` (ny, nx) with |∇ρ| per world unit at places of layer ``z`` that lie ``step``
    apart.

    The gradient is smoothed with the tricubic B-spline, as normals are (S1, fig. 5). ``spacing``
    (3,) belongs to the ``voxels``.
    """
    for row in range(values.shape[0]):
        for column in range(values.shape[1]):
            g = smooth_gradient(voxels, (column * step[0], row * step[1], z))
            values[row, column] = length((g[0] / spacing[0], g[1] / spacing[1], g[2] / spacing[2]))


@kernel(
    types.void(
        types.uint8[:, :, ::1],
        types.boolean[:, :, ::1],
        types.int64[::1],
        types.uint8[:, :, :, ::1],
    )
)
def weigh_labels(codes, mixed, bell, labels):
    """Fill ``labels`` (nz, ny, nx, 3) of ``mixed`` places with the two heaviest labels nearby and
    the second's share.

    Each of the ``codes`` (nz, ny, nx) has the weight of the ``bell`` (2r + 1,) along each axis, in
    integers, so that sums do not depend on the orientation of the volume. NO_VALUE has no weight.
    The share is that of the second label among both, in units of LABEL_SHARE. Border places repeat
    beyond the volume.
    """
    nz, ny, nx = codes.shape
    reach = len(bell) // 2
    weights = np.zeros(LAST_CODE + 1, np.int64)
    for k, j, i in np.argwhere(mixed):
        weights[:] = 0
        # Sum the weights of all labels within the bell.
        for c in range(len(bell)):
            z = min(max(k + c - reach, 0), nz - 1)
            for b in range(len(bell)):
                y = min(max(j + b - reach, 0), ny - 1)
                weight = bell[b] * bell[c]
                for a in range(len(bell)):
                    weights[codes[z, y, min(max(i + a - reach, 0), nx - 1)]] += bell[a] * weight
        weights[NO_VALUE] = 0
        # Keep the two heaviest.
        first = np.argmax(weights)
        weight = weights[first]
        weights[first] = 0
        second = np.argmax(weights)
        share = weights[second] / (weight + weights[second])
        labels[k, j, i, 0] = first
        labels[k, j, i, 1] = second
        labels[k, j, i, 2] = np.uint8(share / LABEL_SHARE + 0.5)
