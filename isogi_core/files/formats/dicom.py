"""DICOM, read by pydicom: a series in a folder, one of several, or one file of many frames."""

import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial, reduce
from pathlib import Path
from typing import Any

import numpy as np

from isogi_core.errors import VolumeError
from isogi_core.files.formats.dicom_mosaic import (
    MOSAIC_NOTE,
    MOSAIC_TAGS,
    Tile,
    is_mosaic,
    mosaic_of,
    plane_of,
)
from isogi_core.files.formats.dicom_stack import (
    SEGMENT_TAGS,
    Slice,
    is_segmentation,
    numbered,
    overlaid,
    segment_in,
    segments_of,
    stack_of,
)
from isogi_core.files.formats.source import (
    LUMINANCE_NOTE,
    Source,
    library,
    luminance_of_colours,
    pick,
    reader,
)
from isogi_core.files.grid import PATIENT_AXES, Affine, Grid, read_as
from isogi_core.files.packed_files import READ_BYTES, line_of, stamp_of
from isogi_core.files.packing import Packing, Scaling, holed

DECODER_PACKAGES = {
    "JPEG-LS": "pyjpegls",
    "JPEG 2000": "pylibjpeg pylibjpeg-openjpeg",
    "JPEG": "python-gdcm",
}
"""Packages to install for pixels that are packed in some way, by a part of its name; all under free
licences without conditions.
"""

DICOM_TO_RAS = np.diag([-1.0, -1.0, 1.0])
"""From a patient's left, posterior, superior, which DICOM means, to right, anterior, superior."""

HEADER_TAGS = (
    *(
        "SeriesInstanceUID",
        "SeriesNumber",
        "SeriesDescription",
        "SOPInstanceUID",
        "InstanceNumber",
        "ImageType",
    ),
    *(
        "ImagePositionPatient",
        "ImageOrientationPatient",
        "PixelSpacing",
        "SpacingBetweenSlices",
        "SliceThickness",
    ),
    *(
        "Rows",
        "Columns",
        "NumberOfFrames",
        "SamplesPerPixel",
        "PhotometricInterpretation",
        "BitsAllocated",
    ),
    *("BitsStored", "HighBit", "PixelRepresentation", "RescaleSlope", "RescaleIntercept"),
    *("PerFrameFunctionalGroupsSequence", "SharedFunctionalGroupsSequence", "TransferSyntaxUID"),
    *("FloatPixelData", "DoubleFloatPixelData", "GridFrameOffsetVector", "DoseGridScaling"),
    *SEGMENT_TAGS,
    *MOSAIC_TAGS,
    *("MediaStorageSOPClassUID", "DirectoryRecordSequence"),
    *(
        f"{kind}PixelPadding{end}"
        for kind in ("", "Float", "DoubleFloat")
        for end in ("Value", "RangeLimit")
    ),
)


DEFLATED_SYNTAX = b"1.2.840.10008.1.2.1.99"
META_BYTES = 1 << 20
META_START = 144
"""The transfer syntax of deflated data, bytes within which a file names it, and the byte after its
length.
"""


Headers = list[tuple[Path | None, Any]]
"""Headers of images, each with its file."""


@dataclass(frozen=True)
class Place:
    """The place of a slice's pixels: a file, None for an upload, and the number of the frame in it.
    In a segmentation they are those of a ``segment``, whose number they get; in a mosaic those of a
    ``tile``.
    """

    path: Path | None
    frame: int
    segment: int = 0
    tile: Tile | None = None


def is_dicom(head: bytes) -> bool:
    """Return True if a file begins as DICOM does, after its preamble."""
    return head[128:132] == b"DICM"


