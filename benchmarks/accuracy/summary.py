"""What a few reports found, in tables and pictures, from their ``report.json``."""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.common.measurement import Measurement
from benchmarks.common.measurement import markdown as lines_of
from isogi_report.sections import Cell, Column, Table, table_of, text_columns

Data = Mapping[str, Any]

INTRODUCTION = """\
How wrong isogi's light is, by cause, and what it costs. Each row is a view of a scene, against a \
reference that is path-traced from each pixel to the lights themselves, with as many bounces as \
may matter. Errors are relative RMSE: of the luminance of surface pixels, over the reference's \
mean, less the noise that is known. The total is the frame's; each part is what remains when one \
ingredient alone gives way to its exact counterpart. A dash is a part that the scene's plan does \
not have. Bake is the seconds of the processor, all threads together, in which the view's light \
was baked, each texel until pixels are at a target error of 2 %, which is of Monte Carlo noise \
alone."""

MADE = """\
Each scene has an albedo of 0.7 and is planned by isogi. `isogi report SCENE -o DIR` makes one \
such report of your own scene, with everything that is left out here."""

PICTURES = "accuracy-reports"
"""The folder beside the page that its pictures are in."""

Files = dict[str, bytes]
"""Pictures by their files' names."""

TOTAL = "total, measured"
"""The row of the split that is of the whole frame."""

SUMS = (TOTAL, "parts together", "total with these")
"""Rows of the split that are no parts."""

BAKE = "bake"
"""The column of the summary with what the light took."""


def summary_of(folders: Mapping[str, Path]) -> Measurement:
    """The summary of the reports in ``folders``, by their names, with their pictures and curves.
    Raises OSError.
    """
    reports = {
        name: json.loads((folder / "report.json").read_text("utf-8"))
        for name, folder in folders.items()
    }
    files: Files = {}
    parts = [INTRODUCTION, overview(reports), f"{MADE} {measured_on(reports)}", *missing(reports)]
    parts += [*shown(reports, folders, files), *curves(reports, folders, files), *scores(reports)]
    return Measurement("Error against run time", dict(figures(reports)), "\n\n".join(parts), files)


def figures(reports: Mapping[str, Data]) -> Iterator[tuple[str, float]]:
    """Each part of each scene's error in per cent, and what the bake took."""
    for name, data in reports.items():
        for part, share, *_ in rows_of(data, "split"):
            if share is not None:
                yield f"{name}: {part}, %", 100.0 * share
        seconds = bake_seconds(data)
        if isinstance(seconds, int | float):
            yield f"{name}: bake, s", seconds


def overview(reports: Mapping[str, Data]) -> str:
    """The total of each scene's error, a column for each of its parts, and what the bake took."""
    totals = {
        name: {row[0]: row[1] for row in rows_of(data, "split")} for name, data in reports.items()
    }
    found = dict.fromkeys(part for table in totals.values() for part in table)
    parts = [part for part in found if part not in SUMS]
    columns = (
        Column("scene"),
        Column("total", "share"),
        *(Column(part, "share") for part in parts),
    )
    rows = [
        (name, table.get(TOTAL), *(table.get(part) for part in parts), bake_seconds(reports[name]))
        for name, table in totals.items()
        if table
    ]
    return markdown((*columns, Column(BAKE, "seconds")), rows)


def bake_seconds(data: Data) -> Cell:
    """What a report's light took, by its summary."""
    tables = [table_of(table) for table in headline(data)]
    cells = [
        dict(zip((each.name for each in table.columns), table.rows[0], strict=True))
        for table in tables
    ]
    return next((cell[BAKE] for cell in cells if BAKE in cell), None)


def measured_on(reports: Mapping[str, Data]) -> str:
    """The machine, and the sizes of the pictures."""
    data = next(iter(reports.values()))
    box = data["machine"]
    view = data["view"]
    size = f"{view['width']} × {view['height']} pixels"
    return (
        f"Measured on {box['cores']} cores of {box['processor']} ({box['system']}), with "
        f"pictures of {size}."
    )


