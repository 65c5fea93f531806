"""TIFF stacks, OME-TIFF and folders of slices, read by tifffile."""

import re
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from isogi_core.errors import VolumeError
from isogi_core.files.coordinates import SPACING_KEY
from isogi_core.files.formats.source import (
    LAYERED,
    LUMINANCE_NOTE,
    TIME_STEPS,
    Source,
    library,
    luminance_of_colours,
    pick,
    pick_step,
    read_numbers,
    reader,
    reading,
)
from isogi_core.files.grid import SINGLE_MOMENT, Grid, Shape
from isogi_core.files.packed_files import stamp_of
from isogi_core.files.packing import Packing, Scaling, holed
from isogi_core.files.units import LENGTHS

TIFF_SUFFIXES = (".tif", ".tiff")
TIFF_UNITS = {
    "micron": "µm",
    "um": "µm",
    "\\u00B5m": "µm",
    "µm": "µm",
    "nm": "nm",
    "mm": "mm",
    "cm": "cm",
    "pixel": "",
}
PLANE_AXES = "YX"
COLOUR_AXIS = "S"
COLOUR_PAGES = (PLANE_AXES + COLOUR_AXIS, COLOUR_AXIS + PLANE_AXES)
"""Axes of pages of colours: each voxel's together, or plane by plane."""

TIME_AXIS = "T"
REPEAT_AXIS = "R"
CHANNEL_AXES = "CL"
DEPTH_AXIS = "Z"
"""Letters of axes along which a field is chosen; other ones before y and x are z, as Z is."""

PLANE_COUNTS = {
    TIME_AXIS: TIME_STEPS,
    **dict.fromkeys(REPEAT_AXIS, TIME_STEPS),
    **dict.fromkeys(CHANNEL_AXES, "channels"),
}
"""Names for planes along an axis that is no depth."""


@reader("TIFF", "time", "channel", "series")
def open_tiff(source: Source) -> Grid:
    """Open the first series of a TIFF file as a grid: only its description is read now. Raises
    VolumeError.
    """
    tifffile = library("tifffile", "TIFF")
    with source.open() as file, tifffile.TiffFile(file, name=source.name) as whole:
        series = _series(source, whole)
        axes = series.axes
        shape = tuple(int(n) for n in series.shape)
        dtype = series.dtype
        pages, moment = _pages(source, axes, shape)
        coloured = COLOUR_AXIS in axes
        (ny, nx) = (shape[axes.rindex(axis)] for axis in PLANE_AXES)
        _check_page(source, series, coloured)
        source.check((len(pages), ny, nx))
        found = _spacing(whole)
        spacing, unit, assumed = found
        others = _others(source, whole)
        if whole.is_ome:
            kind = "OME-TIFF"
        elif whole.is_imagej:
            kind = "ImageJ's TIFF"
        else:
            kind = "TIFF"
        packing = _calibrated(
            _packing(series.keyframe, dtype, coloured), whole.imagej_metadata or {}
        )
    slabs = partial(_page_slabs, source, pages, (ny, nx), packing)
    guess, doubt = _layers_of(axes, shape)
    notes = ((LUMINANCE_NOTE,) if coloured else packing.notes) + doubt + assumed + others
    if found is NOTHING_SAID:
        placed = ""
    elif kind != "TIFF":
        placed = f"{kind}'s sizes of voxels"
    else:
        placed = "its resolution"
    known = packing.read_as(kind, placed) + guess
    grid = Grid(
        (len(pages), ny, nx),
        packing.dtype,
        spacing,
        slabs,
        source.stamp,
        None,
        unit,
        notes,
        read_as=known,
    )
    return replace(
        grid, moment=moment, unchosen=moment != SINGLE_MOMENT and source.count("time") is None
    )


def _layers_of(axes: str, shape: Shape) -> tuple[str, tuple[str, ...]]:
    """Return a phrase for ``read_as`` on the axis along which planes are stacked, and a note if the
    file says that it is no depth.

    A film of planes is no volume: its frames are shown as layers, as there is no other picture of
    it.
    """
    outer = [
        axis
        for axis, length in zip(axes, shape, strict=False)
        if length > 1 and axis not in PLANE_AXES + COLOUR_AXIS
    ]
    if len(outer) != 1 or outer[0] == DEPTH_AXIS:
        return "", ()
    what = PLANE_COUNTS.get(outer[0])
    return (
        "; its planes are taken for depth",
        () if what is None else (LAYERED.format(what=what),),
    )


