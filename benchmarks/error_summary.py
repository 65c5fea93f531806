"""docs/error.md: what a few reports found, in tables and pictures, from their ``report.json``."""

import json
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from isogi_core.report.sections import Column, Table
from server.report.cells import told
from server.report.documents import table_of

Data = Mapping[str, Any]

PICTURED = ("engine under grace at 70", "CT head under uffizi at 110", "MNI brain under grace at 90")
"""Reports that the summary shows pictures of."""

CURVES = ("engine under grace at 70", "engine under uffizi at 70", "engine under constant light at 70")
"""Reports that the summary shows the curves of error against run time of."""

INTRODUCTION = """\
# Error against run time

How wrong isogi's light is, by cause, and what it costs: a summary of the reports that `make reports` makes. \
`isogi report SCENE -o DIR` writes one such report, with everything that is left out here, for a scene of your own.

The reference of each view is path-traced from each pixel to the lights themselves, with as many bounces as may \
matter. Errors are of the luminance of surface pixels, over the reference's mean; the reference's own noise is taken \
off the relative RMSE. Each scene has an albedo of 0.7, is planned by isogi, and baked to its target error of 2 % \
a texel, which is of Monte Carlo noise alone. Seconds are of the processor, over all threads."""


def write_summary(docs: Path, folders: Mapping[str, Path]) -> None:
    """Write ``error.md`` and its pictures into ``docs``, from the reports in ``folders``, by their names."""
    reports = {name: json.loads((folder / "report.json").read_text("utf-8")) for name, folder in folders.items()}
    pictures = docs / "error"
    shutil.rmtree(pictures, ignore_errors=True)
    pictures.mkdir(parents=True)
    parts = [INTRODUCTION, measured_on(reports), *scores(reports), *split(reports)]
    parts += [*curves(reports, folders, pictures), *shown(reports, folders, pictures)]
    (docs / "error.md").write_text("\n\n".join(parts) + "\n", encoding="utf-8")


def measured_on(reports: Mapping[str, Data]) -> str:
    """The machine, and the sizes of the pictures."""
    data = next(iter(reports.values()))
    box, view = data["machine"], data["view"]
    size = f"{view['width']} × {view['height']} pixels"
    return f"Measured on {box['cores']} cores of {box['processor']} ({box['system']}), with pictures of {size}."


def scores(reports: Mapping[str, Data]) -> Iterator[str]:
    """The score of each scene's frame, its plan, and what it took."""
    columns = (Column("scene"), Column("plan"), Column("bytes per texel", "count"), *columns_of(reports, "tracing"))
    rows = [
        (name, data["scene"]["plan"]["representation"], data["scene"]["plan"]["bytes_per_texel"], *found[0][1:])
        for name, data in reports.items()
        if (found := rows_of(data, "tracing"))
    ]
    yield "## Each scene's frame against its reference"
    yield markdown(columns, rows)


def split(reports: Mapping[str, Data]) -> Iterator[str]:
    """The parts of each scene's error, a column a part."""
    tables = {name: {row[0]: row[1] for row in rows_of(data, "split")} for name, data in reports.items()}
    parts = list(dict.fromkeys(part for table in tables.values() for part in table))
    columns = (Column("scene"), *(Column(part, "share") for part in parts))
    yield "## Where the error comes from"
    yield (
        "Each part is the relative RMSE that is left when one ingredient alone gives way to its exact counterpart; a "
        "dash is a part that the scene's plan does not have."
    )
    yield markdown(columns, [(name, *(table.get(part) for part in parts)) for name, table in tables.items() if table])


def curves(reports: Mapping[str, Data], folders: Mapping[str, Path], pictures: Path) -> Iterator[str]:
    """Plots of error against run time."""
    yield "## Error against run time"
    for name in (name for name in CURVES if name in reports):
        for i, plot in enumerate(section(reports[name], "convergence").get("plots", ())):
            file = copied(folders[name] / plot["svg"], pictures, f"{name}-curves-{i + 1}")
            yield f"![{name}: {plot['caption']}]({file})"
            yield f"*{name}: {', '.join(curve['name'] for curve in plot['curves'])}.*"


def shown(reports: Mapping[str, Data], folders: Mapping[str, Path], pictures: Path) -> Iterator[str]:
    """Frames, references and error maps side by side."""
    yield "## The frames, their references, and where they differ"
    for name in (name for name in PICTURED if name in reports):
        drawn = section(reports[name], "tracing").get("pictures", ())
        names = [f"{name}-{i + 1}" for i in range(len(drawn))]
        files = [copied(folders[name] / each["png"], pictures, to) for each, to in zip(drawn, names, strict=True)]
        yield " ".join(map(image, files, [f"{name}: {each['caption']}" for each in drawn]))
        yield f"*{name}: {', '.join(map(caption, drawn))}.*"


def image(file: str, text: str) -> str:
    """A picture in Markdown, twice as large as it is."""
    return f'<img src="{file}" width="240" alt="{text}">'


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
    return f"{pictures.name}/{file.name}"
