"""The architecture page and the README say what is true: files, functions, the picture, and
measured figures.
"""

import ast
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs" / "architecture.md"
README = ROOT / "README.md"
LONGEST = {"An isovalue": 12, "A coefficient": 9}
"""How many files each journey may pass."""

STOP = re.compile(r"^\d+\. `([^`]+)` `([^`]+)`", re.MULTILINE)
ROW = re.compile(r"^\| (.+?) \| `([^`]+)` `([^`]+)` \| (.*) \|$", re.MULTILINE)
FIGURE = re.compile(r"^\| .* \| ([^|]+) \| \[([\w-]+)\]\([^)]+\): `([^`]+)` \|$", re.MULTILINE)


def section(title: str) -> str:
    text = PAGE.read_text(encoding="utf-8")
    assert f"### {title}" in text
    return re.split(r"\n#", text.partition(f"### {title}")[2])[0]


def names_in(path: Path) -> set[str]:
    """Functions and classes that a module defines, methods as ``Class.method``."""
    found = set()
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            found.add(node.name)
        if isinstance(node, ast.ClassDef):
            found |= {
                f"{node.name}.{each.name}"
                for each in node.body
                if isinstance(each, ast.FunctionDef | ast.AsyncFunctionDef)
            }
    return found


@pytest.mark.parametrize("title", LONGEST)
def test_a_journey_is_short_and_turns_back_nowhere(title: str) -> None:
    files = [file for file, _ in STOP.findall(section(title))]
    assert 5 <= len(files) <= LONGEST[title]
    assert len(set(files)) == len(files)


@pytest.mark.parametrize("title", LONGEST)
def test_a_journey_names_functions_that_are_there(title: str) -> None:
    missing = [
        (file, name)
        for file, name in STOP.findall(section(title))
        if name not in names_in(ROOT / file)
    ]
    assert missing == []


def rows_of(text: str) -> list[tuple[str, str, list[str]]]:
    """The rows of the table "Where is …?": a file, the name to begin at, and the files that it
    works with.
    """
    table = text.partition("## Where is")[2]
    return [
        (file, name, re.findall(r"`([^`]+)`", more)) for _, file, name, more in ROW.findall(table)
    ]


def defines(path: Path, name: str) -> bool:
    """Whether a Python module or a module of the page defines a name."""
    if path.suffix == ".py":
        return name in names_in(path)
    return (
        re.search(
            rf"^export (class|function|const) {name}\b", path.read_text(encoding="utf-8"), re.M
        )
        is not None
    )


def not_there(text: str) -> list[str]:
    """What the table names that is not in the repository."""
    files = [
        file
        for first, _, more in rows_of(text)
        for file in (first, *more)
        if not (ROOT / file).is_file()
    ]
    names = [(file, name) for file, name, _ in rows_of(text) if file not in files]
    return files + [f"{file} {name}" for file, name in names if not defines(ROOT / file, name)]


def test_the_table_leads_to_files_and_names_that_are_there() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert len(rows_of(text)) == text.partition("## Where is")[2].count("\n| ") - 1 >= 40
    assert not_there(text) == []


def test_the_search_of_the_table_finds_what_is_not_there() -> None:
    text = (
        "## Where is …?\n| a | `worker/isogi_worker/queue.py` `Nothing` | `no/file.py` |\n| b | "
        "`web/isogi_web/live/live.js` `Live` |  |\n"
    )
    assert not_there(text) == ["no/file.py", "worker/isogi_worker/queue.py Nothing"]


def test_the_page_names_files_that_are_there() -> None:
    named = re.findall(r"`([\w./-]+/[\w.-]+\.(?:py|js|md|toml))`", PAGE.read_text(encoding="utf-8"))
    assert len(named) > 20
    assert [name for name in named if not (ROOT / name).is_file()] == []


@pytest.mark.parametrize(
    ("program", "made", "kept"),
    [
        ("draw_architecture", "picture()", "PICTURE"),
        ("write_path_kernels", "page()", "PAGE"),
    ],
)
def test_what_a_program_writes_is_of_this_source(program: str, made: str, kept: str) -> None:
    compare = f"import {program} as d; print(d.{made} == d.{kept}.read_text())"
    command = [sys.executable, "-c", compare]
    done = subprocess.run(command, cwd=ROOT / "docs", capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "True", f"run: python docs/{program}.py"


def stated(text: str) -> list[tuple[str, str, str]]:
    """The figures in the README's tables: what it states, the measurement, and the figure's
    name.
    """
    return [(value.strip(), name, figure) for value, name, figure in FIGURE.findall(text)]


def is_measured(value: str, name: str, figure: str) -> bool:
    """Whether a figure, as it is stated, is the measured one rounded to as many digits."""
    found = json.loads(
        (ROOT / "docs" / "measurements" / f"{name}.json").read_text(encoding="utf-8")
    )["figures"][figure]
    number = re.match(r"[\d.]+", value)
    assert number, value
    digits = len(number[0].partition(".")[2])
    return float(number[0]) == pytest.approx(round(float(found), digits))


def test_the_readme_states_measured_figures() -> None:
    figures = stated(README.read_text(encoding="utf-8"))
    assert len(figures) >= 4
    assert [each for each in figures if not is_measured(*each)] == []


def test_a_figure_that_was_not_measured_is_found() -> None:
    value, name, figure = stated(README.read_text(encoding="utf-8"))[0]
    assert not is_measured(f"9{value}", name, figure)
