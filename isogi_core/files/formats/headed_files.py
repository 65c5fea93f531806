"""Bare voxels after a header in the same file: Scanco's ISQ, VFF and AmiraMesh.

Sources: Scanco's "ISQ header format"; the header of VFF as GE's MicroView writes it; Amira's
manual, "AmiraMesh Format".
"""

import re
from dataclasses import replace
from typing import Any

import numpy as np

from isogi_core.errors import VolumeError
from isogi_core.files.formats.side_headers import (
    MOST_HEADER_BYTES,
    Described,
    grid_of,
    keys_of,
    numbers,
    sizes,
    text_of,
)
from isogi_core.files.formats.source import Source, reader
from isogi_core.files.grid import Affine, Grid
from isogi_core.files.vector import triple

BLOCK_BYTES = 512
"""Bytes of a block of ISQ, of which the first is the header."""

SIZES_BYTE, LENGTHS_BYTE, SCALING_BYTE, OFFSET_BYTE = (44, 56, 88, 508)
"""Where the header of ISQ has voxels along x, y, z, the whole length along each in µm, the number
that attenuation is multiplied by, and the blocks between header and voxels.
"""


@reader("ISQ")
def open_isq(source: Source) -> Grid:
    """Open a scan of Scanco's microCT as a grid, in mm. Raises VolumeError."""
    with source.open() as file:
        head = file.read(BLOCK_BYTES)
    x, y, z = (int(n) for n in np.frombuffer(head, "<i4", 3, SIZES_BYTE))
    lengths = np.frombuffer(head, "<i4", 3, LENGTHS_BYTE).astype(float)
    scaling = int(np.frombuffer(head, "<i4", 1, SCALING_BYTE)[0])
    first = BLOCK_BYTES * (int(np.frombuffer(head, "<i4", 1, OFFSET_BYTE)[0]) + 1)
    source.check((z, y, x))
    # The header has the length of the whole scan along each axis, in µm.
    spacing = triple(lengths / (x, y, z) / 1000.0)
    described = Described("", first, (z, y, x), np.dtype("<i2"), spacing, unit="mm")
    grid = grid_of(source, "ISQ", described)
    if scaling <= 0:
        return grid
    note = f"Values are as stored: divide by {scaling} for the linear attenuation in 1/cm."
    return replace(grid, notes=(*grid.notes, note))


VFF_END = "\x0c\n"
VFF_TYPES = {8: "u1", 16: ">i2", 32: ">f4"}
"""Types of voxels, big-endian, by their bits."""


@reader("VFF")
def open_vff(source: Source) -> Grid:
    """Open a scan of GE's microCT as a grid; it is in mm if the header has ``elementsize``.

    Raises VolumeError if the scan is packed, has several bands or a number of bits that VFF_TYPES
    lacks, or if its header does not end within MOST_HEADER_BYTES.
    """
    # Each byte of the header is one character: the length of the text is the place of the voxels.
    text, end, _ = text_of(source).partition(VFF_END)
    if not end:
        raise VolumeError(
            f"The VFF header of '{source.name}' does not end within {MOST_HEADER_BYTES} bytes: "
            "export the scan again."
        )
    keys = keys_of(text.replace(";", "\n"), "=")
    bits = int(numbers(source, keys, "bits", 1)[0])
    if keys.get("bands", "1") != "1" or bits not in VFF_TYPES or "compress" in text:
        raise VolumeError(
            f"'{source.name}' is VFF of {bits} bits, packed or of several bands: export it as "
            "DICOM or TIFF from the scanner's program."
        )
    steps = np.array(numbers(source, keys, "spacing") if "spacing" in keys else (1.0, 1.0, 1.0))
    measured = "elementsize" in keys
    if measured:
        steps = steps * numbers(source, keys, "elementsize", 1)[0]
    dtype = np.dtype(VFF_TYPES[bits])
    first = len(text) + len(end)
    shape = sizes(source, keys, "size")
    said = Described("", first, shape, dtype, triple(steps), unit="mm" if measured else "")
    return grid_of(source, "VFF", said)


AMIRA_TYPES = {
    **{"byte": "u1", "char": "i1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"int32": "i4", "float": "f4", "double": "f8"},
}
AMIRA_SIZES = re.compile(r"define\s+Lattice\s+(\d+)\s+(\d+)\s+(\d+)")
AMIRA_ARRAY = re.compile(r"Lattice\s*\{\s*(\w+)(\[\d+\])?\s+\w+\s*\}\s*=?\s*@(\d+)(\s*\([^)]*\))?")
AMIRA_BOX = re.compile(r"BoundingBox\s+([-+.\deE\s]+)")
SAVE_AMIRA = (
    "save it as NRRD or TIFF in Amira or Avizo, or open it in Fiji and save it as TIFF or NRRD"
)


@reader("AmiraMesh")
def open_amira(source: Source) -> Grid:
    """Open a lattice of even coordinates as a grid, if its numbers are neither packed nor written
    out. Raises VolumeError.
    """
    text = text_of(source)
    size = AMIRA_SIZES.search(text)
    array = AMIRA_ARRAY.search(text)
    plain = size and array and not array[2] and not array[4] and array[1] in AMIRA_TYPES
    start = re.search(rf"\n@{array[3]}\r?\n", text) if array else None
    line = text.partition("\n")[0]
    even = 'CoordType "uniform"' in text or "CoordType" not in text
    if not plain or not start or not size or not array or "BINARY" not in line or not even:
        raise VolumeError(
            f"'{source.name}' is AmiraMesh that is packed, text, uneven or no lattice of single "
            f"numbers: {SAVE_AMIRA}."
        )
    order = "<" if "LITTLE-ENDIAN" in line else ">"
    x, y, z = (int(n) for n in size.groups())
    box = AMIRA_BOX.search(text)
    dtype = np.dtype(f"{order}{AMIRA_TYPES[array[1]]}")
    said = Described("", start.end(), (z, y, x), dtype, (1.0, 1.0, 1.0))
    return grid_of(source, "AmiraMesh", _boxed(said, box[1].split() if box else []))


def _boxed(said: Described, words: Any) -> Described:
    """Place voxels whose first and last centres lie at the ends of a box: x0 x1 y0 y1 z0 z1."""
    try:
        ends = np.array([float(word) for word in words[:6]]).reshape(3, 2)
    except ValueError:
        return said
    counts = np.maximum(np.array(said.shape[::-1]) - 1, 1)
    steps = (ends[:, 1] - ends[:, 0]) / counts
    affine = Affine.of(np.column_stack([np.diag(steps), ends[:, 0]]))
    return replace(said, spacing=triple(steps), affine=affine)
