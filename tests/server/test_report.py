"""``isogi report``: what it measures, keeps, refuses and says, with studies that cost nothing."""

import json
import signal
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from isogi_core.errors import ReportError
from isogi_core.model.scene import load_scene
from isogi_core.report.bench import Bench
from isogi_core.report.sections import Section
from isogi_core.report.studies import STUDIES, Study
from server.cli import run
from server.measure import view_of
from server.report import command
from server.report.journal import Entry, Journal, subject_of
from tests.server.report_samples import sections

Run = Callable[[Bench], Section]


@pytest.fixture
def ran(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Keys of the studies that were run, in order: one that gives the samples' first section, one its second."""
    keys: list[str] = []

    def study(section: Section) -> Study:
        def work(_: Bench) -> Section:
            keys.append(section.key)
            return section

        return Study(section.key, section.title, work, 1.0)

    plotless = (replace(section, plots=()) for section in sections())
    monkeypatch.setattr("isogi_core.report.studies.STUDIES", tuple(map(study, plotless)))
    return keys


def become(monkeypatch: pytest.MonkeyPatch, key: str, work: Run) -> None:
    """Have the study of this key do some other ``work``."""
    from isogi_core.report import studies

    changed = (replace(each, run=work) if each.key == key else each for each in studies.STUDIES)
    monkeypatch.setattr(studies, "STUDIES", tuple(changed))


def report(scene: Path, folder: Path, *more: object) -> int:
    return run(["report", str(scene), "-o", str(folder), "--size", "16", *map(str, more)])


def data_of(folder: Path) -> dict[str, Any]:
    data: dict[str, Any] = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    return data


def keys_of(folder: Path) -> list[str]:
    return [section["key"] for section in data_of(folder)["sections"]]


def test_it_writes_the_page_and_says_where(
    capsys: pytest.CaptureFixture[str], ran: list[str], small_scene: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "new" / "report"
    assert report(small_scene, folder, "--json", "--yaw", 30) == 0
    out, error = capsys.readouterr()
    facts = json.loads(out)
    assert Path(facts["page"]) == folder / "index.html"
    assert list(facts["sections"]) == ran == keys_of(folder) == ["split", "none"]
    assert (facts["missing"], facts["found"], facts["stopped"]) == ([], 0, False)
    assert "The error, by cause" in error and "left" in error
    assert data_of(folder)["view"]["width"] == 16
    assert data_of(folder)["view"]["light"][0] == pytest.approx(np.cos(np.radians(15)))


def test_what_is_done_is_not_done_again(
    capsys: pytest.CaptureFixture[str], ran: list[str], small_scene: Path, tmp_path: Path
) -> None:
    assert report(small_scene, tmp_path / "a") == 0
    before = (tmp_path / "a" / "index.html").read_bytes()
    capsys.readouterr()
    assert report(small_scene, tmp_path / "a") == 0
    assert ran == ["split", "none"]
    assert "2 of them measured before" in capsys.readouterr().out
    assert (tmp_path / "a" / "index.html").read_bytes() == before


def test_other_code_measures_again(
    monkeypatch: pytest.MonkeyPatch, ran: list[str], small_scene: Path, tmp_path: Path
) -> None:
    assert report(small_scene, tmp_path / "a") == 0
    monkeypatch.setattr("server.report.journal.code_digest", lambda: "other")
    assert report(small_scene, tmp_path / "a") == 0
    assert ran == ["split", "none"] * 2


def test_ctrl_c_leaves_a_page_of_what_is_done_and_the_next_run_goes_on(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    ran: list[str],
    small_scene: Path,
    tmp_path: Path,
) -> None:
    def stopped(bench: Bench) -> Section:
        signal.raise_signal(signal.SIGINT)
        bench.check()
        raise AssertionError("the work was not cancelled")

    with monkeypatch.context() as patch:
        become(patch, "none", stopped)
        assert report(small_scene, tmp_path / "a") == 1
    assert "Stopped by hand" in capsys.readouterr().out
    assert keys_of(tmp_path / "a") == ["split"]
    assert "Missing: Nothing to see" in (tmp_path / "a" / "index.html").read_text(encoding="utf-8")
    assert report(small_scene, tmp_path / "a") == 0
    assert ran == ["split", "none"]
    assert keys_of(tmp_path / "a") == ["split", "none"]
    assert data_of(tmp_path / "a")["notes"] == []


def test_what_does_not_fit_is_left_out_and_told(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    ran: list[str],
    small_scene: Path,
    tmp_path: Path,
) -> None:
    def endless(bench: Bench) -> Section:
        while True:
            bench.check()
            time.sleep(0.01)

    become(monkeypatch, "split", endless)
    assert report(small_scene, tmp_path / "a", "--deadline", "0.2s") == 0
    assert keys_of(tmp_path / "a") == []
    assert "200 ms did not suffice: The error, by cause, Nothing to see" in capsys.readouterr().out
    assert ran == []


def test_only_some_are_run_and_the_rest_is_told(ran: list[str], small_scene: Path, tmp_path: Path) -> None:
    assert report(small_scene, tmp_path / "a", "--only", "none") == 0
    assert (ran, keys_of(tmp_path / "a")) == (["none"], ["none"])
    assert data_of(tmp_path / "a")["notes"] == ["Not asked for: The error, by cause."]
    assert report(small_scene, tmp_path / "a", "--only", "split") == 0
    assert (ran, keys_of(tmp_path / "a")) == (["none", "split"], ["split", "none"])


@pytest.mark.parametrize(
    ("more", "word"),
    [
        (["--only", "everything"], "split, none"),
        (["--deadline", "soon"], "such as 90, 90s, 10m or 1h"),
        (["--size", "4"], "size"),
        (["--isovalue", "9"], "isovalue"),
        (["--shading", "phong"], "shading"),
    ],
)
def test_wrong_use_is_one_line_and_leaves_no_folder(
    capsys: pytest.CaptureFixture[str], ran: list[str], small_scene: Path, tmp_path: Path, more: list[str], word: str
) -> None:
    assert report(small_scene, tmp_path / "a", *more) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and word in error
    assert ran == [] and not any(tmp_path.iterdir())


def test_a_folder_of_another_report_is_refused(
    capsys: pytest.CaptureFixture[str], ran: list[str], small_scene: Path, tmp_path: Path
) -> None:
    assert report(small_scene, tmp_path / "a") == 0
    capsys.readouterr()
    assert report(small_scene, tmp_path / "a", "--isovalue", 0.6) == 1
    assert "a report of small at 0.5, which is another view (by its isovalue)" in capsys.readouterr().err
    assert report(Path("demo:orbital"), tmp_path / "a") == 1
    assert "which is another scene: choose another folder" in capsys.readouterr().err
    assert ran == ["split", "none"]


def test_a_folder_of_something_else_is_refused(
    capsys: pytest.CaptureFixture[str], ran: list[str], small_scene: Path, tmp_path: Path
) -> None:
    (tmp_path / "index.html").write_text("mine")
    assert report(small_scene, tmp_path) == 1
    assert "holds no report: choose a new or an empty folder" in capsys.readouterr().err
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("index.html", "mine")]
    assert ran == []


def test_a_missing_library_is_told_before_any_work(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, small_scene: Path, tmp_path: Path
) -> None:
    monkeypatch.setattr(command, "LIBRARIES", ("json", "no_such_library"))
    assert report(small_scene, tmp_path / "a") == 1
    assert capsys.readouterr().err == "isogi: A report is drawn with no_such_library: pip install 'isogi[report]'.\n"
    assert not any(tmp_path.iterdir())


def test_the_headline_is_the_summarys_first_row() -> None:
    table = sections()[0].tables[0]
    assert command.headline([replace(sections()[0], key="summary")]) == {
        column.name: cell for column, cell in list(zip(table.columns, table.rows[0], strict=True))[1:]
    }
    assert command.headline(sections()) == {}


def test_the_journal_keeps_sections_whole(small_scene: Path, tmp_path: Path) -> None:
    scene = load_scene(small_scene)
    subject = subject_of(scene, view_of(scene, 16))
    section = sections()[0]
    Journal(tmp_path / "a", subject).keep("split", Entry(section, 2.5))
    again = Journal(tmp_path / "a", subject)
    found = again.find("split")
    assert found is not None and again.find("none") is None
    assert (found.seconds, found.section.tables, found.section.about) == (2.5, section.tables, section.about)
    for picture, kept in zip(section.pictures, found.section.pictures, strict=True):
        assert (picture.caption, picture.kind) == (kept.caption, kept.kind)
        assert np.array_equal(picture.pixels, kept.pixels, equal_nan=True)
    (again.workshop() / "light").mkdir(parents=True)
    again.code = "other"
    assert not again.workshop().exists() and list(again.workshop().parent.iterdir()) == []
    with pytest.raises(ReportError, match=r"view \(by its size\)"):
        Journal(tmp_path / "a", {**subject, "size": [1, 1]})


def test_every_study_has_a_key_that_names_files_and_anchors() -> None:
    keys = [study.key for study in STUDIES]
    assert len(set(keys)) == len(keys) > 5
    assert all(key.isidentifier() and key != "setting" for key in keys)
    assert all(study.weight > 0 for study in STUDIES)
