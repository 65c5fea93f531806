"""Each test is in a tier: the Makefile knows all markers, and folders that give a marker are
there.
"""

import re
import tomllib
from types import SimpleNamespace

import pytest

from tests.conftest import (
    FIXTURES,
    HERE,
    LONGEST,
    ROOMS,
    ROOT,
    markers_of,
    pytest_collection_modifyitems,
)

MAKEFILE = (ROOT / "Makefile").read_text(encoding="utf-8")
SOON = {"data", "journey", "light", "live", "smoke"}
"""Markers of tests that `make test` runs."""


def words_of(variable: str) -> set[str]:
    """The markers that a variable of the Makefile names."""
    found = re.search(rf"^{variable} := (.*)$", MAKEFILE, re.MULTILINE)
    assert found is not None
    return set(re.findall("[a-z0-9]+", found[1])) - {"and", "not", "or"}


def test_every_marker_is_in_a_tier() -> None:
    options = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"][
        "pytest"
    ]["ini_options"]
    markers = {line.partition(":")[0] for line in options["markers"]}
    assert words_of("LATE") | SOON == markers
    assert not words_of("LATE") & SOON
    assert set(ROOMS.values()) | set(FIXTURES.values()) <= markers


@pytest.mark.parametrize("room", ROOMS)
def test_folders_that_give_a_marker_hold_tests(room: str) -> None:
    assert list((HERE / room).rglob("test_*.py"))


def test_the_longest_files_are_there_and_run_first() -> None:
    assert [name for name in LONGEST if not (HERE / name).is_file()] == []
    files = ("test_tiers.py", LONGEST[1], "test_run.py", LONGEST[0])
    items = [SimpleNamespace(path=HERE / name, add_marker=lambda _: None) for name in files]
    pytest_collection_modifyitems(items)  # type: ignore[arg-type]
    assert [item.path.relative_to(HERE).as_posix() for item in items] == [
        *LONGEST[:2],
        "test_tiers.py",
        "test_run.py",
    ]


@pytest.mark.parametrize(
    ("file", "fixtures", "markers"),
    [
        ("frame/rays/test_any.py", [], {"light"}),
        ("frame/test_any.py", ["tmp_path", "live_server"], {"light", "live"}),
        ("server/api/guards/test_any.py", [], {"live"}),
        ("server/test_any.py", ["standard_s3"], {"s3"}),
        ("web/test_any.py", ["browser", "live_server"], {"browser", "live"}),
        ("test_any.py", ["tmp_path"], set()),
        ("server/api_of_others/test_any.py", [], set()),
    ],
)
def test_folder_and_fixtures_mark_a_test(file: str, fixtures: list[str], markers: set[str]) -> None:
    assert markers_of(SimpleNamespace(path=HERE / file, fixturenames=fixtures)) == markers  # type: ignore[arg-type]
