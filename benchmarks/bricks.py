"""A lattice that is fine where it is needed: ``report.bricks`` on real volumes, as docs/accuracy-lattice.md tells it.

``python -m benchmarks.bricks [--size 96] [--only 'engine under grace'] [-o FOLDER]``; references are kept in FOLDER.
Needs the shared data.
"""

from pathlib import Path

import click

from benchmarks.interpolation import ENGINES, PROBES, tell
from isogi_core.report import bricks
from isogi_core.report.sections import Cell, Column, Section, Table

SUBJECTS = (ENGINES[0], *PROBES)


@click.command()
@click.option("-o", "--output", type=click.Path(path_type=Path, file_okay=False), help="Where references are kept.")
@click.option("--size", type=click.IntRange(8, 512), default=96, show_default=True, help="Pixels along each side.")
@click.option("--only", multiple=True, help="Part of a subject's name, such as 'engine under grace'; repeatable.")
def main(output: Path | None, size: int, only: tuple[str, ...]) -> None:
    """Print tables in Markdown for each subject."""
    tell(SUBJECTS, bricks.study, tables_of, output, size, only)


def tables_of(name: str, section: Section) -> str:
    """A section's tables as Markdown, each under its caption."""
    return "\n".join([f"## {name}\n", *(f"{table.caption}:\n\n{markdown(table)}\n" for table in section.tables)])


def markdown(table: Table) -> str:
    """One table."""
    head = "| " + " | ".join(title(column) for column in table.columns) + " |"
    rule = "| --- |" + " ---: |" * (len(table.columns) - 1)
    rows = [
        "| " + " | ".join(text(cell, column) for cell, column in zip(row, table.columns, strict=True)) + " |"
        for row in table.rows
    ]
    return "\n".join([head, rule, *rows])


def title(column: Column) -> str:
    """What stands above a column: shares are told in per cent."""
    return f"{column.name}, %" if column.unit == "share" else column.name


def text(cell: Cell, column: Column) -> str:
    """A cell as it is printed."""
    if cell is None or isinstance(cell, str):
        return cell or "–"
    return f"{100.0 * cell:.2f}" if column.unit == "share" else f"{cell:,.4g}" if cell < 1e4 else f"{cell:,.0f}"


if __name__ == "__main__":
    main()