def _calibrated(packing: Packing, about: Mapping[str, Any]) -> Packing:
    """Return the packing with ImageJ's calibration of values if that is a straight line; with a
    note if it is another.
    """
    kind = about.get("cf")
    (offset, slope) = (about.get(name) for name in ("c0", "c1"))
    if kind is None or int(kind) in UNCALIBRATED_FUNCTIONS:
        return packing
    if int(kind) != STRAIGHT_LINE or offset is None or slope is None:
        return replace(
            packing,
            notes=(*packing.notes, "ImageJ's calibration of values is no straight line: left out."),
        )
    scaling = Scaling(float(slope), float(offset))
    notes = (
        ()
        if scaling.trivial
        else (f"Values are {slope:g} · stored + {offset:g}, ImageJ's calibration.",)
    )
    return replace(packing, scaling=scaling, notes=(*packing.notes, *notes))


STRAIGHT_LINE = 0
UNCALIBRATED_FUNCTIONS = (20, 21)
"""ImageJ's numbers of calibration functions. Source: ij.measure.Calibration."""

NO_DATA = 42113
"""The tag in which geographers' files name the value of pixels without data, as text. Source:
GDAL's GeoTIFF driver.
"""


def _packing(page: Any, stored: np.dtype[Any], coloured: bool) -> Packing:
    """Return how the numbers of a ``page`` stand for values: as they are ``stored``, but one number
    may mean that a pixel has no data. Colours become their luminance.
    """
    if coloured:
        return Packing(np.dtype(np.float32))
    tag = page.tags.get(NO_DATA)
    if tag is None:
        text = ""
    else:
        text = str(tag.value).strip("\0 ")
    # A tag that holds no number is left out.
    try:
        return holed(stored, [float(text)] if text else [], "no data")
    except ValueError:
        return Packing(stored)


def _series(source: Source, whole: Any) -> Any:
    """Return the series that is chosen, the first by default."""
    number = source.count("series") or 0
    first = whole.series[0]
    if len(whole.series) > 1 and "series" not in source.chosen and _is_stack(whole.series):
        pages = [each.pages[0] for each in whole.series]  # planes that were written one by one
        kind = type(first)
        return kind(pages, (len(pages), *first.shape), first.dtype, f"Q{first.axes}", name="planes")
    if number >= len(whole.series):
        raise VolumeError(f"'{source.name}' has series 0 to {len(whole.series) - 1}, not {number}.")
    return whole.series[number]


def _others(source: Source, whole: Any) -> tuple[str, ...]:
    """Say which other series a file has, if none is chosen."""
    if len(whole.series) < 2 or "series" in source.chosen or _is_stack(whole.series):
        return ()
    sizes = [" × ".join(map(str, each.shape[::-1])) for each in whole.series[1:4]]
    listed = ", ".join(f"#series={n} {size}" for n, size in enumerate(sizes, 1))
    return (f"The first of {len(whole.series)} series is shown: there is also {listed}.",)


def _is_stack(series: Any) -> bool:
    """Return True if all series are planes, of one size and type."""
    kinds = {(each.axes, each.shape, each.dtype) for each in series}
    return len(kinds) == 1 and series[0].axes in (PLANE_AXES, PLANE_AXES + COLOUR_AXIS)


def _pages(source: Source, axes: str, shape: Shape) -> tuple[list[int], tuple[int, int]]:
    """Return the numbers of the planes that make up the field that is chosen, in its order along z,
    and its moment.
    """
    inner = next((each for each in COLOUR_PAGES if axes.endswith(each)), PLANE_AXES)
    if not axes.endswith(inner) or (inner == PLANE_AXES and len(axes) < 3):
        raise VolumeError(f"'{source.name}' has the axes {axes}: save a stack of planes.")
    outer = list(zip(axes.removesuffix(inner), shape, strict=False))
    alone = (
        sum(length > 1 for _, length in outer) == 1
    )  # a stack without z: planes are one upon the other
    picks: list[Any] = [_pick(source, axis, length, alone) for axis, length in outer]
    times = [
        (step, n)
        for (axis, n), step in zip(outer, picks, strict=True)
        if axis == TIME_AXIS and n > 1 and not alone
    ]
    numbers = np.arange(int(np.prod([n for _, n in outer]))).reshape([n for _, n in outer])[
        tuple(picks)
    ]
    if numbers.ndim > 1 and sum(n > 1 for n in numbers.shape) > 1:
        raise VolumeError(f"'{source.name}' has the axes {axes}: save one scalar field of it.")
    return [int(number) for number in numbers.ravel()], (times or [SINGLE_MOMENT])[0]


