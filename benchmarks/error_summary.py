"""docs/error.md: what a few reports found, in tables and pictures, from their ``report.json``."""

import json
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

from isogi_core.report.sections import Cell, Column, Table
from server.render import write
from server.report.cells import told
from server.report.documents import table_of

Data = Mapping[str, Any]

INTRODUCTION = """\
# Error against run time

How wrong isogi's light is, by cause, and what it costs. Each row is a view of a scene, against a reference that is \
path-traced from each pixel to the lights themselves, with as many bounces as may matter. Errors are relative RMSE: of \
the luminance of surface pixels, over the reference's mean, less the noise that is known. The total is the frame's; \
each part is what remains when one ingredient alone gives way to its exact counterpart. A dash is a part that the \
scene's plan does not have. Bake is the seconds of the processor, all threads together, in which the view's light was \
baked, each texel to a target error of 2 %, which is of Monte Carlo noise alone."""

MADE = """\
Each scene has an albedo of 0.7 and is planned by isogi. `make reports` makes all of this anew, and \
`isogi report SCENE -o DIR` one such report of your own scene, with everything that is left out here."""

PICTURES = "error"
"""The folder beside ``error.md`` that its pictures are in."""

TOTAL = "total, measured"
"""The row of the split that is of the whole frame."""

SUMS = (TOTAL, "parts together", "total with these")
"""Rows of the split that are no parts."""

BAKE = "bake"
"""The column of the summary with what the light took."""


def write_summary(
    docs: Path, folders: Mapping[str, Path], pictured: Iterable[str] = (), curved: Iterable[str] = ()
) -> None:
    """Write ``error.md`` and its pictures into ``docs``, from the reports in ``folders``, by their names.

    Pictures are those of the reports ``pictured``, curves those of the reports ``curved``. What was there before
    stays until all of it is made.
    """
    reports = {name: json.loads((folder / "report.json").read_text("utf-8")) for name, folder in folders.items()}
    docs.mkdir(parents=True, exist_ok=True)
    fresh = Path(mkdtemp(prefix=".error-", dir=docs))
    try:
        parts = [INTRODUCTION, overview(reports), f"{MADE} {measured_on(reports)}", *missing(reports)]
        parts += [*shown(reports, folders, pictured, fresh), *curves(reports, folders, curved, fresh)]
        parts += scores(reports)
        replace_folder(fresh, docs / PICTURES)
    finally:
        shutil.rmtree(fresh, ignore_errors=True)
    write(docs / "error.md", ("\n\n".join(parts) + "\n").encode())


def replace_folder(fresh: Path, place: Path) -> None:
    """Put a folder in the place of another one."""
    shutil.rmtree(place, ignore_errors=True)
    fresh.chmod(0o755)
    fresh.rename(place)


def overview(reports: Mapping[str, Data]) -> str:
    """The total of each scene's error, a column for each of its parts, and what the bake took."""
    totals = {name: {row[0]: row[1] for row in rows_of(data, "split")} for name, data in reports.items()}
    found = dict.fromkeys(part for table in totals.values() for part in table)
    parts = [part for part in found if part not in SUMS]
    columns = (Column("scene"), Column("total", "share"), *(Column(part, "share") for part in parts))
    rows = [
        (name, table.get(TOTAL), *(table.get(part) for part in parts), bake_seconds(reports[name]))
        for name, table in totals.items()
        if table
    ]
    return markdown((*columns, Column(BAKE, "seconds")), rows)


def bake_seconds(data: Data) -> Cell:
    """What a report's light took, by its summary."""
    tables = [table_of(table) for table in section(data, "summary").get("tables", ())[:1]]
    cells = [dict(zip((each.name for each in table.columns), table.rows[0], strict=True)) for table in tables]
    return next((cell[BAKE] for cell in cells if BAKE in cell), None)


def measured_on(reports: Mapping[str, Data]) -> str:
    """The machine, and the sizes of the pictures."""
    data = next(iter(reports.values()))
    box, view = data["machine"], data["view"]
    size = f"{view['width']} × {view['height']} pixels"
    return f"Measured on {box['cores']} cores of {box['processor']} ({box['system']}), with pictures of {size}."


