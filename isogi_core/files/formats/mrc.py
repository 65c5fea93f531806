"""MRC and CCP4 maps, read by mrcfile: axes in any order, cells at any angle."""

import math
from functools import partial
from io import BytesIO
from typing import Any

import numpy as np

from isogi_core.errors import VolumeError
from isogi_core.files.coordinates import SPACING_KEY
from isogi_core.files.formats.chemistry.levels import level_in
from isogi_core.files.formats.source import Source, library, pick, raw_slabs, reader
from isogi_core.files.grid import Affine, Grid, read_as

MRC_HEADER_BYTES = 1024
EXTENDED_SIZE_BYTE = 92
"""Bytes of a header, and the byte from which on it says how long the extended header is."""


@reader("MRC", "time")
def open_mrc(source: Source) -> Grid:
    """Open a map as a grid: only the header is read now. Raises VolumeError."""
    library("mrcfile", "MRC")
    header = _header(source)
    shape = tuple(int(header[name]) for name in ("nz", "ny", "nx"))
    extended = int(header["nsymbt"])
    source.check(shape)
    if extended < 0:
        raise VolumeError(
            f"The extended header of '{source.name}' has {extended} bytes: write it again."
        )
    dtype, notes = _dtype(header)
    volumes = _volumes(header, shape[0])
    time = pick(source, "time", volumes, "volumes")
    first = MRC_HEADER_BYTES + extended
    if min(float(header["cella"][name]) for name in "xyz") <= 0.0:
        notes = (*notes, f"The file has no cell, a voxel is taken as 1 Å wide: {SPACING_KEY}.")
    notes = (*notes, *source.cut_notes(first + math.prod(shape) * dtype.itemsize))
    shape = (shape[0] // volumes, *shape[1:])
    start = first + time * math.prod(shape) * dtype.itemsize
    affine = _affine(header, time * shape[0])
    spacing = tuple(math.hypot(*column) for column in affine.array[:, :3].T)
    slabs = partial(raw_slabs, source, start, shape, dtype)
    return Grid(
        shape,
        dtype,
        spacing,
        slabs,
        source.stamp,
        affine,
        "Å",
        notes,
        read_as=read_as("MRC", dtype, "its cell and origin"),
        level=level_in(_labels(header)),
        deviations=CRYSTAL_DEVIATIONS if int(header["ispg"]) > 1 else MICROSCOPE_DEVIATIONS,
    )


MICROSCOPE_DEVIATIONS = 3.0
CRYSTAL_DEVIATIONS = 1.5
"""Standard deviations above the mean at which maps are shown at first: of cryo-EM, whose box is
mostly empty, and of a crystal's cell, which is full (Coot's start for 2Fo - Fc).
"""


def _labels(header: Any) -> str:
    """Return the labels of a header, one after the other."""
    return " ".join(bytes(label).decode("latin-1") for label in header["label"])


def _header(source: Source) -> Any:
    """Return the header, without the extended one: mrcfile would allocate as much memory for that
    as the header announces.
    """
    interpreter = library("mrcfile.mrcinterpreter", "MRC").MrcInterpreter
    with source.unpacked() as file:
        head = file.read(MRC_HEADER_BYTES)
    bare = head[:EXTENDED_SIZE_BYTE] + bytes(4) + head[EXTENDED_SIZE_BYTE + 4 :]
    header = interpreter(iostream=BytesIO(bare), permissive=True, header_only=True).header.copy()
    header["nsymbt"] = np.frombuffer(head, header["nsymbt"].dtype, 1, EXTENDED_SIZE_BYTE)[0]
    return header


IMOD_MARK_BYTE = 152
IMOD_FLAGS_BYTE = 156
SIGNED_BYTES_FLAG = 1
"""Bytes of the header that hold IMOD's mark and its flags, and the flag of bytes with a sign."""

IMOD_MARK = 1146047817
"""IMOD's mark. Source: IMOD's description of the MRC format, "The MRC File Header"."""

BY_IMOD = "as IMOD's flag in the file says."
BY_STANDARD = "as MRC2014 says: programs before it wrote them without one."


def _dtype(header: Any) -> tuple[np.dtype[Any], tuple[str, ...]]:
    """Return the type of voxels, with a note if it is that of bytes: only IMOD says if these have a
    sign.
    """
    dtype: np.dtype[Any] = library("mrcfile.utils", "MRC").data_dtype_from_header(header)
    if dtype != np.int8:
        return dtype, ()
    order = np.dtype(np.uint32).newbyteorder(header["mode"].dtype.byteorder)
    stamp, flags = (
        int(np.frombuffer(header.tobytes(), order, 1, place)[0])
        for place in (IMOD_MARK_BYTE, IMOD_FLAGS_BYTE)
    )
    signed = stamp != IMOD_MARK or bool(flags & SIGNED_BYTES_FLAG)
    if stamp == IMOD_MARK:
        why = BY_IMOD
    else:
        why = BY_STANDARD
    return np.dtype(np.int8 if signed else np.uint8), (
        f"The voxels are bytes {'with' if signed else 'without'} a sign, {why}",
    )


def _volumes(header: Any, sections: int) -> int:
    """Return the number of volumes in a stack of volumes; one in all other files."""
    deep = int(header["mz"])
    if int(header["ispg"]) >= 401 and deep > 0 and sections % deep == 0:
        return sections // deep
    return 1


def _affine(header: Any, first: int) -> Affine:
    """Return the affine map from columns, rows and sections to the world in Ångström, by the
    header's axes, cell and origin. ``first`` is the number of the first section that is read.

    The origin is the header's (MRC2014), or else the place in the cell at which the map starts.
    Source: the CCP4 map format.
    """
    axes = [int(header[name]) - 1 for name in ("mapc", "mapr", "maps")]
    if sorted(axes) != [0, 1, 2]:
        if any(int(header[name]) for name in ("mapc", "mapr", "maps")):
            raise VolumeError(
                f"The map's axes are {[axis + 1 for axis in axes]}, which cannot be: write it "
                "again."
            )
        axes = [0, 1, 2]
    # The cell's edges are divided into intervals, whose lengths are the distances of voxels. If the
    # header has no intervals, or no cell, the map fills the cell, and voxels are 1 Å apart.
    size = np.array([int(header[name]) for name in ("nx", "ny", "nz")])
    intervals = np.array([float(header[name]) for name in ("mx", "my", "mz")])
    lengths = np.array([float(header["cella"][name]) for name in "xyz"])
    along = np.empty(3)
    along[axes] = size  # voxels along the axes of the cell
    intervals = np.where(intervals > 0, intervals, along)
    steps = np.where(lengths > 0.0, lengths, intervals) / intervals
    cell = _cell([float(header["cellb"][name]) for name in ("alpha", "beta", "gamma")]) * steps
    starts = np.array([int(header[name]) for name in ("nxstart", "nystart", "nzstart")], float)
    starts[2] += first
    # The origin is the header's, else the place of the first voxel in the cell.
    matrix = cell[:, axes]
    origin = np.array([float(header["origin"][name]) for name in "xyz"])
    if not origin.any():
        origin = matrix @ starts
    return Affine.of(np.column_stack([matrix, origin]))


def _cell(angles: list[float]) -> np.ndarray:
    """Return unit vectors along a cell's axes a, b, c as columns, at its angles in degrees; a along
    x, b in the xy plane.
    """
    if all(0.0 < angle < 180.0 for angle in angles):
        known = angles
    else:
        known = [90.0] * 3
    if known == [90.0] * 3:
        return np.eye(3)
    cosine = np.cos(np.radians(known))
    sine = math.sin(math.radians(known[2]))
    y = (cosine[0] - cosine[1] * cosine[2]) / sine
    z = math.sqrt(max(1.0 - cosine[1] ** 2 - y**2, 0.0))
    return np.array([[1.0, cosine[2], cosine[1]], [0.0, sine, y], [0.0, 0.0, z]])
