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

from isogi_core.errors import Cancelled, ReportError
from isogi_core.plan.assembly import load_scene
from isogi_report import command, measuring
from isogi_report.bench import Bench
from isogi_report.journal import Entry, open_journal, subject_of, workshop
from isogi_report.measuring import STUDIES, Study
from isogi_report.sections import Section
from isogi_report.speed import view_of
from server.cli.command import run
from tests.report.samples import sections

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
    monkeypatch.setattr(measuring, "STUDIES", tuple(map(study, plotless)))
    return keys


def become(monkeypatch: pytest.MonkeyPatch, key: str, work: Run) -> None:
    """Have the study of this key do some other ``work``."""
    changed = (replace(each, run=work) if each.key == key else each for each in measuring.STUDIES)
    monkeypatch.setattr(measuring, "STUDIES", tuple(changed))


def check(bench: Bench) -> None:
    """What work does now and then."""
    if bench.cancelled.is_set():
        raise Cancelled("The report was stopped.")


def report(scene: Path, folder: Path, *more: object) -> int:
    return run(["report", str(scene), "-o", str(folder), "--size", "24", *map(str, more)])


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
    assert data_of(folder)["view"]["width"] == 24
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
    monkeypatch.setattr("isogi_report.journal.code_digest", lambda: "other")
    assert report(small_scene, tmp_path / "a") == 0
    assert ran == ["split", "none"] * 2


def test_ctrl_c_leaves_a_page_and_the_next_run_goes_on(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    ran: list[str],
    small_scene: Path,
    tmp_path: Path,
) -> None:
    def stopped(bench: Bench) -> Section:
        signal.raise_signal(signal.SIGINT)
        assert signal.getsignal(signal.SIGINT) is signal.SIG_DFL, "the next one ends the process"
        check(bench)
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
            check(bench)
            time.sleep(0.01)

    become(monkeypatch, "split", endless)
    assert report(small_scene, tmp_path / "a", "--deadline", "0.2s") == 0
    assert keys_of(tmp_path / "a") == []
    assert "200 ms did not suffice: The error, by cause, Nothing to see" in capsys.readouterr().out
    assert ran == []


def test_what_gave_way_to_time_is_shown_and_measured_anew(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    ran: list[str],
    small_scene: Path,
    tmp_path: Path,
) -> None:
    def hasty(bench: Bench) -> Section:
        bench.hurry.set()
        return sections()[1]

    with monkeypatch.context() as patch:
        become(patch, "none", hasty)
        assert report(small_scene, tmp_path / "a", "--json") == 0
    facts = json.loads(capsys.readouterr().out)
    assert (facts["hurried"], facts["missing"], keys_of(tmp_path / "a")) == (["none"], [], ["split", "none"])
    assert "Cut short for want of time: Nothing to see." in facts["notes"][0]
    assert report(small_scene, tmp_path / "a") == 0
    assert (ran, data_of(tmp_path / "a")["notes"]) == (["split", "none"], [])


def test_a_study_that_fails_is_told_and_the_rest_is_measured(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    ran: list[str],
    small_scene: Path,
    tmp_path: Path,
) -> None:
    def broken(_: Bench) -> Section:
        raise ValueError("no light\nat all")

    with monkeypatch.context() as patch:
        become(patch, "split", broken)
        assert report(small_scene, tmp_path / "a", "--json") == 1
    facts = json.loads(capsys.readouterr().out)
    assert (facts["failed"], facts["missing"], keys_of(tmp_path / "a")) == (["split"], [], ["none"])
    assert facts["notes"] == ["Failed: The error, by cause (ValueError: no light at all)."]
    assert report(small_scene, tmp_path / "a") == 0
    assert (ran, keys_of(tmp_path / "a")) == (["none", "split"], ["split", "none"])


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
        (["--eye", "900,0,0", "--target", "999,0,0"], "Nothing is to be seen at isovalue 0.5"),
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
    assert report(small_scene, tmp_path / "a", "--exposure", 3) == 1
    assert "which is another view (by its exposure)" in capsys.readouterr().err
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
    monkeypatch.setattr(command, "PAGE_LIBRARIES", ("json", "no_such_library"))
    assert report(small_scene, tmp_path / "a") == 1
    assert capsys.readouterr().err == "isogi: A report is drawn with no_such_library: pip install 'isogi[report]'.\n"
    assert not any(tmp_path.iterdir())


