"""Write the table of the kernels of paths into the architecture page: ``python
docs/write_path_kernels.py``.

A row is a record of what rays meet, a column one of the light that paths gather; both select the
kernel, by ``PATH_KERNELS``.
"""

from pathlib import Path

from isogi_core.kernels.transport.entries import PATH_KERNELS

PAGE = Path(__file__).resolve().parent / "architecture.md"

FIRST = "rays meet"
"""The first cell of the table."""


def table() -> str:
    """Return the table."""
    gathered = list(dict.fromkeys(gathers for _, gathers in PATH_KERNELS))
    rows = [row(FIRST, *(f"`{gathers.__name__}`" for gathers in gathered))]
    rows.append("|---" * (1 + len(gathered)) + "|")
    for meets in dict.fromkeys(meets for meets, _ in PATH_KERNELS):
        kernels = (PATH_KERNELS.get((meets, gathers)) for gathers in gathered)
        names = (f"`{kernel.__name__}`" if kernel else "" for kernel in kernels)
        rows.append(row(f"`{meets.__name__}`", *names))
    return "\n".join(rows)


def row(*cells: str) -> str:
    """Return a row of these ``cells``."""
    return f"| {' | '.join(cells)} |"


def page() -> str:
    """Return the text of the page, with the table as it is now."""
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(f"| {FIRST} |")
    _, end, after = rest.partition("\n\n")
    return f"{before}{table()}{end}{after}"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
