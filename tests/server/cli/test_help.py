"""Help: one list of settings, options and documentation; each command shows examples, which it
takes.
"""

from collections.abc import Iterator
from pathlib import Path

import click
import pytest

from isogi_server.cli.command import cli, run
from isogi_server.cli.help import EXAMPLES, group_of
from isogi_server.cli.setting_options import flag, rows, variable
from isogi_server.settings import Settings
from tests.server.cli.lines import parsed

DOCUMENT = Path(__file__).resolve().parents[3] / "docs" / "settings.md"


def test_the_help_lists_every_setting(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["serve", "--help"]) == 0
    words = capsys.readouterr().out.replace("[", " ").replace("]", " ").split()
    for name in Settings.model_fields:
        assert variable(name) in words
        assert (flag(name) in words) is (name != "token"), "a secret is no option"
    assert "--config" in words


def test_only_where_to_listen_is_in_no_group() -> None:
    """Where it fails: a new setting belongs into a group of ``isogi_server.cli.help``."""
    ungrouped = [name for name in Settings.model_fields if group_of(name) == group_of("host")]
    assert ungrouped == ["host", "port", "token"]


def test_the_document_has_a_row_for_each_setting() -> None:
    """Where it fails: the rows of docs/settings.md are those that
    ``isogi_server.cli.setting_options.rows`` gives.
    """
    lines = DOCUMENT.read_text(encoding="utf-8").splitlines()
    assert [line for line in lines if "`ISOGI_" in line and line.startswith("| ")] == rows()


LINES = [(path, line) for path, rows in EXAMPLES.items() for line, _ in rows]


def paths(command: click.Command, words: tuple[str, ...] = ()) -> Iterator[str]:
    """Every command by its words after ``isogi``."""
    yield " ".join(words)
    for name, each in getattr(command, "commands", {}).items():
        yield from paths(each, (*words, name))


def test_every_command_has_examples() -> None:
    assert list(EXAMPLES) and set(EXAMPLES) == set(paths(cli))


@pytest.mark.parametrize(("path", "line"), LINES, ids=[line for _, line in LINES])
def test_an_example_is_a_line_that_its_command_takes(path: str, line: str) -> None:
    context = parsed(line)
    assert path in ("", "store") or context.command_path == f"isogi {path}".rstrip()


def test_an_example_that_is_misspelt_would_be_seen() -> None:
    with pytest.raises(click.UsageError, match="azimut"):
        parsed("isogi render engine.nhdr -o a.png --azimut 40")


@pytest.mark.parametrize("path", EXAMPLES)
def test_the_help_of_a_command_ends_with_its_examples(
    capsys: pytest.CaptureFixture[str], path: str
) -> None:
    assert run([*path.split(), "--help"]) == 0
    shown = capsys.readouterr().out.partition("\nExamples:\n")[2]
    assert [line in shown for line, _ in EXAMPLES[path]] == [True] * len(EXAMPLES[path])
