"""NRRD: pynrrd parses the lines of a header. They are interpreted, and the voxels are read, here:
never more than the header announces.

Format: https://teem.sourceforge.net/nrrd/format.html. pynrrd does not read the voxels, as it
inflates whole files before it checks the sizes, and follows a header's data file anywhere on the
disk.
"""

import bz2
import gzip
import math
import re
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import IO, Any
from unicodedata import normalize

import nrrd
import numpy as np

from isogi_core.errors import VolumeError
from isogi_core.files.coordinates import SPACING_KEY
from isogi_core.files.formats.source import (
    LUMINANCE_NOTE,
    Source,
    luminance_of_colours,
    pick,
    pick_step,
    reader,
    skip,
)
from isogi_core.files.grid import (
    APERIODIC,
    MAX_VOXELS,
    PATIENT_AXES,
    SINGLE_MOMENT,
    Affine,
    Grid,
    LabelName,
    Periodic,
    read_as,
    slab_layers,
)
from isogi_core.files.packed_files import (
    PACKING_DAMAGE,
    READ_BYTES,
    Content,
    cut_notes,
    open_regular,
    read_end,
)
from isogi_core.files.vector import Vector

MAX_HEADER = 1 << 16
"""Most bytes of the header of an untrusted file."""

_SPELLINGS = {
    "i1": "signed char, int8, int8_t",
    "u1": "uchar, unsigned char, uint8, uint8_t",
    "i2": "short, short int, signed short, signed short int, int16, int16_t",
    "u2": "ushort, unsigned short, unsigned short int, uint16, uint16_t",
    "i4": "int, signed int, int32, int32_t",
    "u4": "uint, unsigned int, uint32, uint32_t",
    "i8": (
        "longlong, long long, long long int, signed long long, signed long long int, int64, int64_t"
    ),
    "u8": "ulonglong, unsigned long long, unsigned long long int, uint64, uint64_t",
    "f4": "float",
    "f8": "double",
}
_TYPES = {name: code for code, names in _SPELLINGS.items() for name in names.split(", ")}
_HEADER_END = re.compile(rb"\n[ \t\r\f\v]*\n")
_LIST = re.compile(r"\s*data\s?file\s*:\s*LIST\b", re.IGNORECASE)

TEXT_ENCODINGS = ("ascii", "text", "txt")
"""Encodings whose numbers are written out, so that they have no byte order."""

NAMES_KEY = "data file names"
"""The key under which a header has the lines that follow ``data file: LIST``."""

SPACE_KINDS = ("domain", "space")
TIME_KINDS = ("time",)
COLOUR_KINDS = {"rgb-color": 3, "rgba-color": 4, "3-color": 3, "4-color": 4}
"""Kinds of axes: of space, of time, and of colours; others but UNKNOWN_VALUES are channels."""

UNKNOWN_VALUES = ("none", "???", "")

TIME_KEYS = ("axis 0 index type", "multivolume.framelabels")
"""Keys by which 3D Slicer says that a list is a series in time."""

_SPACES = {
    **dict.fromkeys(("right-anterior-superior", "ras"), ((1, 1, 1), PATIENT_AXES)),
    **dict.fromkeys(("left-anterior-superior", "las"), ((-1, 1, 1), PATIENT_AXES)),
    **dict.fromkeys(("left-posterior-superior", "lps"), ((-1, -1, 1), PATIENT_AXES)),
}
"""Signs that bring coordinates of a space to those of a patient's right, anterior and superior, and
their letters.
"""

Header = dict[str, Any]


