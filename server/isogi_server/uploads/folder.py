"""The folder of uploads, volumes and light probes, and the canonical form of each kind of file."""

import errno
import fcntl
import hashlib
import json
import logging
import math
import os
import re
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO
from urllib.parse import quote, unquote

import numpy as np

from isogi_core.errors import LightError
from isogi_core.files.formats.nrrd import meaning_lines
from isogi_core.files.grid import PATIENT_AXES, Grid, LabelName
from isogi_core.files.probes import parse_probe
from isogi_core.files.radiance import encode_rgbe
from isogi_core.model.environment import resample
from isogi_core.model.volume import Orientation
from isogi_core.plan.volumes.labels import MAX_LABELS
from isogi_core.storage.atomic_file import write_whole
from isogi_server.errors import FullError, UploadFolderError

VOLUME_KIND = "volume"
ENVIRONMENT_KIND = "environment"
"""Kinds of files that may be uploaded."""

SUFFIXES = {VOLUME_KIND: ".nrrd", ENVIRONMENT_KIND: ".hdr"}
"""File name suffixes of canonical files, by kind."""

MAX_HEADER_BYTES = 1 << 17
"""Bytes of a header at most."""

VOXEL_BYTES = 4
"""Bytes of a voxel in the server's memory: voxels are float32."""

SCENE_BYTES = 256 << 10
"""Bytes that the scene of a volume takes in memory in addition to its voxels while nobody views
it: 10 to 30 kB were measured.
"""

PIXEL_BYTES = 64
"""Bytes of a probe's pixel in the server's memory: radiance, and tables for sampling."""


@dataclass(frozen=True)
class Upload:
    """An upload of a ``kind``, kept in a canonical file: its ``id``, a ``name`` for people, and
    ``bytes`` on disk.

    ``size`` is the number of voxels along x, y, z, or of a probe's columns and rows.
    """

    kind: str
    id: str
    name: str
    size: tuple[int, ...]
    bytes: int

    @property
    def held(self) -> int:
        """Return the bytes that count towards the quota: for a volume the larger of disk and
        memory, and its scene; for a probe both.
        """
        if self.kind == ENVIRONMENT_KIND:
            return self.bytes + PIXEL_BYTES * math.prod(self.size)
        return SCENE_BYTES + max(self.bytes, VOXEL_BYTES * math.prod(self.size))


MAX_PROBE_SHAPE = (512, 1024)
"""Rows and columns to which a finer probe is averaged by solid angle, which keeps its energy."""

ROWS_PER_BLOCK = 256
"""Rows of a finer probe that are averaged at a time."""

MOST_PIXELS = 1 << 25
"""Pixels that a probe may have: 8192 × 4096."""

PROBE_HEADER = "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\nNAME={name}\n\n-Y {height} +X {width}\n"
PROBE_HEADER_PATTERN = re.compile(
    rb"#\?RADIANCE\nFORMAT=32-bit_rle_rgbe\nNAME=([!-~]*)\n\n-Y (\d+) \+X (\d+)\n", re.ASCII
)


def write_environment(file: IO[bytes], data: bytes, name: str) -> str:
    """Write a Radiance or OpenEXR picture as a canonical file; return its id, a digest of all but
    the name.

    Raises LightError if it is no lat-long picture of light: not twice as wide as high, black, or
    damaged.
    """
    image = parse_probe(data, name or "the file", MOST_PIXELS)
    height, width, _ = image.shape
    if width != 2 * height:
        raise LightError(
            f"The picture has {width} × {height} pixels: a probe is twice as wide as high, all "
            "around."
        )
    if not image.any():
        raise LightError("The picture is black: give one with light in it.")
    if height > MAX_PROBE_SHAPE[0]:
        image = made_small(image)
    # Encode the radiance anew, so that the file holds nothing else that came with it.
    pixels = encode_rgbe(np.asarray(image, np.float64))
    height, width, _ = image.shape
    # Equal light has an equal id, whatever its name: it is kept and baked once.
    number = hashlib.blake2b(
        f"probe {width} {height}".encode() + pixels, digest_size=16
    ).hexdigest()
    named = quote(name or f"light {number[:6]}", safe="")
    file.write(PROBE_HEADER.format(name=named, height=height, width=width).encode() + pixels)
    return number


