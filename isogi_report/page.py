"""A report as files: ``index.html``, ``report.json``, ``pictures/`` and ``plots/``, each written
whole or not at all.

The page is one file that loads nothing else and runs no script.
"""

import base64
import io
import json
from collections.abc import Iterator, Mapping
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from isogi_core.storage.atomic_file import write_whole
from isogi_report.heading import heading, left_out_rows, machine_rows, plan_facts_rows, scene_rows
from isogi_report.journal import DATA_FILE, PAGE_FILE, Entry, Report, picture_name, plot_name
from isogi_report.plots import draw, gradient, keys, print_picture, scales_of, standalone
from isogi_report.sections import (
    NO_BREAK_SPACE,
    Picture,
    Plot,
    Section,
    Table,
    document_of,
    plain,
    text_column,
    text_columns,
)
from isogi_server.inspect.picture import SCHEME
from isogi_server.values import span

REPORT_FOLDER = Path(__file__).parent

Part = dict[str, Any]


def page(report: Report, head: Mapping[str, Any], files: Mapping[str, bytes]) -> str:
    """Return the page of a report; ``files`` are its pictures, by their names."""
    # Text is escaped in the template; only style, gradient and drawings are markup.
    sheet = Environment(
        loader=FileSystemLoader(REPORT_FOLDER),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    ).get_template("page.html")
    return sheet.render(
        title=head["title"],
        style=Markup(SCHEME + (REPORT_FOLDER / "page.css").read_text(encoding="utf-8")),
        gradient=Markup(gradient()),
        notes=report.notes,
        parts=list(parts(report, files)),
        settings=settings(report, head),
        left_out=left_out_rows(report.scene),
    )


def settings(
    report: Report, head: Mapping[str, Any]
) -> tuple[tuple[str, tuple[tuple[str, str], ...]], ...]:
    """Return the subject and the means of the measurement, in groups of names and texts."""
    return (
        ("Scene and view", scene_rows(report.scene, report.view)),
        ("Plan", plan_facts_rows(report.scene)),
        ("Machine and versions", machine_rows(head)),
    )


def parts(report: Report, files: Mapping[str, bytes]) -> Iterator[Part]:
    """Yield the data that the template draws of each section.

    Tables and plots are numbered through the page.
    """
    tables = count(1)
    plots = count(1)
    for entry in report.entries:
        section = entry.section
        # Error maps of a section share a scale.
        scales = scales_of(entry.section.pictures)
        yield {
            "key": section.key,
            "title": section.title,
            "about": [text for text in section.about.split("\n\n") if text.strip()],
            "tables": [table_part(table, next(tables)) for table in section.tables],
            "plots": [plot_part(plot, next(plots)) for plot in section.plots],
            "pictures": [picture_part(section, i, scale, files) for i, scale in enumerate(scales)],
            "maps": any(scale is not None for scale in scales),
            "seconds": span(entry.seconds),
        }


def table_part(table: Table, number: int) -> Part:
    """Return a table for the template: columns and rows of text."""
    columns = text_columns(table)
    rows = list(zip(*(column.cells for column in columns), strict=True))
    return {"number": number, "caption": table.caption, "columns": columns, "rows": rows}


def plot_part(plot: Plot, number: int) -> Part:
    """Return a plot for the template: its drawing, its legend, and its points as a table."""
    points = [
        (curve.name, x, y) for curve in plot.curves for x, y in zip(curve.x, curve.y, strict=True)
    ]
    columns = [
        text_column(plot.x, [x for _, x, _ in points]),
        text_column(plot.y, [y for _, _, y in points]),
    ]
    names = [name for name, _, _ in points]
    return {
        "number": number,
        "caption": plot.caption,
        "svg": Markup(draw(plot)),
        "legend": keys(plot),
        "alt": (
            f"{plot.y.name} over {plot.x.name}: "
            f"{', '.join(curve.name for curve in plot.curves)}. {plot.caption}"
        ),
        "points": columns,
        "rows": list(zip(names, columns[0].cells, columns[1].cells, strict=True)),
    }