def read_header(source: Source, file: IO[bytes]) -> Header:
    """Read the header's fields, and leave ``file`` at the byte after it. That of an upload or of a
    file in a ZIP ends within MAX_HEADER.
    """
    name = source.name
    if file.read(4) != b"NRRD":
        raise VolumeError(f"'{name}' is not a NRRD file: give an .nrrd or .nhdr volume.")
    if source.path is None:
        begun = file.read(MAX_HEADER)
        # A header with its data in other files may end with the file, without a blank line.
        if len(begun) == MAX_HEADER and not _HEADER_END.search(begun):
            raise VolumeError(
                f"The NRRD header of '{name}' does not end within {MAX_HEADER} bytes: save the "
                "file again."
            )
    file.seek(0)
    lines = _lines(file)
    listed = next((place + 1 for place, line in enumerate(lines) if _LIST.match(line)), len(lines))
    try:
        header: Header = nrrd.read_header(lines[:listed])
    except Exception as error:  # pynrrd raises some twenty kinds on damaged headers
        raise VolumeError(
            f"The NRRD header of '{name}' is damaged ({error}): write the file again."
        ) from error
    missing = [field for field in ("dimension", "type", "encoding", "sizes") if field not in header]
    if missing:
        raise VolumeError(f"The NRRD header of '{name}' has no {missing[0]}: write the file again.")
    return {**header, NAMES_KEY: [line.strip() for line in lines[listed:]]}


def _lines(file: IO[bytes]) -> list[str]:
    """Return the lines of a header, without the blank one that ends it."""
    lines = []
    while line := file.readline().decode("utf-8", "surrogateescape").rstrip():
        lines.append(line)
    return lines


def number_type(name: str, header: Header) -> np.dtype[Any]:
    """Return the NumPy type of the header's type and byte order."""
    code = _TYPES.get(header["type"])
    if code is None:
        raise VolumeError(
            f"'{name}' holds type '{header['type']}': save it as an integer or float type."
        )
    order = {"little": "<", "big": ">"}.get(header.get("endian", ""))
    if header["encoding"].lower() in TEXT_ENCODINGS:
        order = "="
    if order is None and code[1] != "1":
        raise VolumeError(
            f"'{name}' does not say its byte order: add 'endian: little' or 'big' to its header."
        )
    return np.dtype((order or "|") + code)


@dataclass(frozen=True)
class Layout:
    """The order of the numbers of a file: ``fields`` of a ``shape`` (z, y, x), of ``each`` numbers
    a voxel.

    Read are the field number ``field``, and number ``number`` of each voxel, or all as a colour if
    that is None. ``axes`` are the places of x, y, z in the header. The ``moment`` is as in
    ``Grid``.
    """

    shape: tuple[int, int, int]
    axes: tuple[int, int, int]
    fields: int = 1
    field: int = 0
    each: int = 1
    number: int | None = 0
    moment: tuple[int, int] = SINGLE_MOMENT
    unchosen: bool = False
    notes: tuple[str, ...] = ()

    @property
    def numbers(self) -> int:
        """The number of all numbers of the file."""
        return self.fields * math.prod(self.shape) * self.each


def layout_of(source: Source, header: Header) -> Layout:
    """Return the layout that a header describes, of the field that is chosen. Raises VolumeError if
    it is not of scalar fields in space.
    """
    sizes = [int(n) for n in header["sizes"]]
    if header["dimension"] != len(sizes):
        raise VolumeError(
            f"'{source.name}' has {header['dimension']} dimensions and {len(sizes)} sizes: "
            "mend its header."
        )
    if not sizes or min(sizes) < 1 or math.prod(sizes) > MAX_VOXELS:
        raise VolumeError(
            f"'{source.name}' claims sizes {sizes}, which cannot be: mend its header."
        )
    kinds = _kinds(header, sizes)
    x, y, z = _space(source.name, header, kinds, sizes)
    shape = (sizes[z], sizes[y], sizes[x])
    source.check(shape)
    inner, outer = (
        [n for n in span if sizes[n] > 1] for span in (range(x), range(z + 1, len(sizes)))
    )
    if len(inner) > 1 or len(outer) > 1:
        raise VolumeError(f"'{source.name}' has sizes {sizes}: save one scalar field of it.")
    facts: dict[str, Any] = {"fields": math.prod(sizes[z + 1 :]), "each": math.prod(sizes[:x])}
    for axes, key in ((outer, "field"), (inner, "number")):
        for axis in axes:
            facts |= _chosen(source, header, kinds[axis], sizes[axis], key)
    return Layout(shape, (x, y, z), **facts)


