"""The folder of uploaded volumes, and the one form in which they are kept."""

import errno
import fcntl
import hashlib
import json
import logging
import math
import os
import re
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO
from urllib.parse import quote, unquote

import numpy as np

from isogi_core.files.grid import PATIENT_AXES, Grid, LabelName
from isogi_core.model.volume import Orientation
from isogi_core.plan.volumes.labels import MAX_LABELS
from isogi_core.storage.atomic_file import write_whole
from server.errors import FullError, UploadFolderError
from server.uploads.environments import UploadedEnvironment, read_environment

NRRD_TYPES = {
    **{f"{kind}{size}": f"{name}{8 * size}" for kind, name in (("i", "int"), ("u", "uint")) for size in (1, 2, 4, 8)},
    **{"f4": "float", "f8": "double"},
}
"""NRRD's names of types by NumPy's."""

NRRD_SPACES = {PATIENT_AXES: "right-anterior-superior"}
"""NRRD's names of spaces by their letters."""

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
    rb"NRRD0004\ntype: (\w+)\ndimension: 3\nsizes: (\d+) (\d+) (\d+)\nencoding: raw\nendian: little\n"
    rb"(?:spacings: [-+.e\d ]+|space[ a-z]*: [-a-z\d]+\nspace directions: [-+.e\d(), ]+\nspace origin: [-+.e\d(),]+"
    rb"(?:\nspace units: [^\n]+)?)\nname:=([!-~]*)\n"
    rb"(?:Segment\d+_(?:LabelValue|Name|Color):=[^\n]*\n)*\n",
    re.ASCII,
)
MAX_HEADER_BYTES = 1 << 17
"""Bytes that no header is longer than."""

LABEL_NAME = 64
"""Characters of a label's name that are kept, at most."""

VOXEL_BYTES = 4
"""Bytes of a voxel in the server's memory, where all are float32."""

SCENE_BYTES = 256 << 10
"""Bytes that the scene of a volume takes in the server's memory besides its voxels, while nobody looks at it: 10 to 30
kB were measured."""


@dataclass(frozen=True)
class UploadedVolume:
    """A volume in its canonical file: its ``id``, its ``name`` for a person, voxels along x, y, z, and bytes."""

    id: str
    name: str
    size: tuple[int, int, int]
    bytes: int

    @property
    def held(self) -> int:
        """Bytes that the quota counts: those on disk or in memory, whichever are more, and those of its scene."""
        return SCENE_BYTES + max(self.bytes, VOXEL_BYTES * math.prod(self.size))


def write(file: IO[bytes], grid: Grid, name: str) -> str:
    """Write a grid on right angles as a canonical file; gives its id, a digest of all but the name.

    The name of what has none is made of the id. Types that NRRD lacks become the next that it has.
    """
    kind = {"b1": "u1", "f2": "f4"}.get(grid.dtype.str[1:], grid.dtype.str[1:])
    kind = kind if kind in NRRD_TYPES else "f8"
    facts = {
        "type": NRRD_TYPES[kind],
        "sizes": " ".join(str(n) for n in grid.shape[::-1]),
        "place": placing_lines(grid),
    }
    facts["labels"] = "".join(segment(number, label) for number, label in enumerate(shown_labels(grid)))
    digest = hashlib.blake2b(VOLUME_HEADER.format(**facts, name="").encode(), digest_size=16)
    for layer in layer_values(grid, f"<{kind}"):
        digest.update(layer)
    number = digest.hexdigest()
    file.write(VOLUME_HEADER.format(**facts, name=quote(name or f"volume {number[:6]}", safe="")).encode())
    for layer in layer_values(grid, f"<{kind}"):
        file.write(layer)
    return number


def shown_labels(grid: Grid) -> tuple[LabelName, ...]:
    """The labels that a grid names, as many as can be shown; of a segmentation without names a nameless one."""
    return () if grid.labels is None else grid.labels[:MAX_LABELS] or (LabelName(1),)


def segment(number: int, label: LabelName) -> str:
    """The lines of a header that name a label, as 3D Slicer does."""
    red, green, blue = (byte / 255.0 for byte in bytes.fromhex(label.colour[1:] or "000000"))
    name = "".join(letter for letter in label.name if letter.isprintable() and letter != "\\")[:LABEL_NAME]
    rows = {"LabelValue": str(label.value), "Name": name, "Color": label.colour and f"{red:.6f} {green:.6f} {blue:.6f}"}
    return "".join(f"Segment{number}_{key}:={text}\n" for key, text in rows.items() if text)