def picture_part(section: Section, i: int, scale: float | None, files: Mapping[str, bytes]) -> Part:
    """Return a picture for the template, with its file inside;
    ``scale`` is the error at the ends of an error map's colours.
    """
    picture = section.pictures[i]
    height, width = picture.pixels.shape[:2]
    # Put the file into the page itself.
    source = "data:image/png;base64," + base64.b64encode(files[picture_name(section, i)]).decode()
    ends = None
    caption = picture.caption
    if scale is not None:
        ends = f"{100 * scale:g}{NO_BREAK_SPACE}%"
        caption = f"{caption} (±{ends})"
    return {
        "source": source,
        "caption": caption,
        "alt": alt(picture, ends),
        "width": width,
        "height": height,
    }


def alt(picture: Picture, ends: str | None) -> str:
    """Return the description of a picture, for people who cannot see it."""
    if ends is not None:
        return (
            f"Error map, from blue, {ends} too dark, to red, {ends} too bright: {picture.caption}"
        )
    return f"Picture: {picture.caption}"


def write_report(folder: Path, report: Report) -> Path:
    """Write all files into ``folder``, the page last; return the page's path. Raises OSError."""
    head = heading(report.scene, report.view)
    # Write pictures and plots first, remove those of an earlier report, and write the page last.
    files = dict(drawings(report))
    for name, data in files.items():
        (folder / name).parent.mkdir(exist_ok=True)
        write_whole(folder / name, data)
    remove_others(folder, set(files))
    write_whole(
        folder / DATA_FILE, json.dumps(data_of(report, head), indent=1, allow_nan=False).encode()
    )
    write_whole(folder / PAGE_FILE, page(report, head, files).encode())
    return folder / PAGE_FILE


def drawings(report: Report) -> Iterator[tuple[str, bytes]]:
    """Yield name and bytes of every picture and plot."""
    for section in (entry.section for entry in report.entries):
        scales = scales_of(section.pictures)
        for i, picture in enumerate(section.pictures):
            yield picture_name(section, i), print_picture(picture, report, scales[i])
            yield picture_name(section, i, "npy"), array_bytes(picture)
        for i, plot in enumerate(section.plots):
            yield plot_name(section, i), standalone(plot).encode()


def array_bytes(picture: Picture) -> bytes:
    """Return a picture's numbers as a ``.npy`` file."""
    file = io.BytesIO()
    np.save(file, picture.pixels)
    return file.getvalue()


def remove_others(folder: Path, names: set[str]) -> None:
    """Remove pictures and plots that the report no longer has."""
    for path in (*folder.glob("pictures/*-*.*"), *folder.glob("plots/*-*.svg")):
        if path.relative_to(folder).as_posix() not in names:
            path.unlink()


def data_of(report: Report, head: Mapping[str, Any]) -> dict[str, Any]:
    """Return everything that the page says as a document for JSON."""
    sections = [section_data(entry) for entry in report.entries]
    return {
        **plain(head),
        "exposure": report.exposure,
        "notes": list(report.notes),
        "sections": sections,
    }


def section_data(entry: Entry) -> dict[str, Any]:
    """Return a section as a document, with the paths of its pictures and plots, and its time."""
    section = entry.section
    document = document_of(entry.section)
    scales = scales_of(section.pictures)
    pictures = []
    for i, picture in enumerate(document["pictures"]):
        facts: Part = {"png": picture_name(section, i), "npy": picture_name(section, i, "npy")}
        if scales[i] is not None:
            facts["scale"] = scales[i]
        pictures.append({**picture, **facts})
    plots = [{**plot, "svg": plot_name(section, i)} for i, plot in enumerate(document["plots"])]
    return {**document, "plots": plots, "pictures": pictures, "seconds": entry.seconds}