def _kinds(header: Header, sizes: list[int]) -> list[str]:
    """Return the kind of each axis: one of SPACE_KINDS, TIME_KINDS or COLOUR_KINDS, a channel, or
    one of UNKNOWN_VALUES.
    """
    given = [str(kind).lower() for kind in header.get("kinds", ())]
    if len(given) == len(sizes):
        kinds = given
    else:
        kinds = [""] * len(sizes)
    rows = header.get("space directions")
    if rows is not None:
        rows = np.asarray(rows, np.float64)
    else:
        rows = np.zeros((0, 0))
    if not given and len(rows) == len(sizes) > 3:  # an axis without a direction is none of space
        kinds = ["domain" if np.isfinite(row).all() else "list" for row in rows]
    series = any(key in TIME_KEYS for key in map(str.lower, header))
    return ["time" if kind == "list" and series else kind for kind in kinds]


def _space(name: str, header: Header, kinds: list[str], sizes: list[int]) -> tuple[int, int, int]:
    """Return the places of x, y, z. If there are too few axes in space, axes of unknown kinds are,
    the fastest first.
    """
    unknown = [n for n, kind in enumerate(kinds) if kind in UNKNOWN_VALUES]
    spatial = [n for n, kind in enumerate(kinds) if kind in SPACE_KINDS]
    for n in sorted(unknown, key=lambda n: (sizes[n] == 1, n)):
        spatial += [n] if len(spatial) < 3 else []
    if len(kinds) == 3 and len(spatial) == 2:  # slices in time, one upon the other
        spatial += [n for n, kind in enumerate(kinds) if kind in TIME_KINDS]
    spatial.sort()
    given = header.get("kinds", kinds)
    other = next(
        (
            given[n]
            for n, kind in enumerate(kinds)
            if n not in spatial and kind not in UNKNOWN_VALUES
        ),
        "",
    )
    if len(spatial) != 3:
        if other:
            why = f"an axis of kind '{other}', and "
        else:
            why = ""
        raise VolumeError(
            f"'{name}' has {why}{len(spatial)} dimensions in space, not 3: save one scalar "
            "field of it."
        )
    x, y, z = spatial
    if (y, z) != (x + 1, x + 2) and math.prod(
        sizes[n] for n in range(x, z + 1) if n not in spatial
    ) > 1:
        raise VolumeError(
            f"'{name}' has an axis of kind '{other}' between those of space: save one scalar "
            "field of it."
        )
    return x, y, z


def _chosen(source: Source, header: Header, kind: str, length: int, key: str) -> Header:
    """Return the fields of the layout that follow from an axis of this ``kind``, which is not of
    space: under ``key`` the number of the element that is chosen.
    """
    if kind in TIME_KINDS:
        step, unchosen = pick_step(source, length)
        return {key: step, "moment": (step, length), "unchosen": unchosen}
    if key == "number" and COLOUR_KINDS.get(kind) == length and "channel" not in source.chosen:
        return {key: None, "notes": (LUMINANCE_NOTE,)}
    if segments_of(header) and "channel" not in source.chosen:
        if length > 2:
            others = f"channel = 1 to {length - 1} chooses another"
        else:
            others = "channel = 1 chooses the other"
        return {
            key: 0,
            "notes": (f"The segmentation has {length} layers: the first is shown, and {others}.",),
        }
    return {key: pick(source, "channel", length, "channels")}


_SEGMENT = re.compile(r"Segment(\d+)_(\w+)")


def segments_of(header: Header) -> dict[int, dict[str, str]]:
    """Return the entries of 3D Slicer on the segments of a segmentation, by their numbers; empty
    for other volumes.
    """
    found: dict[int, dict[str, str]] = {}
    for key, value in header.items():
        if (match := _SEGMENT.fullmatch(key)) is not None:
            found.setdefault(int(match[1]), {})[match[2]] = str(value)
    return {
        number: each for number, each in found.items() if "LabelValue" in each or "Name" in each
    }


