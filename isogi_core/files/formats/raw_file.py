"""Bare voxels without a header: their sizes and type are in the file's name, or are given."""

import math
import re
from collections.abc import Sequence
from functools import partial
from pathlib import PurePath
from typing import Any

import numpy as np

from isogi_core.errors import VolumeError
from isogi_core.files.formats.source import Source, raw_slabs, reader
from isogi_core.files.grid import Grid, Shape, read_as

RAW_SUFFIXES = (".raw", ".bin", ".dat", ".data", ".vol")
PACKED_SUFFIXES = (".gz", ".bz2")

_TYPES = {
    **{f"{kind}{8 * size}": f"{code}{size}" for kind, code in (("int", "i"), ("uint", "u")) for size in (1, 2, 4, 8)},
    **{"uchar": "u1", "byte": "u1", "ushort": "u2", "short": "i2", "float16": "f2"},
    **{"float32": "f4", "float": "f4", "float64": "f8", "double": "f8"},
}
_ORDERS = {"little": "<", "le": "<", "lsb": "<", "big": ">", "be": ">", "msb": ">"}
_SIZES = re.compile(r"(\d{1,7})x(\d{1,7})x(\d{1,7})")

RAW_EXAMPLE = "raw = '256x256x128,uint8,little'"
"""What sizes along x, y, z, a type and a byte order look like."""


def is_raw(name: str) -> bool:
    """Whether a file seems to be bare voxels by its ``name``, which has their sizes in it."""
    path = PurePath(name.lower())
    bare = path.with_suffix("") if path.suffix in PACKED_SUFFIXES else path
    return bare.suffix in RAW_SUFFIXES and any(_SIZES.fullmatch(word) for word in _words(name))


@reader("bare voxels", "raw")
def open_raw(source: Source) -> Grid:
    """Open bare voxels as a grid, of the sizes and the type that are given, else in the name. Raises VolumeError."""
    given = source.chosen.get("raw")
    shape, dtype = _read(source, given.split(",") if given else _words(source.name), "as given" if given else "")
    source.check(shape)
    if PurePath(source.name).suffix.lower() not in PACKED_SUFFIXES:
        _check_length(source, shape, dtype)
    sizes = " × ".join(map(str, shape[::-1]))
    order = "" if dtype.itemsize == 1 else f", {'big' if dtype.byteorder == '>' else 'little'}-endian"
    how = f"{sizes} voxels of {dtype.name}{order}, {'as given' if given else 'by its name'}"
    notes = (f"The file has no header: it is read as {how}.", *source.cut_notes(math.prod(shape) * dtype.itemsize))
    slabs = partial(raw_slabs, source, 0, shape, dtype, exact=True)
    return Grid(shape, dtype, (1.0, 1.0, 1.0), slabs, source.stamp, notes=notes, read_as=read_as("bare voxels", dtype))


def _words(name: str) -> list[str]:
    """The words of a file's name."""
    return [word for word in re.split(r"[^a-z0-9]+", PurePath(name).name.lower()) if word]


def _read(source: Source, words: Sequence[str], given: str) -> tuple[Shape, np.dtype[Any]]:
    """The shape (z, y, x) and the type that words say; bytes where the file has as many as voxels, and no type."""
    plain = [word.strip().lower() for word in words]
    sizes = next((match for word in plain if (match := _SIZES.fullmatch(word))), None)
    kind = next((_TYPES[word] for word in plain if word in _TYPES), "")
    order = next((_ORDERS[word] for word in plain if word in _ORDERS), "<")
    unknown = [word for word in plain if not _SIZES.fullmatch(word) and word not in (*_TYPES, *_ORDERS)]
    if sizes is None or (given and (unknown or not kind)):
        raise VolumeError(f"The voxels of '{source.name}' need their sizes, a type and a byte order: {RAW_EXAMPLE}.")
    x, y, z = (int(n) for n in sizes.groups())
    return (z, y, x), np.dtype(f"{order}{kind or 'u1'}")


def _check_length(source: Source, shape: Shape, dtype: np.dtype[Any]) -> None:
    """Raise VolumeError where the file has other bytes than its voxels take."""
    with source.open() as file:
        length, size = file.seek(0, 2), math.prod(shape) * dtype.itemsize
    if length != size:
        sizes = " × ".join(map(str, shape[::-1]))
        wrong = f"'{source.name}' has {length} bytes, and {sizes} voxels of {dtype.name} take {size}"
        raise VolumeError(f"{wrong}: say what it holds, {RAW_EXAMPLE}.")
