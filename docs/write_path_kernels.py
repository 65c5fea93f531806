"""Write the table of the kernels of paths into the architecture page: ``python
docs/write_path_kernels.py``.

Each row is an entry of ``PATH_KERNELS``: the record of what rays meet, that of the light which
paths gather, and the kernel that both select.
"""

import re
from inspect import getdoc
from pathlib import Path

from isogi_core.kernels.transport.entries import PATH_KERNELS

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "architecture.md"

BEGIN = "<!-- python docs/write_path_kernels.py writes this table -->"
END = "<!-- end of the table -->"

HEADER = ("| rays meet | gathered light | kernel |", "|---|---|---|")


def table() -> str:
    """Return the table, between its marks."""
    rows = []
    for (meets, gathers), kernel in PATH_KERNELS.items():
        module, _, name = kernel.name.rpartition(".")
        file = f"{module.replace('.', '/')}.py"
        rows.append(f"| {explained(meets)} | {explained(gathers)} | `{file}` `{name}` |")
    return "\n".join([BEGIN, "", *HEADER, *rows, "", END])


def explained(record: type) -> str:
    """Return the name of a ``record``, with the first sentence of its docstring."""
    text = " ".join((getdoc(record) or "").split())
    sentence = re.split(r"[.;] |\.$", text)[0].replace("``", "`")
    return f"`{record.__name__}`: {sentence[0].lower()}{sentence[1:]}"


def page() -> str:
    """Return the text of the page, with the table as it is now."""
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(BEGIN)
    _, _, after = rest.partition(END)
    return f"{before}{table()}{after}"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
