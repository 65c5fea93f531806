"""NRRD volumes: pynrrd reads headers, and voxels are read here, never more than the header promises.

Format: https://teem.sourceforge.net/nrrd/format.html. pynrrd does not read the voxels, as it inflates whole files
before it checks the sizes, and follows a header's data file anywhere on the disk.
"""

import bz2
import gzip
import math
import re
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path, PurePath
from typing import IO, Any

import nrrd
import numpy as np

from isogi_core.errors import VolumeError
from isogi_core.files.grid import PATIENT, Affine, Grid, layers_of
from isogi_core.files.regular import open_regular
from isogi_core.files.zarr_location import stamp_of

Spacing = tuple[float, float, float]
_Stream = IO[bytes] | gzip.GzipFile | bz2.BZ2File

MAX_VOXELS = 2**33
"""Most voxels: more mean a damaged header (32 GiB as float32)."""

MAX_HEADER = 1 << 16
"""Most bytes of the header of an untrusted file."""

_SPELLINGS = {
    "i1": "signed char, int8, int8_t",
    "u1": "uchar, unsigned char, uint8, uint8_t",
    "i2": "short, short int, signed short, signed short int, int16, int16_t",
    "u2": "ushort, unsigned short, unsigned short int, uint16, uint16_t",
    "i4": "int, signed int, int32, int32_t",
    "u4": "uint, unsigned int, uint32, uint32_t",
    "i8": "longlong, long long, long long int, signed long long, signed long long int, int64, int64_t",
    "u8": "ulonglong, unsigned long long, unsigned long long int, uint64, uint64_t",
    "f4": "float",
    "f8": "double",
}
_TYPES = {name: code for code, names in _SPELLINGS.items() for name in names.split(", ")}
_GZIP, _BZIP2 = ("gzip", "gz"), ("bzip2", "bz2")
_DATA_FILE = ("data file", "datafile")
_HEADER_END = re.compile(rb"\n[ \t\r\f\v]*\n")
_SCALAR_KINDS = {"domain", "space", "time", "none", "???"}
_BLOCK = 1 << 24

_SPACES = {
    **dict.fromkeys(("right-anterior-superior", "ras"), ((1, 1, 1), PATIENT)),
    **dict.fromkeys(("left-anterior-superior", "las"), ((-1, 1, 1), PATIENT)),
    **dict.fromkeys(("left-posterior-superior", "lps"), ((-1, -1, 1), PATIENT)),
}
"""Signs that bring coordinates of a space to those of a patient's right, anterior and superior, and their letters."""


def read_nrrd(path: str | Path) -> tuple[np.ndarray, Spacing]:
    """Read one scalar volume: the array (z, y, x) in the file's own type, and spacing (x, y, z).

    Raises VolumeError as ``open_nrrd`` and the grid's slabs do. No memory is allocated on the header's word alone.
    """
    path = Path(path)
    with _readable(path), open_regular(path) as file:
        header = _read_header(path, file)
        with _data(path, header, file) as data:
            return _read(path, data, header)


def open_nrrd(path: str | Path) -> Grid:
    """Open one scalar volume as a grid; only the header is read now.

    Attached or detached (the data file at or below the header's folder); raw, gzip or bzip2; every integer
    and float type, both byte orders. Spacing is the length of each space direction, else ``spacings``, else
    1, as the file gives it, even where that is not positive. Raises VolumeError where the file is missing, not
    NRRD or not one 3-D scalar field; the slabs raise it where the file does not hold exactly the promised voxels.
    """
    path = Path(path)
    with _readable(path), open_regular(path) as file:
        header = _read_header(path, file)
        sizes, dtype = _sizes(path, header), _dtype(path, header)
        with _data(path, header, file) as data:
            files = (path, Path(data.name))
        grid = Grid(sizes[::-1], dtype, _spacing(path, header), partial(_slabs, path), partial(stamp_of, files))
        return _placed(grid, header)


def _slabs(path: Path) -> Iterator[np.ndarray]:
    """Read the voxels of a file, some layers at a time; (layers, ny, nx) each."""
    with _readable(path), open_regular(path) as file:
        header = _read_header(path, file)
        (nx, ny, nz), dtype = _sizes(path, header), _dtype(path, header)
        slab, rest = layers_of(nx * ny * dtype.itemsize) * nx * ny * dtype.itemsize, bytearray()
        with _data(path, header, file) as data:
            for block in _decoded_bytes(path, header, data, nx * ny * nz * dtype.itemsize):
                rest += block
                while len(rest) >= slab:
                    yield np.frombuffer(rest[:slab], dtype).reshape(-1, ny, nx)
                    del rest[:slab]
        if rest:
            yield np.frombuffer(rest, dtype).reshape(-1, ny, nx)


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    """Raise VolumeError, which names the volume, for a file that cannot be read."""
    try:
        yield
    except FileNotFoundError as error:
        raise VolumeError(f"There is no file '{error.filename}': check the volume's path.") from error
    except (OSError, ValueError) as error:  # ValueError: a data file's name that no system can hold
        raise VolumeError(f"The volume '{path}' cannot be read ({error}): check the file.") from error


