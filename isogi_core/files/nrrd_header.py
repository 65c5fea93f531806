"""Headers of NRRD: pynrrd parses their lines; here they are read, and say which axis is what.

Format: https://teem.sourceforge.net/nrrd/format.html.
"""

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import nrrd
import numpy as np

from isogi_core.errors import VolumeError
from isogi_core.files.formats.source import LUMINANCE_NOTE, Source, pick, pick_step
from isogi_core.files.grid import MAX_VOXELS, PATIENT_AXES, SINGLE_MOMENT, Affine, LabelName, Vector

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
_HEADER_END = re.compile(rb"\n[ \t\r\f\v]*\n")
_LIST = re.compile(r"\s*data\s?file\s*:\s*LIST\b", re.IGNORECASE)

TEXT_ENCODINGS = ("ascii", "text", "txt")
"""Encodings whose numbers are written out, so that they have no byte order."""

NAMES_KEY = "data file names"
"""The key under which a header has the lines that follow ``data file: LIST``."""

SPACE_KINDS, TIME_KINDS, COLOUR_KINDS = (
    ("domain", "space"),
    ("time",),
    {"rgb-color": 3, "rgba-color": 4, "3-color": 3, "4-color": 4},
)
"""Kinds of axes: of space, of time, and of colours; others but UNKNOWN_VALUES are channels."""

UNKNOWN_VALUES = ("none", "???", "")

TIME_KEYS = ("axis 0 index type", "multivolume.framelabels")
"""Keys by which 3D Slicer says that a list is a series in time."""

_SPACES = {
    **dict.fromkeys(("right-anterior-superior", "ras"), ((1, 1, 1), PATIENT_AXES)),
    **dict.fromkeys(("left-anterior-superior", "las"), ((-1, 1, 1), PATIENT_AXES)),
    **dict.fromkeys(("left-posterior-superior", "lps"), ((-1, -1, 1), PATIENT_AXES)),
}
"""Signs that bring coordinates of a space to those of a patient's right, anterior and superior, and their letters."""

Header = dict[str, Any]


def read_header(source: Source, file: IO[bytes]) -> Header:
    """Read the header's fields, and leave ``file`` at the byte after it. That of an upload ends within MAX_HEADER."""
    name = source.name
    if file.read(4) != b"NRRD":
        raise VolumeError(f"'{name}' is not a NRRD file: give an .nrrd or .nhdr volume.")
    if source.path is None and not _HEADER_END.search(file.read(MAX_HEADER)):
        raise VolumeError(f"The NRRD header of '{name}' does not end within {MAX_HEADER} bytes: save the file again.")
    file.seek(0)
    lines = _lines(file)
    listed = next((place + 1 for place, line in enumerate(lines) if _LIST.match(line)), len(lines))
    try:
        header: Header = nrrd.read_header(lines[:listed])
    except Exception as error:  # pynrrd raises some twenty kinds on damaged headers
        raise VolumeError(f"The NRRD header of '{name}' is damaged ({error}): write the file again.") from error
    missing = [field for field in ("dimension", "type", "encoding", "sizes") if field not in header]
    if missing:
        raise VolumeError(f"The NRRD header of '{name}' has no {missing[0]}: write the file again.")
    return {**header, NAMES_KEY: [line.strip() for line in lines[listed:]]}


def _lines(file: IO[bytes]) -> list[str]:
    """The lines of a header, without the blank one that ends it."""
    lines = []
    while line := file.readline().decode("utf-8", "surrogateescape").rstrip():
        lines.append(line)
    return lines


def number_type(name: str, header: Header) -> np.dtype[Any]:
    """The NumPy type of the header's type and byte order."""
    code = _TYPES.get(header["type"])
    if code is None:
        raise VolumeError(f"'{name}' holds type '{header['type']}': save it as an integer or float type.")
    order = {"little": "<", "big": ">"}.get(header.get("endian", ""))
    if header["encoding"].lower() in TEXT_ENCODINGS:
        order = "="
    if order is None and code[1] != "1":
        raise VolumeError(f"'{name}' does not say its byte order: add 'endian: little' or 'big' to its header.")
    return np.dtype((order or "|") + code)