def missing(reports: Mapping[str, Data]) -> Iterator[str]:
    """What reports say that they lack."""
    lines = [f"- {name}: {note}" for name, data in reports.items() for note in data["notes"]]
    if lines:
        yield "Not measured:"
        yield "\n".join(lines)


def scores(reports: Mapping[str, Data]) -> Iterator[str]:
    """The score of each scene's frame, its plan, and what it took."""
    head = next(
        (table_of(each) for data in reports.values() for each in headline(data)), Table("", (), ())
    )
    columns = (Column("scene"), Column("plan"), Column("bytes per texel", "count"), *head.columns)
    rows = [
        (
            name,
            data["scene"]["plan"]["representation"],
            data["scene"]["plan"]["bytes_per_texel"],
            *each["rows"][0],
        )
        for name, data in reports.items()
        for each in headline(data)
    ]
    yield "## Each scene's plan and its frame's scores"
    yield markdown(columns, rows)


def headline(data: Data) -> Sequence[Any]:
    """The first table of a report's summary, alone; nothing where it was left out."""
    return section(data, "summary").get("tables", ())[:1]


def curves(reports: Mapping[str, Data], folders: Mapping[str, Path], files: Files) -> Iterator[str]:
    """Plots of error against run time."""
    yield "## Error against run time"
    for name, data in reports.items():
        for i, plot in enumerate(section(data, "convergence").get("plots", ())):
            file = copied(folders[name] / plot["svg"], files, f"{name}-curves-{i + 1}")
            yield f"![{name}: {plot['caption']}]({file})"
            yield f"*{name}: {', '.join(curve['name'] for curve in plot['curves'])}.*"


def shown(reports: Mapping[str, Data], folders: Mapping[str, Path], files: Files) -> Iterator[str]:
    """Frames, references and error maps side by side, twice as large as they are."""
    yield "## The frames, their references, and where they differ"
    for name, data in reports.items():
        drawn = section(data, "summary").get("pictures", ())
        width = 2 * data["view"]["width"]
        copies = [f"{name}-{i + 1}" for i in range(len(drawn))]
        places = [
            copied(folders[name] / each["png"], files, to)
            for each, to in zip(drawn, copies, strict=True)
        ]
        if drawn:
            yield " ".join(
                image(file, f"{name}: {each['caption']}", width)
                for file, each in zip(places, drawn, strict=True)
            )
            yield f"*{name}: {', '.join(map(caption, drawn))}.*"


def image(file: str, text: str, width: int) -> str:
    """A picture in Markdown, so many pixels wide."""
    return f'<img src="{file}" width="{width}" alt="{text}">'


def caption(picture: Data) -> str:
    """A picture's caption, with the scale of its colours where it is an error map."""
    scale = picture.get("scale")
    return picture["caption"] + (
        "" if scale is None else f" (blue {100 * scale:g} % too dark, red too bright)"
    )


def section(data: Data, key: str) -> Data:
    """A section of a report; an empty one where it was left out."""
    return next((each for each in data["sections"] if each["key"] == key), {})


def rows_of(data: Data, key: str) -> Sequence[Sequence[Any]]:
    """The rows of a section's first table; none where it was left out."""
    return next((table["rows"] for table in section(data, key).get("tables", ())), ())


def markdown(columns: Sequence[Column], rows: Iterable[Sequence[Any]]) -> str:
    """A table in Markdown, its cells as reports write them."""
    texts = text_columns(Table("", tuple(columns), tuple(map(tuple, rows))))
    words = sum(not column.numeric for column in texts)
    return lines_of(
        [each.head for each in texts], zip(*(each.cells for each in texts), strict=True), left=words
    )


def copied(path: Path, files: Files, name: str) -> str:
    """Take a picture under a name of its own; where it is, from the page."""
    file = f"{name.lower().replace(' ', '-')}{path.suffix}"
    files[file] = path.read_bytes()
    return f"{PICTURES}/{file}"
