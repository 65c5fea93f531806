"""Colours of a scene by data: the table [[volumes]] with use = "colour", and its values at the
voxels of the scene's volume.

Colours of labels: each place has the two labels of greatest weight around it, so that seams between
labels are smooth. Labels are weighted by the Gaussian that smooths their field, whose surface is
theirs; if places lie several voxels apart, the Gaussian is as many times wider. Frames and paths
interpolate the shares of both labels and take the colour of the greatest (``label_albedo``): where
two labels touch, the colour changes on a surface as smooth as the visible one, and no third label
appears between them.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from isogi_core.errors import SceneError, VolumeError
from isogi_core.files.grid import Affine, Grid, on_right_angles
from isogi_core.files.mappings import require_memory
from isogi_core.files.scene_file import DEFAULT_DEMO, Settings, are_numbers
from isogi_core.files.vector import triple
from isogi_core.kernels.transport.colours import sample_layer, slope_layer, weigh_labels
from isogi_core.model.colours import (
    COLOUR_MAPS,
    MAX_ALBEDO,
    VALUES,
    Scale,
    SurfaceColours,
    spread_colours,
    table_of,
)
from isogi_core.model.lights import Colour
from isogi_core.model.volume import Isovalue, Volume
from isogi_core.plan.volumes.labels import SIGMA, SMOOTHING_REACH, LabelTable, Segmentation
from isogi_core.plan.volumes.masks import matrix_into, nearest_layer
from isogi_core.plan.volumes.opening import open_beside, open_own, stem_of

OF = ("gradient", "curvature")
"""Quantities of the scene's volume that colours can show."""

CURVATURE_BLUR = 1.5
"""Standard deviation in voxels of the Gaussian that curvature is smoothed with: without it
curvature would show the steps between voxels.
"""

MOST_CODES = 1 << 26
"""Most places of a grid of codes: a larger volume has one every few voxels."""

SAMPLED_LAYERS = 48
"""Number of layers of the volume from which the usual range of values is found."""

COLOUR_PERCENTILES = (1.0, 99.0)
"""Percentiles of the values on the surface that views start with: the range of a scene that
gives none.
"""

USUAL_EVEN = 90.0
"""Percentile of the magnitudes of values around 0 that is the end of their range."""

MIN_PERCENTILE_VALUES = 64
"""Least number of values from which percentiles are taken."""

FillPlane = Callable[[float, np.ndarray, np.ndarray], None]
"""Function of z, step and values that fills ``values`` (ny, nx) float32 at places in the plane z of
the scene's volume; NaN if a place has none.

``z`` is in voxels, and the places are ``step`` (3,) voxels apart along x, y and z.
"""


@dataclass(frozen=True)
class ColourTable:
    """The table [[volumes]] of colours: its ``file``, or ``of``, one of OF, for values of the
    scene's volume.

    ``map`` is None if the scene gives ``colours``; ``span`` is None if the values on the surface
    decide. ``outside`` is the albedo of places without a value.
    """

    file: str
    of: str | None
    name: str
    map: str | None
    colours: tuple[Colour, ...]
    span: tuple[float, float] | None
    outside: Colour


def find_table(settings: Settings) -> ColourTable | None:
    """Find and read the table of a scene's colours; None if it has none. Raises SceneError."""
    tables = [
        table
        for table in settings.nested("volumes")
        if table.source.document.get("use") == "colour"
    ]
    if not tables:
        return None
    if len(tables) > 1:
        raise SceneError(
            f"The scene '{settings.source.name}' has {len(tables)} volumes of colour: give one."
        )
    return read_colour_table(tables[0])


def read_colours(
    table: ColourTable, settings: Settings, volume: Volume, isovalue: float
) -> SurfaceColours:
    """Read the colours of a scene by its ``table``. ``volume`` is all of its volume, before a cut;
    views start at ``isovalue``, in the file's units.

    Raises SceneError, and VolumeError if a file cannot be read.
    """
    name, fill, factor = source_of(table, settings, volume)
    return coloured(table, name, volume, fill, factor, volume.normalise_isovalue(isovalue))


