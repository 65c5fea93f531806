"""``isogi report``: what it measures, keeps, refuses and says, with studies that cost nothing."""

import json
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from isogi_core.errors import Cancelled, ReportError
from isogi_core.plan.assembly import load_scene
from isogi_report import command as report
from isogi_report import journal as journals
from isogi_report import measuring
from isogi_report.bench import Bench
from isogi_report.journal import Entry, open_journal, subject_of, workshop
from isogi_report.measuring import STUDIES, Study
from isogi_report.sections import Section
from isogi_report.speed import view_of
from isogi_server.cli.command import run
from tests.report.samples import sections

Run = Callable[[Bench], Section]


class Command:
    """``isogi report`` of the small scene into a folder, by studies that cost nothing.

    ``ran`` has the keys of those that were run, in order: one gives the samples' first section, one
    their second.
    """

    def __init__(
        self,
        scene: Path,
        place: Path,
        patch: pytest.MonkeyPatch,
        capsys: pytest.CaptureFixture[str],
    ) -> None:
        self.scene = scene
        self.place = place
        self.folder = place / "a"
        self.ran: list[str] = []
        self._patch = patch
        self._capsys = capsys
        plotless = (replace(section, plots=()) for section in sections())
        patch.setattr(measuring, "STUDIES", tuple(map(self._study, plotless)))

    def _study(self, section: Section) -> Study:
        def work(_: Bench) -> Section:
            self.ran.append(section.key)
            return section

        return Study(section.key, section.title, work, 1.0)

    def run(
        self, *more: object, scene: Path | None = None, folder: Path | None = None
    ) -> tuple[int, str, str]:
        """Status, output and errors."""
        words = [
            str(scene or self.scene),
            "-o",
            str(folder or self.folder),
            "--size",
            "24",
            *map(str, more),
        ]
        status = run(["report", *words])
        return status, *self._capsys.readouterr()

    def facts(self, *more: object, status: int = 0) -> dict[str, Any]:
        """What ``--json`` tells of a run that ends with this status."""
        ended, out, _ = self.run("--json", *more)
        assert ended == status
        facts: dict[str, Any] = json.loads(out)
        return facts

    @contextmanager
    def having(self, key: str, work: Run) -> Iterator[None]:
        """Meanwhile the study of this key does some other ``work``."""
        with self._patch.context() as patch:
            changed = (
                replace(each, run=work) if each.key == key else each for each in measuring.STUDIES
            )
            patch.setattr(measuring, "STUDIES", tuple(changed))
            yield

    @property
    def data(self) -> dict[str, Any]:
        """The data of the report."""
        data: dict[str, Any] = json.loads((self.folder / "report.json").read_text(encoding="utf-8"))
        return data

    @property
    def keys(self) -> list[str]:
        """The sections of the report."""
        return [section["key"] for section in self.data["sections"]]


