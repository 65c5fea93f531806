"""The page: everything in one file that asks for nothing else and runs no script."""

import base64
from collections.abc import Iterator, Mapping
from itertools import count
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from isogi_report.cells import NO_BREAK_SPACE, text_column, text_columns
from isogi_report.heading import left_out_rows, machine_rows, plan_facts_rows, scene_rows
from isogi_report.journal import Report, picture_name
from isogi_report.plots import draw, gradient, keys, scales_of
from isogi_report.sections import Picture, Plot, Section, Table
from server.inspect.picture import SCHEME
from server.values import span

REPORT_FOLDER = Path(__file__).parent

Part = dict[str, Any]


def page(report: Report, head: Mapping[str, Any], files: Mapping[str, bytes]) -> str:
    """The page of a report; ``files`` are its pictures, by their names."""
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


def settings(report: Report, head: Mapping[str, Any]) -> tuple[tuple[str, tuple[tuple[str, str], ...]], ...]:
    """What was measured, and with what, in groups of names and texts."""
    return (
        ("Scene and view", scene_rows(report.scene, report.view)),
        ("Plan", plan_facts_rows(report.scene)),
        ("Machine and versions", machine_rows(head)),
    )


def parts(report: Report, files: Mapping[str, bytes]) -> Iterator[Part]:
    """What the template draws of each section; tables and plots are numbered through the page."""
    tables, plots = count(1), count(1)
    for entry in report.entries:
        section, scales = entry.section, scales_of(entry.section.pictures)
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
    """A table: heads, and rows of text."""
    columns = text_columns(table)
    rows = list(zip(*(column.cells for column in columns), strict=True))
    return {"number": number, "caption": table.caption, "columns": columns, "rows": rows}


def plot_part(plot: Plot, number: int) -> Part:
    """A plot: its drawing, its legend, and its points as a table."""
    points = [(curve.name, x, y) for curve in plot.curves for x, y in zip(curve.x, curve.y, strict=True)]
    columns = [text_column(plot.x, [x for _, x, _ in points]), text_column(plot.y, [y for _, _, y in points])]
    names = [name for name, _, _ in points]
    return {
        "number": number,
        "caption": plot.caption,
        "svg": Markup(draw(plot)),
        "legend": keys(plot),
        "alt": f"{plot.y.name} over {plot.x.name}: {', '.join(curve.name for curve in plot.curves)}. {plot.caption}",
        "points": columns,
        "rows": list(zip(names, columns[0].cells, columns[1].cells, strict=True)),
    }


def picture_part(section: Section, i: int, scale: float | None, files: Mapping[str, bytes]) -> Part:
    """A picture, with its file in itself; ``scale`` is the error at the ends of an error map's colours."""
    picture = section.pictures[i]
    height, width = picture.pixels.shape[:2]
    source = "data:image/png;base64," + base64.b64encode(files[picture_name(section, i)]).decode()
    ends = None if scale is None else f"{100 * scale:g}{NO_BREAK_SPACE}%"
    caption = picture.caption if ends is None else f"{picture.caption} (±{ends})"
    return {"source": source, "caption": caption, "alt": alt(picture, ends), "width": width, "height": height}


def alt(picture: Picture, ends: str | None) -> str:
    """What a picture is, for who does not see it."""
    if ends is not None:
        return f"Error map, from blue, {ends} too dark, to red, {ends} too bright: {picture.caption}"
    return f"Picture: {picture.caption}"
