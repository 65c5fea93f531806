"""Headers whose voxels lie bare in a file next to them: MetaImage, BOV of VisIt, VGI of VGStudio,
and the .dat of the Volume Library.

A header gives the sizes and type of the bare voxels, and their spacing. The file that it names must
be in its folder or below.
"""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path, PurePath
from typing import Any

import numpy as np

from isogi_core.errors import VolumeError
from isogi_core.files.formats.image_files import ITK_TO_RAS, open_itk
from isogi_core.files.formats.source import Source, raw_slabs, reader
from isogi_core.files.grid import PATIENT_AXES, Affine, Grid, Shape, read_as
from isogi_core.files.vector import Vector, triple

MOST_HEADER_BYTES = 1 << 16
"""Bytes within which a header ends."""


@dataclass(frozen=True)
class Described:
    """Bare voxels as a header describes them.

    - ``data``: name of the file that holds them, empty if that is the header's own.
    - ``first``: byte of that file at which they begin, None if they are its last bytes.
    - ``shape``: voxels along z, y, x; ``dtype``: type of a voxel; ``spacing``: (x, y, z).
    - ``affine``, ``unit``: see ``Grid``.
    """

    data: str
    first: int | None
    shape: Shape
    dtype: np.dtype[Any]
    spacing: Vector
    affine: Affine | None = None
    unit: str = ""


Keys = Mapping[str, str]
"""Values of a header by their names in small letters."""


def keys_of(text: str, between: str) -> dict[str, str]:
    """Read lines of names and values with a sign ``between``, such as = or :; of a name that comes
    twice the first value counts.
    """
    found: dict[str, str] = {}
    for line in text.splitlines():
        name, sign, value = line.partition(between)
        if sign:
            found.setdefault(name.strip().lower(), value.strip())
    return found


def numbers(source: Source, keys: Keys, name: str, count: int = 3) -> tuple[float, ...]:
    """Read the ``count`` numbers that a header gives under ``name``, with blanks or commas between.

    Raises VolumeError if there are more or fewer, or if one is not finite.
    """
    words = re.split(r"[\s,]+", keys.get(name, "").strip())
    try:
        found = tuple(float(word) for word in words)
    except ValueError:
        found = ()
    if len(found) != count or not all(map(math.isfinite, found)):
        raise VolumeError(
            f"'{source.name}' gives {name} = '{keys.get(name, '')[:40]}' and not {count} numbers: "
            "mend it."
        )
    return found


def sizes(source: Source, keys: Keys, name: str) -> Shape:
    """Read the sizes along x, y, z of a header as a shape (z, y, x). Raises VolumeError."""
    x, y, z = numbers(source, keys, name)
    return int(z), int(y), int(x)


def kind_of(source: Source, keys: Keys, name: str, known: Mapping[str, str]) -> str:
    """Return the code of the type of numbers that a header gives under the key ``name``.

    ``known`` has the code, such as "u1", for each word of the format, in small letters. Raises
    VolumeError, which lists them, for any other word.
    """
    given = keys.get(name, "").strip("\"' ").lower()
    if given not in known:
        raise VolumeError(
            f"'{source.name}' gives {name} = '{given[:40]}', which isogi cannot read: write one of "
            f"{', '.join(known)}."
        )
    return known[given]


def text_of(source: Source) -> str:
    """Read a header, at most MOST_HEADER_BYTES of it, a character for each byte."""
    with source.open() as file:
        return file.read(MOST_HEADER_BYTES).decode("latin-1")


def data_of(source: Source, name: str) -> Source:
    """Return the file that a header names; if it is not at that place, one of the same name next to
    the header. Raises VolumeError.
    """
    if source.path is None and source.member is None:
        raise VolumeError(
            f"'{source.name}' is a header whose voxels are in another file, '{name}': send both "
            "together in a ZIP file."
        )
    folder = (source.member or source.path or Path()).parent
    given = PurePath(name.replace("\\", "/"))
    inside = not given.is_absolute() and ".." not in given.parts
    for each in (given, PurePath(given.name)) if inside else (PurePath(given.name),):
        path = folder / each
        if path in source.paths if source.archive else path.is_file():
            return source.at(path)
    raise VolumeError(
        f"'{source.name}' is a header, and '{given.name}' with its voxels is not next to it: put "
        "it there."
    )