@pytest.fixture
def command(
    small_scene: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> Command:
    return Command(small_scene, tmp_path, monkeypatch, capsys)


def check(bench: Bench) -> None:
    """What work does now and then."""
    if bench.cancelled.is_set():
        raise Cancelled("The report was stopped.")


def test_it_writes_the_page_and_says_where(command: Command) -> None:
    command.folder = command.place / "new" / "report"
    status, out, error = command.run("--json", "--yaw", 30)
    facts = json.loads(out)
    assert status == 0 and Path(facts["page"]) == command.folder / "index.html"
    assert list(facts["sections"]) == command.ran == command.keys == ["split", "none"]
    assert (facts["missing"], facts["found"], facts["stopped"]) == ([], 0, False)
    assert "The error, by cause" in error and "left" in error
    assert command.data["view"]["width"] == 24
    assert command.data["view"]["light"][0] == pytest.approx(np.cos(np.radians(15)))


def test_what_is_done_is_not_done_again(command: Command) -> None:
    command.run()
    before = (command.folder / "index.html").read_bytes()
    status, out, _ = command.run()
    assert (status, command.ran) == (0, ["split", "none"]) and "2 of them measured before" in out
    assert (command.folder / "index.html").read_bytes() == before


def test_other_code_measures_again(monkeypatch: pytest.MonkeyPatch, command: Command) -> None:
    command.run()
    monkeypatch.setattr("isogi_report.journal.code_digest", lambda: "other")
    assert command.run()[0] == 0
    assert command.ran == ["split", "none"] * 2


def test_ctrl_c_leaves_a_page_and_the_next_run_goes_on(command: Command) -> None:
    def stopped(bench: Bench) -> Section:
        signal.raise_signal(signal.SIGINT)
        assert signal.getsignal(signal.SIGINT) is signal.SIG_DFL, "the next one ends the process"
        check(bench)
        raise AssertionError("the work was not cancelled")

    with command.having("none", stopped):
        status, out, _ = command.run()
    assert (status, command.keys) == (1, ["split"]) and "Stopped by hand" in out
    assert "Missing: Nothing to see" in (command.folder / "index.html").read_text(encoding="utf-8")
    assert command.run()[0] == 0
    assert command.ran == command.keys == ["split", "none"]
    assert command.data["notes"] == []


def test_ctrl_c_in_a_last_study_that_ends_is_no_stop(command: Command) -> None:
    def unmoved(_: Bench) -> Section:
        signal.raise_signal(signal.SIGINT)
        return sections()[1]

    with command.having("none", unmoved):
        facts = command.facts()
    assert (facts["stopped"], facts["missing"], facts["notes"]) == (False, [], [])
    assert command.keys == ["split", "none"]


def test_what_does_not_fit_is_left_out_and_told(command: Command) -> None:
    def endless(bench: Bench) -> Section:
        while True:
            check(bench)
            time.sleep(0.01)

    with command.having("split", endless):
        status, out, _ = command.run("--deadline", "0.2s")
    assert (status, command.keys, command.ran) == (0, [], [])
    assert "200 ms did not suffice: The error, by cause, Nothing to see" in out


def test_what_gave_way_to_time_is_shown_and_measured_anew(command: Command) -> None:
    def hasty(bench: Bench) -> Section:
        bench.hurry.set()
        return sections()[1]

    with command.having("none", hasty):
        facts = command.facts()
    assert (facts["hurried"], facts["missing"], command.keys) == (["none"], [], ["split", "none"])
    assert "Cut short for want of time: Nothing to see." in facts["notes"][0]
    assert command.run()[0] == 0
    assert (command.ran, command.data["notes"]) == (["split", "none"], [])


def test_a_study_that_fails_is_told_and_the_rest_is_measured(command: Command) -> None:
    def broken(_: Bench) -> Section:
        raise ValueError("no light\nat all")

    with command.having("split", broken):
        facts = command.facts(status=1)
    assert (facts["failed"], facts["missing"], command.keys) == (["split"], [], ["none"])
    assert facts["notes"] == ["Failed: The error, by cause (ValueError: no light at all)."]
    assert command.run()[0] == 0
    assert (command.ran, command.keys) == (["none", "split"], ["split", "none"])


def test_only_some_are_run_and_the_rest_is_told(command: Command) -> None:
    assert command.run("--only", "none")[0] == 0
    assert (command.ran, command.keys) == (["none"], ["none"])
    assert command.data["notes"] == ["Not asked for: The error, by cause."]
    assert command.run("--only", "split")[0] == 0
    assert (command.ran, command.keys) == (["none", "split"], ["split", "none"])


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
    command: Command, more: list[str], word: str
) -> None:
    status, _, error = command.run(*more)
    assert status == 2 and error.count("\n") == 1 and word in error
    assert command.ran == [] and not any(command.place.iterdir())


def test_a_folder_of_another_report_is_refused(command: Command) -> None:
    command.run()
    for more, scene, word in (
        (
            ["--isovalue", 0.6],
            None,
            "a report of small at 0.5, which is another view (by its isovalue)",
        ),
        (["--exposure", 3], None, "which is another view (by its exposure)"),
        ([], Path("demo:orbital"), "which is another scene: choose another folder"),
    ):
        status, _, error = command.run(*more, scene=scene)
        assert status == 1 and word in error
    assert command.ran == ["split", "none"]