def read_colour_table(table: Settings) -> ColourTable:
    """Read the ``table`` of colours. Raises SceneError, also for unknown keys."""
    source = table.source
    table.choice("use", ("colour",))
    file = table.text("file", "")
    of = table.choice("of", OF)
    if bool(file) == (of is not None):
        raise SceneError(
            f"Colours in the scene '{source.name}' need a file, or of = 'gradient' or "
            "'curvature': give one."
        )
    # Colours are a named map, or a list; without either the map is chosen below.
    named = table.choice("map", tuple(COLOUR_MAPS))
    listed = source.document.get("colours")
    colours: tuple[Colour, ...] = ()
    if listed is not None:
        colours = listed_colours(listed, source.name)
    if named and colours:
        raise SceneError(f"The scene '{source.name}' gives a map and colours: leave one out.")
    table.known.add("colours")
    span = table.span("range", -math.inf, math.inf)
    name = table.text("name", "")
    outside = table.colour("outside", 0.5)
    table.refuse_unknown()
    # Curvature has two signs, for which a map of two colours suits; other values ascend.
    if of == "curvature":
        usual = "coolwarm"
    else:
        usual = "viridis"
    return ColourTable(
        file, of, name, named or (None if colours else usual), colours, span, capped(outside)
    )


def listed_colours(listed: Any, scene: str) -> tuple[Colour, ...]:
    """Read a list of two or more albedos of a ``scene``. Raises SceneError."""
    whole = isinstance(listed, list) and 2 <= len(listed) <= VALUES
    if not whole or not all(map(is_albedo, listed)):
        raise SceneError(
            f"colours in the scene '{scene}' is not a list of 2 to {VALUES} albedos [r, g, b] "
            "from 0 to 1."
        )
    return tuple(map(capped, listed))


def is_albedo(each: Any) -> bool:
    """Return True for a list of three shares from 0 to 1."""
    return are_numbers(each, 3) and all(0 <= share <= 1 for share in each)


def capped(albedo: Colour | list[float]) -> Colour:
    """Limit an albedo to MAX_ALBEDO."""
    return triple(np.minimum(albedo, MAX_ALBEDO))


def source_of(
    table: ColourTable, settings: Settings, volume: Volume
) -> tuple[str, FillPlane, float]:
    """Return the source of the values that colours show, by a scene's ``table``: their name, a
    function that fills a plane with them, and a factor.

    Filled values times the factor are in the units of the table's file; gradient and curvature are
    in those of ``layers_of``. ``volume`` is all of the scene's volume, before a cut. Raises
    SceneError and VolumeError.
    """
    if table.of is not None:
        return table.of, *layers_of(table.of, volume)
    voxels, matrix = placed_file(table.file, settings, volume)

    def _sample(z: float, step: np.ndarray, values: np.ndarray) -> None:
        """Fill a plane with the file's values."""
        sample_layer(voxels, matrix, z, step, values)

    return stem_of(Path(table.file), {}), _sample, 1.0


def layers_of(of: str, volume: Volume) -> tuple[FillPlane, float]:
    """Return a function that fills a plane with gradient or curvature ``of`` the ``volume``, and
    the factor that brings its values to units of the file: values per length, or 1 over length.
    """
    # In units of the shortest spacing, slopes stay far from the limits of float32.
    shortest = min(volume.spacing)
    spacing = np.array(volume.spacing) / shortest

    def _slope(z: float, step: np.ndarray, values: np.ndarray) -> None:
        """Fill a plane with the length of the gradient."""
        slope_layer(volume.voxels, spacing, z, step, values)

    def _bend(z: float, step: np.ndarray, values: np.ndarray) -> None:
        """Fill a plane with the mean curvature of the isosurfaces through its places."""
        # Curvature smooths over neighbours, so find it at all voxels of the plane, and then take
        # the places that are a step apart.
        whole = mean_curvature(volume.voxels, spacing, int(z))
        places = [
            np.minimum(np.arange(n) * int(step[0]), m - 1)
            for n, m in zip(values.shape, whole.shape, strict=True)
        ]
        values[:] = whole[np.ix_(*places)]

    if of == "gradient":
        return (_slope, abs(volume.scale) / shortest)
    return (_bend, 1.0 / shortest)


