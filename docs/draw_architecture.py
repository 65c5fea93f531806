"""Draw the rooms of the code and the two journeys through them: ``python
docs/draw_architecture.py``.

Rooms and their order come from the import contracts in ``pyproject.toml``, what they hold from the
packages, and the journeys from the numbered lists in ``docs/architecture.md``. Writes
``docs/architecture.svg``.
"""

import ast
import re
import tomllib
from collections.abc import Iterator
from html import escape
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "architecture.md"
PICTURE = ROOT / "docs" / "architecture.svg"

WIDTH = 1060
ROW = 46
GAP = 8
LEFT = 24
"""Pixels: the picture's width, a room's height, what is between rooms, and the margin."""

JOURNEYS = {"An isovalue": "#c2410c", "A coefficient": "#1d4ed8"}
"""Headings of the journeys, and the colours of their dots."""

STYLE = """text { font: 13px system-ui, sans-serif; fill: #1f2937 }
.name { font-weight: 600 } .about { fill: #4b5563 }
.package { font-size: 15px; font-weight: 700 }
.dot { font-size: 11px; font-weight: 700; fill: #fff; text-anchor: middle }"""


class Room(NamedTuple):
    """A room: its path from the root, what its first sentence says, and how many modules it has."""

    path: str
    about: str
    modules: int


def folder_of(package: str) -> Path:
    """The folder of a package: at the top, or in the folder of its part."""
    places = [ROOT / package, *(ROOT / part / package for part in ("server", "worker", "web"))]
    return next(place for place in places if place.is_dir())


def rooms_of(package: str) -> Iterator[Room]:
    """The rooms of a package, highest first, as its contract lists them; small modules at its
    bottom are left out.
    """
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"][
        "importlinter"
    ]["contracts"]
    (layers,) = [each["layers"] for each in contracts if each.get("containers") == [package]]
    for name in re.findall(r"\w+", " ".join(layers)):
        folder = folder_of(package) / name
        if folder.is_dir():
            yield Room(
                str(folder.relative_to(ROOT)),
                first_sentence(folder / "__init__.py"),
                len(list(folder.rglob("*.py"))),
            )


def first_sentence(path: Path) -> str:
    """The first line of a module's docstring, without its full stop."""
    text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    return text.split("\n")[0].rstrip(".").replace("``", "")


def journey(title: str) -> list[str]:
    """The files of a journey, in order: the numbered list under its heading."""
    _, _, rest = PAGE.read_text(encoding="utf-8").partition(f"### {title}")
    section = re.split(r"\n#", rest)[0]
    return re.findall(r"^\d+\. `([^`]+)`", section, re.MULTILINE)


def stops(room: Room) -> Iterator[tuple[int, str]]:
    """The numbers and colours of journeys' stops in a room."""
    for title, colour in JOURNEYS.items():
        for number, file in enumerate(journey(title), 1):
            if file.startswith(room.path + "/"):
                yield number, colour


def band(y: int, title: str, note: str, rooms: list[Room]) -> tuple[int, list[str]]:
    """A package as a heading and its rooms, from the height ``y`` down: where it ends, and its
    parts.
    """
    parts = [f'<text class="package" x="{LEFT}" y="{y + 14}">{escape(title)}</text>']
    parts.append(f'<text class="about" x="{LEFT + 130}" y="{y + 14}">{escape(note)}</text>')
    y += 24
    for room in rooms:
        parts += drawn(y, room)
        y += ROW + GAP
    return y + 14, parts


def drawn(y: int, room: Room) -> Iterator[str]:
    """A room as a box with its name, its sentence, its size and the journeys' stops in it."""
    yield (
        f'<rect x="{LEFT}" y="{y}" width="{WIDTH - 2 * LEFT}" height="{ROW}" rx="6" '
        'fill="#fff" stroke="#9ca3af"/>'
    )
    if room.modules != 1:
        size = f"{room.modules} modules"
    else:
        size = "1 module"
    yield (
        f'<text class="name" x="{LEFT + 12}" y="{y + 19}">{room.path}/ <tspan '
        f'class="about">{size}</tspan></text>'
    )
    yield f'<text class="about" x="{LEFT + 12}" y="{y + 37}">{escape(room.about)}</text>'
    for place, (number, colour) in enumerate(reversed(list(stops(room)))):
        x = WIDTH - LEFT - 20 - 26 * place
        yield f'<circle cx="{x}" cy="{y + 15}" r="11" fill="{colour}"/>'
        yield f'<text class="dot" x="{x}" y="{y + 19}">{number}</text>'


def picture() -> str:
    """The whole picture as SVG."""
    y = 16
    parts = []
    for title, note, rooms in (
        ("isogi_report", "imports all others", [alone("isogi_report")]),
        (
            "server",
            "imports isogi_worker and isogi_core; each room imports only rooms below it",
            list(rooms_of("isogi_server")),
        ),
        ("worker", "imports isogi_core", [alone("isogi_worker")]),
        (
            "isogi_core",
            "knows no web framework, no scheduler and no picture format",
            list(rooms_of("isogi_core")),
        ),
    ):
        y, more = band(y, title, note, rooms)
        parts += more
    legend = "   ".join(title for title in JOURNEYS)
    for place, (title, colour) in enumerate(JOURNEYS.items()):
        x = LEFT + 10 + 190 * place
        parts.append(
            f'<circle cx="{x}" cy="{y}" r="8" fill="{colour}"/><text x="{x + 16}" '
            f'y="{y + 4}">{title}</text>'
        )
    parts.append(
        f'<text class="about" x="{LEFT + 410}" y="{y + 4}">The page in web/ speaks only the '
        "HTTP API.</text>"
    )
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {y + 24}" role="img" '
        f'aria-label="{legend}">'
    )
    ground = f'<rect width="{WIDTH}" height="{y + 24}" fill="#f9fafb"/>'
    return "\n".join([head, f"<style>{STYLE}</style>", ground, *parts, "</svg>\n"])


def alone(package: str) -> Room:
    """A package that is one room."""
    folder = folder_of(package)
    return Room(
        str(folder.relative_to(ROOT)),
        first_sentence(folder / "__init__.py"),
        len(list(folder.rglob("*.py"))),
    )


if __name__ == "__main__":
    PICTURE.write_text(picture(), encoding="utf-8")