def test_a_folder_of_something_else_is_refused(command: Command) -> None:
    (command.place / "index.html").write_text("mine")
    status, _, error = command.run(folder=command.place)
    assert status == 1 and "holds no report: choose a new or an empty folder" in error
    assert [(path.name, path.read_text()) for path in command.place.iterdir()] == [
        ("index.html", "mine")
    ]
    assert command.ran == []


def test_a_missing_library_is_told_before_any_work(
    monkeypatch: pytest.MonkeyPatch, command: Command
) -> None:
    monkeypatch.setattr(report, "PAGE_LIBRARIES", ("json", "no_such_library"))
    told = "isogi: A report is drawn with no_such_library: pip install 'isogi[report]'.\n"
    assert command.run() == (1, "", told)
    assert not any(command.place.iterdir())


def test_the_headline_is_the_summarys_first_row() -> None:
    table = sections()[0].tables[0]
    assert report.headline([replace(sections()[0], key="summary")]) == {
        column.name: cell
        for column, cell in list(zip(table.columns, table.rows[0], strict=True))[1:]
    }
    assert report.headline(sections()) == {}


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
    assert (found.seconds, found.section.tables, found.section.about) == (
        2.5,
        section.tables,
        section.about,
    )
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


def test_what_other_code_made_goes(
    monkeypatch: pytest.MonkeyPatch, subject: dict[str, Any], tmp_path: Path
) -> None:
    with open_journal(tmp_path, subject):
        workshop(tmp_path).mkdir(parents=True)
    monkeypatch.setattr("isogi_report.journal.code_digest", lambda: "other")
    with open_journal(tmp_path, subject):
        assert list((tmp_path / "work").iterdir()) == []


@pytest.mark.parametrize("name", ["split.json", "split.npz"])
@pytest.mark.parametrize(
    "damage", [lambda data: data[: len(data) // 2], lambda data: b"[]", lambda data: b""]
)
def test_a_damaged_entry_is_measured_again(
    subject: dict[str, Any], tmp_path: Path, name: str, damage: Callable[[bytes], bytes]
) -> None:
    with open_journal(tmp_path, subject) as journal:
        journal.keep("split", Entry(sections()[0], 2.5))
        path = tmp_path / "journal" / name
        path.write_bytes(damage(path.read_bytes()))
        assert journal.find("split") is None


def test_pixels_of_another_run_are_not_shown(
    subject: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A process ends between the writes of an entry that was there before."""
    section = sections()[0]
    brighter = tuple(replace(each, pixels=2.0 * each.pixels) for each in section.pictures)
    whole = journals.write_whole

    def cut(path: Path, data: bytes) -> None:
        if path.suffix == ".json":
            raise KeyboardInterrupt
        whole(path, data)

    with open_journal(tmp_path, subject) as journal:
        journal.keep("split", Entry(section, 2.5))
        with monkeypatch.context() as patch:
            patch.setattr(journals, "write_whole", cut)
            with pytest.raises(KeyboardInterrupt):
                journal.keep("split", Entry(replace(section, pictures=brighter), 2.5))
        assert journal.find("split") is None


def test_one_report_at_a_time_writes_a_folder(command: Command, subject: dict[str, Any]) -> None:
    with open_journal(command.folder, subject):
        status, _, error = command.run()
    assert status == 1 and "is being written by another report: wait for its end" in error
    assert command.ran == []


def test_a_report_looks_from_near_unless_told() -> None:
    assert report.standing({"azimuth": "7"}) == {"azimuth": "7", "elevation": 30.0, "distance": 2.2}
    assert report.standing({"eye": "1,2,3"}) == {"eye": "1,2,3"}


def test_the_sentence_counts() -> None:
    facts = {"page": "p", "sections": {"a": 1.0}, "found": 0, "headline": {}, "notes": []}
    assert report.sentence(facts) == "p: 1 section."
    assert "2 sections, 1 of them" in report.sentence(
        {**facts, "sections": {"a": 1.0, "b": 1.0}, "found": 1}
    )


def test_every_study_has_a_key_that_names_files_and_anchors() -> None:
    keys = [study.key for study in STUDIES]
    assert keys == ["summary", "split", "convergence"]
    assert all(key.isidentifier() and key != "setting" for key in keys)
    assert all(study.weight > 0 for study in STUDIES)
