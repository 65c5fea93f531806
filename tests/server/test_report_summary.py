"""docs/error.md: that it says what the reports' data say, with their pictures, and lives with what was left out."""

import re
from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.error_summary import write_summary
from benchmarks.reports import SUBJECTS
from isogi_core.model.scene import load_scene
from isogi_core.report.sections import Section
from server.measure import view_of
from server.report.bundle import write_report
from server.report.journal import Entry
from server.report.report import Report
from tests.server.report_samples import sections

FULL, SHORT = "engine under grace at 70", "engine under uffizi at 70"


def measured() -> tuple[Section, ...]:
    """The samples, as the sections that the summary reads."""
    full = sections()[0]
    return tuple(replace(full, key=key) for key in ("tracing", "split", "convergence"))


@pytest.fixture(scope="module")
def docs(small_scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A summary of two reports; the second one has no sections."""
    scene, place = load_scene(small_scene), tmp_path_factory.mktemp("summary")
    for name, found in ((FULL, measured()), (SHORT, ())):
        (place / name).mkdir()
        entries = tuple(Entry(section, 1.0) for section in found)
        write_report(place / name, Report(scene, view_of(scene, 24), 1.0, entries))
    write_summary(place / "docs", {name: place / name for name in (FULL, SHORT)})
    return place / "docs"


def test_the_tables_hold_the_scores_and_the_parts(docs: Path) -> None:
    lines = (docs / "error.md").read_text(encoding="utf-8").replace("\u00a0", " ").splitlines()
    assert "| scene | plan | bytes per texel | relative RMSE, % | processor seconds, s |" in lines
    assert sum(line.startswith(f"| {FULL} | transfer | ") and line.endswith(" | 9.7 | 12.3 |") for line in lines) == 1
    assert "| scene | total, % | noise, % |" in lines
    assert f"| {FULL} | 9.7 | – |" in lines
    assert not any(line.startswith(f"| {SHORT} ") for line in lines)


def test_every_picture_is_there_and_none_besides(docs: Path) -> None:
    text = (docs / "error.md").read_text(encoding="utf-8")
    named = re.findall(r'(?:src="|\]\()([^")]+)', text)
    assert len(named) == 5
    assert sorted(named) == sorted(
        path.relative_to(docs).as_posix() for path in docs.rglob("*.*") if path.parent != docs
    )
    assert "blue 5 % too dark, red too bright" in text


def test_the_subjects_are_those_asked_for() -> None:
    named = {(subject.volume, subject.isovalue, subject.light) for subject in SUBJECTS}
    assert named >= {("engine", v, light) for v in (70, 170) for light in ("grace", "uffizi", "constant light")}
    assert {("CT head", 110), ("MNI brain", 90)} <= {(volume, isovalue) for volume, isovalue, _ in named}
    assert len({subject.folder for subject in SUBJECTS}) == len(SUBJECTS)