def read_attached(file: IO[bytes], name: str, most: int) -> Grid:
    """Read one scalar volume from an open, untrusted file with the display ``name`` into memory.

    Like ``read_nrrd``, but no other file is opened, and the header must end within MAX_HEADER bytes and promise at
    most ``most`` voxels: both are checked before any memory is allocated.
    """
    path = Path(name)
    if file.read(4) == b"NRRD" and not _HEADER_END.search(file.read(MAX_HEADER)):
        raise VolumeError(f"The NRRD header of '{path}' does not end within {MAX_HEADER} bytes: save the file again.")
    file.seek(0)
    header = _read_header(path, file)
    if _data_file(header) is not None:
        raise VolumeError(f"'{path}' is a header whose data is in another file: save both as one .nrrd file.")
    voxels = math.prod(_sizes(path, header))
    if voxels > most:
        raise VolumeError(f"'{path}' has {voxels} voxels, and {most} are the most that may be: save a smaller part.")
    return _placed(Grid.of(*_read(path, file, header)), header)


def _read(path: Path, file: IO[bytes], header: dict[str, Any]) -> tuple[np.ndarray, Spacing]:
    """Read the array (z, y, x) and the spacing that a ``header`` describes; ``file`` is at the data."""
    sizes, dtype, data = _sizes(path, header), _dtype(path, header), bytearray()
    for block in _decoded_bytes(path, header, file, math.prod(sizes) * dtype.itemsize):
        data += block
    return np.frombuffer(data, dtype).reshape(sizes[::-1]), _spacing(path, header)


def _read_header(path: Path, file: IO[bytes]) -> dict[str, Any]:
    """Read the header's fields, and leave ``file`` at the byte after it."""
    if file.read(4) != b"NRRD":
        raise VolumeError(f"'{path}' is not a NRRD file: give an .nrrd or .nhdr volume.")
    file.seek(0)
    try:
        header: dict[str, Any] = nrrd.read_header(file)
    except Exception as error:  # pynrrd raises some twenty kinds on damaged headers
        raise VolumeError(f"The NRRD header of '{path}' is damaged ({error}): write the file again.") from error
    missing = [field for field in ("dimension", "type", "encoding", "sizes") if field not in header]
    if missing:
        raise VolumeError(f"The NRRD header of '{path}' has no {missing[0]}: write the file again.")
    return header


def _sizes(path: Path, header: dict[str, Any]) -> tuple[int, int, int]:
    """Voxels along x, y, z. VolumeError where the header is not of one 3-D scalar field of a possible size."""
    sizes = [int(n) for n in header["sizes"]]
    if header["dimension"] != 3 or len(sizes) != 3:
        raise VolumeError(f"'{path}' has {header['dimension']} dimensions, not 3: save one scalar field of it.")
    others = [kind for kind in header.get("kinds", ()) if kind.lower() not in _SCALAR_KINDS]
    if others:
        raise VolumeError(f"'{path}' has an axis of kind '{others[0]}': save one scalar field of it.")
    if min(sizes) < 1 or math.prod(sizes) > MAX_VOXELS:
        raise VolumeError(f"'{path}' claims sizes {sizes}, which cannot be: mend its header.")
    x, y, z = sizes
    return x, y, z


def _dtype(path: Path, header: dict[str, Any]) -> np.dtype[Any]:
    """The NumPy type of the header's type and byte order."""
    code = _TYPES.get(header["type"])
    if code is None:
        raise VolumeError(f"'{path}' holds type '{header['type']}': save it as an integer or float type.")
    order = {"little": "<", "big": ">"}.get(header.get("endian", ""))
    if order is None and code[1] != "1":
        raise VolumeError(f"'{path}' does not say its byte order: add 'endian: little' or 'big' to its header.")
    return np.dtype((order or "|") + code)


