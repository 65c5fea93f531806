"""A report and its journal, which keeps each section as soon as it is measured, so that an
interrupted report continues.

The folder of a report holds one journal, the folder ``journal``. Its ``report.json`` names the
subject of the report: scene, view and exposure. Each section is a JSON file, with the pixels of
its pictures next to it. A section that other code has measured, or that is damaged, is measured
again.
"""

import fcntl
import hashlib
import io
import json
import shutil
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

import isogi_core
from isogi_core.errors import ReportError
from isogi_core.model.view import View
from isogi_core.plan.scene import Scene
from isogi_core.storage.atomic_file import write_whole
from isogi_report.sections import Section, document_of, section_of

PAGE_FILE = "index.html"
"""The page, in the folder of a report."""

DATA_FILE = "report.json"
"""The figures of the page as JSON, next to it."""

JOURNAL_FOLDER = "journal"
"""The folder of the journal, in that of the report."""

SUBJECT_FILE = "report.json"
"""The document of the report's subject, in JOURNAL_FOLDER."""

LOCK_FILE = "lock"

WORK_FOLDER = "work"
"""Folder next to the journal, for references that studies share."""


ENTRY_DAMAGE = (OSError, EOFError, ValueError, KeyError, TypeError, BadZipFile, zlib.error)
"""Errors of reading an entry that is missing, cut or changed."""


@dataclass(frozen=True, eq=False)
class Entry:
    """A measured section, and the processor ``seconds`` spent on it."""

    section: Section
    seconds: float


@dataclass(frozen=True, eq=False)
class Report:
    """The sections of a view in the order of the page, and ``notes`` on missing ones.

    Pictures show radiance times ``exposure`` where the mask ``on`` (h, w) is True, and the film's
    background elsewhere.
    """

    scene: Scene
    view: View
    exposure: float
    on: np.ndarray
    entries: tuple[Entry, ...]
    notes: tuple[str, ...] = ()


def picture_name(section: Section, i: int, suffix: str = "png") -> str:
    """Return the path of picture ``i`` of a section within the report's folder."""
    return f"pictures/{section.key}-{i + 1}.{suffix}"


def plot_name(section: Section, i: int) -> str:
    """Return the path of plot ``i`` of a section within the report's folder."""
    return f"plots/{section.key}-{i + 1}.svg"


class Journal:
    """The finished sections of a report in ``folder`` about ``subject``."""

    def __init__(self, folder: Path, subject: Mapping[str, Any]) -> None:
        """Continue the journal, or begin it if it has no section.

        Raises ReportError if it has sections of another subject.
        """
        self.folder = folder / JOURNAL_FOLDER
        self.code = code_digest()
        path = self.folder / SUBJECT_FILE
        # A journal without sections may be given another subject; references of the old one are of
        # no use then.
        if sections_in(self.folder):
            refuse_other(folder, read(path), subject)
        elif read(path) != subject:
            shutil.rmtree(folder / WORK_FOLDER, ignore_errors=True)
            write_whole(path, json.dumps(subject, indent=2).encode())
        forget_others(workshop(folder))

    def find(self, key: str) -> Entry | None:
        """Return the section of this key
        if this code has measured it and it is whole, else None.
        """
        try:
            document = json.loads((self.folder / f"{key}.json").read_text(encoding="utf-8"))
            if document["code"] != self.code:
                return None
            # An entry counts only if its own pixels can be read, too. Others may be beside it, if a
            # process ended while it wrote another entry.
            data = (self.folder / f"{key}.npz").read_bytes()
            if document["pixels"] != digest_of(data):
                return None
            with np.load(io.BytesIO(data)) as arrays:
                pixels = [arrays[f"arr_{i}"] for i in range(len(document["section"]["pictures"]))]
            return Entry(section_of(document["section"], pixels), document["seconds"])
        except ENTRY_DAMAGE:
            return None

    def keep(self, key: str, entry: Entry) -> None:
        """Write a section, which ``find`` did not find under this ``key``, to the journal: its
        pixels to a file KEY.npz, all else to KEY.json.
        """
        file = io.BytesIO()
        np.savez_compressed(file, *(picture.pixels for picture in entry.section.pictures))
        pixels = file.getvalue()
        # Write the pixels first: ``find`` needs the JSON file, and refuses one of other code or of
        # other pixels. If the process ends in between, it finds no section.
        write_whole(self.folder / f"{key}.npz", pixels)
        document = {
            "code": self.code,
            "seconds": entry.seconds,
            "pixels": digest_of(pixels),
            "section": document_of(entry.section),
        }
        write_whole(self.folder / f"{key}.json", json.dumps(document, allow_nan=False).encode())


