"""docs/error.md: that it says what the reports' data say, with their pictures, and lives with what was left out."""

import re
from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.error_summary import write_summary
from benchmarks.reports import CURVED, PICTURED, SUBJECTS
from isogi_core.report.sections import Column, Section, Table
from server.report.bundle import write_report
from server.report.journal import Entry
from tests.server.report_samples import SHARE, report_of, sections

FULL, SHORT = "engine under grace at 70", "engine under uffizi at 70"


def measured() -> tuple[Section, ...]:
    """The samples, as the sections that the summary reads."""
    full = sections()[0]
    parts = Table("", (Column("part"), SHARE), (("noise", 0.01), ("parts together", 0.5), ("total, measured", 0.0971)))
    headline = Table("The frame", (SHARE, Column("bake", "seconds")), ((0.0971, 12.3),))
    told = {"tracing": full.tables[0], "split": parts, "summary": headline, "convergence": full.tables[0]}
    return tuple(replace(full, key=key, tables=(table,)) for key, table in told.items())


@pytest.fixture(scope="module")
def docs(small_scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A summary of two reports; the second one has no sections."""
    place = tmp_path_factory.mktemp("summary")
    for name, found in ((FULL, measured()), (SHORT, ())):
        (place / name).mkdir()
        notes = () if found else ("Stopped by hand.",)
        write_report(place / name, report_of(small_scene, [Entry(section, 1.0) for section in found], notes))
    (place / "docs" / "error").mkdir(parents=True)
    (place / "docs" / "error" / "former.png").touch()
    write_summary(place / "docs", {name: place / name for name in (FULL, SHORT)}, [FULL, SHORT], [FULL])
    return place / "docs"


def test_it_begins_with_the_parts_of_all_subjects(docs: Path) -> None:
    text = (docs / "error.md").read_text(encoding="utf-8").replace("\u00a0", " ")
    lines = [line for line in text.splitlines() if line]
    assert lines[2] == "| scene | total, % | noise, % | bake, s |"
    assert lines[4] == f"| {FULL} | 9.7 | 1.0 | 12.3 |"
    assert "`make reports`" in lines[5] and "24 × 24 pixels" in lines[5]
    assert lines[6:8] == ["Not measured:", f"- {SHORT}: Stopped by hand."]


def test_the_last_table_holds_the_scores(docs: Path) -> None:
    lines = (docs / "error.md").read_text(encoding="utf-8").replace("\u00a0", " ").splitlines()
    assert "| scene | plan | bytes per texel | relative RMSE, % | processor seconds, s |" in lines
    assert lines[-1].startswith(f"| {FULL} | transfer | ") and lines[-1].endswith(" | 9.7 | 12.3 |")
    assert not any(line.startswith(f"| {SHORT} ") for line in lines)


def test_every_picture_is_there_and_none_besides(docs: Path) -> None:
    text = (docs / "error.md").read_text(encoding="utf-8")
    named = re.findall(r'(?:src="|\]\()([^")]+)', text)
    assert len(named) == 6
    assert sorted(named) == sorted(
        path.relative_to(docs).as_posix() for path in docs.rglob("*.*") if path.parent != docs
    )
    assert "blue 5 % too dark, red too bright" in text
    assert text.count('width="48"') == 4, "twice as large"
    assert sorted(path.name for path in docs.iterdir()) == ["error", "error.md"]


def test_the_subjects_are_those_asked_for() -> None:
    named = {(subject.volume, subject.isovalue, subject.light) for subject in SUBJECTS}
    assert named >= {("engine", v, light) for v in (70, 170) for light in ("grace", "uffizi", "constant light")}
    assert {("CT head", 110), ("MNI brain", 90)} <= {(volume, isovalue) for volume, isovalue, _ in named}
    assert len({subject.folder for subject in SUBJECTS}) == len(SUBJECTS)
    assert {"engine", "CT head", "MNI brain"} == {subject.volume for subject in PICTURED}
    assert {"grace", "uffizi", "constant light"} == {subject.light for subject in CURVED}