def mean_curvature(voxels: np.ndarray, spacing: np.ndarray, z: int) -> np.ndarray:
    """Return the mean curvature of the isosurfaces through the voxels of layer ``z``, per unit of
    ``spacing``; (ny, nx).

    H = (gᵀ∇²ρ g − |g|² Δρ) / 2|g|³ with g = ∇ρ, smoothed: 1/r on a ball of radius r, negative in
    hollows, NaN if g is 0. Source: Kindlmann et al., "Curvature-based transfer functions for direct
    volume rendering", 2003.
    """
    # Combine the layers around z with each of the three weights; derivatives along y and x follow
    # layer by layer.
    weights = gaussian_derivatives(CURVATURE_BLUR).astype(np.float32)
    around = np.clip(z + np.arange(weights.shape[1]) - weights.shape[1] // 2, 0, len(voxels) - 1)
    along_z = np.tensordot(weights, voxels[around].astype(np.float32), 1)

    def _derivative(x: int, y: int, z: int) -> np.ndarray:
        """Return the derivative of these orders along each axis, smoothed; (ny, nx)."""
        found = combine_rows(combine_rows(along_z[z], weights[y]).T, weights[x]).T
        return np.asarray(found / np.float32(np.prod(spacing ** (x, y, z))))

    gx, gy, gz = _derivative(1, 0, 0), _derivative(0, 1, 0), _derivative(0, 0, 1)
    xx, yy, zz = _derivative(2, 0, 0), _derivative(0, 2, 0), _derivative(0, 0, 2)
    xy, xz, yz = _derivative(1, 1, 0), _derivative(1, 0, 1), _derivative(0, 1, 1)
    # gᵀ∇²ρ g from first and second derivatives.
    square = gx * gx + gy * gy + gz * gz
    along = (
        gx * gx * xx
        + gy * gy * yy
        + gz * gz * zz
        + 2.0 * (gx * gy * xy + gx * gz * xz + gy * gz * yz)
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray((along / square - (xx + yy + zz)) / (2.0 * np.sqrt(square)))


def gaussian_derivatives(sigma: float) -> np.ndarray:
    """Return the weights of samples in a row in a Gaussian mean at the middle one, and in its first
    two derivatives; (3, n) float64.

    They are exact on parabolas: of 1, x and x² / 2 they give 1, 1 and 1.
    """
    reach = math.ceil(3.0 * sigma)
    x = np.arange(-reach, reach + 1.0)
    bell = np.exp(-0.5 * (x / sigma) ** 2)
    bell /= bell.sum()
    second = bell * (x**2 - (bell * x**2).sum())
    return np.stack([bell, bell * x / (bell * x**2).sum(), second / (0.5 * second * x**2).sum()])


def combine_rows(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return weighted sums of each row of ``values`` (n, m) with the rows around it, by an odd
    number of ``weights``; rows beyond the ends equal the outermost.
    """
    reach = len(weights) // 2
    count = len(values)
    padded = np.pad(values, ((reach, reach), (0, 0)), mode="edge")
    return np.asarray(
        sum(weight * padded[i : i + count] for i, weight in enumerate(weights.tolist()))
    )


def placed_file(file: str, settings: Settings, volume: Volume) -> tuple[np.ndarray, np.ndarray]:
    """Read the values (nz, ny, nx) float32 in a ``file`` of colours; return them and the matrix
    (3, 4) from the volume's voxel indices to theirs.
    """
    grid = open_beside(settings, file)
    whole, straight = volume_grids(settings, volume)
    matrix = np.ascontiguousarray(matrix_into(f"volume of colour '{file}'", grid, whole, straight))
    require_memory(4 * grid.size, f"The volume of colour '{file}' takes", "give a coarser one")
    with np.errstate(over="ignore"):
        values = np.ascontiguousarray(grid.whole(), np.float32)
    return np.where(np.isfinite(values), values, np.float32(np.nan)), matrix


def volume_grids(settings: Settings, volume: Volume) -> tuple[Grid, Grid]:
    """Return the grid of the scene's volume as its file has it, and the same on right angles."""
    spacing = settings.numbers("spacing", 3)
    if settings.text("volume", DEFAULT_DEMO).startswith("demo:"):
        grid = Grid.of(volume.voxels, volume.spacing)
        return grid, grid
    grid, _ = open_own(settings)
    # Another spacing would move the volume in the world, but not the file of colours.
    if spacing and grid.affine is not None:
        raise SceneError(
            "spacing moves the volume away from its colours: leave it out, or add axes = 'raw'."
        )
    if volume.cell is not None:
        # a field that repeats lies as its cells were set, side by side and with a margin
        orientation = volume.orientation
        place = Affine.of(orientation.affine(volume.spacing), orientation.letters)
        return grid, replace(Grid.of(volume.voxels, volume.spacing), affine=place)
    return grid, on_right_angles(grid, spacing)


def coloured(
    table: ColourTable,
    name: str,
    volume: Volume,
    fill: FillPlane,
    factor: float,
    isovalue: Isovalue,
) -> SurfaceColours:
    """Return the colours of a ``volume`` by values that a function ``fill`` gives, times the
    ``factor``.
    """
    # A large volume has codes some voxels apart.
    step = max(math.ceil((math.prod(volume.shape) / MOST_CODES) ** (1.0 / 3.0)), 1)
    source = table.file or f"its {table.of}"
    span = table.span or usual_span(
        volume, fill, factor, isovalue, source, even=table.of == "curvature"
    )
    shape = [max(math.ceil((n - 1) / step) + 1, 2) for n in volume.shape]
    codes = np.empty(shape, np.uint8)
    values = np.empty(shape[1:], np.float32)
    steps = np.full(3, float(step))
    # Fill a plane at a time with values, and keep their codes.
    for z in range(shape[0]):
        fill(float(min(z * step, volume.shape[0] - 1)), steps, values)
        codes[z] = codes_of(factor * values.astype(np.float64), span)
    if table.map:
        colours = table_of(table.map)
    else:
        colours = spread_colours(np.array(table.colours))
    scale = Scale(table.name or name, span, table.map or "own", colours, table.outside)
    return SurfaceColours(codes, (float(step),) * 3, scale)


def codes_of(values: np.ndarray, span: tuple[float, float]) -> np.ndarray:
    """Return the codes of ``values``: 1 at the low end of the ``span`` and below, 255 at the
    high end and above, 0 for NaN; uint8.
    """
    place = np.clip((values - span[0]) / (span[1] - span[0]), 0.0, 1.0)
    return np.where(np.isnan(place), 0.0, 1.0 + np.rint(place * (VALUES - 1))).astype(np.uint8)


def usual_span(
    volume: Volume,
    fill: FillPlane,
    factor: float,
    isovalue: Isovalue,
    source: str,
    even: bool = False,
) -> tuple[float, float]:
    """Return the COLOUR_PERCENTILES of values at the surface of an ``isovalue``; of all values if
    that surface hardly exists.

    An ``even`` range has 0 in its middle. Raises SceneError if there is no value at all.
    """
    near = []
    everywhere = []
    for z in np.unique(np.linspace(0, volume.shape[0] - 1, SAMPLED_LAYERS).round()).astype(int):
        values = np.empty(volume.shape[1:], np.float32)
        fill(float(z), np.ones(3), values)
        # A voxel is at the surface if a neighbour along x or y is on the other side.
        inside = volume.voxels[z] > isovalue
        border = np.zeros_like(inside)
        border[:, :-1] |= inside[:, 1:] != inside[:, :-1]
        border[:-1] |= inside[1:] != inside[:-1]
        near.append(values[border & ~np.isnan(values)])
        everywhere.append(values[~np.isnan(values)][::7])
    found = np.concatenate(near)
    if len(found) < MIN_PERCENTILE_VALUES:
        found = np.concatenate(everywhere)
    if not len(found):
        raise SceneError(
            f"The volume has no value of '{source}' anywhere: check where both lie, or give "
            "another file."
        )
    low, high = (factor * np.percentile(found.astype(np.float64), COLOUR_PERCENTILES)).tolist()
    if even:
        high = factor * float(np.percentile(np.abs(found), USUAL_EVEN))
        low = -high
    # A single value gets a range around it.
    if low < high:
        return (low, high)
    return (low - 0.5 * (abs(low) or 1.0), low + 0.5 * (abs(low) or 1.0))


MAX_LABELLED_PLACES = 355**3
"""Most places with labels, of three bytes each: larger volumes have labels at every second
voxel, or fewer.
"""

MIDDLE_WEIGHT = 1024
"""Weight of the Gaussian's middle: weights are whole numbers, so that their sums are exact."""


def colours_of_labels(
    listed: tuple[LabelTable, ...], settings: Settings, volume: Volume
) -> SurfaceColours:
    """Return the colours of a scene whose file is a segmentation, with the ``listed`` labels.

    The labels are read from the file again: the ``volume`` holds the smooth field that was made
    from them. Raises VolumeError if the file has another shape than the ``volume`` by now, and
    SceneError or VolumeError if its labels cannot be shown.
    """
    grid, straight = volume_grids(settings, volume)
    if straight.shape != volume.shape:
        raise VolumeError(
            f"The volume '{volume.name}' changed while it was read: try again once it is written."
        )
    found = Segmentation(grid, listed)
    # The labels are in the volume's own file: the matrix leads from the volume, on right angles,
    # back to the file's grid.
    matrix = matrix_into("segmentation", grid, grid, straight)
    stride = stride_of(volume.shape)
    labels = weighed(sampled(found.codes, matrix, volume.shape, stride))
    return SurfaceColours(labels, (float(stride),) * 3, scale_of(found, volume.name))


def stride_of(shape: tuple[int, ...]) -> int:
    """Return the distance in voxels between places with labels, for a volume of ``shape``."""
    stride = 1
    while math.prod(places(n, stride) for n in shape) > MAX_LABELLED_PLACES:
        stride += 1
    return stride


def places(n: int, stride: int) -> int:
    """Return the number of places along a side of ``n`` voxels."""
    return max(math.ceil((n - 1) / stride) + 1, 2)


def sampled(
    codes: np.ndarray, matrix: np.ndarray, shape: tuple[int, ...], stride: int
) -> np.ndarray:
    """Return the nearest of ``codes`` at every ``stride``-th voxel of a volume of ``shape``;
    the last places lie at its end.
    """
    z, y, x = (np.minimum(np.arange(places(n, stride)) * stride, n - 1) for n in shape)
    return np.stack([nearest_layer(codes, matrix, (x, y[:, None]), int(layer)) for layer in z])


def weighed(codes: np.ndarray) -> np.ndarray:
    """Return the two heaviest labels around each place with ``codes`` (nz, ny, nx), and the share
    of the second, as ``SurfaceColours`` has them; (nz, ny, nx, 3) uint8.

    SIGMA and SMOOTHING_REACH of the Gaussian are counted in places here. A place without a label
    takes that of its neighbours within the reach: beyond, the field is zero.
    """
    # If all labels around a place are the same one, it needs no weights. Subtracting 1 turns the
    # code 0, no label, into the greatest, so that it does not count as the lowest.
    highest = _extreme(codes, np.maximum)
    lowest = _extreme(codes - np.uint8(1), np.minimum) + np.uint8(1)
    labels = np.zeros((*codes.shape, 3), np.uint8)
    labels[..., 0] = highest
    bell = np.rint(
        MIDDLE_WEIGHT
        * np.exp(-0.5 * (np.arange(-SMOOTHING_REACH, SMOOTHING_REACH + 1) / SIGMA) ** 2)
    ).astype(np.int64)
    weigh_labels(codes, np.ascontiguousarray(lowest < highest), bell, labels)
    return labels


def _extreme(codes: np.ndarray, extreme: np.ufunc) -> np.ndarray:
    """Return the ``extreme``, np.maximum or np.minimum, of the codes in the cube that extends
    SMOOTHING_REACH places to all sides of each place; (nz, ny, nx) uint8.

    The cube is cut off at the border.
    """
    # The extreme in a cube is the extreme along x of those along y of those along z.
    for axis in range(3):
        before = np.moveaxis(codes, axis, 0)
        after = before.copy()
        # Combine each place with those that are ``step`` before and after it.
        for step in range(1, min(SMOOTHING_REACH, len(before) - 1) + 1):
            extreme(after[step:], before[:-step], out=after[step:])
            extreme(after[:-step], before[step:], out=after[:-step])
        codes = np.moveaxis(after, 0, axis)
    return codes


def scale_of(found: Segmentation, name: str) -> Scale:
    """Return the colour scale of the labels of a segmentation, with a ``name`` for its legend.

    Places far from all labels have the mean albedo of the shown ones.
    """
    shown = [capped(label.colour) for label in found.labels if label.shown]
    outside: Colour = capped(np.mean(shown, axis=0).tolist())
    # The shown label with code k has row k - 1. No place has a higher code: the mean in the other
    # rows only keeps the table grey if all labels are grey.
    table = np.tile(outside, (VALUES, 1))
    table[: len(shown)] = shown
    values = [label.value for label in found.labels if label.shown]
    return Scale(
        name, (float(values[0]), float(values[-1])), "labels", table, outside, found.labels
    )
