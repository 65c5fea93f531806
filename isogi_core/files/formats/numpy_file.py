"""NumPy's own files: an array in an .npy file, or one of several in an .npz file."""

import math
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import IO, Any

import numpy as np

from isogi_core.errors import VolumeError
from isogi_core.files.formats.source import (
    LUMINANCE_NOTE,
    Source,
    luminance_of_colours,
    pick_axes,
    read_numbers,
    reader,
    skip,
    slabs_in,
)
from isogi_core.files.grid import Grid, Shape, read_as
from isogi_core.files.packed_files import read_end

NPY_MAGIC, ZIP_MAGIC = b"\x93NUMPY", b"PK\x03\x04"

UNPACK_HINT = "unpack it, and give what is in it, such as a folder of Zarr or of slices"


@reader("NumPy", "part", "time", "channel")
def open_numpy(source: Source) -> Grid:
    """Open an array (z, y, x) as a grid: only its header is read now. Raises VolumeError.

    Of four or five dimensions, the first choose; a last one of three or four bytes is a colour.
    """
    with _array(source) as file:
        shape, _, dtype = _array_header(file)
    if dtype.hasobject or dtype.names:
        raise VolumeError(f"'{source.name}' holds {dtype}: save an array of numbers.")
    coloured = len(shape) == 4 and dtype == np.uint8 and shape[-1] in (3, 4)
    field = shape[:-1] if coloured else shape
    picked, moment, _ = pick_axes(source, field)
    source.check(field[-3:])
    slabs = partial(_array_slabs, source, picked, coloured)
    notes, known = (LUMINANCE_NOTE,) if coloured else (), read_as("NumPy", dtype)
    values = np.dtype(np.float32) if coloured else dtype
    return Grid(field[-3:], values, (1.0, 1.0, 1.0), slabs, source.stamp, notes=notes, moment=moment, read_as=known)


@contextmanager
def _array(source: Source) -> Iterator[IO[bytes]]:
    """The file of an array, at its beginning."""
    with source.open() as file:
        if file.read(4) != ZIP_MAGIC:
            file.seek(0)
            yield file
            return
        with zipfile.ZipFile(file) as whole:
            names = [name.removesuffix(".npy") for name in whole.namelist() if name.endswith(".npy")]
            chosen = source.chosen.get("part") or (names[0] if len(names) == 1 else None)
            if not names:
                raise VolumeError(f"'{source.name}' is a ZIP file without an array of NumPy: {UNPACK_HINT}.")
            if chosen not in names:
                listed = ", ".join(f"'{source.name}#{name}'" for name in names[:8])
                raise VolumeError(f"'{source.name}' holds several arrays, or none of that name: choose of {listed}.")
            with whole.open(f"{chosen}.npy") as member:
                yield member


def _array_header(file: IO[bytes]) -> tuple[Shape, bool, np.dtype[Any]]:
    """Shape, order and type of an array, whose values come next."""
    version = np.lib.format.read_magic(file)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, fortran, dtype = read(file)
    return tuple(int(n) for n in shape), bool(fortran), dtype


def _array_slabs(source: Source, picked: tuple[int, ...], coloured: bool) -> Iterator[np.ndarray]:
    """Some layers at a time; the whole at once where the first index is the fastest."""
    with _array(source) as file:
        shape, fortran, dtype = _array_header(file)
        inner = shape[len(picked) :]
        if fortran:
            whole = read_numbers(file, source.name, math.prod(shape), dtype).reshape(shape, order="F")
            yield _values(whole[picked], coloured)
            return
        before = int(np.ravel_multi_index(picked, shape[: len(picked)])) if picked else 0
        skip(file, before * math.prod(inner) * dtype.itemsize)
        for slab in slabs_in(file, source.name, inner, dtype):
            yield _values(slab, coloured)
        read_end(file)


def _values(slab: np.ndarray, coloured: bool) -> np.ndarray:
    return luminance_of_colours(slab) if coloured else slab