def grid_of(source: Source, kind: str, said: Described) -> Grid:
    """Open the bare voxels that a header, the ``source``, of a ``kind`` describes as a grid.

    Raises VolumeError if it claims too many voxels, or their file is not there. The slabs raise it
    if that file ends before the last voxel.
    """
    source.check(said.shape)
    voxels = data_of(source, said.data) if said.data else source
    size = math.prod(said.shape) * said.dtype.itemsize
    first = said.first
    if first is None:
        # Of a packed file the bytes of its content count.
        with voxels.unpacked() as content:
            first = max(content.seek(0, 2) - size, 0)
    # ``Source.at`` returns a file with the usual limit of voxels: set that of the header.
    voxels = replace(voxels, voxels=source.voxels)
    beside = () if voxels.path in (None, source.path) else (voxels.path,)
    return Grid(
        said.shape,
        said.dtype,
        said.spacing,
        partial(raw_slabs, voxels, first, said.shape, said.dtype),
        source.stamp if source.archive else partial(source.stamp, *filter(None, beside)),
        said.affine,
        said.unit,
        voxels.cut_notes(first + size),
        read_as=read_as(kind, said.dtype, "its header"),
    )


BRICK_NOTE = "BRICK_SIZE is read as the extent of the whole brick, as VisIt has it."

BOV_TYPES = {
    **{"byte": "u1", "short": "i2", "int": "i4", "float": "f4", "double": "f8"},
    **{"bytes": "u1", "shorts": "i2", "ints": "i4", "floats": "f4", "doubles": "f8"},
}


@reader("BOV")
def open_bov(source: Source) -> Grid:
    """Open the header of a brick of values as a grid. Source: VisIt's manual, "Creating BOV files".
    Raises VolumeError.
    """
    keys = keys_of(text_of(source), ":")
    name = keys.get("data_file", "")
    if not name or "%" in name or keys.get("data_components", "1") != "1":
        raise VolumeError(
            f"'{source.name}' is of several files or of several numbers a voxel: write one file "
            "of one number a voxel."
        )
    shape = sizes(source, keys, "data_size")
    kind = kind_of(source, keys, "data_format", BOV_TYPES)
    order = ">" if keys.get("data_endian", "").upper() == "BIG" else "<"
    # BRICK_SIZE is the extent of the whole; nodes are at its ends, zones between them.
    extent = numbers(source, keys, "brick_size") if "brick_size" in keys else None
    nodal = keys.get("centering", "zonal").strip("\"' ").lower() == "nodal"
    counts = [max(n - nodal, 1) for n in shape[::-1]]
    if extent is None:
        steps = (1.0, 1.0, 1.0)
    else:
        steps = triple(length / n for length, n in zip(extent, counts, strict=True))
    origin = np.zeros(3)
    if "brick_origin" in keys:
        origin = np.array(numbers(source, keys, "brick_origin"))
    affine = np.column_stack([np.diag(steps), origin + (0.0 if nodal else 0.5) * np.array(steps)])
    first = int(numbers(source, keys, "byte_offset", 1)[0]) if "byte_offset" in keys else 0
    said = Described(name, first, shape, np.dtype(f"{order}{kind}"), steps)
    grid = grid_of(source, "BOV", replace(said, affine=Affine.of(affine) if extent else None))
    return replace(grid, notes=(*grid.notes, BRICK_NOTE)) if extent else grid


VGI_TYPES = {
    "unsigned integer": "u",
    "signed integer": "i",
    "integer": "i",
    "float": "f",
}
"""Letters of NumPy's types; another entry of VGI gives the bits of a number."""


@reader("VGI")
def open_vgi(source: Source) -> Grid:
    """Open the header of a volume of VGStudio as a grid. Raises VolumeError."""
    keys = keys_of(text_of(source), "=")
    shape = sizes(source, keys, "size")
    kind = kind_of(source, keys, "datatype", VGI_TYPES)
    bits = int(numbers(source, keys, "bitsperelement", 1)[0])
    if bits not in (8, 16, 32, 64):
        raise VolumeError(f"'{source.name}' gives {bits} bits for a voxel: write 8, 16, 32 or 64.")
    first = int(numbers(source, keys, "skipheader", 1)[0]) if "skipheader" in keys else 0
    known = "resolution" in keys
    steps = triple(numbers(source, keys, "resolution")) if known else (1.0, 1.0, 1.0)
    dtype = np.dtype(f"<{kind}{bits // 8}")
    name = keys.get("name", f"{PurePath(source.name).stem}.vol")
    unit = keys.get("unit", "mm") if known else ""
    return grid_of(source, "VGI", Described(name, first, shape, dtype, steps, unit=unit))


DAT_TYPES = {"uchar": "u1", "char": "i1", "ushort": "u2", "short": "i2", "float": "f4"}