def test_the_headline_is_the_summarys_first_row() -> None:
    table = sections()[0].tables[0]
    assert command.headline([replace(sections()[0], key="summary")]) == {
        column.name: cell for column, cell in list(zip(table.columns, table.rows[0], strict=True))[1:]
    }
    assert command.headline(sections()) == {}


@pytest.fixture
def subject(small_scene: Path) -> dict[str, Any]:
    scene = load_scene(small_scene)
    return subject_of(scene, view_of(scene, 16), 1.0)


def test_the_journal_keeps_sections_whole(subject: dict[str, Any], tmp_path: Path) -> None:
    section = sections()[0]
    with open_journal(tmp_path / "a", subject) as journal:
        journal.keep("split", Entry(section, 2.5))
    with open_journal(tmp_path / "a", subject) as again:
        found = again.find("split")
        assert found is not None and again.find("none") is None
    assert (found.seconds, found.section.tables, found.section.about) == (2.5, section.tables, section.about)
    for picture, kept in zip(section.pictures, found.section.pictures, strict=True):
        assert (picture.caption, picture.kind) == (kept.caption, kept.kind)
        assert np.array_equal(picture.pixels, kept.pixels, equal_nan=True)
    with (
        pytest.raises(ReportError, match=r"view \(by its size\)"),
        open_journal(tmp_path / "a", {**subject, "size": [1, 1]}),
    ):
        pass


def test_a_journal_without_sections_is_anyones(subject: dict[str, Any], tmp_path: Path) -> None:
    with open_journal(tmp_path, subject):
        (workshop(tmp_path) / "light").mkdir(parents=True)
    with open_journal(tmp_path, subject):
        assert (workshop(tmp_path) / "light").exists(), "the same report goes on with it"
    with open_journal(tmp_path, {**subject, "size": [1, 1]}) as journal:
        assert not (tmp_path / "work").exists()
        journal.keep("none", Entry(sections()[1], 1.0))
    with pytest.raises(ReportError, match=r"view \(by its size\)"), open_journal(tmp_path, subject):
        pass


def test_what_other_code_made_goes(monkeypatch: pytest.MonkeyPatch, subject: dict[str, Any], tmp_path: Path) -> None:
    with open_journal(tmp_path, subject):
        workshop(tmp_path).mkdir(parents=True)
    monkeypatch.setattr("isogi_report.journal.code_digest", lambda: "other")
    with open_journal(tmp_path, subject):
        assert list((tmp_path / "work").iterdir()) == []


@pytest.mark.parametrize("name", ["split.json", "split.npz"])
@pytest.mark.parametrize("damage", [lambda data: data[: len(data) // 2], lambda data: b"[]", lambda data: b""])
def test_a_damaged_entry_is_measured_again(
    subject: dict[str, Any], tmp_path: Path, name: str, damage: Callable[[bytes], bytes]
) -> None:
    with open_journal(tmp_path, subject) as journal:
        journal.keep("split", Entry(sections()[0], 2.5))
        path = tmp_path / "journal" / name
        path.write_bytes(damage(path.read_bytes()))
        assert journal.find("split") is None


def test_one_report_at_a_time_writes_a_folder(
    capsys: pytest.CaptureFixture[str], ran: list[str], small_scene: Path, tmp_path: Path, subject: dict[str, Any]
) -> None:
    with open_journal(tmp_path, subject):
        assert report(small_scene, tmp_path) == 1
    assert "is being written by another report: wait for its end" in capsys.readouterr().err
    assert ran == []


def test_a_report_looks_from_near_unless_told() -> None:
    assert command.standing({"azimuth": "7"}) == {"azimuth": "7", "elevation": 30.0, "distance": 2.2}
    assert command.standing({"eye": "1,2,3"}) == {"eye": "1,2,3"}


def test_the_sentence_counts() -> None:
    facts = {"page": "p", "sections": {"a": 1.0}, "found": 0, "headline": {}, "notes": []}
    assert command.sentence(facts) == "p: 1 section."
    assert "2 sections, 1 of them" in command.sentence({**facts, "sections": {"a": 1.0, "b": 1.0}, "found": 1})


def test_every_study_has_a_key_that_names_files_and_anchors() -> None:
    keys = [study.key for study in STUDIES]
    assert keys == ["summary", "split", "convergence"]
    assert all(key.isidentifier() and key != "setting" for key in keys)
    assert all(study.weight > 0 for study in STUDIES)