def made_small(image: np.ndarray) -> np.ndarray:
    """Average an image to MAX_PROBE_SHAPE pixels: first to its width, some rows at a time, so
    that few float64 pixels are in memory.
    """
    height, width = MAX_PROBE_SHAPE
    blocks = (image[row : row + ROWS_PER_BLOCK] for row in range(0, len(image), ROWS_PER_BLOCK))
    narrow = np.concatenate([resample(block, len(block), width) for block in blocks])
    return resample(narrow, height, width).astype(np.float32)


def read_environment(path: Path) -> Upload | None:
    """Read the header of a canonical probe whose file name is its id; None if the file is not
    as ``write_environment`` wrote it.
    """
    with path.open("rb") as file:
        head = PROBE_HEADER_PATTERN.match(file.read(MAX_HEADER_BYTES))
    if head is None:
        return None
    name, height, width = (part.decode() for part in head.groups())
    kept = Upload(
        ENVIRONMENT_KIND, path.stem, unquote(name), (int(width), int(height)), path.stat().st_size
    )
    # The size of the file must be that of header and pixels: else it was cut off.
    if kept.bytes == head.end() + 4 * int(width) * int(height):
        return kept
    return None


NRRD_TYPES = {
    **{
        f"{kind}{size}": f"{name}{8 * size}"
        for kind, name in (("i", "int"), ("u", "uint"))
        for size in (1, 2, 4, 8)
    },
    **{"f4": "float", "f8": "double"},
}
"""Names of types in NRRD files, by NumPy's codes."""

NRRD_SPACES = {PATIENT_AXES: "right-anterior-superior"}
"""Names of spaces in NRRD files, by the letters of their axes."""

VOLUME_HEADER = """\
NRRD0004
type: {type}
dimension: 3
sizes: {sizes}
encoding: raw
endian: little
{place}
name:={name}
{labels}
"""
VOLUME_HEADER_PATTERN = re.compile(
    rb"NRRD0004\ntype: (\w+)\ndimension: 3\nsizes: (\d+) (\d+) (\d+)\n"
    rb"encoding: raw\nendian: little\n"
    rb"(?:spacings: [-+.e\d ]+|space[ a-z]*: [-a-z\d]+\n"
    rb"space directions: [-+.e\d(), ]+\nspace origin: [-+.e\d(),]+"
    rb"(?:\nspace units: [^\n]+)?)\nname:=([!-~]*)\n"
    rb"(?:(?:Segment\d+_(?:LabelValue|Name|Color)|isogi [a-z]+):=[^\n]*\n)*\n",
    re.ASCII,
)
LABEL_NAME = 64
"""Characters of a label's name that are kept."""


def write(file: IO[bytes], grid: Grid, name: str) -> str:
    """Write a grid on right angles, or one cell of a field that repeats, as a canonical file;
    return its id, a digest of all but the name.

    An empty name is replaced by one made of the id. Types that NRRD lacks become the next larger
    one.
    """
    kind = {"b1": "u1", "f2": "f4"}.get(grid.dtype.str[1:], grid.dtype.str[1:])
    kind = kind if kind in NRRD_TYPES else "f8"
    facts = {
        "type": NRRD_TYPES[kind],
        "sizes": " ".join(str(n) for n in grid.shape[::-1]),
        "place": placing_lines(grid),
    }
    facts["labels"] = "".join(
        segment(number, label) for number, label in enumerate(shown_labels(grid))
    )
    facts["labels"] += "".join(f"{line}\n" for line in meaning_lines(grid))
    # The digest comes before the data in the file: go through the layers twice, and keep no copy.
    digest = hashlib.blake2b(VOLUME_HEADER.format(**facts, name="").encode(), digest_size=16)
    for layer in layer_values(grid, f"<{kind}"):
        digest.update(layer)
    number = digest.hexdigest()
    file.write(
        VOLUME_HEADER.format(**facts, name=quote(name or f"volume {number[:6]}", safe="")).encode()
    )
    for layer in layer_values(grid, f"<{kind}"):
        file.write(layer)
    return number


