"""The journal of a report: each section kept as soon as it is measured, so that an interrupted report goes on.

A folder holds one journal. Its ``report.json`` names what the report is of; each section is a JSON file and the
pixels of its pictures beside it. What other code has measured does not count as done.
"""

import hashlib
import io
import json
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import isogi_core
from isogi_core.errors import ReportError
from isogi_core.model.scene import Scene
from isogi_core.model.view import View
from isogi_core.report.sections import Section
from server.render import write
from server.report.documents import document_of, section_of

FOLDER = "journal"
SUBJECT = "report.json"

WORK = "work"
"""Beside the journal: light and references that studies share."""


@dataclass(frozen=True, eq=False)
class Entry:
    """A section that was measured, and the ``seconds`` of the processor that this took."""

    section: Section
    seconds: float


class Journal:
    """The sections that are done of a report in ``folder`` about ``subject``."""

    def __init__(self, folder: Path, subject: Mapping[str, Any]) -> None:
        """Open the journal, or begin one; ReportError where the folder holds something else."""
        self.folder, self.code = folder / FOLDER, code_digest()
        path = self.folder / SUBJECT
        if path.is_file():
            refuse_other(folder, json.loads(path.read_text(encoding="utf-8")), subject)
            return
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise ReportError(f"{folder} is there and holds no report: choose a new or an empty folder.")
        self.folder.mkdir(parents=True)
        write(path, json.dumps(subject, indent=2).encode())

    def workshop(self) -> Path:
        """A folder for the light and the references of this code, which goes on with them; that of other code goes."""
        work = self.folder.with_name(WORK)
        for other in work.glob("*"):
            if other.name != self.code:
                shutil.rmtree(other)
        return work / self.code

    def find(self, key: str) -> Entry | None:
        """The section of this key, if this code has measured it."""
        try:
            document = json.loads((self.folder / f"{key}.json").read_text(encoding="utf-8"))
            if document["code"] != self.code:
                return None
            with np.load(self.folder / f"{key}.npz") as arrays:
                pixels = [arrays[f"arr_{i}"] for i in range(len(document["section"]["pictures"]))]
        except FileNotFoundError:
            return None
        return Entry(section_of(document["section"], pixels), document["seconds"])

    def keep(self, key: str, entry: Entry) -> None:
        """Keep a section; its pixels first, so that what is found is whole."""
        pixels = io.BytesIO()
        np.savez_compressed(pixels, *(picture.pixels for picture in entry.section.pictures))
        write(self.folder / f"{key}.npz", pixels.getvalue())
        document = {"code": self.code, "seconds": entry.seconds, "section": document_of(entry.section)}
        write(self.folder / f"{key}.json", json.dumps(document, allow_nan=False).encode())


def subject_of(scene: Scene, view: View) -> dict[str, Any]:
    """What a report is of, as a document: two reports of the same one measure the same."""
    camera = view.camera
    return {
        "scene": scene.name,
        "digest": scene.digest,
        "volume": scene.volume.digest,
        "isovalue": view.isovalue,
        "camera": [*camera.eye, *camera.target, *camera.up, camera.fov],
        "light": list(view.light),
        "size": [view.width, view.height],
    }


def refuse_other(folder: Path, held: Mapping[str, Any], wanted: Mapping[str, Any]) -> None:
    """ReportError where the folder's report is of something else than what is ``wanted``."""
    other = [name for name in wanted if held.get(name) != wanted[name]]
    if other:
        what = "scene" if {"scene", "digest", "volume"} & set(other) else f"view (by its {' and '.join(other)})"
        held_of = f"a report of {held.get('scene')} at {held.get('isovalue')}"
        raise ReportError(f"{folder} holds {held_of}, which is another {what}: choose another folder.")


def code_digest() -> str:
    """Hex name of all code that a measured figure depends on."""
    digest = hashlib.blake2b(digest_size=10)
    root = Path(isogi_core.__file__).parent
    for path in sorted(root.rglob("*.py")):
        digest.update(path.relative_to(root).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()
