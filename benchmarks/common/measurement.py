"""A measurement: figures by stable names, as text, as JSON, and as a page in docs/measurements."""

import json
import subprocess
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from isogi_core.kernels.simd.types import RAY_WIDTH, REGISTER_LANES
from isogi_core.storage.atomic_file import write_whole
from isogi_report.heading import machine
from isogi_report.sections import plain

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "docs" / "measurements"

Figures = Mapping[str, Any]
"""Numbers, words or truth values by name. A figure keeps its name: pages that state it look it up
by that.
"""


@dataclass(frozen=True, eq=False)
class Measurement:
    """What a part of a suite has measured.

    ``text`` is Markdown; a table of the figures where it is empty. ``pictures`` are files by name,
    written beside the page. ``variant`` tells two measurements of one part apart. ``wrong`` says
    what must not be, if anything is.
    """

    title: str
    figures: Figures
    text: str = ""
    pictures: Mapping[str, bytes] = field(default_factory=dict)
    variant: str = ""
    wrong: str = ""

    @property
    def lines(self) -> str:
        """The figures for a terminal, one a line."""
        width = max(map(len, self.figures), default=0)
        return "\n".join(
            f"  {name:<{width}}  {shown(value)}" for name, value in self.figures.items()
        )

    @property
    def body(self) -> str:
        """What stands on its page, in Markdown."""
        return self.text or markdown(
            ("figure", "value"), ((name, shown(v)) for name, v in self.figures.items())
        )


def shown(value: Any) -> str:
    """A figure for a person."""
    if isinstance(value, float):
        return f"{value:.4g}"
    return str(value)


def markdown(head: Sequence[str], rows: Iterable[Sequence[str]], left: int = 1) -> str:
    """A table in Markdown; all columns but the ``left`` first ones hold numbers."""
    rule = ["---"] * left + ["---:"] * (len(head) - left)
    return "\n".join(f"| {' | '.join(line)} |" for line in (head, rule, *rows))


def merged(found: Sequence[Measurement]) -> Measurement:
    """One measurement of several: each is a section, and its figures have its title before their
    names.
    """
    if len(found) == 1:
        return found[0]
    figures = {
        f"{each.title}: {name}": value for each in found for name, value in each.figures.items()
    }
    text = "\n\n".join(f"## {each.title}\n\n{each.body}" for each in found)
    pictures = {name: data for each in found for name, data in each.pictures.items()}
    return Measurement(
        ", ".join(each.title for each in found), figures, text, pictures, found[0].variant
    )


def write_measurement(name: str, found: Measurement, command: str, folder: Path = FOLDER) -> Path:
    """Write ``NAME.md``, with commit, date, machine and command at its head, and ``NAME.json``; the
    page's path.

    Pictures go to a folder ``NAME`` beside them, and ``index.md`` lists all pages. Each file is
    whole or not there. Raises OSError; ValueError where a figure is no number, word or truth value.
    """
    facts = {
        "commit": commit(),
        "date": f"{datetime.now(UTC):%Y-%m-%d}",
        "machine": hardware(),
        "command": command,
    }
    figures = {key: checked(key, value) for key, value in plain(found.figures).items()}
    (folder / name if found.pictures else folder).mkdir(parents=True, exist_ok=True)
    for file, data in found.pictures.items():
        write_whole(folder / name / file, data)
    document = {"name": name, "title": found.title, **facts, "figures": figures}
    write_whole(
        folder / f"{name}.json",
        (json.dumps(document, indent=1, ensure_ascii=False) + "\n").encode(),
    )
    page = folder / f"{name}.md"
    write_whole(
        page, "\n".join([*front(facts), "", f"# {found.title}", "", found.body, ""]).encode()
    )
    write_whole(folder / "index.md", index_of(folder).encode())
    return page


INDEX = """\
# Measurements

Each page states its commit, date, machine and command. `python -m benchmarks.SUITE PART --write` \
writes a page, its figures as JSON, and this list; the suites are `speed`, `accuracy`, `service` \
and `scaling`. `--list` names the parts of a suite. These are the pages that README and guides \
quote: `make measurements` writes them all, and a release refuses pages that are too old for what \
they measure. Ratios compare only within one page: candidates take turns in one process.
"""


def index_of(folder: Path) -> str:
    """Return the text that lists the pages in ``folder``."""
    pages = [path for path in sorted(folder.glob("*.md")) if path.name != "index.md"]
    return f"{INDEX}\n{listed(pages)}"


def listed(pages: Iterable[Path]) -> str:
    """A table of measured pages with date and commit, from their front matter and titles."""
    rows = []
    for page in pages:
        lines = page.read_text(encoding="utf-8").splitlines()
        facts = dict(line.split(": ", 1) for line in lines[1 : lines.index("---", 1)])
        title = next(line.removeprefix("# ") for line in lines if line.startswith("# "))
        rows.append((f"[{page.stem}]({page.name})", title, facts["date"], facts["commit"]))
    return markdown(("page", "what", "date", "commit"), rows, left=4) + "\n"


def front(facts: Mapping[str, Any]) -> Iterator[str]:
    """The front matter of a page."""
    box = facts["machine"]
    if box["simd"]:
        simd = f"{box['simd']} lanes"
    else:
        simd = "no lanes"
    yield "---"
    yield f"commit: {facts['commit']}"
    yield f"date: {facts['date']}"
    yield f"machine: {box['processor']}, {box['cores']} cores, {simd}"
    yield f"command: {facts['command']}"
    yield "---"


def checked(name: str, value: Any) -> Any:
    """A figure as JSON has it; ValueError where a page could not state it."""
    if isinstance(value, dict | list):
        raise ValueError(f"The figure '{name}' is no number, word or truth value.")
    return value


def hardware() -> dict[str, Any]:
    """The processor, its cores, the system, and how many float32 lanes kernels use (0: none)."""
    return {**machine(), "simd": RAY_WIDTH if REGISTER_LANES else 0}


def commit() -> str:
    """The commit that is measured, "-dirty" where code differs from it; "unknown" outside a
    repository.
    """
    try:
        own = git("rev-parse", "--short=12", "HEAD")
        changed = git("status", "--porcelain", "--untracked-files=no", "--", ".", ":!docs")
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return f"{own}-dirty" if changed else own


def git(*arguments: str) -> str:
    """What git says of the repository; CalledProcessError where there is none."""
    done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=True)
    return done.stdout.strip()