@reader("DICOM", "series", "time")
def open_dicom(source: Source) -> Grid:
    """Open a file, or a folder with a series, as a grid: only headers are read now. Raises
    VolumeError.
    """
    library("pydicom", "DICOM")
    _check_inflated(source)
    folder = source.is_folder
    headers: Headers = list(_headers(source)) if folder else [(source.path, _read_header(source))]
    if headers and "DirectoryRecordSequence" in headers[0][1]:
        raise VolumeError(
            f"'{source.name}' is the list of a DICOM disk: give the folder with the images of one "
            "series."
        )
    if not headers or "Rows" not in headers[0][1]:
        raise VolumeError(f"'{source.name}' holds no DICOM image: check the volume's path.")
    chosen = _series(source, headers)
    for _, header in chosen:
        source.check(
            (int(header.get("NumberOfFrames") or 1), int(header.Rows), int(header.Columns))
        )
    first = chosen[0][1]
    segmented = is_segmentation(chosen[0][1])
    slices = [each for path, header in chosen for each in _slices_of(source.name, path, header)]
    slices = overlaid(slices) if segmented else slices
    stack, notes = stack_of(source.name, slices, partial(pick, source, "time"), segmented)
    if len(stack.layers) == 1 and not folder:
        raise VolumeError(
            f"'{source.name}' is one slice: give the folder of its series, or a file of many "
            "frames."
        )
    rows, columns = plane_of(first)
    source.check((len(stack.layers), rows, columns))
    if is_mosaic(first):
        notes = (*notes, MOSAIC_NOTE.format(count=len(stack.layers)))
    packings = {each.packing for each in slices}
    coloured = int(first.get("SamplesPerPixel", 1)) > 1
    if str(first.get("PhotometricInterpretation", "")) == "PALETTE COLOR" and not segmented:
        raise VolumeError(f"'{source.name}' holds colours of a palette: save its values.")
    labels = segments_of(first) if segmented else None
    if segmented:
        dtype = np.dtype(np.uint16)
    else:
        dtype = _value_type(packings, coloured or stack.between)
    if stack.affine is not None:
        affine = Affine.of(DICOM_TO_RAS @ stack.affine, PATIENT_AXES)
    else:
        affine = None
    shape = (len(stack.layers), rows, columns)
    layers = partial(_layers, source, stack.layers, shape, dtype)
    files = sorted({path for path, _ in chosen if path is not None})
    notes = (*notes, *((LUMINANCE_NOTE,) if coloured else slices[0].packing.notes))
    stamp = source.stamp if source.archive else partial(_stamp_of_files, source, files)
    if affine is not None:
        placed = "its slices' positions"
    elif stack.measured:
        placed = "its slices' numbers"
    else:
        placed = ""
    known = slices[0].packing.read_as("DICOM segmentation" if segmented else "DICOM", placed)
    if len(packings) > 1:
        known = read_as(
            "DICOM, each slice of a slope of its own,", slices[0].packing.stored, placed
        )
    unit = "mm" if stack.measured else ""
    return Grid(
        shape,
        dtype,
        stack.spacing,
        layers,
        stamp,
        affine,
        unit,
        notes,
        labels=labels,
        read_as=known,
    )


def _stamp_of_files(source: Source, files: list[Path]) -> str:
    return f"{stamp_of(files)} {sorted(source.chosen.items())}"


def _check_inflated(source: Source) -> None:
    """Raise VolumeError if an upload inflates to more than its voxels may take: pydicom inflates
    all at once.
    """
    if source.path is not None or source.is_folder:
        return
    with source.open() as file:
        head = file.read(META_BYTES)
        if DEFLATED_SYNTAX not in head:
            return
        file.seek(META_START + int.from_bytes(head[META_START - 4 : META_START], "little"))
        inflater = zlib.decompressobj(-zlib.MAX_WBITS)
        left = 4 * source.voxels + META_BYTES
        while (
            left > 0
            and not inflater.eof
            and (data := inflater.unconsumed_tail or file.read(READ_BYTES))
        ):
            left -= len(inflater.decompress(data, READ_BYTES))
    if left <= 0:
        raise VolumeError(
            f"'{source.name}' inflates to more than {4 * source.voxels} bytes: save a smaller part."
        )


PIXEL_TAGS = {
    0x7FE00008: "FloatPixelData",
    0x7FE00009: "DoubleFloatPixelData",
    0x7FE00010: "PixelData",
}
"""Tags of pixels, and DICOM's names of them: the tag says if they are whole numbers."""