@dataclass(frozen=True)
class Layout:
    """How the numbers of a file lie: ``fields`` of a ``shape`` (z, y, x), of ``each`` numbers a voxel.

    Of these field number ``field`` is meant, and number ``number`` of each voxel, or all as a colour where that is
    None. ``axes`` are the places of x, y, z in the header. The ``moment`` is as in ``Grid``.
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
        """All numbers of the file."""
        return self.fields * math.prod(self.shape) * self.each


def layout_of(source: Source, header: Header) -> Layout:
    """The layout that a header tells, of what is chosen. VolumeError where it is not of scalar fields in space."""
    sizes = [int(n) for n in header["sizes"]]
    if header["dimension"] != len(sizes):
        raise VolumeError(
            f"'{source.name}' has {header['dimension']} dimensions and {len(sizes)} sizes: mend its header."
        )
    if not sizes or min(sizes) < 1 or math.prod(sizes) > MAX_VOXELS:
        raise VolumeError(f"'{source.name}' claims sizes {sizes}, which cannot be: mend its header.")
    kinds = _kinds(header, sizes)
    x, y, z = _space(source.name, header, kinds, sizes)
    shape = (sizes[z], sizes[y], sizes[x])
    source.check(shape)
    inner, outer = ([n for n in span if sizes[n] > 1] for span in (range(x), range(z + 1, len(sizes))))
    if len(inner) > 1 or len(outer) > 1:
        raise VolumeError(f"'{source.name}' has sizes {sizes}: save one scalar field of it.")
    facts: dict[str, Any] = {"fields": math.prod(sizes[z + 1 :]), "each": math.prod(sizes[:x])}
    for axes, key in ((outer, "field"), (inner, "number")):
        for axis in axes:
            facts |= _chosen(source, header, kinds[axis], sizes[axis], key)
    return Layout(shape, (x, y, z), **facts)


def _kinds(header: Header, sizes: list[int]) -> list[str]:
    """What each axis is: a kind of SPACE_KINDS, TIME_KINDS or COLOUR_KINDS, a channel, or one of UNKNOWN_VALUES."""
    given = [str(kind).lower() for kind in header.get("kinds", ())]
    kinds = given if len(given) == len(sizes) else [""] * len(sizes)
    rows = header.get("space directions")
    rows = np.asarray(rows, np.float64) if rows is not None else np.zeros((0, 0))
    if not given and len(rows) == len(sizes) > 3:  # an axis without a direction is none of space
        kinds = ["domain" if np.isfinite(row).all() else "list" for row in rows]
    series = any(key in TIME_KEYS for key in map(str.lower, header))
    return ["time" if kind == "list" and series else kind for kind in kinds]


def _space(name: str, header: Header, kinds: list[str], sizes: list[int]) -> tuple[int, int, int]:
    """The places of x, y, z. Axes of unknown kinds are of space where these are needed, the fastest first."""
    unknown = [n for n, kind in enumerate(kinds) if kind in UNKNOWN_VALUES]
    spatial = [n for n, kind in enumerate(kinds) if kind in SPACE_KINDS]
    for n in sorted(unknown, key=lambda n: (sizes[n] == 1, n)):
        spatial += [n] if len(spatial) < 3 else []
    if len(kinds) == 3 and len(spatial) == 2:  # slices in time, one upon the other
        spatial += [n for n, kind in enumerate(kinds) if kind in TIME_KINDS]
    spatial.sort()
    given = header.get("kinds", kinds)
    other = next((given[n] for n, kind in enumerate(kinds) if n not in spatial and kind not in UNKNOWN_VALUES), "")
    if len(spatial) != 3:
        why = f"an axis of kind '{other}', and " if other else ""
        raise VolumeError(f"'{name}' has {why}{len(spatial)} dimensions in space, not 3: save one scalar field of it.")
    x, y, z = spatial
    if (y, z) != (x + 1, x + 2) and math.prod(sizes[n] for n in range(x, z + 1) if n not in spatial) > 1:
        raise VolumeError(
            f"'{name}' has an axis of kind '{other}' between those of space: save one scalar field of it."
        )
    return x, y, z


def _chosen(source: Source, header: Header, kind: str, length: int, key: str) -> Header:
    """What a layout has along an axis that is not of space: under the ``key`` the element that is chosen."""
    if kind in TIME_KINDS:
        step, unchosen = pick_step(source, length)
        return {key: step, "moment": (step, length), "unchosen": unchosen}
    if key == "number" and COLOUR_KINDS.get(kind) == length and "channel" not in source.chosen:
        return {key: None, "notes": (LUMINANCE_NOTE,)}
    if segments_of(header) and "channel" not in source.chosen:
        others = f"channel = 1 to {length - 1} chooses another" if length > 2 else "channel = 1 chooses the other"
        return {key: 0, "notes": (f"The segmentation has {length} layers: the first is shown, and {others}.",)}
    return {key: pick(source, "channel", length, "channels")}


_SEGMENT = re.compile(r"Segment(\d+)_(\w+)")


def segments_of(header: Header) -> dict[int, dict[str, str]]:
    """What 3D Slicer says of the segments of a segmentation, by their numbers; empty of other volumes."""
    found: dict[int, dict[str, str]] = {}
    for key, value in header.items():
        if (match := _SEGMENT.fullmatch(key)) is not None:
            found.setdefault(int(match[1]), {})[match[2]] = str(value)
    return {number: each for number, each in found.items() if "LabelValue" in each or "Name" in each}


def labels_of(header: Header, layer: int) -> tuple[LabelName, ...] | None:
    """The labels of a segmentation of 3D Slicer in a ``layer``; None where the file is none.

    Files of old versions have a segment in each layer, and no values: these are then 1.
    """
    segments = segments_of(header)
    if not segments:
        return None
    layers = {n: _number(each.get("Layer"), 0 if "LabelValue" in each else n) for n, each in segments.items()}
    there = [each for n, each in segments.items() if layers[n] == layer]
    return tuple(
        LabelName(_number(each.get("LabelValue"), 1), each.get("Name", ""), _segment_colour(each.get("Color", "")))
        for each in there
    )


def _number(text: str | None, fallback: int) -> int:
    return int(text) if text is not None and re.fullmatch(r"\d{1,18}", text) else fallback


def _segment_colour(text: str) -> str:
    """Slicer's red, green and blue from 0 to 1, sRGB, as ``#rrggbb``; empty where they are none."""
    parts = re.findall(r"[\d.eE+-]+", text)
    try:
        shares = [min(max(float(part), 0.0), 1.0) for part in parts]
    except ValueError:
        return ""
    return "#" + "".join(f"{round(255.0 * share):02x}" for share in shares) if len(shares) == 3 else ""