@contextmanager
def _data(path: Path, header: dict[str, Any], file: IO[bytes]) -> Iterator[IO[bytes]]:
    """The file with the voxels: ``file``, which is at the byte after the header, or the header's data file."""
    name = _data_file(header)
    if name is None:
        yield file
        return
    where = PurePath(name)
    if where.is_absolute() or ".." in where.parts:
        raise VolumeError(f"'{path}' points at '{name}' outside its folder: put the data beside the header.")
    if name.split()[:1] == ["LIST"] or "%" in name:
        raise VolumeError(f"'{path}' spreads its data over several files: save it as one file.")
    with open_regular(path.parent / where) as data:
        yield data


def _data_file(header: dict[str, Any]) -> str | None:
    """Name of the header's data file; None where the voxels follow the header."""
    name: str | None = next((value for field, value in header.items() if field.lower() in _DATA_FILE), None)
    return name


def _decoded_bytes(path: Path, header: dict[str, Any], file: IO[bytes], size: int) -> Iterator[bytes]:
    """Yield ``size`` bytes after line skip, decoding and byte skip; VolumeError where there are fewer or more."""
    encoding, passed = header["encoding"].lower(), 0
    if encoding not in ("raw", *_GZIP, *_BZIP2):
        raise VolumeError(f"'{path}' has encoding '{encoding}': save it as raw, gzip or bzip2.")
    skip = _skip_lines(path, header, file, size)
    try:
        stream = _decoded(encoding, file)
        for _ in _blocks(stream, skip):
            pass
        for block in _blocks(stream, size):
            passed += len(block)
            yield block
        passed += len(stream.read(1))
    except (OSError, EOFError, zlib.error) as error:
        raise VolumeError(f"The voxels of '{path}' are damaged or cut short ({error}): copy it again.") from error
    if passed != size:
        less = "fewer" if passed < size else "more"
        raise VolumeError(f"'{path}' holds {less} than the {size} bytes that its sizes need: copy it again.")


def _decoded(encoding: str, file: IO[bytes]) -> _Stream:
    """The stream of decoded voxel bytes in ``file``."""
    if encoding in _GZIP:
        return gzip.GzipFile(fileobj=file)
    if encoding in _BZIP2:
        return bz2.BZ2File(file)
    return file


def _skip_lines(path: Path, header: dict[str, Any], file: IO[bytes], size: int) -> int:
    """Skip the header's lines; returns the decoded bytes that are still to be skipped.

    A byte skip of -1 (raw data only) means that the voxels are the file's last ``size`` bytes.
    """
    lines = header.get("line skip", header.get("lineskip", 0))
    skip: int = header.get("byte skip", header.get("byteskip", 0))
    from_end = skip == -1 and header["encoding"] == "raw"
    if lines < 0 or (skip < 0 and not from_end):
        raise VolumeError(f"'{path}' skips {lines} lines and {skip} bytes, which cannot be: mend its header.")
    while lines > 0 and file.readline():
        lines -= 1
    if not from_end:
        return skip
    start = file.tell()
    skip = max(0, file.seek(0, 2) - size - start)
    file.seek(start)
    return skip


def _blocks(stream: _Stream, size: int) -> Iterator[bytes]:
    """Yield the next ``size`` bytes, or as many as there are, in blocks."""
    while size > 0 and (block := stream.read(min(size, _BLOCK))):
        size -= len(block)
        yield block


def _spacing(path: Path, header: dict[str, Any]) -> Spacing:
    """Lengths of the space directions (one row per axis), else ``spacings``, else 1."""
    if "space directions" in header:
        rows = np.asarray(header["space directions"], np.float64)
        steps = [math.hypot(*row) for row in rows] if rows.ndim == 2 else []
    else:
        steps = [float(step) for step in header.get("spacings", (1.0, 1.0, 1.0))]
    if len(steps) != 3:
        raise VolumeError(f"'{path}' gives {len(steps)} spacings for 3 axes: mend its header.")
    return steps[0], steps[1], steps[2]


def _placed(grid: Grid, header: dict[str, Any]) -> Grid:
    """The grid with what its header says of the world; with spacing alone where that is all."""
    units = {str(unit).strip('"') for unit in header.get("space units", ())}
    unit = units.pop() if len(units) == 1 else ""
    rows = np.asarray(header.get("space directions", ()), np.float64)
    if rows.shape != (3, 3):
        return replace(grid, unit=unit)
    signs, letters = _SPACES.get(str(header.get("space", "")).lower().removesuffix("-time"), ((1, 1, 1), ""))
    origin = np.asarray(header.get("space origin", (0.0, 0.0, 0.0)), np.float64)
    known = origin if origin.shape == (3,) and np.isfinite(origin).all() else np.zeros(3)
    affine = np.column_stack([rows.T, known]) * np.array(signs)[:, None]
    return replace(grid, unit=unit, affine=Affine.of(affine, letters))
