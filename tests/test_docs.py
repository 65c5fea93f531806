"""The documentation: every page is in the index, links lead somewhere, and files that pages name
are there.
"""

import re
import subprocess
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
MEASUREMENTS = DOCS / "measurements"
PAGES = [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")] + sorted(
    DOCS.rglob("*.md")
)

LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)|<img src=\"([^\"]+)\"")
CODE = re.compile(r"```.*?```", re.DOTALL)
LONGEST_ENTRY = 40
"""Words of a change."""

TICKED = re.compile(r"`([^`\s]+)`")


def links(text: str) -> Iterator[str]:
    """Where a page's links and pictures lead, but for addresses elsewhere."""
    for link, picture in LINK.findall(CODE.sub("", text)):
        if not re.match(r"[a-z]+:", link or picture):
            yield link or picture


def anchors(text: str) -> set[str]:
    """What a page's headings are called in links, as GitHub does it."""
    heads = re.findall(r"^#+ (.*)$", CODE.sub("", text), re.M)
    return {re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") for head in heads}


def broken(page: Path, text: str) -> Iterator[str]:
    """Links of a page to a file, or to a heading of it, that is not there."""
    for link in links(text):
        path, _, anchor = link.partition("#")
        target = page.parent / path if path else page
        if not target.exists() or (
            anchor and anchor not in anchors(target.read_text(encoding="utf-8"))
        ):
            yield link


@cache
def tracked() -> frozenset[str]:
    """Every file of the repository, and its folders."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    files = [Path(line) for line in listed.stdout.splitlines() if (ROOT / line).exists()]
    return frozenset(str(each) for file in files for each in (file, *file.parents))


def missing(text: str) -> Iterator[str]:
    """Paths in backticks that lead into a folder of the repository, and modules, that are not
    there.
    """
    folders = {path for path in tracked() if "/" not in path and (ROOT / path).is_dir()}
    names = {Path(path).name for path in tracked()}
    for word in TICKED.findall(CODE.sub("", text)):
        inside = (
            "/" in word and word.partition("/")[0] in folders and re.fullmatch(r"[\w./-]+", word)
        )
        if (inside and word.rstrip("/") not in tracked()) or (
            re.fullmatch(r"\w+\.py", word) and word not in names
        ):
            yield word


def test_the_index_links_every_page() -> None:
    listed = set(links((DOCS / "index.md").read_text(encoding="utf-8")))
    assert {path.name for path in DOCS.glob("*.md")} - {"index.md"} <= listed
    assert "measurements/index.md" in listed


def test_the_list_of_measurements_links_every_page() -> None:
    listed = set(links((MEASUREMENTS / "index.md").read_text(encoding="utf-8")))
    assert {path.name for path in MEASUREMENTS.glob("*.md")} - {"index.md"} == listed


def test_pages_that_explain_are_short() -> None:
    scene = set(links((DOCS / "scene.md").read_text(encoding="utf-8")))
    listed = {"scene.md", "lights.md", "colours.md", "rooms.md", "surfaces.md", "materials.md"}
    assert listed - {"scene.md"} <= scene
    explaining = listed | {"architecture.md", "concepts.md", "tutorial.md"}
    words = {name: len((DOCS / name).read_text(encoding="utf-8").split()) for name in explaining}
    assert {name: count for name, count in words.items() if count > 1500} == {}


def test_relative_links_resolve() -> None:
    wrong = {
        path.name: found
        for path in PAGES
        if (found := list(broken(path, path.read_text(encoding="utf-8"))))
    }
    assert wrong == {}


def test_files_in_backticks_exist() -> None:
    wrong = {
        path.name: found
        for path in PAGES
        if (found := list(missing(path.read_text(encoding="utf-8"))))
    }
    assert wrong == {}


def test_pages_that_code_names_exist() -> None:
    sources = [
        ROOT / path
        for path in tracked()
        if Path(path).suffix in (".py", ".yml") or path == "Makefile"
    ]
    named = {
        name
        for path in sources
        for name in re.findall(r"\bdocs/[\w/-]+\.md\b", path.read_text(encoding="utf-8"))
    }
    assert "docs/cluster.md" in named
    assert named - tracked() == set()


def test_pictures_in_docs_are_shown_somewhere() -> None:
    shown = {
        (path.parent / link).resolve()
        for path in PAGES
        for link in links(path.read_text(encoding="utf-8"))
    }
    pictures = [path for suffix in ("*.png", "*.svg") for path in DOCS.rglob(suffix)]
    assert {path.name for path in pictures if path.resolve() not in shown} == set()


def bold(name: str) -> set[str]:
    """The bold words of a page, in the singular."""
    found = re.findall(r"\*\*([^*]+)\*\*", (DOCS / name).read_text(encoding="utf-8"))
    return {re.sub(r"(?<=[^s])s$", "", word.strip(".").lower()) for word in found}


def test_the_glossary_has_the_words_of_the_concepts() -> None:
    assert len(bold("concepts.md")) > 20
    assert bold("concepts.md") - bold("glossary.md") == set()


def long_entries(text: str) -> list[str]:
    """Lines of a list that take more words than a change does."""
    return [
        line
        for line in text.splitlines()
        if line.startswith("- ") and len(line.split()) > LONGEST_ENTRY + 1
    ]


def test_entries_of_the_changelog_say_one_change() -> None:
    assert long_entries((ROOT / "CHANGELOG.md").read_text(encoding="utf-8")) == []
    assert long_entries(f"- {'word ' * LONGEST_ENTRY}\n- {'word ' * (LONGEST_ENTRY + 1)}") != []


def test_changes_are_files_of_one_line_and_a_known_kind() -> None:
    config = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"][
        "towncrier"
    ]
    kinds = {kind["directory"] for kind in config["type"]}
    assert config["start_string"] in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    for path in sorted((ROOT / config["directory"]).glob("*.md")):
        if path.name != "README.md":
            assert re.fullmatch(rf"[\w-]+\.({'|'.join(kinds)})\.md", path.name), path.name
            text = path.read_text(encoding="utf-8").strip()
            assert "\n" not in text and 0 < len(text.split()) <= LONGEST_ENTRY, path.name


def test_the_search_finds_what_is_wrong() -> None:
    text = (
        "# One `two`\n[a](no.md) [b](#one-two) [c](#three) "
        "![d](http://a/b.png)\n`tests/no.py` `no_module.py`"
    )
    page = DOCS / "page.md"
    assert list(links(text)) == ["no.md", "#one-two", "#three"]
    assert anchors(text) == {"one-two"}
    assert list(broken(page, text.replace("#one-two", "#move-about"))) == ["no.md", "#three"]
    assert list(missing(text)) == ["tests/no.py", "no_module.py"]
