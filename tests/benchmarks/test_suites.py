"""Suites: what a part prints and writes, and that a page's figures can be looked up by their
names.
"""

import json
import re
from collections.abc import Iterator
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from benchmarks.accuracy.__main__ import main as accuracy
from benchmarks.common import measurement
from benchmarks.common import suite as suites
from benchmarks.common.measurement import FOLDER, Measurement, index_of, merged, write_measurement
from benchmarks.common.suite import part, suite
from benchmarks.scaling.__main__ import main as scaling
from benchmarks.service.__main__ import main as service
from benchmarks.speed.__main__ import main as speed

SUITES = {"speed": speed, "accuracy": accuracy, "service": service, "scaling": scaling}


@part(size=8)
@click.argument("target", required=False)
@click.option("--deep", is_flag=True)
@click.option("-o", "--output", type=click.Path())
def halves(target: str | None, deep: bool, output: str | None, size: int) -> Measurement:
    """Half of a size."""
    return Measurement(f"{target} halved", {"half": size / 2, "deep": deep}, variant="deep" * deep)


@part()
def pairs() -> Iterator[Measurement]:
    """Two measurements, of which the second one fails."""
    yield Measurement("one", {"value": 1})
    yield Measurement("two", {"value": 2}, wrong="Two is too many.")


MAIN = suite("Halves and pairs.", halves, pairs)


@pytest.fixture
def folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """Where measurements are written; the test's parts count as parts of the suite "speed"."""
    monkeypatch.setattr(
        suites,
        "write_measurement",
        lambda name, found, command: write_measurement(name, found, command, tmp_path),
    )
    return tmp_path


def run(*arguments: str) -> tuple[int, str]:
    done = CliRunner().invoke(MAIN, list(arguments))
    assert done.exception is None or isinstance(done.exception, SystemExit)
    return done.exit_code, done.stdout


def test_a_part_prints_its_figures_as_lines_or_as_json(folder: Path) -> None:
    assert run("halves", "cube", "--size", "6", "--json") == (0, '{"half": 3.0, "deep": false}\n')
    assert run("halves", "cube", "--size", "6") == (0, "\ncube halved\n  half  3\n  deep  False\n")
    assert list(folder.iterdir()) == [], "nothing is written unless it is asked for"


def test_write_makes_a_page_and_its_figures(folder: Path) -> None:
    secret = folder / "somewhere" / "a cube.toml"
    assert run("halves", str(secret), "--deep", "-o", str(folder), "--size", "6", "--write")[0] == 0
    (name,) = {path.stem for path in folder.iterdir() if path.name != "index.md"}
    assert name.endswith("-halves-deep")
    data = json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))
    assert data["figures"] == {"half": 3.0, "deep": True} and data["name"] == name
    assert data["command"].endswith(" halves 'a cube.toml' --size 6 --deep"), (
        "without paths and without --write"
    )
    assert (
        data["machine"]["cores"] >= 1
        and data["machine"]["simd"] >= 0
        and data["machine"]["processor"]
    )
    lines = (folder / f"{name}.md").read_text(encoding="utf-8").splitlines()
    assert [line.partition(":")[0] for line in lines[:6]] == [
        "---",
        "commit",
        "date",
        "machine",
        "command",
        "---",
    ]
    assert lines[1] == f"commit: {data['commit']}" and re.fullmatch(
        r"date: \d{4}-\d\d-\d\d", lines[2]
    )
    assert lines[7] == f"# {data['title']}" and "| half | 3 |" in lines


def test_several_measurements_are_sections_of_one_page(folder: Path) -> None:
    code, out = run("pairs", "--write", "--json")
    assert (code, [json.loads(line) for line in out.splitlines()]) == (
        1,
        [{"value": 1}, {"value": 2}],
    )
    (file,) = folder.glob("*.json")
    assert json.loads(file.read_text(encoding="utf-8"))["figures"] == {
        "one: value": 1,
        "two: value": 2,
    }
    assert "## two\n" in file.with_suffix(".md").read_text(encoding="utf-8")


def test_a_suite_runs_all_parts_and_fails_where_one_does(folder: Path) -> None:
    code, out = run("--json")
    assert (code, len(out.splitlines())) == (1, 3)


def test_pictures_lie_beside_the_page(tmp_path: Path) -> None:
    found = Measurement("drawn", {"n": 1}, "![it](speed-drawn/it.png)", {"it.png": b"\x89PNG"})
    page = write_measurement("speed-drawn", found, "python", tmp_path)
    assert (page.with_suffix("") / "it.png").read_bytes() == b"\x89PNG"
    assert "![it]" in page.read_text(encoding="utf-8")
    assert merged([found]) is found


def test_the_list_of_measurements_has_each_page(tmp_path: Path) -> None:
    write_measurement("speed-x", Measurement("new figures", {"n": 1}), "python", tmp_path)
    listed = (tmp_path / "index.md").read_text(encoding="utf-8")
    assert "| [speed-x](speed-x.md) | new figures | 20" in listed
    assert listed == index_of(tmp_path)


def test_the_list_of_measurements_is_up_to_date() -> None:
    """Where it fails: any ``--write`` makes the list anew."""
    assert (FOLDER / "index.md").read_text(encoding="utf-8") == index_of(FOLDER)


@pytest.mark.parametrize("value", [[1, 2], {"a": 1}])
def test_a_figure_is_one_value(value: object, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="'many' is no number"):
        write_measurement("speed-x", Measurement("x", {"many": value}), "python", tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_outside_a_repository_the_commit_is_unknown(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    assert re.fullmatch(r"[0-9a-f]{12,}(-dirty)?", measurement.commit())
    monkeypatch.setattr(measurement, "ROOT", tmp_path)
    assert measurement.commit() == "unknown"


@pytest.mark.parametrize("name", SUITES)
def test_each_suite_lists_parts_that_know_json_and_write(name: str) -> None:
    made = SUITES[name]
    listed = [line.split()[0] for line in CliRunner().invoke(made, ["--list"]).stdout.splitlines()]
    assert listed == list(made.commands) and len(listed) > 4
    for each in made.commands.values():
        assert each.help and {"as_json", "write"} <= {parameter.name for parameter in each.params}
        assert each.callback is not None and each.callback.__module__.startswith(
            f"benchmarks.{name}."
        )


def test_a_part_has_one_name_with_dashes_or_underscores() -> None:
    assert (
        CliRunner()
        .invoke(speed, ["first_view", "--help"])
        .stdout.endswith(
            CliRunner().invoke(speed, ["first-view", "--help"]).stdout.partition("\n")[2]
        )
    )
    assert CliRunner().invoke(speed, ["third-view"]).exit_code == 2
