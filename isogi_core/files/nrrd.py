"""NRRD volumes: voxels are read here, never more than the header promises.

Format: https://teem.sourceforge.net/nrrd/format.html. pynrrd does not read the voxels, as it inflates whole files
before it checks the sizes, and follows a header's data file anywhere on the disk.
"""

import bz2
import gzip
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import IO, Any
from unicodedata import normalize

import numpy as np

from isogi_core.errors import VolumeError
from isogi_core.files.formats.source import Source, luminance_of_colours, skip
from isogi_core.files.grid import Grid, Vector, read_as, slab_layers
from isogi_core.files.nrrd_header import (
    TEXT_ENCODINGS,
    Header,
    Layout,
    affine_of,
    data_names,
    labels_of,
    layout_of,
    number_type,
    placed_by,
    read_header,
    spacing_of,
    unit_of,
)
from isogi_core.files.packed_files import PACKING_DAMAGE, READ_BYTES, Content, cut_notes, read_end
from isogi_core.files.regular import open_regular
from isogi_core.files.zarr_location import stamp_of

_RAW, _GZIP, _BZIP2 = ("raw",), ("gzip", "gz"), ("bzip2", "bz2")


def read_nrrd(path: str | Path) -> tuple[np.ndarray, Vector]:
    """Read one scalar volume: the array (z, y, x) in the file's own type, and spacing (x, y, z).

    Raises VolumeError as ``open_nrrd`` and the grid's slabs do. No memory is allocated on the header's word alone.
    """
    grid = open_nrrd(path)
    x, y, z = grid.spacing
    return np.concatenate(list(grid.slabs())), (x, y, z)


def open_nrrd(path: str | Path, chosen: Mapping[str, str] | None = None) -> Grid:
    """Open one scalar volume as a grid; only the header is read now.

    Attached or detached (data files at or below the header's folder); raw, gzip, bzip2 or text; every integer and float
    type, both byte orders. ``chosen`` are a ``channel`` and a ``time`` where there are several. Spacing is the length
    of each space direction, else ``spacings``, else 1, as the file gives it, even where that is not positive. Raises
    VolumeError where the file is missing, not NRRD or not of scalar fields in space; the slabs raise it where the file
    does not hold exactly the promised voxels.
    """
    return _open(Source(str(path), Path(path), chosen=chosen or {}))


def read_attached(file: IO[bytes], name: str, most: int) -> Grid:
    """Open one scalar volume of an open, untrusted file with the display ``name``.

    Like ``open_nrrd``, but no other file is opened, and the header must end within MAX_HEADER bytes and promise at
    most ``most`` voxels: both are checked before any memory is allocated.
    """
    return _open(Source(name, file=file, voxels=most))


def _open(source: Source) -> Grid:
    source.refuse_others("channel", "time")
    with _readable(source), source.open() as file:
        header = read_header(source, file)
        layout, dtype = layout_of(source, header), number_type(source.name, header)
        with _data(source, header, file) as parts:
            files = [Path(part.name) for part in parts if part is not file]
            cut = _cut_notes(source, header, parts, layout.numbers * dtype.itemsize)
    return Grid(
        layout.shape,
        np.dtype(np.float32) if layout.number is None else dtype,
        spacing_of(source.name, header, layout),
        partial(_slabs, source),
        partial(_stamp, source, files),
        affine_of(header, layout),
        unit_of(header),
        (*layout.notes, *cut),
        layout.moment,
        layout.unchosen,
        labels_of(header, layout.number or 0),
        read_as("NRRD", dtype, placed_by(header)),
    )


def _stamp(source: Source, files: list[Path]) -> str:
    """The state of the header and of its data files, and what is chosen of them."""
    paths = [source.path] if source.path is not None else []
    chosen = f" {sorted(source.chosen.items())}" if source.chosen else ""
    return f"{stamp_of([*paths, *(files or paths)])}{chosen}"