def _read_header(source: Source) -> Any:
    """Read the header of an image, up to its pixels. It has an element for pixels that are floats,
    an empty one.
    """
    reading = library("pydicom.filereader", "DICOM")
    pixels: list[str] = []

    def stop(tag: int, _representation: str | None, _length: int) -> bool:
        if tag in PIXEL_TAGS:
            pixels.append(PIXEL_TAGS[tag])
        return tag in PIXEL_TAGS

    tags = [reading.Tag(each) for each in HEADER_TAGS]
    with source.open() as file:
        header = reading.read_partial(file, stop, force=True, specific_tags=tags)
    if pixels and pixels[0] != "PixelData":
        setattr(header, pixels[0], b"")
    return header


def _headers(source: Source) -> Iterator[tuple[Path | None, Any]]:
    """Yield the headers of all images in a folder; other files are passed over."""
    for path in source.paths:
        file = source.at(path)
        if not may_be_dicom(file):
            continue
        _check_inflated(file)
        header = _read_header(file)
        if "Rows" in header:
            yield path, header


def may_be_dicom(source: Source) -> bool:
    """Return True if a file has DICOM's mark, or begins with a tag of its first groups, as the mark
    was not always written.
    """
    with source.open() as file:
        head = file.read(132)
    return is_dicom(head) or (head[1:2] == b"\0" and head[0] in (2, 8) and head[3:4] == b"\0")


def _series(source: Source, headers: Any) -> Headers:
    """Return the images of the series that is chosen: one of several must be. Orientation and size
    divide a series, too.
    """
    groups: dict[tuple[Any, ...], Headers] = {}
    for path, header in headers:
        pose = tuple(np.round(np.array(header.get("ImageOrientationPatient") or (), float), 3))
        key = str(header.get("SeriesInstanceUID", "")), pose, int(header.Rows), int(header.Columns)
        groups.setdefault(key, []).append((path, header))
    found = sorted(
        groups.values(), key=lambda each: (int(each[0][1].get("SeriesNumber") or 0), -len(each))
    )
    number = source.chosen.get("series")
    if number is None and len(found) == 1:
        return found[0]
    uids = [str(each[0][1].get("SeriesInstanceUID", "")) for each in found]
    if number is not None and (number in uids or (number.isdecimal() and int(number) < len(found))):
        return found[uids.index(number) if number in uids else int(number)]
    listed = "; ".join(f"#series={n}: {_about(each)}" for n, each in enumerate(found[:8]))
    if number is None:
        wrong = f"'{source.name}' holds {len(found)} series"
    else:
        wrong = f"There is no series '{number}'"
    raise VolumeError(f"{wrong}: choose of {listed}.")


def _about(series: Headers) -> str:
    """Describe a series in words."""
    header = series[0][1]
    frames = sum(int(each.get("NumberOfFrames") or 1) for _, each in series)
    described = str(header.get("SeriesDescription", "") or "without a name")[:40]
    return f"{described}, {frames} of {header.Columns} × {header.Rows}"


def _slices_of(name: str, path: Path | None, header: Any) -> Iterator[Slice]:
    """Yield the slices in a file: its only one, each of its frames, or each tile of its mosaic."""
    if is_mosaic(header):
        yield from _tiles_of(name, path, header)
        return
    count = int(header.get("NumberOfFrames") or 1)
    frames = header.get("PerFrameFunctionalGroupsSequence")
    shared = (header.get("SharedFunctionalGroupsSequence") or [None])[0]
    for number in range(count):
        groups = [frames[number]] if frames else []
        groups += [shared] if shared is not None else []
        yield _slice(Place(path, number, segment_in(header, groups)), header, groups)


def _tiles_of(name: str, path: Path | None, header: Any) -> Iterator[Slice]:
    """Yield the slices of a mosaic, which follow each other along its normal."""
    mosaic = mosaic_of(name, header)
    whole = _slice(Place(path, 0), header, [])
    for n, tile in enumerate(mosaic.tiles):
        each = replace(
            whole,
            place=(Place(path, 0, tile=tile),),
            uid=f"{whole.uid} {n}",
            number=(whole.number[0], n),
            position=None,
        )
        if mosaic.position is None or mosaic.normal is None:
            yield each
        else:
            shift = n * (whole.between or 1.0) * mosaic.normal
            yield replace(each, position=tuple((mosaic.position + shift).tolist()))