def labels_of(header: Header, layer: int) -> tuple[LabelName, ...] | None:
    """Return the labels of a segmentation of 3D Slicer in a ``layer``; None if the file is none.

    Files of old versions have a segment in each layer, and no values: these are then 1.
    """
    segments = segments_of(header)
    if not segments:
        return None
    layers = {
        n: _number(each.get("Layer"), 0 if "LabelValue" in each else n)
        for n, each in segments.items()
    }
    there = [each for n, each in segments.items() if layers[n] == layer]
    return tuple(
        LabelName(
            _number(each.get("LabelValue"), 1),
            each.get("Name", ""),
            _segment_colour(each.get("Color", "")),
        )
        for each in there
    )


def _number(text: str | None, fallback: int) -> int:
    if text is not None and re.fullmatch(r"\d{1,18}", text):
        return int(text)
    return fallback


def _segment_colour(text: str) -> str:
    """Return Slicer's red, green and blue from 0 to 1, sRGB, as ``#rrggbb``; empty if they are
    none.
    """
    parts = re.findall(r"[\d.eE+-]+", text)
    try:
        shares = [min(max(float(part), 0.0), 1.0) for part in parts]
    except ValueError:
        return ""
    if len(shares) == 3:
        return "#" + "".join(f"{round(255.0 * share):02x}" for share in shares)
    return ""


def spacing_of(name: str, header: Header, layout: Layout) -> Vector:
    """Return the lengths of the space directions of x, y, z (one row per axis), else their
    ``spacings``, else 1.
    """
    if "space directions" in header:
        rows = np.asarray(header["space directions"], np.float64)
        if rows.ndim == 2:
            steps = [math.hypot(*row) for row in rows]
        else:
            steps = []
    else:
        steps = [float(step) for step in header.get("spacings", (1.0,) * len(header["sizes"]))]
    if len(steps) != len(header["sizes"]):
        raise VolumeError(
            f"'{name}' gives {len(steps)} spacings for {len(header['sizes'])} axes: mend its "
            "header."
        )
    x, y, z = (steps[axis] for axis in layout.axes)
    return x, y, z


def affine_of(header: Header, layout: Layout) -> Affine | None:
    """Return the map from voxels to the world; None if the header gives the spacing alone."""
    rows = np.asarray(header.get("space directions", ()), np.float64)
    if rows.shape != (len(header["sizes"]), 3):
        return None
    signs, letters = _SPACES.get(
        str(header.get("space", "")).lower().removesuffix("-time"), ((1, 1, 1), "")
    )
    origin = np.asarray(header.get("space origin", (0.0, 0.0, 0.0)), np.float64)
    if origin.shape == (3,) and np.isfinite(origin).all():
        known = origin
    else:
        known = np.zeros(3)
    return Affine.of(
        np.column_stack([rows[list(layout.axes)].T, known]) * np.array(signs)[:, None], letters
    )


def placed_by(header: Header) -> str:
    """Name the entries of a header that place voxels, or give their distances; empty
    without one.
    """
    if "space" in header:
        space = f" in {header['space']}"
    else:
        space = ""
    if "space directions" in header:
        return f"its space directions{space}"
    if "spacings" in header:
        return "its spacings"
    return ""


def unit_of(header: Header) -> str:
    """Return the unit of lengths; empty if axes have several or none."""
    units = {str(unit).strip('"') for unit in header.get("space units", ())}
    return units.pop() if len(units) == 1 else ""


def unit_notes(header: Header) -> tuple[str, ...]:
    """Say so if axes have several units."""
    units = [str(unit).strip('"') for unit in header.get("space units", ())]
    if len(set(units)) < 2:
        return ()
    return (f"Its axes are in {', '.join(units)}, taken as one unit: {SPACING_KEY}.",)


_DIGITS = re.compile(r"%0?\d{0,2}d")
"""A number in a pattern of names, of at most 99 digits: each name is made in memory."""

_PATTERN = re.compile(r"(\S*%0?\d*d\S*)((?:\s+-?\d+){3,4})")