def _pick(source: Source, axis: str, length: int, alone: bool) -> Any:
    """Return the part that is taken along an axis: all of z, or of an axis that is ``alone``, else
    the element that is chosen.
    """
    if alone and length > 1:
        return slice(None)
    if axis == TIME_AXIS:
        return pick_step(source, length)[0]
    if axis in REPEAT_AXIS:
        key = "time"
    elif axis in CHANNEL_AXES:
        key = "channel"
    else:
        key = None
    if key is None:
        return slice(None)
    return pick(source, key, length, f"elements of {key}")


def _check_page(source: Source, series: Any, coloured: bool) -> None:
    """Raise VolumeError if pages of a series cannot be those of a volume."""
    page = series.keyframe
    if int(page.photometric) == 3:
        raise VolumeError(f"'{source.name}' holds colours of a palette: save its values.")
    if coloured and page.axes not in COLOUR_PAGES:
        raise VolumeError(f"'{source.name}' holds pages of {page.axes}: save a plane a page.")
    planes = 3 if coloured else 2
    if len([n for n in page.shape if n > 1]) > planes:
        raise VolumeError(f"'{source.name}' holds pages of {page.axes}: save a plane a page.")


def _page_slabs(
    source: Source, pages: list[int], plane: Shape, packing: Packing
) -> Iterator[np.ndarray]:
    """Yield the planes of a series, one at a time; (1, ny, nx) each."""
    tifffile = library("tifffile", "TIFF")
    with source.open() as file, tifffile.TiffFile(file, name=source.name) as whole:
        series = _series(source, whole)
        for number in pages:
            yield packing.apply(_plane(source, whole, series, number, plane))[None]


def _plane(source: Source, whole: Any, series: Any, number: int, plane: Shape) -> np.ndarray:
    """Return one plane of a series: of its page, or of one page whose voxels hold the planes of
    all.
    """
    coloured = COLOUR_AXIS in series.axes
    if len(series.pages) == 1 and series.dataoffset is not None and number >= 0:
        count = int(np.prod(plane)) * (series.shape[-1] if coloured else 1)
        order = np.dtype(series.dtype).newbyteorder(whole.byteorder)
        whole.filehandle.seek(series.dataoffset + number * count * order.itemsize)
        values = read_numbers(whole.filehandle, source.name, count, order)
        values = values.reshape(*plane, *([series.shape[-1]] if coloured else []))
    else:
        page = series.pages[number]
        if page is None:
            raise VolumeError(f"Plane {number} of '{source.name}' is missing: write it again.")
        values = page.asarray()
        if page.axes == COLOUR_AXIS + PLANE_AXES:
            values = np.moveaxis(values, 0, -1)
    if coloured:
        return luminance_of_colours(values)
    return values.reshape(plane)


Spacing = tuple[tuple[float, float, float], str, tuple[str, ...]]
"""Steps along x, y, z, their unit, and notes on assumptions."""

NOTHING_SAID: Spacing = ((1.0, 1.0, 1.0), "", ())

PLANES_NOTE = (
    f"The file does not say how far planes lie apart, they are as far as pixels: {SPACING_KEY}."
)


def _spacing(whole: Any) -> Spacing:
    """Read spacing and unit as microscopists' files say them, else the resolution in pixels a
    centimetre: other files give one for printers, which is none.
    """
    if whole.is_ome:
        return _ome_spacing(whole.ome_metadata or "")
    page = whole.pages[0]
    y, x = (_resolution(page, name) for name in ("YResolution", "XResolution"))
    if whole.is_imagej:
        about = whole.imagej_metadata or {}
        unit = str(about.get("unit", ""))
        between = abs(float(about.get("spacing", 0.0)))
        if not between and (x, y) == (1.0, 1.0):
            return NOTHING_SAID
        notes = () if between else (PLANES_NOTE,)
        return (x, y, between or x), TIFF_UNITS.get(unit, unit), notes
    unit_tag = page.tags.get("ResolutionUnit")
    if unit_tag is not None and int(unit_tag.value) == CENTIMETRE:
        return (1e4 * x, 1e4 * y, 1e4 * x), "µm", (PLANES_NOTE,)
    return NOTHING_SAID


CENTIMETRE = 3
"""TIFF's number of the unit of resolution."""


def _resolution(page: Any, name: str) -> float:
    """Return the world units per pixel of a tag that gives pixels per unit."""
    tag = page.tags.get(name)
    above, below = tag.value if tag is not None else (1, 1)
    return below / above if above and below else 1.0