@contextmanager
def open_journal(folder: Path, subject: Mapping[str, Any]) -> Iterator[Journal]:
    """Open the journal of ``folder`` for this process alone.

    Raises ReportError if the folder holds something else, or is in use.
    """
    journal = folder / JOURNAL_FOLDER
    # Never write into a folder with other files.
    if folder.exists() and (
        not folder.is_dir() or (not journal.is_dir() and any(folder.iterdir()))
    ):
        raise ReportError(f"{folder} exists and holds no report: choose a new or an empty folder.")
    journal.mkdir(parents=True, exist_ok=True)
    with (journal / LOCK_FILE).open("w") as file:
        # The lock is released when the process ends, however that happens.
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ReportError(
                f"{folder} is being written by another report: wait for its end."
            ) from None
        yield Journal(folder, subject)


def workshop(folder: Path) -> Path:
    """Return the path of the folder for references that this code makes of a report in ``folder``;
    create nothing.
    """
    return folder / WORK_FOLDER / code_digest()


def forget_others(work: Path) -> None:
    """Remove the folders of other code next to the folder ``work``."""
    for other in work.parent.glob("*"):
        if other.name != work.name:
            shutil.rmtree(other)


def sections_in(journal: Path) -> bool:
    """Return True if the folder of a ``journal`` has any section, whole or not."""
    return any(path.name != SUBJECT_FILE for path in journal.glob("*.json"))


def read(path: Path) -> Mapping[str, Any]:
    """Return the document in a JSON file; an empty one if the file is missing or damaged."""
    try:
        found: Mapping[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return found


def subject_of(scene: Scene, view: View, exposure: float) -> dict[str, Any]:
    """Return the subject of a report as a document. Reports of equal subjects measure the same."""
    camera = view.camera
    return {
        "scene": scene.name,
        "digest": scene.digest,
        "volume": scene.volume.digest,
        "isovalue": view.isovalue,
        "camera": [*camera.eye, *camera.target, *camera.up, camera.fov],
        "light": list(view.light),
        "size": [view.width, view.height],
        "exposure": exposure,
    }


def refuse_other(folder: Path, held: Mapping[str, Any], wanted: Mapping[str, Any]) -> None:
    """Raise ReportError if the folder's report is of another subject than ``wanted``."""
    other = [name for name in wanted if held.get(name) != wanted[name]]
    if other:
        # Name the scene as the difference if it differs, else the parameters of the view.
        if {"scene", "digest", "volume"} & set(other):
            what = "scene"
        else:
            what = f"view (by its {' and '.join(other)})"
        held_of = f"a report of {held.get('scene')} at {held.get('isovalue')}"
        raise ReportError(
            f"{folder} holds {held_of}, which is another {what}: choose another folder."
        )


def digest_of(data: bytes) -> str:
    """Return the digest of the bytes of a file, in hexadecimal."""
    return hashlib.blake2b(data, digest_size=10).hexdigest()


def code_digest() -> str:
    """Return the digest, in hexadecimal, of all code that a measured figure depends on."""
    digest = hashlib.blake2b(digest_size=10)
    for root in (Path(isogi_core.__file__).parent, Path(__file__).parent):
        for path in sorted(root.rglob("*.py")):
            digest.update(path.relative_to(root).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()