def shown_labels(grid: Grid) -> tuple[LabelName, ...]:
    """Return the labels that a grid names, as many as can be shown; one nameless label for a
    segmentation without names.
    """
    if grid.labels is None:
        return ()
    return grid.labels[:MAX_LABELS] or (LabelName(1),)


def segment(number: int, label: LabelName) -> str:
    """Return the header lines that name a label, as 3D Slicer writes them."""
    red, green, blue = (byte / 255.0 for byte in bytes.fromhex(label.colour[1:] or "000000"))
    name = "".join(letter for letter in label.name if letter.isprintable() and letter != "\\")[
        :LABEL_NAME
    ]
    rows = {
        "LabelValue": str(label.value),
        "Name": name,
        "Color": label.colour and f"{red:.6f} {green:.6f} {blue:.6f}",
    }
    return "".join(f"Segment{number}_{key}:={text}\n" for key, text in rows.items() if text)


def layer_values(grid: Grid, kind: str) -> Iterator[memoryview]:
    """Yield the values of a grid layer by layer, converted to ``kind``, so that no copy of the
    whole takes memory.
    """
    return (np.ascontiguousarray(layer, kind).data for slab in grid.slabs() for layer in slab)


def placing_lines(grid: Grid) -> str:
    """Return the header lines that place a grid on right angles in space: the spacing alone if
    that is all. A cell of a field that repeats may be oblique.
    """
    if any(grid.periodic) and grid.affine is not None:
        x, y, z = grid.affine.array[:, :3].T
        return space_lines(grid.affine.letters, (x, y, z), grid.affine.origin, grid.unit)
    orientation = Orientation.of(grid)
    if not orientation.placed and not orientation.letters and not orientation.unit:
        return f"spacings: {' '.join(repr(float(step)) for step in grid.spacing)}"
    # Rows are the world vectors between neighbouring voxels.
    steps = orientation.matrix.T * np.array(grid.spacing)[:, None]
    return space_lines(orientation.letters, steps, orientation.origin, orientation.unit)


def space_lines(
    letters: str, steps: Iterable[Sequence[float]], origin: Sequence[float], unit: str
) -> str:
    """The lines of a header for a space with these ``letters``, in which voxels lie ``steps`` apart
    from an ``origin`` on, in a ``unit``.
    """
    if letters in NRRD_SPACES:
        space = f"space: {NRRD_SPACES[letters]}"
    else:
        space = "space dimension: 3"
    lines = [
        space,
        f"space directions: {' '.join(map(vector, steps))}",
        f"space origin: {vector(origin)}",
    ]
    plain = "".join(letter for letter in unit if letter.isprintable() and letter != '"')
    units = [f"space units: {' '.join(3 * (quoted,))}" for quoted in (f'"{plain}"',) if plain]
    return "\n".join([*lines, *units])


def vector(row: Sequence[float]) -> str:
    """Return a vector as NRRD writes it."""
    return f"({','.join(repr(float(value)) for value in row)})"


def read_volume(path: Path) -> Upload | None:
    """Read the header of a canonical volume whose file name is its id; its voxels are not checked.

    Return None if the header is none that ``write`` makes, or if the length of the file is not
    that of header and voxels.
    """
    with path.open("rb") as file:
        head = VOLUME_HEADER_PATTERN.match(file.read(MAX_HEADER_BYTES))
    if head is None:
        return None
    voxel_type, *sizes, name = (part.decode() for part in head.groups())
    x, y, z = map(int, sizes)
    kept = Upload(VOLUME_KIND, path.stem, unquote(name), (x, y, z), path.stat().st_size)
    # A file of another length was cut off, or has something appended. Unknown types count as 0
    # bytes, so that no file with voxels fits them.
    voxel_bytes = {nrrd_type: int(code[1]) for code, nrrd_type in NRRD_TYPES.items()}
    file_bytes = head.end() + voxel_bytes.get(voxel_type, 0) * math.prod(kept.size)
    return kept if kept.bytes == file_bytes else None


