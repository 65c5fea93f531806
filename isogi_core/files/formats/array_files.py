"""Arrays: NumPy's files, .npy and .npz, and bare voxels, whose sizes and type are in the file's
name, or are given.
"""

import math
import re
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import PurePath
from typing import IO, Any

import numpy as np

from isogi_core.errors import VolumeError
from isogi_core.files.formats.kinds import PACKED_SUFFIXES, ZIP_MAGIC
from isogi_core.files.formats.source import (
    LUMINANCE_NOTE,
    Source,
    luminance_of_colours,
    pick_axes,
    raw_slabs,
    read_numbers,
    reader,
    skip,
    slabs_in,
)
from isogi_core.files.grid import Grid, Shape, read_as
from isogi_core.files.packed_files import read_end


@reader("NumPy", "part", "time", "channel")
def open_numpy(source: Source) -> Grid:
    """Open an array (z, y, x) as a grid: only its header is read now. Raises VolumeError.

    If it has four or five dimensions, ``pick_axes`` chooses an index along each of the first ones.
    A last dimension of three or four bytes holds colours.
    """
    with _array(source) as file:
        shape, _, dtype = _array_header(file)
    if dtype.hasobject or dtype.names:
        raise VolumeError(f"'{source.name}' holds {dtype}: save an array of numbers.")
    coloured = len(shape) == 4 and dtype == np.uint8 and shape[-1] in (3, 4)
    field = shape[:-1] if coloured else shape
    if len(field) < 3:
        raise VolumeError(
            f"'{source.name}' has {len(field)} dimensions, {shape}: a volume has three (z, y, x), "
            "so stack its slices."
        )
    picked, moment, _ = pick_axes(source, field)
    source.check(field[-3:])
    slabs = partial(_array_slabs, source, picked, coloured)
    notes = (LUMINANCE_NOTE,) if coloured else ()
    # The luminance of colours is a real number.
    if coloured:
        values = np.dtype(np.float32)
    else:
        values = dtype
    return Grid(
        field[-3:],
        values,
        (1.0, 1.0, 1.0),
        slabs,
        source.stamp,
        notes=notes,
        moment=moment,
        read_as=read_as("NumPy", dtype),
    )


@contextmanager
def _array(source: Source) -> Iterator[IO[bytes]]:
    """Yield the file of an array, at its beginning."""
    with source.open() as file:
        if file.read(4) != ZIP_MAGIC:
            file.seek(0)
            yield file
            return
        with zipfile.ZipFile(file) as whole:
            names = [
                name.removesuffix(".npy") for name in whole.namelist() if name.endswith(".npy")
            ]
            chosen = source.chosen.get("part") or (names[0] if len(names) == 1 else None)
            if chosen not in names:
                listed = ", ".join(f"'{source.name}#{name}'" for name in names[:8])
                raise VolumeError(
                    f"'{source.name}' holds several arrays, or none of that name: choose of "
                    f"{listed}."
                )
            with whole.open(f"{chosen}.npy") as member:
                yield member


def _array_header(file: IO[bytes]) -> tuple[Shape, bool, np.dtype[Any]]:
    """Return shape, order and type of an array, whose values come next."""
    version = np.lib.format.read_magic(file)
    if version == (1, 0):
        read = np.lib.format.read_array_header_1_0
    else:
        read = np.lib.format.read_array_header_2_0
    shape, fortran, dtype = read(file)
    return tuple(int(n) for n in shape), bool(fortran), dtype


def _array_slabs(source: Source, picked: tuple[int, ...], coloured: bool) -> Iterator[np.ndarray]:
    """Yield some layers at a time; the whole at once if the first index is the fastest."""
    with _array(source) as file:
        shape, fortran, dtype = _array_header(file)
        inner = shape[len(picked) :]
        if fortran:
            whole = read_numbers(file, source.name, math.prod(shape), dtype).reshape(
                shape, order="F"
            )
            yield _values(whole[picked], coloured)
            return
        if picked:
            before = int(np.ravel_multi_index(picked, shape[: len(picked)]))
        else:
            before = 0
        skip(file, before * math.prod(inner) * dtype.itemsize)
        for slab in slabs_in(file, source.name, inner, dtype):
            yield _values(slab, coloured)
        read_end(file)


def _values(slab: np.ndarray, coloured: bool) -> np.ndarray:
    if coloured:
        return luminance_of_colours(slab)
    return slab


RAW_SUFFIXES = (".raw", ".bin", ".dat", ".data", ".vol")

_TYPES = {
    **{
        f"{kind}{8 * size}": f"{code}{size}"
        for kind, code in (("int", "i"), ("uint", "u"))
        for size in (1, 2, 4, 8)
    },
    **{"uchar": "u1", "byte": "u1", "ushort": "u2", "short": "i2", "float16": "f2"},
    **{"float32": "f4", "float": "f4", "float64": "f8", "double": "f8"},
}
_ORDERS = {"little": "<", "le": "<", "lsb": "<", "big": ">", "be": ">", "msb": ">"}
_SIZES = re.compile(r"(\d{1,7})x(\d{1,7})x(\d{1,7})")

