"""OpenDX as APBS, VMD and others write it: values at the points of a regular grid, z fastest, as
text or binary.

Format: https://apbs.readthedocs.io/en/latest/formats/opendx.html, and OpenDX's User's Guide,
appendix B.
"""

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from isogi_core.errors import VolumeError
from isogi_core.files.formats.chemistry.cube import ANGSTROM
from isogi_core.files.formats.chemistry.sets import pick_set, read_z_fastest
from isogi_core.files.formats.chemistry.text import Text, text_of
from isogi_core.files.formats.source import Source, reader
from isogi_core.files.grid import Affine, Grid, read_as

_COMMENTS = re.compile(rb"(?:[ \t]*(?:#[^\n]*)?\r?\n)*")
_OBJECT = re.compile(rb"[ \t]*object\b[^\n]*\bclass\b", re.IGNORECASE)
_POSITIONS = re.compile(
    rb"class[ \t]+\"?gridpositions\"?[ \t]+counts((?:[ \t]+\d{1,9}){1,9})", re.IGNORECASE
)
_LATTICE = re.compile(
    rb"^[ \t]*(origin|delta)((?:[ \t]+[-+\d.eEdD]+)+)", re.IGNORECASE | re.MULTILINE
)
_ARRAY = re.compile(
    rb"class[ \t]+\"?array\"?\s+type[ \t]+\"?([\w ]+?)\"?\s+(?:category[ \t]+\w+\s+)?"
    rb"rank[ \t]+(\d)\s+(?:shape[ \t]+(\d+)\s+)?items[ \t]+(\d+)\s+"
    rb"((?:\"?(?:lsb|msb|ieee|binary|ascii|text)\"?\s+)*)(?:data[ \t]+)?(follows|file\b|mode\b|\d+)"
    rb"[^\n]*\n",
    re.IGNORECASE,
)

_TYPES = {
    "double": "f8",
    "float": "f4",
    "int": "i4",
    "unsigned int": "u4",
    "short": "i2",
    "unsigned short": "u2",
    "byte": "u1",
    "unsigned byte": "u1",
    "signed byte": "i1",
}

OF_MOLECULES = ("apbs", "vmd", "pme", "mdpocket", "mdanalysis", "gromacs", "pymol", "chimera")
"""Programs whose lengths are ångströms, as comments name them."""


def is_dx(head: bytes) -> bool:
    """Return True if a file begins as OpenDX does: comments, and then an object of a class."""
    start = _COMMENTS.match(head)
    at = start.end() if start is not None else 0
    return _OBJECT.match(head, at) is not None or _POSITIONS.search(head) is not None


@dataclass(frozen=True)
class Placed:
    """The place of values: ``shape`` along x, y, z, and the ``matrix`` with the origin, (3, 4)."""

    shape: tuple[int, int, int]
    matrix: np.ndarray
    comments: str


@dataclass(frozen=True)
class Values:
    """The format of numbers: their ``dtype``, the number of them for ``each`` voxel, and True if
    they are text.
    """

    dtype: np.dtype[Any]
    each: int
    binary: bool


@reader("OpenDX", "part", "channel")
def open_dx(source: Source) -> Grid:
    """Open the values of a regular grid: headers are read now. Raises VolumeError.

    They lie with z as the fastest, so that all of them are in memory when they are read.
    """
    with text_of(source) as text:
        placed = read_positions(text)
    nx, ny, nz = placed.shape
    source.check((nz, ny, nx))
    with text_of(source) as text:
        values = find_values(text, placed)
    part, notes = pick_set(source, tuple(map(str, range(1, values.each + 1))), "numbers a voxel")
    unit = ANGSTROM if any(word in placed.comments for word in OF_MOLECULES) else ""
    if not unit:
        notes = (*notes, "The file does not name a unit of lengths.")
    spacing = np.linalg.norm(placed.matrix[:, :3], axis=0).tolist()
    dtype = values.dtype if values.binary else np.dtype(np.float64)
    return Grid(
        (nz, ny, nx),
        dtype,
        tuple(spacing),
        partial(_slabs, source, placed, part),
        source.stamp,
        Affine.of(placed.matrix),
        unit,
        notes,
        read_as=read_as("OpenDX", dtype, "its origin and deltas"),
    )


def read_positions(text: Text) -> Placed:
    """Find the grid's counts, origin and deltas, wherever they stand in the file."""
    comments = ""
    found = text.find(_POSITIONS)
    if found is not None:
        comments = found.string[: found.start()][:MOST_COMMENTS].decode("latin-1").lower()
        counts = [int(word) for word in found[1].split()]
    if found is None or len(counts) != 3 or min(counts) < 1:
        raise VolumeError(
            f"'{text.name}' has no regular grid of three dimensions: write it with gridpositions."
        )
    rows: dict[bytes, list[list[float]]] = {b"origin": [], b"delta": []}
    while len(rows[b"delta"]) < 3 and (line := text.find(_LATTICE)) is not None:
        numbers = [float(word.replace(b"D", b"E")) for word in line[2].split()]
        rows[line[1].lower()].append(numbers)
    origin = (rows[b"origin"] or [[0.0] * 3])[0]
    deltas = rows[b"delta"]
    if len(deltas) != 3 or any(len(row) != 3 for row in (*deltas, origin)):
        raise VolumeError(f"'{text.name}' does not say three deltas of its grid: write it again.")
    matrix = np.column_stack([np.array(deltas).T, np.array(origin)])
    if not np.isfinite(matrix).all():
        raise VolumeError(f"'{text.name}' has deltas that are not finite: write it again.")
    return Placed((counts[0], counts[1], counts[2]), matrix, comments)


MOST_COMMENTS = 4096


def find_values(text: Text, placed: Placed) -> Values:
    """Find the array of the grid's values, and read on after its header. Raises VolumeError."""
    while (found := text.find(_ARRAY)) is not None:
        rank, each = int(found[2]), int(found[3] or 1)
        if int(found[4]) != math.prod(placed.shape) or rank > 1:
            continue
        words = found[5].lower().split()
        kind = _TYPES.get(" ".join(found[1].decode("latin-1").lower().split()))
        if found[6].lower() != b"follows":
            raise VolumeError(
                f"'{text.name}' has its values in another place than after their header: write "
                "them into one file, 'data follows'."
            )
        if kind is None:
            raise VolumeError(
                f"'{text.name}' holds type {found[1].decode('latin-1')}: save floats."
            )
        order = ">" if any(b"msb" in word for word in words) else "<"
        binary = any(
            mark in word for word in words for mark in (b"binary", b"ieee", b"lsb", b"msb")
        )
        return Values(np.dtype(order + kind), each, binary)
    raise VolumeError(
        f"'{text.name}' has no array of {math.prod(placed.shape)} values for its grid: write it "
        "again."
    )


def _slabs(source: Source, placed: Placed, part: int) -> Iterator[np.ndarray]:
    with text_of(source) as text:
        values = find_values(text, placed)
        if not values.binary:
            yield read_z_fastest(text, placed.shape, part, values.each)
            return
        count = math.prod(placed.shape) * values.each
        found = text.binary(count, values.dtype)
    yield found.reshape(*placed.shape, values.each)[..., part].transpose(2, 1, 0)