def _ome_spacing(text: str) -> Spacing:
    """Read physical sizes of the first image, in the unit of its x axis."""
    found = re.search(r"<(?:\w+:)?Pixels\b[^>]*>", text)
    if found:
        given = dict(re.findall(r'PhysicalSize(\w+)="([^"]*)"', found[0]))
    else:
        given = {}
    if not {"X", "Y"} <= set(given):
        return NOTHING_SAID
    units = [given.get(f"{axis}Unit", "µm") for axis in "XYZ" if axis in given]
    metres = [LENGTHS.get(unit.lower()) for unit in units]
    scales = [1.0 for _ in units]
    notes = () if "Z" in given else (PLANES_NOTE,)
    first = metres[0]
    if first is not None and None not in metres:
        scales = [(each or first) / first for each in metres]
    elif len(set(units)) > 1:
        notes = (*notes, f"Its axes are in {', '.join(units)}, taken as one unit: {SPACING_KEY}.")
    steps = [float(given[axis]) * scale for axis, scale in zip("XYZ", scales, strict=False)]
    x, y, z = (*steps, steps[0])[:3]
    return (x, y, z), units[0], notes


def slices_in(folder: Source) -> list[Path]:
    """Return the TIFF files in a folder or an archive, in the order of the numbers in
    their names.
    """
    return sorted(
        (path for path in folder.paths if path.suffix.lower() in TIFF_SUFFIXES), key=_numbers
    )


def _numbers(path: Path) -> list[tuple[int, str]]:
    """Return the sort key of a name by its numbers, not by their digits, as people sort."""
    return [
        (int(part), "") if part.isdecimal() else (-1, part)
        for part in re.split(r"(\d+)", path.name)
        if part
    ]


def open_tiff_folder(source: Source) -> Grid:
    """Open a folder of TIFF slices as a grid. Raises VolumeError if slices are missing, or unlike
    the others.
    """
    tifffile = library("tifffile", "TIFF")
    source.refuse_others()
    files = slices_in(source)
    _check_gaps(source, files)
    kinds: list[tuple[Shape, Packing, bool]] = []
    for file in files:
        with (
            reading(str(file), "TIFF"),
            source.at(file).open() as content,
            tifffile.TiffFile(content) as whole,
        ):
            page = whole.pages[0]
            coloured = page.axes.endswith(COLOUR_AXIS)
            kinds.append((page.shape, _packing(page, page.dtype, coloured), coloured))
            if len(whole.pages) > 1:
                raise VolumeError(
                    f"'{file}' is a stack among the slices of '{source.name}': move it elsewhere."
                )
    usual = Counter(kinds).most_common(1)[0][0]
    for file, kind in zip(files, kinds, strict=True):
        if kind != usual:
            others = (
                f"is {kind[0]} {kind[1].stored}, and most others are {usual[0]} {usual[1].stored}"
            )
            raise VolumeError(f"'{file.name}' in '{source.name}' {others}: move it elsewhere.")
    (ny, nx, *_), packing, coloured = usual
    source.check((len(files), ny, nx))
    slabs = partial(_slices, source, files, coloured, packing)
    stamp = source.stamp if source.archive else partial(stamp_of, files)
    notes = (LUMINANCE_NOTE,) if coloured else packing.notes
    return Grid(
        (len(files), ny, nx),
        packing.dtype,
        (1.0, 1.0, 1.0),
        slabs,
        stamp,
        notes=notes,
        read_as=packing.read_as("slices of TIFF"),
    )


def _check_gaps(source: Source, files: list[Path]) -> None:
    """Raise VolumeError if the numbers in the slices' names leave some out."""
    numbers = [[part for part, text in _numbers(file) if not text] for file in files]
    lasts = [each[-1] for each in numbers if each]
    steps = np.diff(lasts)
    if (
        len(lasts) != len(files)
        or not len(steps)
        or len({tuple(each[:-1]) for each in numbers}) > 1
    ):
        return
    usual = int(np.median(steps))
    for file, after, step in zip(files, files[1:], steps, strict=False):
        if step != usual:
            wrong = f"'{file.name}' is followed by '{after.name}', where others are {usual} apart"
            raise VolumeError(
                f"Slices of '{source.name}' are missing or doubled ({wrong}): complete the folder."
            )


def _slices(
    source: Source, files: list[Path], coloured: bool, packing: Packing
) -> Iterator[np.ndarray]:
    tifffile = library("tifffile", "TIFF")
    for file in files:
        with reading(str(file), "TIFF"), source.at(file).open() as content:
            values = tifffile.imread(content, key=0)
        yield packing.apply(luminance_of_colours(values) if coloured else values)[None]