READERS = {VOLUME_KIND: read_volume, ENVIRONMENT_KIND: read_environment}
"""Functions that read the headers of canonical files, by kind."""


log = logging.getLogger("isogi.uploads")

UPLOAD_ID = re.compile(r"[0-9a-f]{20}([0-9a-f]{12})?")
"""Pattern of ids: digests of 80 or 128 bits."""

UNFINISHED_SUFFIX = ".part"
OWNERS_FILE = "owners.json"
"""The file that lists the owners of uploads."""

DISK_FULL_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def read_owners(path: Path) -> dict[str, list[str]]:
    """Return the names of the owners of each upload, by its id. Raises UploadFolderError if the
    file is damaged.
    """
    try:
        if path.exists():
            owners = json.loads(path.read_bytes())
        else:
            owners = {}
        return {str(number): [str(name) for name in names] for number, names in owners.items()}
    except (ValueError, AttributeError, TypeError, RecursionError):
        raise UploadFolderError(
            f"The list of owners {path} is damaged: repair it, or delete it."
        ) from None


def default_folder() -> Path:
    """Return the default folder of uploads: ``$XDG_DATA_HOME/isogi/volumes``, or below
    ``~/.local/share``.
    """
    return (
        Path(os.environ.get("XDG_DATA_HOME") or Path.home() / ".local" / "share")
        / "isogi"
        / "volumes"
    )


