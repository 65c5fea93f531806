"""The summary of reports says what their data say, with their pictures, and lives with what was
left out.
"""

import re
from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.accuracy.summary import PICTURES, summary_of
from benchmarks.common.measurement import Measurement
from isogi_report.journal import Entry
from isogi_report.page import write_report
from isogi_report.sections import Column, Section, Table
from tests.report.samples import SHARE, report_of, sections

FULL = "engine under grace at 70"
SHORT = "engine under uffizi at 70"


def measured() -> tuple[Section, ...]:
    """The samples, as the sections that the summary reads."""
    full = sections()[0]
    parts = Table(
        "",
        (Column("part"), SHARE),
        (("noise", 0.01), ("parts together", 0.5), ("total, measured", 0.0971)),
    )
    headline = Table("The frame", (SHARE, Column("bake", "seconds")), ((0.0971, 12.3),))
    told = {"split": parts, "summary": headline, "convergence": full.tables[0]}
    return tuple(replace(full, key=key, tables=(table,)) for key, table in told.items())


@pytest.fixture(scope="module")
def found(small_scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Measurement:
    """A summary of two reports; the second one has no sections."""
    place = tmp_path_factory.mktemp("summary")
    for name, done in ((FULL, measured()), (SHORT, ())):
        (place / name).mkdir()
        notes = () if done else ("Stopped by hand.",)
        write_report(
            place / name, report_of(small_scene, [Entry(section, 1.0) for section in done], notes)
        )
    return summary_of({name: place / name for name in (FULL, SHORT)})


def test_it_begins_with_the_parts_of_all_subjects(found: Measurement) -> None:
    lines = [line for line in found.text.replace("\u00a0", " ").splitlines() if line]
    assert lines[1] == "| scene | total, % | noise, % | bake, s |"
    assert lines[3] == f"| {FULL} | 9.7 | 1.0 | 12.3 |"
    assert "24 × 24 pixels" in lines[4]
    assert (
        found.figures[f"{FULL}: noise, %"] == pytest.approx(1.0)
        and found.figures[f"{FULL}: bake, s"] == 12.3
    )
    assert lines[5:7] == ["Not measured:", f"- {SHORT}: Stopped by hand."]


def test_the_last_table_holds_the_scores(found: Measurement) -> None:
    lines = found.text.replace("\u00a0", " ").splitlines()
    assert "| scene | plan | bytes per texel | relative RMSE, % | bake, s |" in lines
    assert lines[-1].startswith(f"| {FULL} | transfer | ") and lines[-1].endswith(" | 9.7 | 12.3 |")
    assert not any(line.startswith(f"| {SHORT} ") for line in lines)


def test_every_picture_is_there_and_none_besides(found: Measurement) -> None:
    text = found.text
    named = re.findall(r'(?:src="|\]\()([^")]+)', text)
    assert len(named) == 6
    assert sorted(named) == sorted(f"{PICTURES}/{file}" for file in found.pictures)
    assert "blue 5 % too dark, red too bright" in text
    assert text.count('width="48"') == 4, "twice as large"
