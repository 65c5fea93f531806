"""A report as files: ``index.html``, ``report.json``, ``pictures/`` and ``plots/``, each whole or not there at all."""

import io
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from isogi_core.storage.atomic_file import write_whole
from isogi_report.heading import heading
from isogi_report.journal import DATA_FILE, PAGE_FILE, Entry, Report, picture_name, plot_name
from isogi_report.page import page
from isogi_report.plots import print_picture, scales_of, standalone
from isogi_report.sections import Picture, document_of, plain


def write_report(folder: Path, report: Report) -> Path:
    """Write everything into ``folder``, the page last; gives the page's path back. Raises OSError."""
    head, files = heading(report.scene, report.view), dict(drawings(report))
    for name, data in files.items():
        (folder / name).parent.mkdir(exist_ok=True)
        write_whole(folder / name, data)
    forget(folder, set(files))
    write_whole(folder / DATA_FILE, json.dumps(data_of(report, head), indent=1, allow_nan=False).encode())
    write_whole(folder / PAGE_FILE, page(report, head, files).encode())
    return folder / PAGE_FILE


def drawings(report: Report) -> Iterator[tuple[str, bytes]]:
    """Name and bytes of every picture and plot."""
    for section in (entry.section for entry in report.entries):
        scales = scales_of(section.pictures)
        for i, picture in enumerate(section.pictures):
            yield picture_name(section, i), print_picture(picture, report, scales[i])
            yield picture_name(section, i, "npy"), array_bytes(picture)
        for i, plot in enumerate(section.plots):
            yield plot_name(section, i), standalone(plot).encode()


def array_bytes(picture: Picture) -> bytes:
    """A picture's numbers as a ``.npy`` file."""
    file = io.BytesIO()
    np.save(file, picture.pixels)
    return file.getvalue()


def forget(folder: Path, names: set[str]) -> None:
    """Remove pictures and plots that the report does not have any more."""
    for path in (*folder.glob("pictures/*-*.*"), *folder.glob("plots/*-*.svg")):
        if path.relative_to(folder).as_posix() not in names:
            path.unlink()


def data_of(report: Report, head: Mapping[str, Any]) -> dict[str, Any]:
    """Everything that the page says, as a document for JSON."""
    sections = [section_data(entry) for entry in report.entries]
    return {**plain(head), "exposure": report.exposure, "notes": list(report.notes), "sections": sections}


def section_data(entry: Entry) -> dict[str, Any]:
    """A section with where its pictures and plots are, and what it took."""
    section, document = entry.section, document_of(entry.section)
    scales = scales_of(section.pictures)
    pictures = [
        {
            **picture,
            "png": picture_name(section, i),
            "npy": picture_name(section, i, "npy"),
            **({} if scales[i] is None else {"scale": scales[i]}),
        }
        for i, picture in enumerate(document["pictures"])
    ]
    plots = [{**plot, "svg": plot_name(section, i)} for i, plot in enumerate(document["plots"])]
    return {**document, "plots": plots, "pictures": pictures, "seconds": entry.seconds}