def _slice(place: Place, header: Any, groups: list[Any]) -> Slice:
    """Return one slice, by the functional groups of its frame, else by the header."""
    read = partial(_frame_value, header, groups)
    position = read("PlanePositionSequence", "ImagePositionPatient")
    pose = _floats(read("PlaneOrientationSequence", "ImageOrientationPatient"))
    spacing = _floats(read("PixelMeasuresSequence", "PixelSpacing"))
    between = read("PixelMeasuresSequence", "SpacingBetweenSlices") or read(
        "PixelMeasuresSequence", "SliceThickness"
    )
    alone = bool(groups) or int(header.get("NumberOfFrames") or 1) == 1
    scale = "PixelValueTransformationSequence"
    slope = read(scale, "RescaleSlope")
    intercept = read(scale, "RescaleIntercept")
    if slope is None:
        slope = header.get("DoseGridScaling")
    return Slice(
        place=(place,),
        uid=f"{header.get('SOPInstanceUID', '')} {place.frame}",
        number=(int(header.get("InstanceNumber") or 0), place.frame),
        position=_shifted(
            _floats(position), pose, header.get("GridFrameOffsetVector"), place.frame, alone
        ),
        pose=pose,
        pixel=(spacing[1], spacing[0]) if spacing else None,
        between=float(between) if between else None,
        packing=_rescaling(
            header, Scaling(1.0 if slope is None else float(slope), float(intercept or 0.0))
        ),
    )


def _shifted(
    position: tuple[float, ...] | None,
    pose: tuple[float, ...] | None,
    offsets: Any,
    frame: int,
    alone: bool,
) -> tuple[float, ...] | None:
    """Return the position of a frame that is shifted from the first along the normal, as those of
    dose grids are. None if it is not ``alone`` and shares one position with all others.
    """
    if position is None or pose is None or not offsets:
        return position if alone else None
    normal = np.cross(pose[:3], pose[3:])
    return tuple(
        (np.array(position) + normal * (float(offsets[frame]) - float(offsets[0]))).tolist()
    )


def _frame_value(header: Any, groups: list[Any], sequence: str, name: str) -> Any:
    """Return a value of the groups of a frame, else of the shared ones, else of the header; None if
    none has it.
    """
    for group in groups:
        inner = group.get(sequence)
        if inner and name in inner[0]:
            return inner[0].get(name)
    return header.get(name)


def _floats(values: Any) -> tuple[float, ...] | None:
    if values:
        return tuple(float(value) for value in values)
    return None


def _stored_type(header: Any) -> np.dtype[Any]:
    """Return the type of stored values."""
    if "FloatPixelData" in header or "DoubleFloatPixelData" in header:
        return np.dtype(np.float32 if "FloatPixelData" in header else np.float64)
    if int(header.get("PixelRepresentation", 0)):
        kind = "i"
    else:
        kind = "u"
    return np.dtype(f"{kind}{max(int(header.BitsAllocated) // 8, 1)}")


def _value_type(packings: set[Packing], floating: bool) -> np.dtype[Any]:
    """Return the type of values: one for all slices, whatever their slopes."""
    found = np.result_type(*(each.dtype for each in packings))
    if floating:
        return np.result_type(found, np.float32)
    return found


def _rescaling(header: Any, scaling: Scaling) -> Packing:
    """Return the packing of an image's pixels; those of a value, or of a range, that says "no
    pixel" are holes. Source: DICOM PS3.3, C.7.5.1.1.2. Colours and labels have no such value.
    """
    if is_segmentation(header):
        return Packing(np.dtype(np.uint16))
    if int(header.get("SamplesPerPixel", 1)) > 1:
        return Packing(np.dtype(np.float32), scaling=scaling)
    stored = _stored_type(header)
    ends = [_padding(header, stored, end) for end in ("Value", "RangeLimit")]
    return replace(
        holed(stored, ends if ends[0] is not None else (), "the padding value"), scaling=scaling
    )