RAW_EXAMPLE = "raw = '256x256x128,uint8,little'"
"""An example of sizes along x, y, z, a type and a byte order."""


def is_raw(name: str) -> bool:
    """Return True if a file seems to be bare voxels by its ``name``, which has their
    sizes in it.
    """
    path = PurePath(name.lower())
    if path.suffix in PACKED_SUFFIXES:
        bare = path.with_suffix("")
    else:
        bare = path
    return bare.suffix in RAW_SUFFIXES and any(_SIZES.fullmatch(word) for word in _words(name))


@reader("bare voxels", "raw")
def open_raw(source: Source) -> Grid:
    """Open bare voxels as a grid, of the sizes and the type that are given, else in the name.
    Raises VolumeError.
    """
    given = source.chosen.get("raw")
    shape, dtype = _read(
        source, given.split(",") if given else _words(source.name), "as given" if given else ""
    )
    source.check(shape)
    if PurePath(source.name).suffix.lower() not in PACKED_SUFFIXES:
        _check_length(source, shape, dtype)
    sizes = " × ".join(map(str, shape[::-1]))
    if dtype.itemsize == 1:
        order = ""
    else:
        order = f", {'big' if dtype.byteorder == '>' else 'little'}-endian"
    how = f"{sizes} voxels of {dtype.name}{order}, {'as given' if given else 'by its name'}"
    notes = (
        f"The file has no header: it is read as {how}.",
        *source.cut_notes(math.prod(shape) * dtype.itemsize),
    )
    slabs = partial(raw_slabs, source, 0, shape, dtype, exact=True)
    return Grid(
        shape,
        dtype,
        (1.0, 1.0, 1.0),
        slabs,
        source.stamp,
        notes=notes,
        read_as=read_as("bare voxels", dtype),
    )


def _words(name: str) -> list[str]:
    """Return the words of a file's name."""
    return [word for word in re.split(r"[^a-z0-9]+", PurePath(name).name.lower()) if word]


def _read(source: Source, words: Sequence[str], given: str) -> tuple[Shape, np.dtype[Any]]:
    """Return the shape (z, y, x) and the type that words name. Without a type voxels are bytes."""
    plain = [word.strip().lower() for word in words]
    sizes = next((match for word in plain if (match := _SIZES.fullmatch(word))), None)
    kind = next((_TYPES[word] for word in plain if word in _TYPES), "")
    order = next((_ORDERS[word] for word in plain if word in _ORDERS), "<")
    unknown = [
        word for word in plain if not _SIZES.fullmatch(word) and word not in (*_TYPES, *_ORDERS)
    ]
    if sizes is None or (given and (unknown or not kind)):
        raise VolumeError(
            f"The voxels of '{source.name}' need their sizes, a type and a byte order: "
            f"{RAW_EXAMPLE}."
        )
    x, y, z = (int(n) for n in sizes.groups())
    return (z, y, x), np.dtype(f"{order}{kind or 'u1'}")


def _check_length(source: Source, shape: Shape, dtype: np.dtype[Any]) -> None:
    """Raise VolumeError if the file has more or fewer bytes than its voxels take."""
    with source.open() as file:
        length = file.seek(0, 2)
        size = math.prod(shape) * dtype.itemsize
    if length != size:
        sizes = " × ".join(map(str, shape[::-1]))
        wrong = (
            f"'{source.name}' has {length} bytes, and {sizes} voxels of {dtype.name} take {size}"
        )
        would = [
            *(f"{sizes} of {name}" for name in types_of(length, math.prod(shape))),
            *depths_of(length, shape, dtype),
            *cubes_of(length),
        ]
        fits = f" ({' or '.join(would[:3])} would fit)" if would else ""
        raise VolumeError(f"{wrong}{fits}: say what it holds, {RAW_EXAMPLE}.")


USUAL_TYPES = {1: "uint8", 2: "uint16", 4: "float32", 8: "float64"}
"""Types that bare voxels often have, by their bytes."""


def types_of(length: int, voxels: int) -> list[str]:
    """Name the type of which so many ``voxels`` take ``length`` bytes; none if there is none."""
    if length % voxels:
        return []
    return [name for size, name in USUAL_TYPES.items() if size == length // voxels]


def depths_of(length: int, shape: Shape, dtype: np.dtype[Any]) -> list[str]:
    """Name the sizes of which ``length`` bytes are whole layers, if they are."""
    depth, rest = divmod(length, shape[1] * shape[2] * dtype.itemsize)
    if rest or not depth:
        return []
    return [f"{shape[2]} × {shape[1]} × {depth} of {dtype.name}"]


def cubes_of(length: int) -> list[str]:
    """Name the cubes of the usual types that take ``length`` bytes."""
    sides = {name: round((length / size) ** (1 / 3)) for size, name in USUAL_TYPES.items()}
    return [
        f"{n} × {n} × {n} of {name}"
        for (size, name), n in zip(USUAL_TYPES.items(), sides.values(), strict=True)
        if n > 1 and n**3 * size == length
    ]