@reader("a .dat header")
def open_dat(source: Source) -> Grid:
    """Open a header of the Volume Library as a grid. Raises VolumeError."""
    keys = keys_of(text_of(source), ":")
    shape = sizes(source, keys, "resolution")
    kind = kind_of(source, keys, "format", DAT_TYPES)
    steps = (1.0, 1.0, 1.0)
    if "slicethickness" in keys:
        steps = triple(numbers(source, keys, "slicethickness"))
    dtype = np.dtype(f"<{kind}")
    return grid_of(
        source, "a .dat header", Described(keys["objectfilename"], 0, shape, dtype, steps)
    )


META_TYPES = {
    **{"met_char": "i1", "met_uchar": "u1", "met_short": "i2", "met_ushort": "u2"},
    **{"met_int": "i4", "met_uint": "u4", "met_long": "i4", "met_ulong": "u4"},
    **{"met_long_long": "i8", "met_ulong_long": "u8", "met_float": "f4", "met_double": "f8"},
}
LAST_META_KEY = re.compile(
    r"^\s*ElementDataFile\s*=\s*([^\r\n]*)\r?\n?", re.MULTILINE | re.IGNORECASE
)


def open_metaimage(source: Source) -> Grid:
    """Open a MetaImage as a grid: bare voxels of one number by themselves, others by SimpleITK.
    Raises VolumeError.
    """
    text = text_of(source)
    end = LAST_META_KEY.search(text)
    keys = keys_of(text[: end.end()] if end else text, "=")
    if end and _is_plain(keys, end[1].strip()):
        return _open_plain_metaimage(source)
    return open_itk(source)


def _is_plain(keys: Keys, name: str) -> bool:
    """Return True if a header describes one file of bare voxels of three dimensions."""
    packed = keys.get("compresseddata", "false").lower() == "true"
    binary = keys.get("binarydata", "true").lower() == "true"
    one = keys.get("elementnumberofchannels", "1") == "1"
    alone = name.split()[:1] != ["LIST"] and "%" not in name
    known = keys.get("elementtype", "").lower() in META_TYPES
    return keys.get("ndims") == "3" and binary and one and alone and known and not packed


@reader("MetaImage")
def _open_plain_metaimage(source: Source) -> Grid:
    """Open bare voxels with a header of MetaImage, which lie in a patient's left, posterior,
    superior. Source: ITK's MetaIO, "MetaImage".
    """
    text = text_of(source)
    end = LAST_META_KEY.search(text)
    assert end is not None, "the header was looked at"
    keys = keys_of(text[: end.end()], "=")
    name = "" if end[1].strip().upper() == "LOCAL" else end[1].strip()
    kind = kind_of(source, keys, "elementtype", META_TYPES)
    msb = keys.get("binarydatabyteordermsb", keys.get("elementbyteordermsb", "false"))
    steps = np.ones(3)
    for key in ("elementsize", "elementspacing"):
        if key in keys:
            steps = np.array(numbers(source, keys, key))
    turn = np.eye(3)
    for key in ("orientation", "rotation", "transformmatrix"):
        if key in keys:
            turn = np.array(numbers(source, keys, key, 9)).reshape(3, 3).T
    origin = np.zeros(3)
    for key in ("origin", "position", "offset"):
        if key in keys:
            origin = np.array(numbers(source, keys, key))
    first: int | None = (
        int(numbers(source, keys, "headersize", 1)[0]) if "headersize" in keys else 0
    )
    if first == -1:
        first = None
    elif not name:
        first = end.end()
    affine = ITK_TO_RAS @ np.column_stack([turn * steps, origin])
    said = Described(
        name,
        first,
        sizes(source, keys, "dimsize"),
        np.dtype(f"{'>' if msb.lower() == 'true' else '<'}{kind}"),
        triple(steps),
        Affine.of(affine, PATIENT_AXES),
        "mm",
    )
    return grid_of(source, "MetaImage", said)


SIDE_SUFFIXES = (".mhd", ".nhdr", ".bov", ".vgi", ".dat", ".hdr")
MOST_LOOKED_AT = 64
"""Headers in a folder that are searched for a file's name, at most."""


def header_beside(source: Source) -> Source | None:
    """Find the header next to bare voxels that names them: the one of the same stem first; None if
    there is none. Raises VolumeError if several others do.
    """
    path = source.path
    if path is None or source.archive is not None:
        return None
    found = [
        each
        for each in sorted(path.parent.iterdir())[: 1 << 12]
        if each.suffix.lower() in SIDE_SUFFIXES and each != path and each.is_file()
    ]
    named = [each for each in found[:MOST_LOOKED_AT] if path.name in text_of(source.at(each))]
    same = [each for each in named if each.stem == path.stem]
    if len(same or named) > 1:
        listed = ", ".join(f"'{each.name}'" for each in (same or named)[:4])
        raise VolumeError(
            f"'{source.name}' is bare voxels, and {listed} next to it name it: give one of these."
        )
    return source.at((same or named)[0]) if named else None