def _slabs(source: Source) -> Iterator[np.ndarray]:
    """Read the voxels of a file, some layers at a time; (layers, ny, nx) each."""
    with _readable(source), source.open() as file:
        header = read_header(source, file)
        layout, dtype = layout_of(source, header), number_type(source.name, header)
        with _data(source, header, file) as parts:
            size = layout.numbers * dtype.itemsize
            blocks = (
                block for part in parts for block in _decoded_bytes(source.name, header, part, size // len(parts))
            )
            yield from _field(layout, _layers(layout, dtype, blocks))


def _layers(layout: Layout, dtype: np.dtype[Any], blocks: Iterator[bytes]) -> Iterator[np.ndarray]:
    """The numbers of a file, some layers at a time; (layers, ny, nx, each)."""
    inner = (*layout.shape[1:], layout.each)
    layer = int(np.prod(inner)) * dtype.itemsize
    slab, rest = slab_layers(layer) * layer, bytearray()
    for block in blocks:
        rest += block
        while len(rest) >= slab:
            yield np.frombuffer(rest[:slab], dtype).reshape(-1, *inner)
            del rest[:slab]
    if rest:
        yield np.frombuffer(rest, dtype).reshape(-1, *inner)


def _field(layout: Layout, slabs: Iterator[np.ndarray]) -> Iterator[np.ndarray]:
    """The layers of the field that is chosen, and of each voxel the number; all are passed, so that all are counted."""
    first = layout.field * layout.shape[0]
    last, z = first + layout.shape[0], 0
    for slab in slabs:
        part = slab[max(first - z, 0) : max(last - z, 0)]
        z += len(slab)
        if len(part):
            yield luminance_of_colours(part) if layout.number is None else part[..., layout.number]


@contextmanager
def _readable(source: Source) -> Iterator[None]:
    """Raise VolumeError, which names the volume, for a file that cannot be read."""
    try:
        yield
    except FileNotFoundError as error:
        raise VolumeError(f"There is no file '{error.filename}': check the volume's path.") from error
    except (OSError, ValueError) as error:  # ValueError: a data file's name that no system can hold
        raise VolumeError(f"The volume '{source.name}' cannot be read ({error}): check the file.") from error


@contextmanager
def _data(source: Source, header: Header, file: IO[bytes]) -> Iterator[list[IO[bytes]]]:
    """The files with the voxels: ``file``, which is at the byte after the header, or the header's data files."""
    names = data_names(source, header)
    if names is None:
        yield [file]
        return
    assert source.path is not None, "a header that names files has a path"
    with ExitStack() as opened:
        yield [opened.enter_context(open_regular(_beside(source.path.parent, name))) for name in names]


def _beside(folder: Path, name: str) -> Path:
    """The path of a file in a ``folder``, whose name's letters may be composed otherwise there: å of one or of two."""
    forms = (name, normalize("NFC", name), normalize("NFD", name))
    return next((folder / form for form in forms if (folder / form).exists()), folder / name)


def _decoded_bytes(name: str, header: Header, file: IO[bytes], size: int) -> Iterator[bytes]:
    """Yield ``size`` bytes after line skip, decoding and byte skip; VolumeError where there are fewer or more."""
    encoding, passed = header["encoding"].lower(), 0
    if encoding not in (*_RAW, *_GZIP, *_BZIP2, *TEXT_ENCODINGS):
        raise VolumeError(f"'{name}' has encoding '{encoding}': save it as raw, gzip, bzip2 or text.")
    before = _skip_lines(name, header, file, size)
    try:
        stream = _decoded(encoding, file)
        skip(stream, before)
        dtype = number_type(name, header)
        blocks = _written_out(name, stream, dtype) if encoding in TEXT_ENCODINGS else _blocks(stream, size)
        for block in blocks:
            passed += len(block)
            yield block[: size - passed] if passed > size else block
        passed += read_end(stream)
    except PACKING_DAMAGE as error:
        raise VolumeError(f"The voxels of '{name}' are damaged or cut short ({error}): copy it again.") from error
    if passed != size:
        less = "fewer" if passed < size else "more"
        raise VolumeError(f"'{name}' holds {less} than the {size} bytes that its sizes need: copy it again.")


def _decoded(encoding: str, file: IO[bytes]) -> Content:
    """The stream of decoded voxel bytes in ``file``."""
    if encoding in _GZIP:
        return gzip.GzipFile(fileobj=file)
    return bz2.BZ2File(file) if encoding in _BZIP2 else file


def _written_out(name: str, stream: Content, dtype: np.dtype[Any]) -> Iterator[bytes]:
    """The bytes of numbers that are written out, with blanks or commas between."""
    rest = b""
    while block := stream.read(READ_BYTES >> 4):
        text = (rest + block).replace(b",", b" ")
        words = text.split()
        rest = words.pop() if words and not text[-1:].isspace() else b""
        yield _header_numbers(name, words, dtype)
    yield _header_numbers(name, rest.split(), dtype)


def _header_numbers(name: str, words: list[bytes], dtype: np.dtype[Any]) -> bytes:
    """The bytes of written numbers in a type. VolumeError where one is no number of it."""
    try:
        return np.array([int(word) if dtype.kind in "iu" else float(word) for word in words], dtype).tobytes()
    except (ValueError, OverflowError) as error:
        raise VolumeError(f"'{name}' holds a word that is no {dtype} ({error}): write it again.") from error


def _cut_notes(source: Source, header: Header, parts: list[IO[bytes]], size: int) -> tuple[str, ...]:
    """What there is to say of how packed files end."""
    if header["encoding"].lower() not in _GZIP:
        return ()
    each, notes = size // len(parts), dict[str, None]()
    for part in parts:
        start = part.tell()
        before = _skip_lines(source.name, header, part, each)
        notes |= dict.fromkeys(cut_notes(part, before + each))
        part.seek(start)
    return tuple(notes)


def _skip_lines(name: str, header: Header, file: IO[bytes], size: int) -> int:
    """Skip the header's lines; returns the decoded bytes that are still to be skipped.

    A byte skip of -1 (raw data only) means that the voxels are the file's last ``size`` bytes.
    """
    lines, count = (int(header.get(f"{what} skip") or header.get(f"{what}skip") or 0) for what in ("line", "byte"))
    from_end = count == -1 and header["encoding"] == "raw"
    if lines < 0 or (count < 0 and not from_end):
        raise VolumeError(f"'{name}' skips {lines} lines and {count} bytes, which cannot be: mend its header.")
    while lines > 0 and file.readline():
        lines -= 1
    if not from_end:
        return count
    start = file.tell()
    count = max(0, file.seek(0, 2) - size - start)
    file.seek(start)
    return count


def _blocks(stream: Content, size: int) -> Iterator[bytes]:
    """Yield the next ``size`` bytes, or as many as there are, in blocks."""
    while size > 0 and (block := stream.read(min(size, READ_BYTES))):
        size -= len(block)
        yield block