def missing(reports: Mapping[str, Data]) -> Iterator[str]:
    """What reports say that they lack."""
    lines = [f"- {name}: {note}" for name, data in reports.items() for note in data["notes"]]
    if lines:
        yield "Not measured:"
        yield "\n".join(lines)


def scores(reports: Mapping[str, Data]) -> Iterator[str]:
    """The score of each scene's frame, its plan, and what it took."""
    columns = (Column("scene"), Column("plan"), Column("bytes per texel", "count"), *columns_of(reports, "tracing"))
    rows = [
        (name, data["scene"]["plan"]["representation"], data["scene"]["plan"]["bytes_per_texel"], *found[0][1:])
        for name, data in reports.items()
        if (found := rows_of(data, "tracing"))
    ]
    yield "## Each scene's plan and its frame's scores"
    yield markdown(columns, rows)


def curves(
    reports: Mapping[str, Data], folders: Mapping[str, Path], names: Iterable[str], pictures: Path
) -> Iterator[str]:
    """Plots of error against run time."""
    yield "## Error against run time"
    for name in names:
        for i, plot in enumerate(section(reports[name], "convergence").get("plots", ())):
            file = copied(folders[name] / plot["svg"], pictures, f"{name}-curves-{i + 1}")
            yield f"![{name}: {plot['caption']}]({file})"
            yield f"*{name}: {', '.join(curve['name'] for curve in plot['curves'])}.*"


def shown(
    reports: Mapping[str, Data], folders: Mapping[str, Path], names: Iterable[str], pictures: Path
) -> Iterator[str]:
    """Frames, references and error maps side by side, twice as large as they are."""
    yield "## The frames, their references, and where they differ"
    for name in names:
        drawn, width = section(reports[name], "tracing").get("pictures", ()), 2 * reports[name]["view"]["width"]
        copies = [f"{name}-{i + 1}" for i in range(len(drawn))]
        files = [copied(folders[name] / each["png"], pictures, to) for each, to in zip(drawn, copies, strict=True)]
        if drawn:
            yield " ".join(
                image(file, f"{name}: {each['caption']}", width) for file, each in zip(files, drawn, strict=True)
            )
            yield f"*{name}: {', '.join(map(caption, drawn))}.*"


def image(file: str, text: str, width: int) -> str:
    """A picture in Markdown, so many pixels wide."""
    return f'<img src="{file}" width="{width}" alt="{text}">'


def caption(picture: Data) -> str:
    """A picture's caption, with the scale of its colours where it is an error map."""
    scale = picture.get("scale")
    return picture["caption"] + ("" if scale is None else f" (blue {100 * scale:g} % too dark, red too bright)")


def section(data: Data, key: str) -> Data:
    """A section of a report; an empty one where it was left out."""
    return next((each for each in data["sections"] if each["key"] == key), {})


def rows_of(data: Data, key: str) -> Sequence[Sequence[Any]]:
    """The rows of a section's first table; none where it was left out."""
    return next((table["rows"] for table in section(data, key).get("tables", ())), ())


def columns_of(reports: Mapping[str, Data], key: str) -> tuple[Column, ...]:
    """The columns of the first table of a section, but for the first column."""
    tables = (table for data in reports.values() for table in section(data, key).get("tables", ()))
    return next((table_of(table).columns[1:] for table in tables), ())


def markdown(columns: Sequence[Column], rows: Iterable[Sequence[Any]]) -> str:
    """A table in Markdown."""
    texts = told(Table("", tuple(columns), tuple(map(tuple, rows))))
    heads, rules = [column.head for column in texts], ["---:" if column.numeric else "---" for column in texts]
    lines = [heads, rules, *zip(*(column.cells for column in texts), strict=True)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def copied(path: Path, pictures: Path, name: str) -> str:
    """Copy a picture under a name of its own; where it is, from docs."""
    file = pictures / f"{name.lower().replace(' ', '-')}{path.suffix}"
    shutil.copyfile(path, file)
    return f"{PICTURES}/{file.name}"
