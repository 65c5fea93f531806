"""README and docs: every command runs as it stands, in the order of its page, beside the files that
pages name.

The address of the server is replaced, and the lines of ``ELSEWHERE`` are left out.
"""

import os
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.docs.pages import (
    ELSEWHERE,
    HERE,
    LONG,
    ROOT,
    Block,
    blocks_of,
    isogi_lines,
    lines_of,
    pages,
    write_files,
)
from tests.live import serving
from tests.server.cli.lines import parsed

TESTED = {"client.md": "tests/client/test_docs.py"}
"""Pages whose commands another test runs."""

PAGES = [page for page in pages() if blocks_of(page) and page.name not in TESTED]
SHORT = [
    page
    for page in PAGES
    if any(block.without(*ELSEWHERE, *LONG).lines for block in blocks_of(page))
]
SECONDS = 1800
SLOW = ("tutorial.md", "uploads.md", "python.md")
"""Pages whose commands take longer than those of all others together."""

by_page = pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
needs_tools = pytest.mark.skipif(
    not all(map(shutil.which, ("bash", "curl", "openssl"))), reason="needs bash, curl and openssl"
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the files that pages name."""
    folder = tmp_path_factory.mktemp("reader")
    write_files(folder)
    return folder


@pytest.fixture(scope="module")
def server(folder: Path) -> Iterator[str]:
    """The address of a server that shows engine.toml and takes uploads."""
    with serving(
        folder / "engine.toml", folder / "light", uploads_mb=64, uploads=str(folder / "uploads")
    ) as url:
        yield url


def run(block: Block, folder: Path, server: str) -> None:
    """Run a block as a reader does in ``make shell``; fails with the line that failed."""
    environment = os.environ | {
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        "ISOGI_STORE": str(folder / "light"),
    }
    if block.kind == "sh":
        program = ["bash", "-euxo", "pipefail", "-c"]
    else:
        program = ["python", "-c"]
    script = "\n".join(block.lines).replace(HERE, server)
    done = subprocess.run(
        [*program, script],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=SECONDS,
        check=False,
    )
    assert done.returncode == 0, f"{script}\n{done.stdout[-2000:]}\n{done.stderr[-4000:]}"


@needs_tools
@pytest.mark.slow
@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, id=page.name, marks=[pytest.mark.long] * (page.name in SLOW))
        for page in SHORT
    ],
)
def test_short_commands_run_in_the_order_of_their_page(
    page: Path, folder: Path, server: str
) -> None:
    for block in blocks_of(page):
        run(block.without(*ELSEWHERE, *LONG), folder, server)


@needs_tools
@pytest.mark.long
@by_page
def test_every_command_runs_in_the_order_of_its_page(page: Path, folder: Path, server: str) -> None:
    for block in blocks_of(page):
        run(block.without(*ELSEWHERE), folder, server)


@by_page
def test_isogi_takes_every_line_of_a_page(
    page: Path, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    for line in isogi_lines(page):
        parsed(line)


def test_lines_that_are_not_run_are_on_a_page() -> None:
    lines = [line for page in pages() for line in lines_of(page)]
    assert [
        start for start in (*ELSEWHERE, *LONG) if not any(line.startswith(start) for line in lines)
    ] == []
    assert all(TESTED.keys() & {page.name} or page in PAGES for page in pages() if blocks_of(page))


def test_make_has_the_targets_that_pages_name() -> None:
    makefile = (ROOT / "Makefile").read_text()
    text = "".join(
        page.read_text(encoding="utf-8") for page in (*pages(), ROOT / "CONTRIBUTING.md")
    )
    named = set(re.findall(r"(?:`|^)make ([a-z-]+)", text, re.MULTILINE))
    assert {"serve", "shell", "test"} <= named
    assert {name for name in named if not re.search(rf"^{name}:", makefile, re.MULTILINE)} == set()


def test_the_environment_has_what_pages_use() -> None:
    """Films need an FFmpeg, and Python on the pages the client's libraries."""
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"][
        "optional-dependencies"
    ]
    locked = set(
        re.findall(r"^([\w.-]+)==", (ROOT / "requirements.lock").read_text(), re.MULTILINE)
    )
    needed = {
        re.split(r"[<>=; ]", each)[0].lower()
        for name in ("client", "film", "report")
        for each in extras[name]
    }
    assert {"httpx", "imageio-ffmpeg"} <= needed
    assert needed - locked == set()


@pytest.mark.skipif(shutil.which("make") is None, reason="there is no make on this machine")
def test_make_shell_has_isogi_at_hand() -> None:
    """What is installed is left alone; the last command of the shell fails, which is no failure of
    make.
    """
    command = ["make", "--silent", "--old-file", "install", "shell"]
    environment = {**os.environ, "SHELL": "/bin/sh"}
    typed = "command -v isogi\ncommand -v python\nfalse\n"
    done = subprocess.run(
        command, cwd=ROOT, input=typed, capture_output=True, text=True, check=True, env=environment
    )
    assert done.stdout.splitlines()[1:] == [
        str(ROOT / ".venv" / "bin" / name) for name in ("isogi", "python")
    ]


def test_an_editable_install_stays_one() -> None:
    """An install of the folder without -e puts a copy in its place, whose kernels all compile
    again.
    """
    for page in (*pages(), ROOT / "CONTRIBUTING.md"):
        assert not re.search(
            r"pip install ['\"]?\.(\[|\s|`|$)", page.read_text(encoding="utf-8")
        ), page.name