class UploadFolder:
    """The uploads in a folder that one server uses at a time. Its methods raise UploadFolderError,
    and FullError if the disk is full.

    The table ``uploads``, by id, is replaced and never changed, so that others may iterate over it.
    """

    def __init__(self, path: Path) -> None:
        """Set the folder; nothing is opened yet."""
        self.path = path
        self.uploads: dict[str, Upload] = {}
        self._owners: dict[str, list[str]] = {}
        self._lock: IO[bytes] | None = None

    @property
    def held(self) -> int:
        """Return the bytes that count towards the quota."""
        return sum(kept.held for kept in self.uploads.values())

    @property
    def volumes(self) -> list[Upload]:
        """Return the volumes."""
        return self._all(VOLUME_KIND)

    @property
    def environments(self) -> list[Upload]:
        """Return the light probes."""
        return self._all(ENVIRONMENT_KIND)

    def open(self) -> None:
        """Lock the folder, for its user alone; delete files that were written in part, and read
        the others' headers.
        """
        with name_folder_in_errors(self.path):
            self.path.mkdir(0o700, parents=True, exist_ok=True)
            self.path.chmod(0o700)
            # Without the lock, another server's drafts would be deleted.
            self._lock = self._take()
            for path in self.path.glob(f"*{UNFINISHED_SUFFIX}"):
                path.unlink()
            self._owners = read_owners(self.path / OWNERS_FILE)
            found = [
                self._read(kind, path)
                for kind in SUFFIXES
                for path in sorted(self.path.glob(f"*{SUFFIXES[kind]}"))
            ]
            self.uploads = {kept.id: kept for kept in found if kept}

    def close(self) -> None:
        """Release the folder's lock."""
        if self._lock is not None:
            self._lock.close()

    def place(self, number: str) -> Path:
        """Return the path of an upload's file."""
        return self.path / f"{number}{SUFFIXES[self.uploads[number].kind]}"

    @contextmanager
    def drafts(self) -> Iterator[tuple[IO[bytes], IO[bytes]]]:
        """Yield two files, deleted at the end of the block: one without a name for the body of
        a request, and one for its canonical form.
        """
        with name_folder_in_errors(self.path):
            body = tempfile.TemporaryFile(dir=self.path)  # noqa: SIM115
            draft = tempfile.NamedTemporaryFile(  # noqa: SIM115
                dir=self.path, suffix=UNFINISHED_SUFFIX, delete=False
            )
        try:
            with body, draft:
                yield body, draft
        finally:
            Path(draft.name).unlink(missing_ok=True)

    def put(self, draft: IO[bytes], number: str, kind: str = VOLUME_KIND) -> Upload:
        """Keep a canonical draft under its id; once this returns, it survives a loss of power.
        Return the upload.
        """
        place = self.path / f"{number}{SUFFIXES[kind]}"
        with name_folder_in_errors(self.path):
            draft.flush()
            os.fsync(draft.fileno())
            os.replace(draft.name, place)
            self._settle()
        # Read the file back: a disk that loses data is found now.
        kept = self._read(kind, place)
        if kept is None:
            raise UploadFolderError(
                f"The {kind} in {place} did not come out as it went in: check the disk."
            )
        self.uploads = {**self.uploads, number: kept}
        return kept

    def owners_of(self, number: str) -> list[str]:
        """Return the names of an upload's owners; an empty list if none is named."""
        return self._owners.get(number, [])

    def give(self, number: str, owner: str) -> None:
        """Add an owner to an upload, unless the name is empty."""
        if owner and number in self.uploads and owner not in self.owners_of(number):
            self._own({**self._owners, number: [*self.owners_of(number), owner]})

    def take_back(self, number: str, owner: str) -> None:
        """Remove an owner from an upload."""
        self._own(
            {**self._owners, number: [each for each in self.owners_of(number) if each != owner]}
        )

    def _own(self, owners: dict[str, list[str]]) -> None:
        """Write and keep the table of owners."""
        with name_folder_in_errors(self.path):
            write_whole(self.path / OWNERS_FILE, json.dumps(owners).encode())
        self._owners = owners

    def remove(self, number: str) -> None:
        """Delete an upload, its owners first."""
        if number in self._owners:
            self._own({key: owners for key, owners in self._owners.items() if key != number})
        with name_folder_in_errors(self.path):
            self.place(number).unlink(missing_ok=True)
            self.uploads = {key: kept for key, kept in self.uploads.items() if key != number}
            self._settle()

    def _take(self) -> IO[bytes]:
        """Take the folder's lock, which ends with the process. Raises UploadFolderError if
        another server has it.
        """
        lock = (self.path / "lock").open("wb")
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return lock
        except BlockingIOError:
            lock.close()
            sentence = (
                f"Another server keeps its uploads in {self.path}: choose another "
                "folder with --uploads."
            )
            raise UploadFolderError(sentence) from None

    def _settle(self) -> None:
        """Write the names in the folder to the disk, so that a rename survives a loss of power."""
        folder = os.open(self.path, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)

    def _all(self, kind: str) -> list[Upload]:
        """Return the uploads of a ``kind``."""
        return [kept for kept in self.uploads.values() if kept.kind == kind]

    def _read(self, kind: str, path: Path) -> Upload | None:
        """Read the header of a file; log a warning and return None if isogi has not written it."""
        if UPLOAD_ID.fullmatch(path.stem) and not path.is_symlink():
            kept = READERS[kind](path)
        else:
            kept = None
        if kept is None:
            log.warning("%s is not a %s that isogi has written: it is ignored", path, kind)
        return kept


@contextmanager
def name_folder_in_errors(folder: Path) -> Iterator[None]:
    """For the block, turn OSError into FullError or UploadFolderError that names the ``folder``."""
    try:
        yield
    except OSError as error:
        if error.errno in DISK_FULL_ERRORS:
            raise FullError(
                f"The disk of {folder} is full: delete volumes, or make room."
            ) from error
        raise UploadFolderError(
            f"The folder of uploads {folder} cannot be used ({error.strerror})."
        ) from error
