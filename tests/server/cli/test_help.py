"""Help: each command shows examples, and these are lines that it takes."""

from collections.abc import Iterator

import click
import pytest

from server.cli.command import cli, run
from server.cli.help import EXAMPLES
from tests.server.cli.lines import parsed

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
def test_the_help_of_a_command_ends_with_its_examples(capsys: pytest.CaptureFixture[str], path: str) -> None:
    assert run([*path.split(), "--help"]) == 0
    shown = capsys.readouterr().out.partition("\nExamples:\n")[2]
    assert [line in shown for line, _ in EXAMPLES[path]] == [True] * len(EXAMPLES[path])