def spacing_of(name: str, header: Header, layout: Layout) -> Vector:
    """Lengths of the space directions of x, y, z (one row per axis), else their ``spacings``, else 1."""
    if "space directions" in header:
        rows = np.asarray(header["space directions"], np.float64)
        steps = [math.hypot(*row) for row in rows] if rows.ndim == 2 else []
    else:
        steps = [float(step) for step in header.get("spacings", (1.0,) * len(header["sizes"]))]
    if len(steps) != len(header["sizes"]):
        raise VolumeError(f"'{name}' gives {len(steps)} spacings for {len(header['sizes'])} axes: mend its header.")
    x, y, z = (steps[axis] for axis in layout.axes)
    return x, y, z


def affine_of(header: Header, layout: Layout) -> Affine | None:
    """Where voxels lie in the world; None where the header says spacing alone."""
    rows = np.asarray(header.get("space directions", ()), np.float64)
    if rows.shape != (len(header["sizes"]), 3):
        return None
    signs, letters = _SPACES.get(str(header.get("space", "")).lower().removesuffix("-time"), ((1, 1, 1), ""))
    origin = np.asarray(header.get("space origin", (0.0, 0.0, 0.0)), np.float64)
    known = origin if origin.shape == (3,) and np.isfinite(origin).all() else np.zeros(3)
    return Affine.of(np.column_stack([rows[list(layout.axes)].T, known]) * np.array(signs)[:, None], letters)


def placed_by(header: Header) -> str:
    """What in a header says where voxels lie, or how far apart; empty where nothing does."""
    space = f" in {header['space']}" if "space" in header else ""
    return (
        f"its space directions{space}"
        if "space directions" in header
        else "its spacings"
        if "spacings" in header
        else ""
    )


def unit_of(header: Header) -> str:
    """The unit of lengths; empty where axes have several or none."""
    units = {str(unit).strip('"') for unit in header.get("space units", ())}
    return units.pop() if len(units) == 1 else ""


_PATTERN = re.compile(r"(\S*%0?\d*d\S*)((?:\s+-?\d+){3,4})")


def data_names(source: Source, header: Header) -> list[str] | None:
    """Names of the files with the voxels, in their order; None where these follow the header. VolumeError."""
    given = next((value for field, value in header.items() if field.lower() in ("data file", "datafile")), None)
    if given is None:
        return None
    if source.path is None:
        raise VolumeError(f"'{source.name}' is a header whose data is in another file: save both as one .nrrd file.")
    pattern = _PATTERN.fullmatch(given)
    names = header[NAMES_KEY] if given.split()[:1] == ["LIST"] else _numbered(pattern) if pattern else [given]
    if not names or len(names) > max(header["sizes"]):
        raise VolumeError(f"'{source.name}' names {len(names)} data files, which cannot be: mend its header.")
    return [_inside(source.name, name) for name in names]


def _numbered(pattern: re.Match[str]) -> list[str]:
    """The names that a pattern stands for: ``sl%03d.raw 0 31 1``."""
    first, last, step = (int(part) for part in pattern[2].split()[:3])
    if not step or pattern[1].count("%") != 1:
        return []
    numbers = range(first, last + (1 if step > 0 else -1), step)
    return [pattern[1] % number for number in numbers[:MAX_HEADER]]


def _inside(name: str, data: str) -> str:
    where = Path(data)
    if where.is_absolute() or ".." in where.parts:
        raise VolumeError(f"'{name}' points at '{data}' outside its folder: put the data beside the header.")
    return data