def layer_values(grid: Grid, kind: str) -> Iterator[memoryview]:
    """The values of a grid, layer by layer, as a type: no copy of the whole takes memory."""
    return (np.ascontiguousarray(layer, kind).data for slab in grid.slabs() for layer in slab)


def placing_lines(grid: Grid) -> str:
    """The lines of a header that say where a grid on right angles lies: spacing alone where that is all."""
    orientation = Orientation.of(grid)
    if not orientation.placed and not orientation.letters and not orientation.unit:
        return f"spacings: {' '.join(repr(float(step)) for step in grid.spacing)}"
    steps = orientation.matrix.T * np.array(grid.spacing)[:, None]
    space = f"space: {NRRD_SPACES[orientation.letters]}" if orientation.letters in NRRD_SPACES else "space dimension: 3"
    lines = [space, f"space directions: {' '.join(map(vector, steps))}", f"space origin: {vector(orientation.origin)}"]
    unit = "".join(letter for letter in orientation.unit if letter.isprintable() and letter != '"')
    units = [f"space units: {' '.join(3 * (quoted,))}" for quoted in (f'"{unit}"',) if unit]
    return "\n".join([*lines, *units])


def vector(row: Sequence[float]) -> str:
    """A vector as NRRD writes it."""
    return f"({','.join(repr(float(value)) for value in row)})"


def read_facts(path: Path) -> UploadedVolume | None:
    """What a file whose name is its id says of itself; None where it is not as ``write`` left it."""
    with path.open("rb") as file:
        head = VOLUME_HEADER_PATTERN.match(file.read(MAX_HEADER_BYTES))
    if head is None:
        return None
    kind, *sizes, name = (part.decode() for part in head.groups())
    x, y, z = map(int, sizes)
    kept = UploadedVolume(path.stem, unquote(name), (x, y, z), path.stat().st_size)
    widths = {name: int(code[1]) for code, name in NRRD_TYPES.items()}
    whole = head.end() + widths.get(kind, 0) * math.prod(kept.size)
    return kept if kept.bytes == whole else None


log = logging.getLogger("isogi.uploads")

UPLOAD_ID = re.compile(r"[0-9a-f]{20}([0-9a-f]{12})?")
"""What ids look like."""

UNFINISHED_SUFFIX = ".part"
OWNERS_FILE = "owners.json"
"""The file of who has sent a volume by name."""

DISK_FULL_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def read_owners(path: Path) -> dict[str, list[str]]:
    """The names of those whom volumes belong to, by the volumes' ids. Raises UploadFolderError where it is damaged."""
    try:
        owners = json.loads(path.read_bytes()) if path.exists() else {}
        return {str(number): [str(name) for name in names] for number, names in owners.items()}
    except (ValueError, AttributeError, TypeError):
        raise UploadFolderError(f"{path}, which says whose volumes are, is damaged: mend it, or delete it.") from None


def default_folder() -> Path:
    """Where uploads are kept by default: ``$XDG_DATA_HOME/isogi/volumes``, or below ``~/.local/share``."""
    return Path(os.environ.get("XDG_DATA_HOME") or Path.home() / ".local" / "share") / "isogi" / "volumes"