def _padding(header: Any, stored: np.dtype[Any], end: str) -> float | None:
    """Return the padding value of an image, or the limit of its range; None if it has none."""
    prefix = {"f4": "Float", "f8": "DoubleFloat"}.get(stored.str[1:], "")
    value = header.get(f"{prefix}PixelPadding{end}")
    if isinstance(value, bytes):  # where the file leaves its type to that of the pixels
        if len(value) >= 2:
            return int.from_bytes(value[:2], "little")
        return None
    return None if value is None else float(value)


Layer = tuple[tuple[tuple[Place, ...], float, Packing], ...]


def _layers(
    source: Source, layers: tuple[Layer, ...], shape: tuple[int, int, int], dtype: np.dtype[Any]
) -> Iterator[np.ndarray]:
    """Yield the layers of a stack, one at a time; (1, rows, columns) each. Layers without a slice
    are NaN, or 0 if values are whole numbers.
    """
    frames = Frames(source)
    for layer in layers:
        if not layer:
            yield np.full((1, *shape[1:]), np.nan if dtype.kind == "f" else 0, dtype)
            continue
        parts = [
            packing.apply(reduce(np.maximum, map(frames.pixels, places)))
            for places, _, packing in layer
        ]
        if len(parts) == 1:
            yield parts[0].astype(dtype, copy=False)[None]
        else:
            mix = sum(
                part.astype(np.float64) * weight
                for part, (_, weight, _) in zip(parts, layer, strict=True)
            )
            yield np.asarray(mix).astype(dtype)[None]


class Frames:
    """Reads the pixels of slices; those read last are kept, as two layers may be made of one
    slice.
    """

    def __init__(self, source: Source) -> None:
        """Read nothing yet."""
        self._source = source
        self._kept: list[tuple[Place, np.ndarray]] = []
        self._file: tuple[Path | None, Any] | None = None

    def pixels(self, place: Place) -> np.ndarray:
        """Return the stored values of a slice, in full signed or unsigned range; luminance of
        colours.
        """
        found = next((pixels for known, pixels in self._kept if known == place), None)
        if found is None:
            found = self._decoded(place)
            self._kept = [*self._kept[-1:], (place, found)]
        return found

    def _decoded(self, place: Place) -> np.ndarray:
        pydicom = library("pydicom", "DICOM")
        if self._file is None or self._file[0] != place.path or place.path is None is self._file:
            if place.path is None:
                source = self._source
            else:
                source = self._source.at(place.path)
            with source.open() as file:
                self._file = place.path, pydicom.dcmread(file, force=True)
        data = self._file[1]
        values = np.asarray(self._decode(data, place.frame))
        if place.tile is not None:
            values = place.tile.of(values)
        if int(data.get("SamplesPerPixel", 1)) > 1:
            return luminance_of_colours(values)
        return numbered(
            used_bits(values, data) if values.dtype.kind in "iu" else values, place.segment, data
        )

    def _decode(self, data: Any, frame: int) -> Any:
        decode: Callable[..., Any] = library("pydicom.pixels", "DICOM").pixel_array
        try:
            return decode(data, index=frame)
        except (RuntimeError, NotImplementedError) as error:
            syntax = data.file_meta.TransferSyntaxUID
            if syntax.is_compressed and "plugin" in str(error):
                needed = f"The pixels of '{self._source.name}' are packed as {syntax.name}"
                plugin = next(
                    (each for part, each in DECODER_PACKAGES.items() if part in syntax.name),
                    "python-gdcm",
                )
                raise VolumeError(f"{needed}, which needs: pip install {plugin}.") from error
            raise VolumeError(
                f"The pixels of '{self._source.name}' cannot be decoded ({line_of(error)})."
            ) from error


def used_bits(values: np.ndarray, header: Any) -> np.ndarray:
    """Return values without their unused bits, which may hold anything, such as an overlay."""
    allocated = int(header.BitsAllocated)
    stored = int(header.get("BitsStored", allocated))
    high = int(header.get("HighBit", stored - 1))
    if stored >= allocated or not stored <= high + 1 <= allocated:
        return values
    up = np.left_shift(values, allocated - 1 - high)
    return np.right_shift(up, allocated - stored)