def data_names(source: Source, header: Header) -> list[str] | None:
    """Return the names of the files with the voxels, in their order; None if voxels follow the
    header. Raises VolumeError.
    """
    given = next(
        (value for field, value in header.items() if field.lower() in ("data file", "datafile")),
        None,
    )
    if given is None:
        return None
    if source.path is None and source.member is None:
        raise VolumeError(
            f"'{source.name}' is a header whose data is in another file, {given[:80]}: send both "
            "together, or save both as one .nrrd file."
        )
    pattern = _PATTERN.fullmatch(given)
    if given.split()[:1] == ["LIST"]:
        names = header[NAMES_KEY]
    elif pattern:
        names = _numbered(pattern)
    else:
        names = [given]
    if not names or len(names) > max(header["sizes"]):
        raise VolumeError(
            f"'{source.name}' names {len(names)} data files, which cannot be: mend its header."
        )
    return [_inside(source.name, name) for name in names]


def _numbered(pattern: re.Match[str]) -> list[str]:
    """Return the names that a pattern stands for: ``sl%03d.raw 0 31 1``."""
    first, last, step = (int(part) for part in pattern[2].split()[:3])
    if not step or pattern[1].count("%") != 1 or _DIGITS.search(pattern[1]) is None:
        return []
    numbers = range(first, last + (1 if step > 0 else -1), step)
    return [pattern[1] % number for number in numbers[:MAX_HEADER]]


def _inside(name: str, data: str) -> str:
    where = Path(data)
    if where.is_absolute() or ".." in where.parts:
        raise VolumeError(
            f"'{name}' points at '{data}' outside its folder: put the data beside the header."
        )
    return data


_RAW = ("raw",)
_GZIP = ("gzip", "gz")
_BZIP2 = ("bzip2", "bz2")


@reader("NRRD", "channel", "time")
def open_nrrd(source: Source) -> Grid:
    """Open one scalar volume as a grid; only the header is read now.

    Files may be attached or, but for uploads, detached (data files at or below the header's
    folder); raw, gzip, bzip2 or text; of every integer and float type, in both byte orders. Spacing
    is the length of each space direction, else ``spacings``, else 1, as the file gives it, even if
    it is not positive.

    Raises VolumeError if the file is missing, not NRRD or not of scalar fields in space; the slabs
    raise it if the file does not hold exactly the announced voxels. Memory is allocated only for
    voxels that are there, whatever the header says.
    """
    with _readable(source), source.open() as file:
        header = read_header(source, file)
        layout = layout_of(source, header)
        dtype = number_type(source.name, header)
        with _data_files(source, header, file) as parts:
            files = [Path(part.name) for part in parts if part is not file and source.path]
            cut = _notes_on_lost_checksums(source, header, parts, layout.numbers * dtype.itemsize)
    return Grid(
        layout.shape,
        np.dtype(np.float32) if layout.number is None else dtype,
        spacing_of(source.name, header, layout),
        partial(_slabs, source),
        partial(source.stamp, *files),
        affine_of(header, layout),
        unit_of(header),
        (*layout.notes, *cut, *unit_notes(header)),
        layout.moment,
        layout.unchosen,
        labels_of(header, layout.number or 0),
        read_as("NRRD", dtype, placed_by(header)),
        periodic_of(header),
        number_of(header, LEVEL_KEY),
        number_of(header, DEVIATIONS_KEY),
    )


PERIODIC_KEY = "isogi periodic"
LEVEL_KEY = "isogi level"
DEVIATIONS_KEY = "isogi deviations"
"""Keys by which isogi keeps the meaning of a grid that came in another kind of file."""


def meaning_lines(grid: Grid) -> list[str]:
    """Return lines of a header that keep the facts which ``periodic_of`` and ``number_of`` read."""
    given = {LEVEL_KEY: grid.level, DEVIATIONS_KEY: grid.deviations}
    numbers = [f"{key}:={value!r}" for key, value in given.items() if value is not None]
    if any(grid.periodic):
        return [f"{PERIODIC_KEY}:={' '.join(str(int(each)) for each in grid.periodic)}", *numbers]
    return numbers


def periodic_of(header: Header) -> Periodic:
    """Return for each axis True if the field repeats along it, by isogi's key."""
    words = str(header.get(PERIODIC_KEY, "")).split()
    if len(words) != 3:
        return APERIODIC
    x, y, z = (word == "1" for word in words)
    return x, y, z


def number_of(header: Header, key: str) -> float | None:
    """Return the finite number of a header's ``key``; None without one."""
    try:
        number = float(header[key])
    except (KeyError, ValueError):
        return None
    return number if math.isfinite(number) else None