class UploadFolder:
    """The volumes in a folder of one server, in a table by their ids. Raises UploadFolderError, and FullError.

    The table is replaced and never changed: iterations over the former one go on.
    """

    def __init__(self, path: Path) -> None:
        """Name the folder; nothing is opened yet."""
        self.path = path
        self.volumes: dict[str, UploadedVolume] = {}
        self.environments: dict[str, UploadedEnvironment] = {}
        self._owners: dict[str, list[str]] = {}
        self._lock: IO[bytes] | None = None

    @property
    def held(self) -> int:
        """Bytes that count towards the quota."""
        volumes, environments = self.volumes.values(), self.environments.values()
        return sum(kept.held for kept in volumes) + sum(kept.held for kept in environments)

    def open(self) -> None:
        """Take the folder, for its owner alone; throw away what was half-written, and find what is whole."""
        with name_folder_in_errors(self.path):
            self.path.mkdir(0o700, parents=True, exist_ok=True)
            self.path.chmod(0o700)
            self._lock = self._take()
            for path in self.path.glob(f"*{UNFINISHED_SUFFIX}"):
                path.unlink()
            self._owners = read_owners(self.path / OWNERS_FILE)
            self.volumes = {kept.id: kept for kept in map(self._read, sorted(self.path.glob("*.nrrd"))) if kept}
            self.environments = {kept.id: kept for kept in map(self._light, sorted(self.path.glob("*.hdr"))) if kept}

    def close(self) -> None:
        """Leave the folder to others."""
        if self._lock is not None:
            self._lock.close()

    def place(self, number: str) -> Path:
        """The file of a volume, or of an environment, in the folder."""
        return self.path / (f"{number}.nrrd" if number in self.volumes else f"{self.environments[number].id}.hdr")

    @contextmanager
    def drafts(self) -> Iterator[tuple[IO[bytes], IO[bytes]]]:
        """Two files: for what a client sends, which has no name, and for its canonical form. Gone afterwards."""
        with name_folder_in_errors(self.path):
            body = tempfile.TemporaryFile(dir=self.path)  # noqa: SIM115
            draft = tempfile.NamedTemporaryFile(dir=self.path, suffix=UNFINISHED_SUFFIX, delete=False)  # noqa: SIM115
        try:
            with body, draft:
                yield body, draft
        finally:
            Path(draft.name).unlink(missing_ok=True)

    def put(self, draft: IO[bytes], number: str) -> UploadedVolume:
        """Keep a canonical draft of a volume under its id: once this returns no power cut takes it away."""
        place = self.path / f"{number}.nrrd"
        self._move(draft, place)
        kept = self._read(place)
        if kept is None:
            raise UploadFolderError(f"The volume in {place} did not come out as it went in: check the disk.")
        self.volumes = {**self.volumes, number: kept}
        return kept

    def put_environment(self, draft: IO[bytes], number: str) -> UploadedEnvironment:
        """Keep a canonical draft of an environment likewise."""
        place = self.path / f"{number}.hdr"
        self._move(draft, place)
        kept = self._light(place)
        if kept is None:
            raise UploadFolderError(f"The light in {place} did not come out as it went in: check the disk.")
        self.environments = {**self.environments, number: kept}
        return kept

    def _move(self, draft: IO[bytes], place: Path) -> None:
        """Give a draft its name, for good."""
        with name_folder_in_errors(self.path):
            draft.flush()
            os.fsync(draft.fileno())
            os.replace(draft.name, place)
            self._settle()

    def owners_of(self, number: str) -> list[str]:
        """The names of those whom a volume belongs to; none where nobody is named."""
        return self._owners.get(number, [])

    def give(self, number: str, owner: str) -> None:
        """Have an upload belong to one more, unless that is nobody."""
        if owner and (number in self.volumes or number in self.environments) and owner not in self.owners_of(number):
            self._own({**self._owners, number: [*self.owners_of(number), owner]})

    def take_back(self, number: str, owner: str) -> None:
        """Have a volume belong to one less."""
        self._own({**self._owners, number: [each for each in self.owners_of(number) if each != owner]})

    def _own(self, owners: dict[str, list[str]]) -> None:
        """Keep who owns what."""
        with name_folder_in_errors(self.path):
            write_whole(self.path / OWNERS_FILE, json.dumps(owners).encode())
        self._owners = owners

    def remove(self, number: str) -> None:
        """Delete a volume, or an environment."""
        if number in self._owners:
            self._own({key: owners for key, owners in self._owners.items() if key != number})
        with name_folder_in_errors(self.path):
            self.place(number).unlink(missing_ok=True)
            self.volumes = {key: kept for key, kept in self.volumes.items() if key != number}
            self.environments = {key: kept for key, kept in self.environments.items() if key != number}
            self._settle()

    def _take(self) -> IO[bytes]:
        """The folder's lock, which other servers respect and which ends with the process."""
        lock = (self.path / "lock").open("wb")
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return lock
        except BlockingIOError:
            lock.close()
            sentence = f"Another server keeps its uploads in {self.path}: choose another folder with --uploads."
            raise UploadFolderError(sentence) from None

    def _settle(self) -> None:
        """Have the folder's names on the disk."""
        folder = os.open(self.path, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)

    def _read(self, path: Path) -> UploadedVolume | None:
        kept = read_facts(path) if UPLOAD_ID.fullmatch(path.stem) and not path.is_symlink() else None
        if kept is None:
            log.warning("%s is no volume that isogi has kept: it is left alone", path)
        return kept

    def _light(self, path: Path) -> UploadedEnvironment | None:
        kept = read_environment(path) if UPLOAD_ID.fullmatch(path.stem) and not path.is_symlink() else None
        if kept is None:
            log.warning("%s is no light that isogi has kept: it is left alone", path)
        return kept


@contextmanager
def name_folder_in_errors(folder: Path) -> Iterator[None]:
    """What the system says of a ``folder`` as an error that names it."""
    try:
        yield
    except OSError as error:
        if error.errno in DISK_FULL_ERRORS:
            raise FullError(f"The disk of {folder} is full: delete volumes, or make room.") from error
        raise UploadFolderError(f"The folder of uploads {folder} cannot be used ({error.strerror}).") from error