def _slabs(source: Source) -> Iterator[np.ndarray]:
    """Read the voxels of a file, some layers at a time; (layers, ny, nx) each."""
    with _readable(source), source.open() as file:
        header = read_header(source, file)
        layout = layout_of(source, header)
        dtype = number_type(source.name, header)
        with _data_files(source, header, file) as parts:
            size = layout.numbers * dtype.itemsize
            blocks = (
                block
                for part in parts
                for block in _decoded_bytes(source.name, header, part, size // len(parts))
            )
            yield from _field(layout, _layers(layout, dtype, blocks))


def _layers(layout: Layout, dtype: np.dtype[Any], blocks: Iterator[bytes]) -> Iterator[np.ndarray]:
    """Yield the numbers of a file, some layers at a time, (layers, ny, nx, each), from the
    ``blocks`` of its decoded bytes. The layers of each further field follow those of the one
    before.
    """
    inner = (*layout.shape[1:], layout.each)
    layer_bytes = int(np.prod(inner)) * dtype.itemsize
    slab_bytes = slab_layers(layer_bytes) * layer_bytes
    rest = bytearray()
    for block in blocks:
        rest += block
        while len(rest) >= slab_bytes:
            yield np.frombuffer(rest[:slab_bytes], dtype).reshape(-1, *inner)
            del rest[:slab_bytes]
    if rest:
        yield np.frombuffer(rest, dtype).reshape(-1, *inner)


def _field(layout: Layout, slabs: Iterator[np.ndarray]) -> Iterator[np.ndarray]:
    """Yield the layers of the field that is chosen, and of each voxel the number that is. All
    layers are read, so that missing ones are noticed.
    """
    first = layout.field * layout.shape[0]
    last = first + layout.shape[0]
    z = 0
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
        raise VolumeError(
            f"There is no file '{error.filename}': check the volume's path."
        ) from error
    except (OSError, ValueError) as error:  # ValueError: a data file's name that no system can hold
        raise VolumeError(
            f"The volume '{source.name}' cannot be read ({error}): check the file."
        ) from error


@contextmanager
def _data_files(source: Source, header: Header, file: IO[bytes]) -> Iterator[list[IO[bytes]]]:
    """Open the files with the voxels, and yield them as one list, in the order of the voxels.

    The list is ``[file]``, at the byte after the header, if the header names no data files. The
    files that it names are in the folder of the header: on the disk, or in the same archive.
    """
    names = data_names(source, header)
    if names is None:
        yield [file]
        return
    with ExitStack() as opened:
        # An upload has neither a member nor a path: ``data_names`` refused it.
        if source.member is not None:
            beside = [source.at(source.member.parent / name) for name in names]
            yield [opened.enter_context(each.open()) for each in beside]
            return
        assert source.path is not None, "a header that names files has a path"
        yield [
            opened.enter_context(open_regular(_beside(source.path.parent, name))) for name in names
        ]


def _beside(folder: Path, name: str) -> Path:
    """Return the path of a file in a ``folder``, in which the letters of its name may be composed
    otherwise: å of one character or of two.
    """
    forms = (name, normalize("NFC", name), normalize("NFD", name))
    return next((folder / form for form in forms if (folder / form).exists()), folder / name)


def _decoded_bytes(name: str, header: Header, file: IO[bytes], size: int) -> Iterator[bytes]:
    """Yield the ``size`` bytes of voxels of a data file, in blocks: those after line skip, decoding
    and byte skip. Raises VolumeError after the last block if there are fewer or more.
    """
    encoding = header["encoding"].lower()
    passed = 0
    if encoding not in (*_RAW, *_GZIP, *_BZIP2, *TEXT_ENCODINGS):
        raise VolumeError(
            f"'{name}' has encoding '{encoding}': save it as raw, gzip, bzip2 or text."
        )
    byte_skip = _skip_lines(name, header, file, size)
    try:
        stream = _decoded(encoding, file)
        skip(stream, byte_skip)
        dtype = number_type(name, header)
        if encoding in TEXT_ENCODINGS:
            blocks = _written_out(name, stream, dtype)
        else:
            blocks = _blocks(stream, size)
        for block in blocks:
            passed += len(block)
            # Text may hold more numbers than are needed: cut the surplus off the block's end.
            surplus = passed - size
            yield block[:-surplus] if surplus > 0 else block
        # Try to read one byte more, which shows that the file is too long.
        passed += read_end(stream)
    except PACKING_DAMAGE as error:
        raise VolumeError(
            f"The voxels of '{name}' are damaged or cut short ({error}): copy it again."
        ) from error
    if passed != size:
        less = "fewer" if passed < size else "more"
        raise VolumeError(
            f"'{name}' holds {less} than the {size} bytes that its sizes need: copy it again."
        )


def _decoded(encoding: str, file: IO[bytes]) -> Content:
    """Return the stream of decoded voxel bytes in ``file``."""
    if encoding in _GZIP:
        return gzip.GzipFile(fileobj=file)
    if encoding in _BZIP2:
        return bz2.BZ2File(file)
    return file


def _written_out(name: str, stream: Content, dtype: np.dtype[Any]) -> Iterator[bytes]:
    """Yield the bytes of numbers that are written as text, with blanks or commas between."""
    rest = b""
    while block := stream.read(READ_BYTES >> 4):
        text = (rest + block).replace(b",", b" ")
        words = text.split()
        if words and not text[-1:].isspace():
            rest = words.pop()
        else:
            rest = b""
        yield _header_numbers(name, words, dtype)
    yield _header_numbers(name, rest.split(), dtype)


def _header_numbers(name: str, words: list[bytes], dtype: np.dtype[Any]) -> bytes:
    """Return the bytes of written numbers in a type. Raises VolumeError if a word is no such
    number.
    """
    try:
        return np.array(
            [int(word) if dtype.kind in "iu" else float(word) for word in words], dtype
        ).tobytes()
    except (ValueError, OverflowError) as error:
        raise VolumeError(
            f"'{name}' holds a word that is no {dtype} ({error}): write it again."
        ) from error


def _notes_on_lost_checksums(
    source: Source, header: Header, parts: list[IO[bytes]], size: int
) -> tuple[str, ...]:
    """Return a note if a gzip file of the data files ``parts`` ends before its checksum, though all
    voxels are there; ``size`` bytes are those of all parts, decoded.

    There is none for other encodings: bzip2 files that end early are refused as damaged.
    """
    if header["encoding"].lower() not in _GZIP:
        return ()
    each = size // len(parts)
    # Several parts may have the same note: keep it once.
    notes = dict[str, None]()
    for part in parts:
        start = part.tell()
        byte_skip = _skip_lines(source.name, header, part, each)
        notes |= dict.fromkeys(cut_notes(part, byte_skip + each))
        part.seek(start)
    return tuple(notes)


def _skip_lines(name: str, header: Header, file: IO[bytes], size: int) -> int:
    """Skip as many lines of a data file as the header says. Return the byte skip, which is left to
    the caller: the number of bytes before the voxels once the rest of the file is decoded.

    A byte skip of -1 (raw data only) means that the voxels are the file's last ``size`` bytes.
    Raises VolumeError for other negative numbers.
    """
    lines, byte_skip = (
        int(header.get(f"{what} skip") or header.get(f"{what}skip") or 0)
        for what in ("line", "byte")
    )
    from_end = byte_skip == -1 and header["encoding"].lower() in _RAW
    if lines < 0 or (byte_skip < 0 and not from_end):
        raise VolumeError(
            f"'{name}' skips {lines} lines and {byte_skip} bytes, which cannot be: mend its header."
        )
    while lines > 0 and file.readline():
        lines -= 1
    if not from_end:
        return byte_skip
    start = file.tell()
    byte_skip = max(0, file.seek(0, 2) - size - start)
    file.seek(start)
    return byte_skip


def _blocks(stream: Content, size: int) -> Iterator[bytes]:
    """Yield the next ``size`` bytes, or as many as there are, in blocks."""
    while size > 0 and (block := stream.read(min(size, READ_BYTES))):
        size -= len(block)
        yield block
